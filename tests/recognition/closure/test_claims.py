"""Claims of eq. 4 and 5 against classifiers trained by hand, and what a match of grids is worth."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from specmap_cli.core.geometry import IDENTITY, FloatArray, Pose2
from specmap_cli.core.settings import RecognitionConfig
from specmap_cli.core.shortcuts import Shortcuts
from specmap_cli.grids.gridmap import FREE, GridMap, PackedGrid
from specmap_cli.recognition.closure import claims
from specmap_cli.recognition.closure.claims import ClaimRanker
from specmap_cli.recognition.closure.loop_closer import Decision, Stay, confirm, decide
from specmap_cli.recognition.closure.verification import Check
from specmap_cli.recognition.features.sets import feature_names
from specmap_cli.recognition.learning.boosting import StumpBoost
from tests.recognition.watching import watched
from tests.turning import altered

NAMES = feature_names("table1")
PAPER = RecognitionConfig(
    feature_set="table1",
    booster="stumps",
    closure_rounds=6,
    groups=0,
    refresh_growth=0.0,
    closure_negatives=1_000_000,
)
TREES = RecognitionConfig(feature_set="table1", closure_rounds=12)


def scans_of(place: int, seed: int = 0, n: int = 40) -> FloatArray:
    """Features of scans of a place, around a centre of its own."""
    centre = np.random.default_rng(place).normal(0.0, 1.0, len(NAMES))
    return np.random.default_rng([place, seed]).normal(centre, 0.6, (n, len(NAMES)))


def ranker(config: RecognitionConfig, places: int) -> ClaimRanker:
    made = ClaimRanker(config, np.random.default_rng(0))
    for place in range(places):
        made.remember(place, scans_of(place))
    return made


@pytest.mark.parametrize("config", [PAPER, TREES])
def test_before_there_are_two_submaps_the_first_claims_all(config: RecognitionConfig) -> None:
    new = scans_of(9)
    assert ranker(config, 0).claims(new) == {}
    only = ranker(config, 1).claims(new)
    assert list(only) == [0]
    assert only[0].xi == 1.0


def test_claims_are_the_shares_of_classifiers_trained_as_the_paper_says() -> None:
    """c_o against the other old submaps; c_n against all old submaps but o (Section III-C)."""
    old = {place: scans_of(place) for place in range(4)}
    new = scans_of(2, seed=1)
    found = ranker(PAPER, 4).claims(new)
    for o, X in old.items():
        others = np.vstack([old[i] for i in old if i != o])
        y = np.repeat([1.0, -1.0], [len(X), len(others)])
        c_old = StumpBoost(NAMES, 6).fit(np.vstack([X, others]), y)
        y = np.repeat([1.0, -1.0], [len(new), len(others)])
        c_new = StumpBoost(NAMES, 6).fit(np.vstack([new, others]), y)
        assert found[o].new_by_old == (c_old.margins(new) > 0.0).mean()
        assert found[o].old_by_new == (c_new.margins(X) > 0.0).mean()
        assert found[o].xi == found[o].new_by_old * found[o].old_by_new


@pytest.mark.parametrize("groups", [0, 1, 2, 3, 50])
def test_a_submap_is_no_negative_of_itself(groups: int, monkeypatch: pytest.MonkeyPatch) -> None:
    made, new = ranker(PAPER.model_copy(update={"groups": groups}), 5), scans_of(7)
    learning = watched(monkeypatch, claims, "boosted")
    assert sorted(made.claims(new)) == list(range(5))
    left_out: dict[str, list[set[int]]] = {"new": [], "old": []}
    for _, X, questions, _ in learning:
        for question in questions:
            seen = X[question.samples]
            whose = "new" if (seen[question.positive] == new[0]).all(axis=1).any() else "old"
            others = {row.tobytes() for row in seen[~question.positive]}
            left_out[whose].append({i for i in range(5) if scans_of(i)[0].tobytes() not in others})
    assert sorted(map(sorted, left_out["old"])) == [[0], [1], [2], [3], [4]]
    assert len(left_out["new"]) == min(groups or 5, 5)
    assert sorted(i for out in left_out["new"] for i in out) == [0, 1, 2, 3, 4]


def test_negatives_are_capped_and_of_all_submaps_alike(monkeypatch: pytest.MonkeyPatch) -> None:
    config = PAPER.model_copy(update={"closure_negatives": 40, "groups": 1})
    made = ranker(altered(config, "recognition", {"samples_per_submap": 10}), 3)
    for visit in range(1, 9):
        made.remember(10 + visit, scans_of(1, seed=visit))
        made.merge(1, 10 + visit)
    learning = watched(monkeypatch, claims, "boosted")
    made.claims(scans_of(9))
    ((_, X, questions, _),) = learning
    assert {int((~question.positive).sum()) for question in questions[1:]} == {40}
    assert {int(question.positive.sum()) for question in questions} == {20}  # twice the samples
    pool = X[:60]  # half as many again as are used
    for place, seeds in {1: range(9), 0: [0], 2: [0]}.items():
        known = np.vstack([scans_of(place, seed=seed) for seed in seeds])
        of_place = (pool[:, None] == known).all(axis=2)
        assert of_place.any(axis=1).sum() == 20
        if place == 1:  # evenly spread over its stays
            assert of_place[:, 40:80].any()
            assert of_place[:, -40:].any()


def test_stays_of_one_submap_are_judged_together() -> None:
    made = ranker(TREES, 4)
    made.remember(8, scans_of(1, seed=5))
    made.merge(1, 8)
    claims = made.claims(scans_of(1, seed=6))
    assert sorted(claims) == [0, 1, 2, 3]
    assert max(claims, key=lambda i: claims[i].xi) == 1
    made.remember(9, scans_of(77, seed=5))  # another place, merged by mistake
    made.merge(1, 9)
    assert made.claims(scans_of(1, seed=6))[1].old_by_new < claims[1].old_by_new


def test_a_classifier_is_trained_again_when_its_submap_or_the_map_grew_and_bins_are_cut() -> None:
    made = ranker(TREES.model_copy(update={"refresh_growth": 0.5}), 4)
    made.claims(scans_of(9))
    before, bins = dict(made._classifiers), made._quantiser

    def trained_again(number: int, scans: FloatArray, merged: int | None = None) -> set[int]:
        made.remember(number, scans)
        if merged is not None:
            made.merge(merged, number)
        made.claims(scans_of(9))
        now = made._classifiers
        return {i for i, was in before.items() if now[i].booster is not was.booster}

    assert trained_again(4, scans_of(1, seed=2), merged=1) == {1}
    assert trained_again(5, scans_of(4)) == {1}  # 5 of 4 is less than half more
    assert trained_again(6, scans_of(5)) == {0, 1, 2, 3}
    assert made._quantiser is bins
    trained_again(7, scans_of(6))  # the eighth stay: there were four
    assert made._quantiser is not bins
    made = ranker(PAPER, 3)  # without growth allowed
    made.claims(scans_of(9))
    first = dict(made._classifiers)
    made.claims(scans_of(9))
    assert all(made._classifiers[i] is not first[i] for i in first)


def test_the_same_seed_gives_the_same_claims_stumps_need_none_and_nothing_is_changed() -> None:
    for config, seeds in ((TREES, (0, 0)), (PAPER, (0, 5))):
        ranks = []
        for seed in seeds:
            made, new = ClaimRanker(config, np.random.default_rng(seed)), scans_of(1, 4)
            handed = [scans_of(place) for place in range(3)]
            for place, X in enumerate(handed):
                made.remember(place, X)
            ranks.append([claims.xi for claims in made.claims(new).values()])
            left = [*handed, new]
            np.testing.assert_array_equal(left, [*map(scans_of, range(3)), scans_of(1, 4)])
        assert ranks[0] == ranks[1]


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
    packed = PackedGrid.of(GridMap(np.full((2, 2), FREE, dtype=np.uint8), 0.05))
    return Stay(number=number, features=np.zeros((1, 1)), packed=packed, track=LINE, **known)


def told(old: Stay, new: Stay, check: Check | None) -> Decision:
    """The verdict where nothing confirmed the way between two stays."""
    return decide(old, new, check, abs(new.travelled_m - old.travelled_m), CONFIG)


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
def test_why_is_said(
    change: dict[str, Any] | None, verified: bool, merged: bool, reason: str
) -> None:
    found = told(stay(), stay(1), None if change is None else replace(SURE, **change))
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
    assert told(old, new, SURE).reason == reason
    assert told(new, old, SURE).reason == reason


def along(travelled_m: float, where: Pose2 | None = IDENTITY) -> Stay:
    """A stay that began so far along the way; nothing else of it matters here."""
    return stay(map_from_stay=where, travelled_m=travelled_m)


@pytest.mark.parametrize(
    ("where", "end", "mended_m", "metres"),
    [
        (IDENTITY, 80.0, 0.0, 0.0),
        (IDENTITY, 80.0, 0.3, 0.3 / CONFIG.max_drift),  # what it mends counts as way
        (IDENTITY, 80.0, 0.6, 80.0),  # it mends too much to be believed
        (IDENTITY, math.inf, 0.0, math.inf),  # it came after a loss of tracking
        (None, 80.0, 0.0, 80.0),
    ],
)
def test_a_match_cuts_the_way_as_short_as_drift_makes_what_it_mends(
    where: Pose2 | None, end: float, mended_m: float, metres: float
) -> None:
    way = Shortcuts()
    confirm(way, along(0.0), along(end, where), Pose2(mended_m, 0.0, 0.0), CONFIG)
    assert way.between(0.0, end) == pytest.approx(metres)
