"""Two recordings of one building laid out as one, and a layout without some of its keyframes."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np
import pytest

from specmap_cli.core.geometry import FloatArray, Pose2, compose, invert
from specmap_cli.core.records import IntArray
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.layout.joining import (
    gaps_of,
    join_layouts,
    placed,
    tracked_over_gaps,
    without_keyframes,
)
from specmap_cli.layout.path_graph import Draft, Graph, solved
from specmap_cli.layout.pose_graph import Link
from specmap_cli.layout.result import Layout
from tests.layout.driving import Drive, between, drifted, laid_out, stored, true_link, worst

CUT = 470  # keyframes of the first lap
ELSEWHERE = Pose2(30.0, -8.0, 2.0)  # where the frame of the second recording lies
GAP = range(100, 400)  # of the first lap, all but its links


@dataclass(frozen=True)
class Twice:
    """The drive recorded in two pieces, each laid out by itself."""

    truth: FloatArray
    store: KeyframeStore
    old: Layout
    new: Layout

    @property
    def true_motion(self) -> Pose2:
        """The frame of the second piece in that of the first, by the first keyframe."""
        first = compose(compose(self.old.poses[0], invert(self.truth[0])), self.truth[CUT])
        return Pose2(*compose(first, invert(self.new.poses[0])).tolist())


@pytest.fixture(scope="module")
def twice(drive: Drive) -> Iterator[Twice]:
    truth, scans = drive
    first = drifted(truth[:CUT])
    second = compose(np.array(ELSEWHERE), drifted(truth[CUT:]))
    old, new = laid_out(first, scans[:CUT]), laid_out(second, scans[CUT:])
    with stored(np.concatenate([first, second]), scans) as store:
        yield Twice(truth, store, old, new)


def joined(twice: Twice, motion: Pose2, ties: tuple[Link, ...] = ()) -> Layout:
    return join_layouts(twice.store, twice.old, placed(twice.new, motion, CUT), ties, {CUT: None})


def test_the_second_recording_comes_to_lie_where_it_belongs(twice: Twice) -> None:
    layout = joined(twice, twice.true_motion @ Pose2(0.15, -0.1, 0.01))
    assert worst(layout.poses, twice.truth) < 0.4
    assert layout.loose == ()
    assert len([one for one in layout.kept if one.source < CUT <= one.target]) >= 5
    assert layout.agreement.share < 0.02
    assert [move.first for move in layout.parts] == [CUT]
    ends = {(one.source, one.target) for one in (*layout.kept, *layout.dropped)}
    assert twice.old.kept
    assert {(one.source, one.target) for one in twice.old.kept} <= ends, "the links stay"
    assert np.isin([*twice.old.nodes, *(twice.new.nodes + CUT)], layout.nodes).all()


def test_without_any_tie_the_second_piece_is_loose(twice: Twice) -> None:
    layout = joined(twice, Pose2(200.0, 0.0, 0.0))
    assert layout.loose == (CUT,)
    apart, alone = between(layout.poses, CUT, -1), between(twice.new.poses, 0, -1)
    assert apart == pytest.approx(alone, abs=0.01)


@pytest.mark.parametrize("off_m", [0.0, 0.25])
def test_a_closure_ties_pieces_that_lie_metres_apart(twice: Twice, off_m: float) -> None:
    """Walls measure it anew: those of whole submaps match some decimetres off."""
    i, j = 10, CUT + 12
    true = true_link(twice.truth, i, j, "closure")
    tie = replace(true, source_from_target=true.source_from_target @ Pose2(off_m, 0.0, 0.0))
    layout = joined(twice, twice.true_motion @ Pose2(0.8, 0.5, 0.0), (tie,))
    assert worst(layout.poses, twice.truth) < 0.4
    (kept,) = [one for one in layout.kept if (one.source, one.target) == (i, j)]
    assert (true.source_from_target.inverse() @ kept.source_from_target).distance < 0.1


def test_a_layout_moves_as_a_whole(twice: Twice) -> None:
    moved = placed(twice.old, ELSEWHERE, 100)
    assert worst(moved.poses, twice.old.poses) < 1e-9
    assert moved.nodes.tolist() == (twice.old.nodes + 100).tolist()
    assert {one.source for one in moved.kept} == {one.source + 100 for one in twice.old.kept}


@pytest.fixture(scope="module")
def whole(drive: Drive) -> Layout:
    truth, scans = drive
    return laid_out(drifted(truth), scans)


def moved(poses: FloatArray) -> FloatArray:
    return compose(invert(poses[:-1]), poses[1:])


def test_motions_stay_as_tracked_and_over_gaps_as_laid_out() -> None:
    rng = np.random.default_rng(1)
    tracked, placed = rng.normal(size=(9, 3)), rng.normal(size=(9, 3))
    found = moved(tracked_over_gaps(tracked, placed, np.array([0, 1, 4, 5, 8]), ()))
    np.testing.assert_allclose(found[[0, 2]], moved(tracked)[[0, 4]], atol=1e-12)
    over = [compose(invert(placed[a]), placed[b]) for a, b in ((1, 4), (5, 8))]
    np.testing.assert_allclose(found[[1, 3]], over, atol=1e-12)


def test_a_long_step_of_a_recording_that_was_thinned_before_is_a_gap() -> None:
    tracked, placed = np.random.default_rng(3).normal(size=(5, 3)), np.zeros((5, 3))
    placed[:, 0] = [0.0, 0.1, 2.0, 2.1, 4.0]
    gaps = gaps_of(placed, np.array([0, 0, 0, 0, 1]))
    assert list(gaps) == [2]  # the last step leads into another recording
    assert not gaps_of(placed, np.full(5, -1))  # a log of few scans
    found = moved(tracked_over_gaps(tracked, placed, np.arange(5), gaps))
    np.testing.assert_allclose(found[1], [1.9, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(found[[0, 2, 3]], moved(tracked)[[0, 2, 3]], atol=1e-12)
    assert (tracked_over_gaps(tracked, tracked, np.arange(2, 5), ()) == tracked[2:]).all()


@contextmanager
def fewer(
    layout: Layout, drive: Drive, gone: range, *, gaps: bool = False
) -> Iterator[tuple[KeyframeStore, Layout, IntArray]]:
    """The store and the layout without some keyframes, and the numbers of the others."""
    truth, scans = drive
    numbers = np.setdiff1d(np.arange(len(layout.poses)), gone)
    tracked = tracked_over_gaps(drifted(truth), layout.poses, numbers, ())
    with stored(tracked, [scans[k] for k in numbers.tolist()]) as store:
        of = np.zeros(len(layout.poses), dtype=np.int64)
        over = gaps_of(store.poses, of[numbers]) if gaps else {}
        yield store, without_keyframes(store, layout, numbers, of, over), numbers


def test_what_is_left_lies_as_it_did_and_its_graph_says_so(whole: Layout, drive: Drive) -> None:
    with fewer(whole, drive, GAP, gaps=True) as (store, rest, numbers):
        graph = Graph.of(store.poses, rest.nodes, rest.odometry)
    assert (rest.poses == whole.poses[numbers]).all()
    assert len(rest.odometry) == len(rest.nodes) - 1
    draft = Draft(poses=rest.poses[rest.nodes], loops=rest.kept)
    assert np.abs(solved(graph, draft).poses - draft.poses)[:, :2].max() < 0.05


def test_a_link_whose_end_is_gone_ends_beside_it(whole: Layout, drive: Drive) -> None:
    lost = [one for one in whole.kept if one.source in GAP or one.target in GAP]
    assert lost
    with fewer(whole, drive, GAP) as (_, rest, _):
        kept = rest.kept
    assert len({frozenset((one.source, one.target)) for one in kept}) == len(kept)
    stayed = len(whole.kept) - len(lost)
    assert len(kept) > stayed
    for one in kept[stayed:]:
        expected = between(rest.poses, one.source, one.target)
        np.testing.assert_allclose(expected, one.source_from_target, atol=1e-9)
        assert np.linalg.eigvalsh(one.information).min() > 0.0


def test_a_link_that_ends_elsewhere_is_less_sure_than_before(whole: Layout, drive: Drive) -> None:
    """The end of the link that is gone is 12 keyframes away from the next, and 112."""
    spread = []
    for first in (240, 140, 40):  # the first time it is still there
        with fewer(whole, drive, range(first, 240)) as (_, rest, numbers):
            (one,) = [each for each in rest.kept if numbers[each.target] == 620]
        spread.append(np.linalg.inv(one.information).trace())
    assert spread == sorted(set(spread))
