"""Ways on which tracking may have drifted: those that no match confirmed."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.geometry import IDENTITY, Pose2
from specmap_cli.core.settings import RecognitionConfig
from specmap_cli.grids.gridmap import FREE, GridMap, PackedGrid
from specmap_cli.recognition.closure.decision import DriftGraph, Stay

CONFIG = RecognitionConfig()
EMPTY = PackedGrid.of(GridMap(np.full((2, 2), FREE, dtype=np.uint8), 0.05))


def stay(travelled_m: float, where: Pose2 | None = IDENTITY) -> Stay:
    """A stay that began so far along the way; nothing else of it matters here."""
    return Stay(
        number=0,
        features=np.zeros((1, 1)),
        packed=EMPTY,
        track=np.zeros((1, 3)),
        map_from_stay=where,
        travelled_m=travelled_m,
    )


def test_without_a_match_the_way_is_the_one_driven() -> None:
    way = DriftGraph(CONFIG)
    assert way.between(stay(20.0), stay(152.0)) == 132.0
    assert way.between(stay(152.0), stay(20.0)) == 132.0


def test_a_match_that_mends_nothing_cuts_the_way_short() -> None:
    way = DriftGraph(CONFIG)
    way.confirm(stay(25.0), stay(110.0), 0.0)
    assert way.between(stay(20.0), stay(152.0)) == pytest.approx(5.0 + 42.0)
    assert way.between(stay(152.0), stay(20.0)) == pytest.approx(5.0 + 42.0)
    assert way.between(stay(60.0), stay(70.0)) == pytest.approx(10.0)


def test_what_a_match_mends_counts_as_way() -> None:
    """On so many metres tracking drifts as much: 0.3 m on 3 m of path."""
    way = DriftGraph(CONFIG)
    way.confirm(stay(0.0), stay(80.0), 0.3)
    assert way.between(stay(0.0), stay(80.0)) == pytest.approx(0.3 / CONFIG.max_drift)


def test_a_match_that_cuts_no_way_short_is_not_kept() -> None:
    way = DriftGraph(CONFIG)
    for mended_m in (0.2, 0.3, 0.2, 0.1):
        way.confirm(stay(0.0), stay(80.0), mended_m)
    way.confirm(stay(80.0), stay(81.0), 0.3)
    assert [metres * CONFIG.max_drift for _, _, metres in way._ties] == pytest.approx([0.2, 0.1])


def test_matches_are_followed_one_after_the_other() -> None:
    way = DriftGraph(CONFIG)
    way.confirm(stay(10.0), stay(50.0), 0.0)
    way.confirm(stay(52.0), stay(90.0), 0.0)
    assert way.between(stay(9.0), stay(91.0)) == pytest.approx(1.0 + 2.0 + 1.0)


@pytest.mark.parametrize(
    ("old", "new", "mended_m"),
    [
        (stay(0.0), stay(80.0), 0.6),
        (stay(0.0, None), stay(80.0), 0.0),
        (stay(0.0), stay(80.0, None), 0.0),
        (stay(0.0), stay(math.inf), 0.0),
    ],
    ids=["mends too much", "nothing known of one", "nothing known of the other", "after a loss"],
)
def test_what_confirms_nothing(old: Stay, new: Stay, mended_m: float) -> None:
    way = DriftGraph(CONFIG)
    way.confirm(old, new, mended_m)
    assert way.between(stay(0.0), stay(80.0)) == 80.0


def test_across_a_loss_of_tracking_no_way_is_known() -> None:
    way = DriftGraph(CONFIG)
    way.confirm(stay(10.0), stay(50.0), 0.0)
    assert way.between(stay(10.0), stay(math.inf)) == math.inf
    assert math.isnan(way.between(stay(math.inf), stay(math.inf)))


places = st.floats(0.0, 500.0)


@given(st.lists(st.tuples(places, places, st.floats(0.0, 0.5)), max_size=12), places, places)
def test_no_match_makes_a_way_longer(
    ties: list[tuple[float, float, float]], start: float, end: float
) -> None:
    way = DriftGraph(CONFIG)
    last = abs(end - start)
    for old, new, mended_m in ties:
        way.confirm(stay(old), stay(new), mended_m)
        now = way.between(stay(start), stay(end))
        assert 0.0 <= now <= last + 1e-9
        last = now
