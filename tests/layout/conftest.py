"""A robot that drove one and a half laps through the ring; made once."""

from collections.abc import Iterator

import pytest

from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.layout.path_graph import Graph, graph_of
from specmap_cli.layout.walls import Walls
from tests.layout.driving import (
    SECOND_LAP,
    Drive,
    Laps,
    building,
    drifted,
    round_trip,
    scans_of,
    stored,
)


@pytest.fixture(scope="session")
def drive() -> Drive:
    """True poses of 1.5 laps and the scans taken there."""
    truth = round_trip()
    return truth, scans_of(building(), truth)


@pytest.fixture
def store(drive: Drive) -> Iterator[KeyframeStore]:
    """The drive as it was tracked, with some drift."""
    truth, scans = drive
    with stored(drifted(truth), scans) as store:
        yield store


@pytest.fixture(scope="session")
def perfect(drive: Drive) -> Iterator[Laps]:
    """The drive as it was, and its graph, with a break where the second lap begins."""
    truth, scans = drive
    with stored(truth, scans) as store:
        yield store, graph_of(store, [], {SECOND_LAP: None})


@pytest.fixture(scope="session")
def graph(perfect: Laps) -> Graph:
    """The graph of the drive as it was, its second lap a part."""
    return perfect[1]


@pytest.fixture(scope="session")
def walls(perfect: Laps) -> Walls:
    """What was seen on the drive as it was."""
    return Walls(*perfect)
