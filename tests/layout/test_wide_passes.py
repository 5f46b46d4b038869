"""Passes searched as far as the path's error reaches, and claimed only where they are clear."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from specmap_cli.core.geometry import FloatArray, Pose2, compose
from specmap_cli.core.records import PlanarScan
from specmap_cli.layout.judging import judge, spread_of
from specmap_cli.layout.motion_edges import MATCH_RANGE_M
from specmap_cli.layout.path_graph import Graph, graph_of
from specmap_cli.layout.strays import Guess
from specmap_cli.layout.walls import Walls
from specmap_cli.layout.wide_passes import WideClaims, wide_claims
from tests.layout.driving import as_tracked, between, link, stored
from tests.turning import turned

Drive = tuple[FloatArray, list[PlanarScan]]


@pytest.fixture(autouse=True)
def _often() -> Iterator[None]:
    with turned("layout.wide_passes", _WIDE_EVERY_M=4.0):
        yield


def stretched(truth: FloatArray, metres: float, until: int = 450) -> FloatArray:
    """The path of a robot that found the first lap shorter or longer along its way."""
    tracked = np.array(truth)
    tracked[until:] = compose(np.array([metres, 0.0, 0.0]), truth[until:])
    return tracked


def searched(drive: Drive, metres: float) -> tuple[Graph, WideClaims]:
    """What is found where the second lap was put metres aside, by an error that is expected."""
    truth, scans = drive
    with stored(stretched(truth, metres), scans) as store:
        graph = graph_of(store, [], [])
        spread = spread_of(graph, as_tracked(graph))
        walls = Walls(store, graph, MATCH_RANGE_M)
        return graph, wide_claims(graph, as_tracked(graph), walls, spread)


def test_what_lies_metres_away_is_found(drive: Drive) -> None:
    truth, _ = drive
    graph, claims = searched(drive, 4.0)
    late = [claim for claim in claims.links if claim.target > 480]
    assert len(late) >= 3
    for claim in late:
        gap = between(truth, claim.source, claim.target).inverse() @ claim.source_from_target
        assert gap.distance < 0.2
    assert {claim.kind for claim in claims.links} == {"nearby"}
    verdicts = judge(graph, as_tracked(graph), late).closures
    assert min(one.away_m for one in verdicts) > 3.0
    alone = judge(graph, as_tracked(graph), late[:1]).closures
    assert [one.reason for one in alone] == ["impossible"], "one pass far away is not believed"


@pytest.mark.parametrize(
    ("home", "name", "value"),
    [
        ("layout.nearby_passes", "LOOPS_PER_NODE", 0),
        ("layout.nearby_passes", "LOOP_SEARCH_MAX_M", 99.0),  # the near search reaches as far
        ("layout.wide_passes", "_WIDE_EVERY_M", 500.0),
    ],
)
def test_nothing_is_searched_where_it_need_not_be(
    drive: Drive, home: str, name: str, value: float
) -> None:
    with turned(home, **{name: value}):
        assert searched(drive, 4.0)[1] == WideClaims((), {})


def test_a_path_that_is_tied_is_not_searched_and_nothing_twice(drive: Drive) -> None:
    truth, scans = drive
    with stored(stretched(truth, 4.0), scans) as store:
        graph = graph_of(store, [], [])
        walls = Walls(store, graph, MATCH_RANGE_M)
        draft = as_tracked(graph)
        spread = spread_of(graph, draft)
        nodes = graph.nodes.tolist()
        ties = [link(nodes[0], node, (0.0, 0.0, 0.0)) for node in nodes[30:]]
        tied = as_tracked(graph, *ties)
        assert wide_claims(graph, tied, walls, spread) == WideClaims((), {})
        first = wide_claims(graph, draft, walls, spread)
        again = as_tracked(graph)
        again = type(again)(poses=again.poses, tied=again.tied, tried=first.guesses)
        assert wide_claims(graph, again, walls, spread) == WideClaims((), {})


def test_a_guess_reaches_along_its_error_and_turns_as_far() -> None:
    guess = Guess(Pose2(10.0, 5.0, 0.5), np.diag([4.0, 0.01, 0.1**2]))
    places = np.array([[15.0, 5.0], [10.0, 9.0], [18.0, 5.0], [10.0, 6.0]])
    assert guess.reaches(places, np.zeros(2)).tolist() == [True, False, False, True]
    angles = guess.angles(0.05)
    assert angles.min() == pytest.approx(0.2, abs=0.051)
    assert angles.max() == pytest.approx(0.8, abs=0.051)
    unknown = Guess(Pose2(0.0, 0.0, 0.0), np.diag([1.0, 1.0, 100.0]))
    assert np.ptp(unknown.angles(0.1)) == pytest.approx(2 * np.pi, abs=0.2)
