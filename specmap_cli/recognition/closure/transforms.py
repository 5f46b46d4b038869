"""Which transforms between two grids are worth a closer look: a global search without pose prior.

Rotations come from the directions of the walls, translations from a correlation by Fourier
transform of walls with walls and of free space with walls. What is transformed for one rotation is
kept for the others.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray, Pose2, wrap_angle
from specmap_cli.grids.correlation import Peak, Target, marked_cells, peaks
from specmap_cli.recognition.closure.prepared import PreparedGrid

# How much is tried: more of each takes longer and found nothing more on fr079 and simulated tours.
_SLACK_RAD = math.radians(3.0)  # the direction of few walls is good to a few degrees
# Stairs of coarse cells bend that direction: by 22 degrees on simulated rooms in cells of 0.25 m.
_FINE_CELL_M, _CELL_M_PER_SLACK = 0.05, 0.025
_PEAKS_PER_ROTATION = 2
_PEAKS_APART_M = 1.0
_TRANSFORMS = 8
# Transforms farther apart are different ones to try, and rivals when both fit.
_DIFFERENT_M, _DIFFERENT_RAD = 0.5, math.radians(2.0)
RIVAL_M, RIVAL_RAD = 1.0, math.radians(10.0)

_Placed = tuple[float, Pose2]


class TransformSearch:
    """The promising transforms old_from_new between two grids.

    `few` and `many` are the rotations off that of aligned walls, the smallest first, radians, that
    are tried at first, and when these lead nowhere. `centre` (2,) is that of the new grid's walls.
    """

    def __init__(self, old: PreparedGrid, new: PreparedGrid) -> None:
        steps = _slack_steps(old, new)
        self.few, self.many = _slacks(steps), _slacks(steps + 1)
        self.centre: FloatArray = new.coarse.walls.mean(axis=0)
        self._old = old.coarse
        self._aligned = old.direction - new.direction
        self._parts = (new.coarse.walls - self.centre, new.coarse.free - self.centre)
        # of many rotations, neighbours of the best must not crowd out the rivals that count
        self._apart = (RIVAL_M, RIVAL_RAD) if steps else (_DIFFERENT_M, _DIFFERENT_RAD)
        self._targets: dict[int, Target] = {}
        self._placed: dict[tuple[int, float], list[list[_Placed]]] = {}

    def best(self, slacks: Iterable[float]) -> list[Pose2]:
        """At most 8 transforms with one of these rotations, the most promising first."""
        found: list[_Placed] = []
        for quarters in (0, 1):
            for slack in slacks:
                for placed in self._of_rotation(quarters, slack):
                    found.extend(placed)
        found.sort(key=lambda item: -item[0])
        kept: list[Pose2] = []
        for _, pose in found:
            if all(differ(pose, other, self.centre, *self._apart) for other in kept):
                kept.append(pose)
            if len(kept) == _TRANSFORMS:
                break
        return kept

    def _of_rotation(self, quarters: int, slack: float) -> list[list[_Placed]]:
        """The best transforms, with their values, of a rotation and of half a turn more.

        Walls and free space of the new grid, turned, are laid on the old one at every shift.
        """
        key = quarters, slack
        if key not in self._placed:
            target = self._target(quarters)
            angle = self._aligned + quarters * math.pi / 2 + slack
            turn, cell = Pose2(0.0, 0.0, angle), self._old.cell_m
            pictures = [
                marked_cells(turn.apply(points), cell, target.shape) for points in self._parts
            ]
            apart = round(_PEAKS_APART_M / cell)
            self._placed[key] = [
                [
                    self._transform(peak, wrap_angle(angle + half))
                    for peak in peaks(correlation, target.size, cell, _PEAKS_PER_ROTATION, apart)
                ]
                for half, correlation in zip(
                    (0.0, math.pi), target.correlate_turned(np.stack(pictures)), strict=True
                )
            ]
        return self._placed[key]

    def _transform(self, peak: Peak, angle: float) -> _Placed:
        """A peak's value, and the transform that turns by `angle` and takes the centre there."""
        at = Pose2(peak.x + self._old.origin[0], peak.y + self._old.origin[1], angle)
        return peak.value, at @ Pose2(-float(self.centre[0]), -float(self.centre[1]), 0.0)

    def _target(self, quarters: int) -> Target:
        """The old grid, with room for the new one at each rotation about this one."""
        if quarters not in self._targets:
            angle = self._aligned + quarters * math.pi / 2
            turned = Pose2(0.0, 0.0, angle).apply(np.vstack(self._parts))
            reach: FloatArray = np.abs(turned).max(axis=0)
            reach = reach + math.sin(self.many[-1]) * reach[::-1]
            # to both sides, and what rounding to cells adds
            columns, rows = (2 * np.ceil(reach / self._old.cell_m).astype(int) + 3).tolist()
            self._targets[quarters] = Target.of(self._old.layers, (rows, columns))
        return self._targets[quarters]


def differ(a: Pose2, b: Pose2, centre: NDArray[np.float64], metres: float, radians: float) -> bool:
    """Whether two transforms place `centre` (2,) farther apart than this, or turn it further."""
    shift = a.apply(centre[None])[0] - b.apply(centre[None])[0]
    turn = abs(wrap_angle(a.theta - b.theta))
    return math.hypot(*shift.tolist()) > metres or turn > radians


def _slack_steps(old: PreparedGrid, new: PreparedGrid) -> int:
    """How many steps to either side of aligned walls are tried at once, for the size of cells."""
    cell_m = max(old.area.resolution, new.area.resolution)
    return max(0, int((cell_m - _FINE_CELL_M) / _CELL_M_PER_SLACK))


def _slacks(steps: int) -> Sequence[float]:
    """Rotations off that of aligned walls, the smallest first, radians."""
    return (0.0, *(sign * k * _SLACK_RAD for k in range(1, steps + 1) for sign in (-1.0, 1.0)))
