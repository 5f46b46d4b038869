"""Worlds and recordings that several test modules share; each is made once a session."""

from __future__ import annotations

import signal
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, settings

from specmap_cli.core.geometry import Pose2
from specmap_cli.core.records import Sweep
from specmap_cli.grids.gridmap import FREE, OCCUPIED, GridMap
from specmap_cli.grids.map_server import read_grid
from specmap_cli.pipelines.simulate import SimulationResult, simulate
from specmap_cli.simulation.room_truth import RoomTruth, read_rooms
from specmap_cli.simulation.simulator import SimulationOptions, simulate_sweeps
from tests.house import result

__all__ = ["result"]  # a fixture for all

settings.register_profile(
    "specmap",
    derandomize=True,
    deadline=None,
    max_examples=40,
    suppress_health_check=[HealthCheck.too_slow],  # a busy machine is no failure
)
settings.load_profile("specmap")

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # a shell does so to what it runs behind `&`
    signal.signal(signal.SIGINT, signal.default_int_handler)

SAMPLE_LOGS = Path(__file__).parent.parent / "sample_logs"

# bottom, top, left and right cell of the three rooms and the corridor of `flat`
FLAT_ROOMS = ((42, 116, 4, 64), (42, 100, 68, 116), (42, 116, 120, 176), (4, 38, 4, 176))


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
def flat_rooms() -> RoomTruth:
    """The rooms of `flat`: 1 to 3 above, from the left, and 4 the corridor."""
    labels = np.zeros((120, 180), dtype=np.int32)
    for number, (bottom, top, left, right) in enumerate(FLAT_ROOMS, start=1):
        labels[bottom:top, left:right] = number
    return RoomTruth(labels, 0.05)


@pytest.fixture(scope="session")
def flat_options() -> SimulationOptions:
    """A coarse full-circle laser at 5 Hz, two laps."""
    return SimulationOptions(
        field_of_view_deg=360, beams=180, range_max_m=12, rate_hz=5, laps=2, seed=3
    )


@pytest.fixture(scope="session")
def flat_tour(flat: GridMap, flat_options: SimulationOptions) -> list[tuple[Sweep, Pose2]]:
    """Two laps through `flat` with their true poses."""
    return list(simulate_sweeps(flat, flat_options))


@pytest.fixture(scope="session")
def flat_log(
    flat: GridMap, flat_options: SimulationOptions, tmp_path_factory: pytest.TempPathFactory
) -> SimulationResult:
    """The recording of `flat_tour` as a file, its truth beside it."""
    return simulate(flat, flat_options, tmp_path_factory.mktemp("flat") / "flat.mcap")


@pytest.fixture(scope="session")
def office() -> GridMap:
    """The plan of the sample logs."""
    return read_grid(SAMPLE_LOGS / "office.yaml")


@pytest.fixture(scope="session")
def office_rooms() -> RoomTruth:
    """The rooms of the plan of the sample logs."""
    return read_rooms(SAMPLE_LOGS / "office_rooms.png", 0.05)
