"""Three days of the flat, on the third of which something has changed, and another building."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from specmap_cli.grids.gridmap import FREE, OCCUPIED, GridMap
from specmap_cli.pipelines.build import build_map
from specmap_cli.pipelines.simulate import simulate
from specmap_cli.pipelines.update import update_map
from specmap_cli.simulation import simulator
from specmap_cli.simulation.simulator import SimulationOptions
from tests.flats import QUICK, Mapped, mapped
from tests.sharing import made_once

_DAY_NS = 86_400 * 1_000_000_000
_FIRST_NS = 1_764_000_000 * 1_000_000_000  # 2025-11-24 in UTC


@contextmanager
def day(number: int) -> Iterator[None]:
    """Tours begin on this day, in a moment that is no whole microsecond."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(simulator, "START_NS", _FIRST_NS + number * _DAY_NS + 123_456_789)
        yield


def toured(plan: GridMap, folder: Path, seed: int) -> Path:
    """The recording of a tour by a robot that does not see behind itself."""
    options = SimulationOptions(beams=120, range_max_m=12, rate_hz=3, speed_mps=0.9, seed=seed)
    return simulate(plan, options, folder / f"seed{seed}.mcap").log


def rebuilt(flat: GridMap) -> GridMap:
    """The flat with a closed door, a cabinet more, and a hole in a wall."""
    cells = flat.cells.copy()
    cells[39:41, 140:158] = OCCUPIED  # the door of the third room
    cells[60:76, 108:116] = OCCUPIED  # a cabinet of 0.4 m x 0.8 m in the second room
    cells[70:90, 116:120] = FREE  # from the second room to the third
    return GridMap(cells, flat.resolution)


@pytest.fixture(scope="session")
def week(flat: GridMap, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A map of the flat, the same with another log, and one after the changes."""

    def make(folder: Path) -> Path:
        maps = folder / "maps"
        with day(0):
            build_map(toured(flat, folder, 3), maps / "monday", QUICK)
        with day(1):
            update_map(maps / "monday", toured(flat, folder, 21), maps / "tuesday", QUICK)
        with day(2):
            build_map(toured(rebuilt(flat), folder, 9), maps / "wednesday", QUICK)
        return maps

    return made_once(tmp_path_factory, "week", make)


@pytest.fixture(scope="session")
def sunday(
    flat: GridMap, flat_options: SimulationOptions, tmp_path_factory: pytest.TempPathFactory
) -> Mapped:
    """A tour of the flat on the day before: its third room could be neither entered nor seen."""
    cells = flat.cells.copy()
    cells[38:42, 140:158] = OCCUPIED
    plan, once = GridMap(cells, flat.resolution), flat_options.model_copy(update={"laps": 1})

    def make(folder: Path) -> Mapped:
        with day(-1):
            return mapped(plan, once, folder)

    return made_once(tmp_path_factory, "sunday", make)


@pytest.fixture(scope="session")
def other(flat_options: SimulationOptions, tmp_path_factory: pytest.TempPathFactory) -> Mapped:
    """Another building: two rooms above each other, none like a room of the flat."""
    cells = np.full((200, 120), OCCUPIED, dtype=np.uint8)
    cells[4:90, 4:60] = FREE
    cells[94:196, 4:116] = FREE
    cells[90:94, 30:50] = FREE
    cells[120:140, 60:70] = OCCUPIED
    plan, once = GridMap(cells, 0.05), flat_options.model_copy(update={"laps": 1, "seed": 5})
    return made_once(tmp_path_factory, "other", lambda folder: mapped(plan, once, folder))
