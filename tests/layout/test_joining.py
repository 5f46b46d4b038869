"""Two recordings of one building laid out as one."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pytest

from specmap_cli.core.geometry import FloatArray, Pose2, compose, invert
from specmap_cli.core.records import PlanarScan
from specmap_cli.core.settings import RelaxationConfig
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.layout.joining import join_layouts, placed, without_guesses
from specmap_cli.layout.relaxation import Constraint, Layout, relax
from tests.layout.driving import STIFF, drifted, stored, worst

CONFIG = RelaxationConfig()
CUT = 470  # keyframes of the first lap
ELSEWHERE = Pose2(30.0, -8.0, 2.0)  # where the frame of the second recording lies


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
        old_from_world = compose(self.old.poses[0], invert(self.truth[0]))
        first = compose(old_from_world, self.truth[CUT])
        return Pose2(*compose(first, invert(self.new.poses[0])).tolist())


@pytest.fixture(scope="module")
def twice(drive: tuple[FloatArray, list[PlanarScan]]) -> Iterator[Twice]:
    truth, scans = drive
    first = drifted(truth[:CUT])
    second = compose(np.array(ELSEWHERE), drifted(truth[CUT:]))
    with stored(first, scans[:CUT]) as a, stored(second, scans[CUT:]) as b:
        old, new = relax(a, [], [], CONFIG), relax(b, [], [], CONFIG)
    with stored(np.concatenate([first, second]), scans) as store:
        yield Twice(truth, store, old, new)


def joined(twice: Twice, motion: Pose2, ties: tuple[Constraint, ...] = ()) -> Layout:
    new = placed(twice.new, motion, CUT)
    return join_layouts(twice.store, twice.old, new, ties, {CUT: None})


def test_the_second_recording_comes_to_lie_where_it_belongs(twice: Twice) -> None:
    layout = joined(twice, twice.true_motion @ Pose2(0.15, -0.1, 0.01))
    assert worst(layout.poses, twice.truth) < 0.4
    assert layout.loose == ()
    across = [link for link in layout.kept if link.source < CUT <= link.target]
    assert len(across) >= 5
    assert layout.evidence.standing.share < 0.02
    assert [move.first for move in layout.evidence.parts] == [CUT]
    assert without_guesses(layout, (CUT,)).evidence.parts == ()


def test_the_links_of_both_pieces_stay(twice: Twice) -> None:
    layout = joined(twice, twice.true_motion)
    ends = {(link.source, link.target) for link in (*layout.kept, *layout.dropped)}
    assert twice.old.kept
    assert {(link.source, link.target) for link in twice.old.kept} <= ends
    assert set(twice.old.nodes.tolist()) <= set(layout.nodes.tolist())
    assert set((twice.new.nodes + CUT).tolist()) <= set(layout.nodes.tolist())


def test_without_any_tie_the_second_piece_is_loose(twice: Twice) -> None:
    layout = joined(twice, Pose2(200.0, 0.0, 0.0))
    assert layout.loose == (CUT,)
    apart = compose(invert(layout.poses[CUT]), layout.poses[-1])
    alone = compose(invert(twice.new.poses[0]), twice.new.poses[-1])
    assert apart == pytest.approx(alone, abs=0.01)


def test_a_closure_ties_pieces_that_lie_metres_apart(twice: Twice) -> None:
    i, j = 10, CUT + 12
    true = compose(invert(twice.truth[i]), twice.truth[j])
    tie = Constraint(i, j, Pose2(*true.tolist()), STIFF)
    layout = joined(twice, twice.true_motion @ Pose2(0.8, 0.5, 0.0), (tie,))
    assert worst(layout.poses, twice.truth) < 0.4
    assert (i, j) in {(link.source, link.target) for link in layout.kept}


def test_a_layout_moves_as_a_whole(twice: Twice) -> None:
    moved = placed(twice.old, ELSEWHERE, 100)
    assert worst(moved.poses, twice.old.poses) < 1e-9
    assert moved.nodes.tolist() == (twice.old.nodes + 100).tolist()
    assert {link.source for link in moved.kept} == {link.source + 100 for link in twice.old.kept}
