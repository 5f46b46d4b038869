"""Loop closure: what is claimed, what is verified, what merges, and what must not."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from specmap_cli.core.config import RecognitionConfig, load_config
from specmap_cli.core.geometry import Pose2, wrap_angle
from specmap_cli.core.records import Closure
from specmap_cli.grids.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap
from specmap_cli.recognition.closure.claims import ClaimRanker, Claims
from specmap_cli.recognition.closure.loop_closer import LoopCloser
from specmap_cli.recognition.closure.prepared import prepare, wall_direction
from specmap_cli.recognition.closure.verification import judge, tracks_overlap, verify

QUICK = RecognitionConfig(closure_rounds=20)
ORDER = [0, 1, 2, 3, 0, 2, 1]


def closer(config: RecognitionConfig = QUICK) -> LoopCloser:
    return LoopCloser(config, np.random.default_rng(0))


def tour(building: Any, loop: LoopCloser, rooms: list[int], **known: float) -> list[Closure]:
    """Visit rooms in turn, merging as advised; returns the merges."""
    merges = []
    for number, room in enumerate(rooms):
        for closure in loop.consider(building.visit(number, room, seed=number, **known)):
            if closure.merged:
                merges.append(closure)
                loop.merge(closure.old, closure.new)
    return merges


def test_rooms_visited_again_merge_and_nothing_else_does(building: Any) -> None:
    merges = tour(building, closer(), ORDER)
    assert [(c.old, c.new) for c in merges] == [(0, 4), (2, 5), (1, 6)]
    for closure in merges:
        assert closure.verified
        assert closure.xi == pytest.approx(closure.claims_new_by_old * closure.claims_old_by_new)


def test_the_transform_between_visits_is_right(building: Any) -> None:
    for closure in tour(building, closer(), ORDER):
        truth = building.truth(ORDER[closure.old], closure.old, closure.new)
        assert closure.old_from_new is not None
        error = truth.inverse() @ closure.old_from_new
        assert error.distance < 0.06
        assert abs(error.theta) < np.radians(0.7)


def test_the_same_seed_gives_the_same_closures(building: Any) -> None:
    assert tour(building, closer(), ORDER[:5]) == tour(building, closer(), ORDER[:5])


def test_every_pair_considered_says_why(building: Any) -> None:
    loop = closer()
    for number in range(3):
        considered = loop.consider(building.visit(number, number))
        assert {c.old for c in considered} == set(range(number))
        for closure in considered:
            assert not closure.merged
            assert closure.reason
            assert (closure.old_from_new is None) == (not closure.verified)


def test_twin_rooms_stay_two_and_the_ambiguity_is_said(twins: Any) -> None:
    loop = closer()
    loop.consider(twins.visit(0, 0, seed=0, travelled_m=0.0))
    closure = loop.consider(twins.visit(1, 1, seed=1, travelled_m=14.0))[0]
    assert closure.score > 0.7
    assert not closure.merged
    assert "ambiguous" in closure.reason


def test_a_room_found_again_merges_whatever_the_drift_on_a_long_way(twins: Any) -> None:
    loop = closer()
    loop.consider(twins.visit(0, 0, seed=0, travelled_m=0.0))
    closure = loop.consider(twins.visit(1, 1, seed=1, travelled_m=400.0))[0]
    assert closure.merged


def test_a_submap_without_a_wall_is_considered_and_refused(building: Any) -> None:
    loop = closer()
    loop.consider(building.visit(0, 0))
    view = building.visit(1, 0)
    empty = GridMap(np.full((30, 30), UNKNOWN, dtype=np.uint8), 0.05)
    bare = type(view)(1, view.features, empty, view.track)
    assert not any(c.verified for c in loop.consider(bare))


def test_leftover_duplicates_are_found_through_the_topology(building: Any) -> None:
    loop = closer(RecognitionConfig(closure_rounds=5, candidates=1, members=1))
    # advice is not followed: the second visit of room 0 stays a submap of its own
    for number, room in enumerate([0, 1, 2]):
        loop.consider(building.visit(number, room, seed=number))
    loop.consider(building.visit(3, 0, seed=3))
    loop._checked.clear()
    adjacency = {0: [1], 1: [0, 3], 2: [], 3: [1]}
    found = loop.consider_leftovers(adjacency)
    assert [(c.old, c.new) for c in found if c.merged] == [(0, 3)]
    loop.merge(0, 3)
    assert not any(c.merged for c in loop.consider_leftovers({0: [1], 1: [0], 2: []}))


def test_merging_may_name_any_visit(building: Any) -> None:
    loop = closer()
    for number, room in enumerate([0, 1, 0]):
        loop.consider(building.visit(number, room, seed=number))
    loop.merge(0, 2)
    loop.merge(2, 0)
    considered = loop.consider(building.visit(3, 0, seed=5))
    merged = next(c for c in considered if c.merged)
    assert merged.old in (0, 2)


def test_the_paper_s_rule_waits_for_two_submaps_and_takes_the_best_xi(building: Any) -> None:
    config = load_config(preset="paper").recognition.model_copy(update={"closure_rounds": 8})
    loop = closer(config)
    for number in range(2):
        assert loop.consider(building.visit(number, number, feature_set="table1")) == []
    considered = loop.consider(building.visit(2, 0, seed=9, feature_set="table1"))
    assert len(considered) == 2
    best = max(considered, key=lambda c: c.xi)
    for closure in considered:
        assert closure.merged == (closure is best and closure.xi >= 0.175)
        assert np.isnan(closure.score)
        assert closure.xi == pytest.approx(closure.claims_new_by_old * closure.claims_old_by_new)


def test_xi_is_the_product_of_both_claims() -> None:
    assert Claims(0.5, 0.4, 0.0, np.ones(1)).xi == pytest.approx(0.2)


@pytest.mark.parametrize("booster", ["trees", "stumps"])
def test_the_right_submap_ranks_first(building: Any, booster: str) -> None:
    config = RecognitionConfig.model_validate({"closure_rounds": 20, "booster": booster})
    ranker = ClaimRanker(config, np.random.default_rng(0))
    for k in range(4):
        ranker.remember(k, building.visit(k, k).features)
    claims = ranker.claims(building.visit(9, 2, seed=4).features)
    assert max(claims, key=lambda k: claims[k].rank) == 2
    assert all(0.0 <= c.xi <= 1.0 for c in claims.values())


def test_a_classifier_is_kept_until_the_map_has_grown(building: Any) -> None:
    ranker = ClaimRanker(QUICK, np.random.default_rng(0))
    for k in range(5):
        ranker.remember(k, building.visit(k, k % 4, seed=k).features)
    new = building.visit(9, 2, seed=4).features
    ranker.claims(new)
    kept = {k: c[2] for k, c in ranker._classifiers.items()}
    ranker.remember(5, building.visit(5, 1, seed=8).features)
    ranker.claims(new)
    assert all(ranker._classifiers[k][2] is kept[k] for k in range(5))


@pytest.mark.parametrize("turn", [0.0, 0.7, -2.4])
def test_verification_needs_no_guess(building: Any, turn: float) -> None:
    old, new = building.visit(0, 1, seed=0), building.visit(1, 1, seed=2)
    first, second = prepare(old.grid), prepare(new.grid)
    assert first is not None
    assert second is not None
    check = verify(first, second)
    assert check is not None
    error = building.truth(1, 0, 2).inverse() @ check.old_from_new
    assert error.distance < 0.06
    assert check.score > 0.8
    moved = judge(first, second, check.old_from_new @ Pose2(0.6, 0.0, turn))
    assert moved.score < check.score


def test_free_space_where_the_other_has_a_wall_counts_against(building: Any) -> None:
    first, other = prepare(building.visit(0, 1).grid), prepare(building.visit(1, 2).grid)
    assert first is not None
    assert other is not None
    check = verify(first, other)
    assert check is not None
    assert check.score < 0.75


@pytest.mark.parametrize("degrees", [0, 10, 37, 80])
def test_the_direction_of_walls_turns_with_them(degrees: float) -> None:
    cells = np.full((200, 200), FREE, dtype=np.uint8)
    rows, columns = np.mgrid[:200, :200] - 100
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    along, across = c * columns + s * rows, -s * columns + c * rows
    box = (np.maximum(np.abs(along) - 60, np.abs(across) - 40) > 0) & (
        np.maximum(np.abs(along) - 64, np.abs(across) - 44) < 0
    )
    cells[box] = OCCUPIED
    found = wall_direction(GridMap(cells, 0.05))
    off = wrap_angle(4.0 * (found - np.radians(degrees))) / 4.0
    assert abs(np.degrees(off)) < 1.0


def test_tracks_overlap_by_the_smaller_share() -> None:
    line = np.column_stack([np.arange(0.0, 10.0, 0.5), np.zeros(20), np.zeros(20)])
    assert tracks_overlap(line, line, Pose2(0.0, 0.5, 0.0), 1.0) == 1.0
    assert tracks_overlap(line, line[:2], Pose2(0.0, 0.0, 0.0), 1.0) == pytest.approx(0.2)
    assert tracks_overlap(line, line[:0], Pose2(0.0, 0.0, 0.0), 1.0) == 0.0
