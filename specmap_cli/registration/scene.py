"""A sweep in front of the local map: how well it fits somewhere, and where it fits best near by."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from specmap_cli.core.geometry import FloatArray, Pose2, product
from specmap_cli.core.settings import RegistrationConfig
from specmap_cli.grids.matching import Window, search
from specmap_cli.registration.local_map import LocalMap
from specmap_cli.registration.sweep_view import SweepView

_COARSE_VOXELS = 0.5  # kernels wider than this need neither all points nor full convergence
_CLEARLY_BETTER = 0.02  # score that a search must gain: as much as scores of one place vary


@dataclass(frozen=True, slots=True, kw_only=True)
class Fit:
    """A pose (4, 4) of the base in the map and its score in [0, 1].

    `refused` alignments on the way to it ran off and were not followed.
    """

    pose: FloatArray
    score: float
    refused: int = 0

    @property
    def planar(self) -> Pose2:
        """The pose in the plane."""
        return Pose2.from_matrix(self.pose)

    def or_better(self, other: Fit) -> Fit:
        """The other fit when it is clearly better, else this one; refusals of both count."""
        best = other if other.score > self.score + _CLEARLY_BETTER else self
        return replace(best, refused=self.refused + other.refused)


@dataclass(frozen=True, slots=True, kw_only=True)
class Scene:
    """One sweep and the local map that it is registered on."""

    view: SweepView
    local: LocalMap
    config: RegistrationConfig

    def score(self, place: Pose2) -> float:
        """How well, in [0, 1], the sweep's walls lie on the map's when the base is at a place."""
        return self.local.field.score(self.view.probe, place)

    def align(self, guess: FloatArray, kernels: Sequence[float]) -> Fit:
        """The registration method from a guess (4, 4), with one kernel (in voxels) after another.

        A result that runs off is refused: the one before it stands, at first the guess.
        """
        pose, refused = guess, 0
        for kernel in kernels:
            coarse = kernel > _COARSE_VOXELS
            points = self.view.sparse if coarse else self.view.cloud
            width_m = kernel * self.local.sensor.voxel_m
            found = self.local.aligner.align(points, pose, width_m, coarse=coarse)
            if not _within_limits(guess, found, self.config):
                refused = 1
                break
            pose = found
        return Fit(pose=pose, score=self.score(Pose2.from_matrix(pose)), refused=refused)

    def search(self, guess: FloatArray, window: Window, kernels: Sequence[float]) -> Fit:
        """The result of a correlative search around a guess (4, 4), aligned."""
        planar = Pose2.from_matrix(guess)
        found = search(self.local.field, self.view.probe, planar, window).pose
        return self.align(product((found @ planar.inverse()).matrix(), guess), kernels)


def _within_limits(guess: FloatArray, found: FloatArray, config: RegistrationConfig) -> bool:
    """Whether an alignment is finite, upright and no farther from its guess than allowed."""
    if not np.isfinite(found).all():
        return False
    trace = float((guess[:3, :3] * found[:3, :3]).sum())  # of the turn from one to the other
    turn = math.acos(min(1.0, max(-1.0, (trace - 1.0) / 2.0)))
    upright = float(found[2, 2]) > np.cos(config.max_tilt_rad)
    near = math.dist(guess[:3, 3].tolist(), found[:3, 3].tolist()) <= config.max_shift_m
    return near and turn <= config.max_shift_rad and upright
