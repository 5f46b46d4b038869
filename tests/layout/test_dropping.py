"""A layout from which keyframes were taken is the same layout of the others."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from specmap_cli.core.geometry import FloatArray, compose, invert
from specmap_cli.core.records import IntArray, PlanarScan
from specmap_cli.core.settings import RelaxationConfig
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.layout.dropping import gaps_of, tracked_over_gaps, without_keyframes
from specmap_cli.layout.path_graph import Draft, joined
from specmap_cli.layout.relaxation import Layout, relax
from specmap_cli.layout.solving import solved
from tests.layout.driving import drifted, stored

CONFIG = RelaxationConfig()
GAP = range(100, 400)  # of the first lap, all but its links


@pytest.fixture(scope="module")
def laid_out(
    drive: tuple[FloatArray, list[PlanarScan]],
) -> Iterator[tuple[KeyframeStore, Layout]]:
    truth, scans = drive
    with stored(drifted(truth), scans) as store:
        yield store, relax(store, [], [], CONFIG)


def left_of(layout: Layout) -> IntArray:
    return np.setdiff1d(np.arange(len(layout.poses)), GAP)


def moved(poses: FloatArray) -> FloatArray:
    return compose(invert(poses[:-1]), poses[1:])


def test_motions_stay_as_tracked_and_over_gaps_as_laid_out() -> None:
    rng = np.random.default_rng(1)
    tracked, placed = rng.normal(size=(9, 3)), rng.normal(size=(9, 3))
    numbers = np.array([0, 1, 4, 5, 8])
    found = moved(tracked_over_gaps(tracked, placed, numbers, ()))
    np.testing.assert_allclose(found[[0, 2]], moved(tracked)[[0, 4]], atol=1e-12)
    over = [compose(invert(placed[a]), placed[b]) for a, b in ((1, 4), (5, 8))]
    np.testing.assert_allclose(found[[1, 3]], over, atol=1e-12)


def test_a_long_step_of_a_recording_that_was_thinned_before_is_a_gap() -> None:
    rng = np.random.default_rng(3)
    tracked, placed = rng.normal(size=(5, 3)), np.zeros((5, 3))
    placed[:, 0] = [0.0, 0.1, 2.0, 2.1, 4.0]
    gaps = gaps_of(placed, np.array([0, 0, 0, 0, 1]))
    assert list(gaps) == [2]  # the last step leads into another recording
    assert not gaps_of(placed, np.full(5, -1))  # a log of few scans
    found = moved(tracked_over_gaps(tracked, placed, np.arange(5), gaps))
    np.testing.assert_allclose(found[1], [1.9, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(found[[0, 2, 3]], moved(tracked)[[0, 2, 3]], atol=1e-12)


def test_without_a_gap_nothing_changes() -> None:
    tracked = np.random.default_rng(2).normal(size=(6, 3))
    numbers = np.arange(2, 6)
    assert (tracked_over_gaps(tracked, tracked, numbers, ()) == tracked[numbers]).all()


def test_what_is_left_lies_as_it_did_and_its_graph_says_so(
    laid_out: tuple[KeyframeStore, Layout], drive: tuple[FloatArray, list[PlanarScan]]
) -> None:
    whole, layout = laid_out
    numbers = left_of(layout)
    tracked = tracked_over_gaps(whole.poses, layout.poses, numbers, ())
    with stored(tracked, [drive[1][k] for k in numbers.tolist()]) as store:
        of = np.zeros(len(layout.poses), dtype=np.int64)
        gaps = gaps_of(store.poses, of[numbers])
        fewer = without_keyframes(store, layout, numbers, of, gaps)
        graph = joined(store.poses, fewer.nodes, fewer.odometry)
    assert (fewer.poses == layout.poses[numbers]).all()
    assert len(fewer.odometry) == len(fewer.nodes) - 1
    draft = Draft(poses=fewer.poses[fewer.nodes], loops=fewer.kept)
    again = solved(graph, draft).poses
    assert np.abs(again - draft.poses)[:, :2].max() < 0.05


def test_a_link_whose_end_is_gone_ends_beside_it(
    laid_out: tuple[KeyframeStore, Layout], drive: tuple[FloatArray, list[PlanarScan]]
) -> None:
    whole, layout = laid_out
    numbers = left_of(layout)
    lost = [one for one in layout.kept if one.source in GAP or one.target in GAP]
    assert lost
    tracked = tracked_over_gaps(whole.poses, layout.poses, numbers, ())
    with stored(tracked, [drive[1][k] for k in numbers.tolist()]) as store:
        of = np.zeros(len(layout.poses), dtype=np.int64)
        fewer = without_keyframes(store, layout, numbers, of, {})
    assert len({frozenset((one.source, one.target)) for one in fewer.kept}) == len(fewer.kept)
    stayed = len(layout.kept) - len(lost)
    assert len(fewer.kept) > stayed
    for one in fewer.kept[stayed:]:
        expected = compose(invert(fewer.poses[one.source]), fewer.poses[one.target])
        np.testing.assert_allclose(expected, one.source_from_target, atol=1e-9)
        assert np.linalg.eigvalsh(one.information).min() > 0.0


def test_a_carried_link_is_less_sure_than_the_one_it_comes_from(
    laid_out: tuple[KeyframeStore, Layout], drive: tuple[FloatArray, list[PlanarScan]]
) -> None:
    whole, layout = laid_out
    spread = {}
    for first in (140, 40):  # the end of the link that is gone is 12 keyframes away, and 112
        numbers = np.setdiff1d(np.arange(len(layout.poses)), range(first, 240))
        tracked = tracked_over_gaps(whole.poses, layout.poses, numbers, ())
        with stored(tracked, [drive[1][k] for k in numbers.tolist()]) as store:
            of = np.zeros(len(layout.poses), dtype=np.int64)
            fewer = without_keyframes(store, layout, numbers, of, {})
        (one,) = [each for each in fewer.kept if numbers[each.target] == 620]
        spread[first] = np.linalg.inv(one.information).trace()
    (link,) = [each for each in layout.kept if each.target == 620]
    assert np.linalg.inv(link.information).trace() < spread[140] < spread[40]
