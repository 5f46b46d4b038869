"""A robot that drove one and a half laps through the ring; made once."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import PlanarScan
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.layout.path_graph import Graph, graph_of
from tests.layout.driving import building, drifted, round_trip, scans_of, stored


@pytest.fixture(scope="session")
def drive() -> tuple[FloatArray, list[PlanarScan]]:
    """True poses of 1.5 laps and the scans taken there."""
    truth = round_trip(1.5)
    return truth, scans_of(building(), truth)


@pytest.fixture
def store(drive: tuple[FloatArray, list[PlanarScan]]) -> Iterator[KeyframeStore]:
    """The drive as it was tracked, with some drift."""
    truth, scans = drive
    with stored(drifted(truth), scans) as store:
        yield store


@pytest.fixture(scope="session")
def perfect(
    drive: tuple[FloatArray, list[PlanarScan]],
) -> Iterator[tuple[KeyframeStore, Graph]]:
    """The drive as it was, and its graph, with a break where the second lap begins."""
    truth, scans = drive
    second_lap = 480
    with stored(truth, scans) as store:
        yield store, graph_of(store, [], [second_lap])
