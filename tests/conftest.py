"""Worlds and recordings that several test modules share; each is made once a session."""

import signal
import sys
from collections.abc import Iterator
from functools import cache
from importlib.metadata import EntryPoints, entry_points
from pathlib import Path

import numpy as np
import pytest
import typer
from hypothesis import HealthCheck, settings

from specmap_cli.core import plugins
from specmap_cli.core.geometry import Pose2
from specmap_cli.core.process import one_blas_thread
from specmap_cli.core.records import Sweep
from specmap_cli.grids.gridmap import FREE, OCCUPIED, GridMap
from specmap_cli.grids.map_server import read_grid, write_grid
from specmap_cli.maps.store import Map, read_map
from specmap_cli.pipelines.build import build_map
from specmap_cli.pipelines.simulate import SimulationResult, simulate
from specmap_cli.simulation.simulator import SimulationOptions, simulated_tour
from specmap_cli.simulation.worlds import RoomTruth, read_rooms
from tests.flats import TRAINED, Explained, Mapped, mapped, record_tour
from tests.house import house, result
from tests.sharing import made_once
from tests.strategies import FEW_CASES, MANY, MANY_CASES
from tests.turning import turning_back

__all__ = ["house", "result"]  # fixtures for all

settings.register_profile(
    "specmap",
    derandomize=not MANY,  # those are of `--hypothesis-seed`
    deadline=None,
    max_examples=MANY_CASES if MANY else FEW_CASES,
    suppress_health_check=[HealthCheck.too_slow],  # a busy machine is no failure
)
settings.load_profile("specmap")

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # a shell does so to what it runs behind `&`
    signal.signal(signal.SIGINT, signal.default_int_handler)

SAMPLE_LOGS = Path(__file__).parent.parent / "sample_logs"

# bottom, top, left and right cell of the three rooms and the corridor of `flat`
FLAT_ROOMS = ((42, 116, 4, 64), (42, 100, 68, 116), (42, 116, 120, 176), (4, 38, 4, 176))


@cache
def _offered(group: str, _path: tuple[str, ...]) -> EntryPoints:
    return entry_points(group=group)


@pytest.fixture(scope="session", autouse=True)
def _what_stays_the_same_is_found_once() -> Iterator[None]:
    """Some thousand times a log is opened, and some hundred times a command run in this process.

    Each log asks which packages add readers, 3 ms; each command makes all commands anew, 15 ms.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(plugins, "entry_points", lambda group: _offered(group, tuple(sys.path)))
        patch.setattr(typer.main, "get_command", cache(typer.main.get_command))
        yield


@pytest.fixture(scope="session", autouse=True)
def _one_thread() -> Iterator[None]:
    """As the commands work; and a worker has one processor."""
    with one_blas_thread():
        yield


@pytest.fixture(scope="session")
def flat() -> GridMap:
    """Three rooms of different sizes above a corridor, 9 m x 6 m, doors 0.9 m wide."""
    cells = np.full((120, 180), OCCUPIED, dtype=np.uint8)
    for bottom, top, left, right in FLAT_ROOMS:
        cells[bottom:top, left:right] = FREE
    for left in (25, 85, 140):
        cells[38:42, left : left + 18] = FREE
    cells[90:100, 20:34] = OCCUPIED  # a desk, so that the first room is not symmetric
    return GridMap(cells, 0.05)


@pytest.fixture(scope="session")
def plan(flat: GridMap, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The YAML of `flat`, its picture beside it."""
    stem = tmp_path_factory.mktemp("plan") / "flat"
    write_grid(stem, flat)
    return stem.with_suffix(".yaml")


@pytest.fixture(scope="session")
def flat_rooms() -> RoomTruth:
    """The rooms of `flat`: 1 to 3 above, from the left, and 4 the corridor."""
    labels = np.zeros((120, 180), dtype=np.int32)
    for number, (bottom, top, left, right) in enumerate(FLAT_ROOMS, start=1):
        labels[bottom:top, left:right] = number
    return RoomTruth(labels, 0.05)


@pytest.fixture(scope="session")
def flat_options() -> SimulationOptions:
    """A coarse full-circle laser at 3 Hz, two laps."""
    return SimulationOptions(
        field_of_view_deg=360, beams=120, range_max_m=12, rate_hz=3, speed_mps=0.9, laps=2, seed=3
    )


@pytest.fixture(scope="session")
def flat_tour(flat: GridMap, flat_options: SimulationOptions) -> list[tuple[Sweep, Pose2]]:
    """Two laps through `flat` with their true poses."""
    return list(simulated_tour(flat, flat_options).scans())


@pytest.fixture(scope="session")
def flat_log(
    flat: GridMap, flat_options: SimulationOptions, tmp_path_factory: pytest.TempPathFactory
) -> SimulationResult:
    """The recording of `flat_tour` as a file, its truth beside it."""
    return made_once(
        tmp_path_factory, "flat", lambda folder: simulate(flat, flat_options, folder / "flat.mcap")
    )


@pytest.fixture(scope="session")
def flat_built(flat_log: SimulationResult, tmp_path_factory: pytest.TempPathFactory) -> Explained:
    """A build whose paths are given as text."""

    def make(folder: Path) -> Explained:
        out, pictures = folder / "map", folder / "pictures"
        report = build_map(str(flat_log.log), str(out), TRAINED, explain=str(pictures))
        return Explained(report, pictures)

    return made_once(tmp_path_factory, "flat_built", make)


@pytest.fixture(scope="session")
def flat_map(flat_built: Explained) -> Map:
    """The map of `flat_log`."""
    return read_map(flat_built.report.out)


@pytest.fixture(scope="session")
def first_tour(
    flat: GridMap, flat_options: SimulationOptions, tmp_path_factory: pytest.TempPathFactory
) -> Mapped:
    """One lap through the flat."""
    options = flat_options.model_copy(update={"laps": 1})
    return made_once(tmp_path_factory, "first", lambda folder: mapped(flat, options, folder))


@pytest.fixture(scope="session")
def second_tour(
    flat: GridMap, flat_options: SimulationOptions, tmp_path_factory: pytest.TempPathFactory
) -> Mapped:
    """Another one, on another way."""
    options = flat_options.model_copy(update={"laps": 1, "seed": 8, "spacing_m": 1.5})
    return made_once(tmp_path_factory, "second", lambda folder: mapped(flat, options, folder))


@pytest.fixture(scope="session")
def tiny_log(flat: GridMap, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Twelve seconds of a tour."""

    def make(folder: Path) -> Path:
        return record_tour(flat, folder / "tiny.mcap", max_duration_s=12)

    return made_once(tmp_path_factory, "tiny", make)


@pytest.fixture(scope="session")
def office() -> GridMap:
    """The plan of the sample logs."""
    return read_grid(SAMPLE_LOGS / "office.yaml")


@pytest.fixture(scope="session")
def office_rooms() -> RoomTruth:
    """The rooms of the plan of the sample logs."""
    return read_rooms(SAMPLE_LOGS / "office_rooms.png", 0.05)


@pytest.fixture(autouse=True)
def _constants() -> Iterator[None]:
    with turning_back():
        yield
