"""What a match is worth: every reason in its words, the limits that decide, and confirmed ways."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.geometry import IDENTITY, Pose2
from specmap_cli.core.settings import RecognitionConfig
from specmap_cli.grids.gridmap import FREE, GridMap, PackedGrid
from specmap_cli.recognition.closure.decision import Decision, DriftGraph, Stay, decide
from specmap_cli.recognition.closure.verification import Check

CONFIG = RecognitionConfig()
SURE = Check(
    old_from_new=IDENTITY, score=0.9, confirmed_m=25.0, overlap=0.9, least_overlap=0.8, lead=0.5
)
LINE = np.column_stack([np.arange(0.0, 8.0, 0.25), np.zeros(32), np.zeros(32)])
MERGES = "the grids match and the tracks overlap"
APART = "the grids match, the robot's tracks do not overlap"
TWIN = "ambiguous: looks the same but is too far away, a twin"


def stay(number: int = 0, **known: Any) -> Stay:
    """A stay along a line of 8 m; only its track and what is known of its frame matter."""
    grid = GridMap(np.full((2, 2), FREE, dtype=np.uint8), 0.05)
    return Stay(
        number=number, features=np.zeros((1, 1)), packed=PackedGrid.of(grid), track=LINE, **known
    )


def told(old: Stay, new: Stay, check: Check | None, config: RecognitionConfig) -> Decision:
    """The verdict where nothing confirmed the way between two stays."""
    return decide(old, new, check, DriftGraph(config).between(old, new), config)


@pytest.mark.parametrize(
    ("change", "verified", "merged", "reason"),
    [
        (None, False, False, "the grids do not match"),
        ({}, True, True, MERGES),
        ({"score": 0.7499}, False, False, "the grids do not match"),
        ({"score": 0.75}, True, True, MERGES),
        ({"confirmed_m": 4.95}, False, False, "too little wall matches"),
        ({"overlap": 0.39, "least_overlap": 0.39}, False, False, "the grids overlap too little"),
        ({"least_overlap": 0.14}, False, False, "the grids overlap too little"),
        ({"lead": 0.09}, False, False, "ambiguous: the grids match in more than one way"),
        ({"old_from_new": Pose2(6.0, 0.0, 0.0)}, True, False, APART),
        ({"old_from_new": Pose2(0.0, 1.01, 0.0)}, True, False, APART),
    ],
)
def test_every_verdict_says_why(
    change: dict[str, Any] | None, verified: bool, merged: bool, reason: str
) -> None:
    check = None if change is None else replace(SURE, **change)
    found = told(stay(), stay(1), check, CONFIG)
    assert (found.verified, found.merged, found.reason) == (verified, merged, reason)


@pytest.mark.parametrize(
    ("apart_m", "turned_deg", "driven_m", "reason"),
    [
        (0.4, 0.0, 0.0, MERGES),
        (0.6, 0.0, 0.0, TWIN),
        (0.6, 0.0, 2.0, MERGES),
        (2.5, 0.0, 15.0, TWIN),  # the office next door
        (9.0, 0.0, 80.0, TWIN),
        (9.0, 0.0, 90.0, MERGES),
        (9.0, 0.0, math.inf, MERGES),
        (0.0, 30.0, 5.0, MERGES),  # tracking turns a little
        (0.0, 90.0, 5.0, TWIN),
        (0.0, -177.0, 350.0, TWIN),
        (0.0, 90.0, 1000.0, MERGES),
        (90.0, 0.0, math.nan, MERGES),  # between two losses of tracking no way is known
        (None, 0.0, 0.0, MERGES),  # nor is a frame
    ],
)
def test_twins_are_told_by_the_drift_that_one_place_would_need(
    apart_m: float | None, turned_deg: float, driven_m: float, reason: str
) -> None:
    old = stay(0, map_from_stay=Pose2(3.0, 2.0, 0.4), travelled_m=10.0)
    new = stay(1, travelled_m=10.0 + driven_m)
    if apart_m is not None:
        frame = Pose2(3.0, 2.0, 0.4) @ Pose2(apart_m, 0.0, math.radians(turned_deg))
        new = replace(new, map_from_stay=frame)
    assert told(old, new, SURE, CONFIG).reason == reason
    assert told(new, old, SURE, CONFIG).reason == reason


def along(travelled_m: float, where: Pose2 | None = IDENTITY) -> Stay:
    """A stay that began so far along the way; nothing else of it matters here."""
    return stay(map_from_stay=where, travelled_m=travelled_m)


@pytest.mark.parametrize(
    ("confirmed", "start", "end", "metres"),
    [
        ([], 20.0, 152.0, 132.0),  # the way that was driven
        ([(25.0, 110.0, 0.0)], 20.0, 152.0, 5.0 + 42.0),  # a match cuts it short
        ([(25.0, 110.0, 0.0)], 60.0, 70.0, 10.0),
        ([(0.0, 80.0, 0.3)], 0.0, 80.0, 0.3 / CONFIG.max_drift),  # what it mends counts as way
        ([(0.0, 80.0, 0.6)], 0.0, 80.0, 80.0),  # it mends too much to be believed
        ([(0.0, math.inf, 0.0)], 0.0, 80.0, 80.0),  # it came after a loss of tracking
        ([(10.0, 50.0, 0.0), (52.0, 90.0, 0.0)], 9.0, 91.0, 1.0 + 2.0 + 1.0),
        ([(10.0, 50.0, 0.0)], 10.0, math.inf, math.inf),  # across a loss no way is known
    ],
)
def test_a_way_is_as_short_as_the_matches_on_it_make_it(
    confirmed: list[tuple[float, float, float]], start: float, end: float, metres: float
) -> None:
    way = DriftGraph(CONFIG)
    for old, new, mended_m in confirmed:
        way.confirm(along(old), along(new), mended_m)
    assert way.between(along(start), along(end)) == pytest.approx(metres)
    assert way.between(along(end), along(start)) == pytest.approx(metres)


def test_a_match_that_cuts_no_way_short_or_of_an_unknown_frame_is_not_kept() -> None:
    way = DriftGraph(CONFIG)
    assert math.isnan(way.between(along(math.inf), along(math.inf))), "after two losses"
    way.confirm(along(0.0, None), along(80.0), 0.0)
    way.confirm(along(0.0), along(80.0, None), 0.0)
    for mended_m in (0.2, 0.3, 0.2, 0.1):
        way.confirm(along(0.0), along(80.0), mended_m)
    way.confirm(along(80.0), along(81.0), 0.3)
    assert [metres * CONFIG.max_drift for _, _, metres in way._ties] == pytest.approx([0.2, 0.1])


places = st.floats(0.0, 500.0)


@given(st.lists(st.tuples(places, places, st.floats(0.0, 0.5)), max_size=12), places, places)
def test_no_match_makes_a_way_longer(
    ties: list[tuple[float, float, float]], start: float, end: float
) -> None:
    way = DriftGraph(CONFIG)
    last = abs(end - start)
    for old, new, mended_m in ties:
        way.confirm(along(old), along(new), mended_m)
        now = way.between(along(start), along(end))
        assert 0.0 <= now <= last + 1e-9
        last = now
