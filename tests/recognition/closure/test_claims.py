"""Claims of eq. 4 and 5: against classifiers trained by hand, what is held out, what is kept."""

from __future__ import annotations

import numpy as np
import pytest

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.settings import RecognitionConfig
from specmap_cli.recognition.closure import claims
from specmap_cli.recognition.closure.claims import ClaimRanker
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
    assert (only[0].xi, only[0].rank, only[0].by_stay.tolist()) == (1.0, 1.0, [1.0])


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
        chances = [1.0 / (1.0 + np.exp(-c.margins(Z))) for c, Z in ((c_old, new), (c_new, X))]
        assert found[o].rank == pytest.approx(chances[0].mean() * chances[1].mean())


@pytest.mark.parametrize("groups", [0, 1, 2, 3, 50])
def test_an_old_submap_is_never_among_the_negatives_that_judge_it(
    groups: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = PAPER.model_copy(update={"groups": groups})
    made, new = ranker(config, 5), scans_of(7)
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


def test_of_a_submap_visited_often_no_more_scans_are_asked_than_of_one_visited_twice(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    made = ranker(altered(TREES, "recognition", {"samples_per_submap": 40}), 2)
    asking = watched(monkeypatch, claims, "_claims")
    counts = []
    for visit in range(1, 13):
        asking.clear()
        made.claims(scans_of(9))
        asked = asking[1][3]  # one group after the other: submap 1 is the second
        assert len(asked) == visit
        assert len({len(X) for X in asked}) == 1  # every stay alike
        counts.append(sum(map(len, asked)))
        made.remember(10 + visit, scans_of(1, seed=visit))
        made.merge(1, 10 + visit)
    assert counts[:2] == [40, 80]
    assert max(counts) <= 96  # eight of each stay at the least


def test_negatives_are_capped_and_of_all_submaps_alike_however_often_they_were_visited(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
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
    visits = {1: range(9), 0: [0], 2: [0]}
    for place, seeds in visits.items():
        known = np.vstack([scans_of(place, seed=seed) for seed in seeds])
        of_place = (pool[:, None] == known).all(axis=2)
        assert of_place.any(axis=1).sum() == 20
        if place == 1:  # evenly spread over its stays
            assert of_place[:, 40:80].any()
            assert of_place[:, -40:].any()


def test_stays_of_one_submap_are_claimed_one_by_one_and_judged_together() -> None:
    made = ranker(TREES, 4)
    made.remember(8, scans_of(1, seed=5))
    made.remember(9, scans_of(77, seed=5))  # another place, merged by mistake
    made.merge(1, 8)
    made.merge(1, 9)
    claims = made.claims(scans_of(1, seed=6))
    assert sorted(claims) == [0, 1, 2, 3]
    assert len(claims[1].by_stay) == 3
    assert claims[1].by_stay[:2].min() > claims[1].by_stay[2]
    assert max(claims, key=lambda i: claims[i].rank) == 1


def test_a_classifier_is_trained_again_when_its_submap_or_the_map_has_grown_enough() -> None:
    made = ranker(TREES.model_copy(update={"refresh_growth": 0.5}), 4)
    made.claims(scans_of(9))
    before = dict(made._classifiers)

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
    made = ranker(PAPER, 3)  # without growth allowed
    made.claims(scans_of(9))
    first = dict(made._classifiers)
    made.claims(scans_of(9))
    assert all(made._classifiers[i] is not first[i] for i in first)


def test_the_bins_are_cut_anew_once_the_map_has_doubled() -> None:
    made = ranker(TREES, 2)
    made.claims(scans_of(9))
    first = made._quantiser
    made.remember(2, scans_of(2))
    made.claims(scans_of(9))
    assert made._quantiser is first
    made.remember(3, scans_of(3))
    made.claims(scans_of(9))
    assert made._quantiser is not first


def test_the_same_seed_gives_the_same_claims_stumps_need_none_and_nothing_is_changed() -> None:
    for config, seeds in ((TREES, (0, 0)), (PAPER, (0, 5))):
        ranks = []
        for seed in seeds:
            made, new = ClaimRanker(config, np.random.default_rng(seed)), scans_of(1, 4)
            handed = [scans_of(place) for place in range(3)]
            for place, X in enumerate(handed):
                made.remember(place, X)
            ranks.append([claims.rank for claims in made.claims(new).values()])
            for place, X in enumerate(handed):
                np.testing.assert_array_equal(X, scans_of(place))
            np.testing.assert_array_equal(new, scans_of(1, 4))
        assert ranks[0] == ranks[1]
