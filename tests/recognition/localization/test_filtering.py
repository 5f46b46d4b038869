"""The hidden Markov filter against sums over all paths, views of scans, and clues to unknown."""

from collections.abc import Collection, Mapping
from itertools import pairwise, product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.geometry import Pose2
from specmap_cli.core.records import PlanarScan, PosedScan
from specmap_cli.core.settings import LocalizationConfig
from specmap_cli.recognition.localization.filtering import Clue, HiddenMarkovFilter, ViewGrouping
from tests.recognition.posed import posed
from tests.turning import configured, turn

LINE: dict[int, list[int]] = {0: [1], 1: [0, 2], 2: [1], 5: []}


def hidden_markov(links: Mapping[int, Collection[int]], **settings: float) -> HiddenMarkovFilter:
    return HiddenMarkovFilter(links, configured(LocalizationConfig, "recognition", settings))


@given(st.integers(0, 10_000), st.integers(1, 4), st.floats(-999.0, 999.0))
def test_filter_and_smoother_are_sums_over_all_paths(seed: int, steps: int, shift: float) -> None:
    """Only differences of log likelihoods count: all may be as low as many returns make them."""
    evidence = np.random.default_rng(seed).normal(0.0, 2.0, (steps, 5))
    model = hidden_markov(LINE, stay=0.8)
    weights = np.zeros((steps, 5))
    ends, first = np.zeros(5), model.predicted()
    for path in product(range(5), repeat=steps):
        weight = first[path[0]] * np.exp(sum(evidence[t, s] for t, s in enumerate(path)))
        for a, b in pairwise(path):
            weight *= model.transition[a, b]
        ends[path[-1]] += weight
        for t, s in enumerate(path):
            weights[t, s] += weight
    smoothed = weights / weights.sum(axis=1, keepdims=True)
    for row in evidence:
        filtered = model.update(row + shift)
        found = model.smooth(evidence + shift)
        assert found == pytest.approx(smoothed), "the filter is left as it was"
    assert filtered == pytest.approx(ends / ends.sum())


neighbours = st.lists(st.integers(0, 9), max_size=4)
networks = st.dictionaries(st.integers(0, 9), neighbours, min_size=1, max_size=6)
chances = st.floats(0.001, 0.4)


@given(networks, st.floats(0.01, 0.99), chances, chances)
def test_rows_of_transitions_sum_to_one_and_say_what_the_settings_say(
    adjacency: dict[int, list[int]], stay: float, leap: float, leave: float
) -> None:
    model = hidden_markov(adjacency, stay=stay, leap=leap, leave=leave)
    ids, m = model.ids, len(model.ids)
    assert model.transition.sum(axis=1) == pytest.approx(np.ones(m + 1))
    assert (model.transition >= 0.0).all()
    inside = 1.0 - leap - leave
    for row, id_ in enumerate(ids):
        near = {n for n in adjacency[id_] if n in adjacency and n != id_}
        for column, other in enumerate(ids):
            chance = leap / m
            if other == id_:
                chance += inside * (stay if near else 1.0)
            elif other in near:
                chance += inside * (1.0 - stay) / len(near)
            assert model.transition[row, column] == pytest.approx(chance)
        assert model.transition[row, m] == pytest.approx(leave)
    assert model.transition[m, :m] == pytest.approx(np.full(m, leave / m))


@pytest.mark.parametrize("unknown", [0.5, 0.2])
def test_before_the_first_scan_every_submap_is_as_likely(unknown: float) -> None:
    assert hidden_markov({}).predicted().tolist() == [1.0], "without a submap all is unknown"
    model = hidden_markov(LINE, unknown_prior=unknown)
    first = [*[(1.0 - unknown) / 4.0] * 4, unknown]
    assert model.predicted().tolist() == pytest.approx(first)
    model.update(np.array([9.0, 0.0, 0.0, 0.0, 0.0]))
    assert model.predicted()[0] > 0.9
    model.reset()
    assert model.predicted().tolist() == pytest.approx(first)


@given(st.integers(0, 999))
def test_what_is_said_again_takes_the_place_of_what_was_said_before(seed: int) -> None:
    """A view that is known better than before counts once, as it is known last."""
    evidence = np.random.default_rng(seed).normal(0.0, 2.0, (3, 5))
    once, again = hidden_markov(LINE), hidden_markov(LINE)
    for row in evidence:
        before = once.predicted()
        once.update(row)
        again.update(row + 5.0 * np.arange(5))
        again.update(-row, again=True)
        assert again.predicted(again=True) == pytest.approx(before)
        last = again.update(row, again=True)
    assert last == pytest.approx(once.update(evidence[-1], again=True))


def test_evidence_that_rules_out_every_likely_state_leaves_the_prior() -> None:
    model = hidden_markov({0: [], 1: []}, leap=1e-300, leave=0.0)
    before = model.update(np.array([0.0, -800.0, -np.inf]))
    after = model.update(np.array([-np.inf, -np.inf, 0.0]))  # unknown is out of reach
    assert before[0] == pytest.approx(1.0)
    assert before[2] == 0.0
    assert np.isfinite(model.smooth(np.array([[0.0, 1.0, -np.inf]] * 3))).all()
    assert after == pytest.approx(before)


@pytest.mark.parametrize("worth", [-0.2, 0.0, 0.2, 3.0])
def test_unknown_gains_by_its_worth_and_by_nothing_else(worth: float) -> None:
    """However well the submaps are told apart."""
    for spread in (0.0, 1.0, 10.0):
        model = hidden_markov(LINE)
        prior = model.predicted()
        belief = model.update(model.with_unknown(spread * np.arange(4.0), worth))
        odds = (belief[4] / belief[:4].sum()) / (prior[4] / prior[:4].sum())
        assert np.log(odds) == pytest.approx(worth)


def at(x: float, theta: float = 0.0, lost: bool = False) -> PosedScan:
    """A scan without a return, x metres along a line."""
    nothing = PlanarScan(0, np.zeros(0), np.zeros(0), 10.0, full_circle=True)
    return posed(nothing, Pose2(x, 0.0, theta), lost=lost)


@pytest.mark.parametrize(
    ("scans", "begins"),
    [
        ([at(0.0), at(0.0)], [True, False]),
        ([at(0.0), at(0.09)], [True, False]),
        ([at(0.0), at(0.11)], [True, True]),
        ([at(0.0), at(0.0, 0.19)], [True, False]),
        ([at(0.0), at(0.0, 0.21)], [True, True]),
        ([at(0.0), at(5.0, lost=True)], [True, False]),
        ([at(0.03 * k, lost=k == 0) for k in range(9)], [k % 4 == 0 for k in range(9)]),
    ],
)
def test_a_view_begins_where_the_robot_moved_or_a_track_begins_though_lost_or_unmoved(
    scans: list[PosedScan], begins: list[bool]
) -> None:
    turn("recognition", view_m=0.1, view_rad=0.2)
    views = ViewGrouping()
    assert [views.begins(scan) for scan in scans] == begins


@given(st.lists(st.floats(-50.0, 50.0), min_size=1, max_size=20))
def test_what_a_view_says_is_the_mean_of_its_scans(said: list[float]) -> None:
    views = ViewGrouping()
    views.begins(at(3.0))
    views.mean(np.array([1e6]))
    views.begins(at(4.0))
    for value in said:
        mean = views.mean(np.array([value, -value]))
    assert mean == pytest.approx([np.mean(said), -np.mean(said)], abs=1e-9)


def test_motion_that_nothing_was_said_of_counts_when_something_is_but_a_lost_scan_is_none() -> None:
    turn("recognition", independent_m=1.0, independent_rad=2.0)
    scans = [*(at(0.3 * k) for k in range(4)), at(50.0, lost=True), at(1.0)]
    clue, worths = Clue(), []
    for said, scan in zip([4.0, None, None, 2.0, None, 4.0], scans, strict=True):
        clue.see(scan, scan.lost)
        clue.add(said)
        worths.append(clue.worth)
    assert worths == pytest.approx([4.0, 0.0, 0.0, 1.8, 1.8, 0.4])
