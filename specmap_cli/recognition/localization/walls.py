"""Do scans fit the walls of the map? The evidence that tells its places from all others best.

A scan is sought in the grids of the submaps that it is likely from, and followed from there by the
robot's motion: in its own place nearly all of its returns lie on walls, elsewhere hardly ever.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.records import PlanarScan, PosedScan
from specmap_cli.core.settings import LocalizationConfig
from specmap_cli.grids.gridmap import UNKNOWN, GridMap
from specmap_cli.grids.matching import Match, ScoreField, refine, search_everywhere
from specmap_cli.recognition.learning.misfit import HeldOutMisfit, near_returns, pooled

_LEAST_POINTS = 10  # fewer fit anywhere
_OFF = 0.95  # a point that much off is a quarter of a metre from walls: behind none by noise
# Of the search, coarse: what it finds within 0.3 m and a few degrees is mended by the refinement.
_STEP_M, _STEP_RAD, _PLACES = 0.3, math.radians(5.0), 4


class Ratio:
    """Log likelihood of unknown over known, by the misfit of a scan; never past `fit_most`.

    Misfits in known places are exponential, of the mean that the map's own views had; in other
    places, where they fit best, they are normal. What fits worse than those on average is no more
    of a known place for it.
    """

    def __init__(self, held_out: HeldOutMisfit | None, config: LocalizationConfig) -> None:
        self.known = pooled(held_out, config)
        self.config = config

    def of(self, misfit: float) -> float:
        """The log likelihood at a misfit in [0, 1]; it never falls with it."""
        foreign, spread = self.config.foreign_misfit, self.config.foreign_misfit_spread
        off = (min(misfit, foreign) - foreign) / spread
        unknown = -0.5 * off**2 - math.log(spread * math.sqrt(2.0 * math.pi))
        known = -misfit / self.known - math.log(self.known)
        return min(max(unknown - known, -self.config.fit_most), self.config.fit_most)


@dataclass(frozen=True, slots=True)
class _Place:
    """Where the last scan fitted: `pose` in a submap, when the robot was at `map_from_base`."""

    submap: int
    pose: Pose2
    map_from_base: Pose2


class WallCheck:
    """How well successive scans fit the walls of submaps; `field` gives those of each grid."""

    def __init__(
        self,
        grids: Mapping[int, GridMap],
        field: Callable[[int], ScoreField],
        ratio: Ratio,
        config: LocalizationConfig,
    ) -> None:
        self.grids = grids
        self.field = field
        self.ratio = ratio
        self.config = config
        self._place: _Place | None = None
        self._patience = _Patience(config.fit_search_m)

    def restart(self) -> None:
        """Forget the place: the next pose has nothing to do with the last one."""
        self._place = None
        self._patience = _Patience(self.config.fit_search_m)

    def unknown(self, posed: PosedScan, seen: PlanarScan, likely: Sequence[int]) -> float | None:
        """Log likelihood of unknown over the submaps that are `likely`; None: nothing is known.

        `seen` is what is matched: the scan, or better all that was seen of late from where it was
        taken. What fits where the robot's motion leads is not sought. All else is, in one submap
        after the other until it fits, but not at every scan: a search takes longer than the rest.
        """
        points = posed.base_from_laser.apply(near_returns(seen, self.config.fit_range_m))
        if posed.lost or len(points) < _LEAST_POINTS:
            return None
        self._patience.drive(posed.map_from_base)
        before = self._place
        found = self._followed(posed, points)
        if found is not None and found[0] < 0.0:
            return found[0]
        self._place = None
        if before is None and not self._patience.is_over():
            return None
        return self._sought(posed, points, likely, found)

    def _followed(self, posed: PosedScan, points: FloatArray) -> tuple[float, _Place] | None:
        """What the place says to which the motion since the last scan leads, when it is known."""
        if self._place is None:
            return None
        last = self._place
        guess = last.pose @ (last.map_from_base.inverse() @ posed.map_from_base)
        match = refine(self.field(last.submap), points, guess)
        self._place = _Place(last.submap, match.pose, posed.map_from_base)
        return self.ratio.of(self._misfit(last.submap, points, match.pose)), self._place

    def _sought(
        self,
        posed: PosedScan,
        points: FloatArray,
        likely: Sequence[int],
        best: tuple[float, _Place] | None,
    ) -> float | None:
        """What the best place in the likely submaps says, which is followed if it fits."""
        for submap in likely:
            match = _anywhere(self.field(submap), points)
            ratio = self.ratio.of(self._misfit(submap, points, match.pose))
            if best is None or ratio < best[0]:
                best = ratio, _Place(submap, match.pose, posed.map_from_base)
            if ratio < 0.0:
                break
        if best is None:
            return None
        fits = best[0] < 0.0
        self._place = best[1] if fits else None
        self._patience.searched(fits)
        return best[0]

    def _misfit(self, submap: int, points: FloatArray, pose: Pose2) -> float:
        """How far off the walls points (N, 2) are; those where the map saw nothing count less."""
        placed = pose.apply(points)
        off = 1.0 - np.asarray(self.field(submap).at(placed), dtype=np.float64)
        unseen = (self.grids[submap].values_at(placed) == UNKNOWN) & (off > _OFF)
        return float(np.mean(np.where(unseen, self.config.unseen_weight, 1.0) * off))


class _Patience:
    """When to search again: after some path, or, standing, after twice as many scans as before."""

    def __init__(self, path_m: float) -> None:
        self.path_m = path_m
        self._driven_m = path_m
        self._scans, self._wait = 0, 1
        self._at: Pose2 | None = None

    def drive(self, map_from_base: Pose2) -> None:
        """Take in where the next scan was taken."""
        if self._at is not None:
            self._driven_m += (self._at.inverse() @ map_from_base).distance
        self._at = map_from_base
        self._scans += 1

    def is_over(self) -> bool:
        """Whether it is time to search."""
        return self._driven_m >= self.path_m or self._scans >= self._wait

    def searched(self, found: bool) -> None:
        """Begin anew; after a search in vain the next one without motion comes later."""
        self._driven_m, self._scans = 0.0, 0
        self._wait = 1 if found else 2 * self._wait


def _anywhere(field: ScoreField, points: FloatArray) -> Match:
    """The best refined match of points (N, 2) anywhere on a field."""
    found = search_everywhere(field, points, count=_PLACES, step=_STEP_M, angle_step=_STEP_RAD)
    refined = [refine(field, points, match.pose) for match in found]
    return max(refined, key=lambda match: match.score, default=Match(Pose2(0.0, 0.0, 0.0), 0.0))
