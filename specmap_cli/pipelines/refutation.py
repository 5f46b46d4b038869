"""What loop closures say about the layout, and which of them the layout refutes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from specmap_cli.core.geometry import FloatArray, Pose2, compose, invert, wrap_angles
from specmap_cli.core.records import Closure, IntArray
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.layout.closure_matching import place_around, sharpened
from specmap_cli.layout.passes import METRES_A_RADIAN
from specmap_cli.layout.pose_graph import Link
from specmap_cli.layout.result import Layout
from specmap_cli.pipelines.exploration import Regions, in_own_frame

_CLOSURE_SIGMA_M = 0.04  # spread of matched grids' transforms about the truth, x and y
_CLOSURE_SIGMA_RAD = 0.0087  # spread of their heading

Pair = tuple[int, int]

REFUTED = "contradicts the layout"


def constraints_of(
    closures: Sequence[Closure], regions: Regions, store: KeyframeStore
) -> dict[Pair, Link]:
    """For each pair of merged regions, (old, new): where a keyframe lies, seen from another.

    Grids that match while the robot's tracks do not overlap are no evidence for the layout: that is
    what look-alike rooms do, too.
    """
    sigma = np.array([_CLOSURE_SIGMA_M, _CLOSURE_SIGMA_M, _CLOSURE_SIGMA_RAD])
    information = np.diag(1.0 / sigma**2)
    return {
        (closure.old, closure.new): _constraint(
            regions[closure.old],
            regions[closure.new],
            closure.old_from_new,
            store,
            information,
        )
        for closure in closures
        if closure.merged and closure.old_from_new is not None
    }


def refute(
    closures: Sequence[Closure], constraints: Mapping[Pair, Link], layout: Layout
) -> tuple[Closure, ...]:
    """The closures, without the merges whose constraint the layout dropped."""
    dropped = {(link.source, link.target) for link in layout.dropped if link.kind == "closure"}
    refuted = {
        pair
        for pair, constraint in constraints.items()
        if (constraint.source, constraint.target) in dropped
    }
    return tuple(
        _taken_back(closure) if (closure.old, closure.new) in refuted else closure
        for closure in closures
    )


def _constraint(
    old: Sequence[int],
    new: Sequence[int],
    old_from_new: Pose2,
    store: KeyframeStore,
    information: FloatArray,
) -> Link:
    """The keyframes of two regions that saw most alike, tied by the walls around them.

    Under the transform they are the nearest to each other, turned as little as may be.
    """
    old_track = in_own_frame(store, old)
    new_track = compose(np.array(old_from_new), in_own_frame(store, new))
    i, j = nearest_pair(old_track, new_track)
    guess = Pose2(*compose(invert(old_track[i]), new_track[j]).tolist())
    places = place_around(store, old, i), place_around(store, new, j)
    return Link(
        source=old[i],
        target=new[j],
        source_from_target=sharpened(*places, guess),
        information=information,
        kind="closure",
    )


def nearest_pair(old: FloatArray, new: FloatArray) -> Pair:
    """Which poses of two tracks (n, 3) and (m, 3) are nearest: a turn is as bad as a way.

    Only those are turned that are no farther apart than that, which are few of the n times m.
    """
    away = np.hypot(old[:, 0, None] - new[:, 0], old[:, 1, None] - new[:, 1])

    def apart(i: IntArray, j: IntArray) -> FloatArray:
        turns = np.abs(wrap_angles(old[i, 2] - new[j, 2]))
        return np.asarray(away[i, j] + METRES_A_RADIAN * turns)

    first = np.array([np.unravel_index(int(away.argmin()), away.shape)]).T
    i, j = np.nonzero(away <= apart(*first))
    best = int(apart(i, j).argmin())
    return int(i[best]), int(j[best])


def _taken_back(closure: Closure) -> Closure:
    """A merge that is none any more."""
    return replace(closure, merged=False, verified=False, reason=REFUTED, old_from_new=None)
