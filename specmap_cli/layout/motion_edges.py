"""Edges between successive nodes: the front end's motion, and how far it can be trusted.

The covariance of a step has two parts: noise in proportion to the motion, and what the walls in
sight leave undetermined, from their normals (Censi, "On achievable accuracy for range-finder
localization", ICRA 2007): along a bare corridor a scan fixes nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from specmap_cli.core.geometry import FloatArray, Pose2, compose, inverse3, invert
from specmap_cli.core.records import IntArray
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.grids.matching import observability
from specmap_cli.layout.pose_graph import Link, LinkKind

_STEP_SHARE = 0.03  # error of a motion, metres per metre driven
_TURN_SHARE = 0.02  # error of a motion's turn, radians per radian
GUESS_M = 0.3  # error of a motion without a wall in sight, or over a break
_GUESS_RAD = 0.2  # error of the turn of such a motion
_RANGE_NOISE_M = 0.1  # error of a reading; more than the laser's: neighbours err alike
MATCH_RANGE_M = 12.0  # farther returns are not matched

# Error of a step of no length: registration ends within a fifth of a map cell of 5 cm, 3 m away.
_LEAST_M, _LEAST_RAD = 0.01, 0.003


@dataclass(frozen=True, slots=True)
class Bridge:
    """How well the motion over a break of the tracking is known, where odometry measured it.

    Standard deviations of the first pose after the break, seen from the last one before.
    """

    position_m: float
    heading_rad: float

    @property
    def information(self) -> FloatArray:
        """(3, 3) of the motion."""
        return np.diag([self.position_m**-2, self.position_m**-2, self.heading_rad**-2])


def motion_links(
    store: KeyframeStore,
    nodes: IntArray,
    breaks: Mapping[int, Bridge | None],
) -> tuple[Link, ...]:
    """Links from each of the keyframes `nodes` (M,) to the next, as tracked.

    Those that end in one of `breaks`, where tracking started afresh, are bridges, or loose where
    nothing is known of the motion: a guess.
    """
    poses = store.poses[nodes]
    motions = compose(invert(poses[:-1]), poses[1:])
    steps = [Pose2(*motion) for motion in motions.tolist()]
    informations = _informations(store, nodes[1:].tolist(), steps, breaks)
    return tuple(
        Link(
            source=source,
            target=end,
            source_from_target=step,
            information=information,
            kind=_kind(end, breaks),
        )
        for source, end, step, information in zip(
            nodes[:-1].tolist(), nodes[1:].tolist(), steps, informations, strict=True
        )
    )


def _informations(
    store: KeyframeStore,
    ends: Sequence[int],
    steps: Sequence[Pose2],
    breaks: Mapping[int, Bridge | None],
) -> FloatArray:
    """(L, 3, 3) of the motions `steps` (L,) that end in these keyframes."""
    fisher = [
        np.zeros((3, 3))
        if end in breaks
        else observability(store.points(end, MATCH_RANGE_M), _RANGE_NOISE_M)
        for end in ends
    ]
    informations = step_information(steps, np.array(fisher).reshape(-1, 3, 3))
    for k, end in enumerate(ends):
        if end in breaks:
            bridge = breaks[end]
            informations[k] = guess_information() if bridge is None else bridge.information
    return informations


def _kind(end: int, breaks: Mapping[int, Bridge | None]) -> LinkKind:
    """What a motion that ends in a keyframe is."""
    if end not in breaks:
        return "odometry"
    return "loose" if breaks[end] is None else "bridge"


def guess_information() -> FloatArray:
    """Information (3, 3) of a motion that no wall in sight confirms."""
    return np.diag([GUESS_M**-2, GUESS_M**-2, _GUESS_RAD**-2])


def step_information(steps: Sequence[Pose2], fisher: FloatArray) -> FloatArray:
    """Information (L, 3, 3) of motions `steps` (L,), each weighed in the frame it ends in.

    `fisher` (L, 3, 3) is what the walls seen from its end tell of a place.
    """
    position = [_LEAST_M + _STEP_SHARE * step.distance for step in steps]
    angle = [_LEAST_RAD + _TURN_SHARE * abs(step.theta) for step in steps]
    sigmas = np.column_stack([position, position, angle])
    moved = sigmas[:, :, None] ** 2 * np.eye(3)
    unseen = inverse3(fisher + guess_information())
    return inverse3(moved + unseen)
