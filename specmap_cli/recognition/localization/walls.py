"""Do scans fit the walls of the map? The evidence that tells its places from all others best.

A scan is sought in the grids of the submaps that it is likely from, and followed from there by the
robot's motion: in its own place nearly all of its returns lie on walls, elsewhere hardly ever.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from operator import itemgetter

import numpy as np

from specmap_cli.core.geometry import IDENTITY, FloatArray, Pose2
from specmap_cli.core.records import PlanarScan, PosedScan
from specmap_cli.core.settings import LocalizationConfig
from specmap_cli.core.tracks import moved
from specmap_cli.grids.gridmap import UNKNOWN, GridMap
from specmap_cli.grids.matching import ScoreField, refine, search_everywhere
from specmap_cli.recognition.learning.misfit import HeldOutMisfit, near_returns, pooled
from specmap_cli.recognition.localization.place import Place
from specmap_cli.recognition.localization.sight import Sightlines

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


class WallCheck:
    """How well successive scans fit the walls of submaps; `field` gives those of each grid.

    `frames` are the frames of the grids in the layout, where it is known. `found` tells whether the
    last scan was found by a search.
    """

    def __init__(
        self,
        grids: Mapping[int, GridMap],
        field: Callable[[int], ScoreField],
        ratio: Ratio,
        config: LocalizationConfig,
        frames: Mapping[int, Pose2] | None = None,
    ) -> None:
        self.field = field
        self.ratio = ratio
        self.config = config
        self.frames = frames or {}
        self.found = False
        self._sight = Sightlines(grids, config.fit_range_m)
        self._place: Place | None = None
        self._patience = _Patience(config)

    def restart(self) -> None:
        """Forget the place: the next pose has nothing to do with the last one."""
        self._place = None
        self._patience = _Patience(self.config)

    def unknown(self, posed: PosedScan, seen: PlanarScan, likely: Sequence[int]) -> float | None:
        """Log likelihood of unknown over `likely` submaps, in their order; None: nothing is known.

        `seen` is what is matched: the scan, or better all that was seen of late from where it was
        taken. What fits where the motion leads is not sought, and is looked at again only after
        some motion. All else is sought, in one submap after the other until it fits, but not at
        every scan: a search takes longer than the rest.
        """
        self.found = False
        self._patience.drive(posed.map_from_base)
        before = self._place
        if before is not None and self._drives_on(before, posed.map_from_base):
            return None
        points = posed.base_from_laser.apply(near_returns(seen, self.config.fit_range_m))
        if posed.lost or len(points) < _LEAST_POINTS:
            return None
        followed = None
        if before is not None:
            followed = self._followed(before, before.submap, posed, points)
            if followed is not None and followed[0] < 0.0:
                self._place = followed[1]
                return followed[0]
        self._place = None
        due = self._patience.due(likely, at_once=before is not None)
        return self._sought(posed, points, due, before, followed) if due else None

    def _drives_on(self, place: Place, map_from_base: Pose2) -> bool:
        """Whether the robot left a place where a scan fitted, but is not yet at the next to look.

        A robot that stands still looks at every scan: people pass.
        """
        config, before = self.config, place.map_from_base
        left = moved(before, map_from_base, config.view_m, config.view_rad)
        return left and not moved(before, map_from_base, config.fit_step_m, config.fit_step_rad)

    def _followed(
        self, before: Place, submap: int, posed: PosedScan, points: FloatArray
    ) -> tuple[float, Place] | None:
        """What the place in a submap says to which the motion leads; None when it is not known.

        Where all that was seen of late does not fit, the scan alone may: legs of chairs and tables,
        which hide behind each other, are in the one and hardly in the map.
        """
        guess = before.led_to(submap, posed.map_from_base, self.frames)
        if guess is None:
            return None
        said = self._refined(posed, points, submap, guess)
        if said[0] >= 0.0:
            own = posed.base_from_laser.apply(near_returns(posed.planar, self.config.fit_range_m))
            if len(own) >= _LEAST_POINTS:
                said = min(said, self._refined(posed, own, submap, guess), key=itemgetter(0))
        return said

    def _refined(
        self, posed: PosedScan, points: FloatArray, submap: int, guess: Pose2
    ) -> tuple[float, Place]:
        """What the place near a guess says, where points (N, 2) fit best."""
        match = refine(self.field(submap), points, guess)
        return self._said(posed, points, Place(submap, match.pose, posed.map_from_base))

    def _sought(
        self,
        posed: PosedScan,
        points: FloatArray,
        likely: Sequence[int],
        before: Place | None,
        best: tuple[float, Place] | None,
    ) -> float | None:
        """What the best place in the likely submaps says, which is followed if it fits."""
        for submap in likely:
            said = None
            if before is not None and submap != before.submap:
                said = self._followed(before, submap, posed, points)
            if said is None or said[0] >= 0.0:
                found = _anywhere(self.field(submap), points)
                places = [Place(submap, pose, posed.map_from_base) for pose in found]
                said = min((self._said(posed, points, each) for each in places), key=itemgetter(0))
            if best is None or said[0] < best[0]:
                best = said
            if said[0] < 0.0:
                break
        if best is None:
            return None
        self.found = best[0] < 0.0
        self._place = best[1] if self.found else None
        again = self._patience.goes_on and not self.found  # the likeliest said it already
        self._patience.searched(self.found)
        return None if again else best[0]

    def _said(self, posed: PosedScan, points: FloatArray, place: Place) -> tuple[float, Place]:
        """Log likelihood of unknown when a scan is at a place, and the place."""
        return self.ratio.of(self._misfit(posed, points, place)), place

    def _misfit(self, posed: PosedScan, points: FloatArray, place: Place) -> float:
        """How far off the walls points (N, 2) are, and what share of the scan is behind walls.

        Points where the map saw nothing count less, and so many behind walls as doors, people and
        things that were moved explain do not count.
        """
        placed = place.pose.apply(points)
        off = 1.0 - np.asarray(self.field(place.submap).at(placed), dtype=np.float64)
        unseen = (self._sight.grids[place.submap].values_at(placed) == UNKNOWN) & (off > _OFF)
        on_walls = 1.0 - float(np.mean(np.where(unseen, self.config.unseen_weight, 1.0) * off))
        usual = self.config.behind_usual
        behind = max(0.0, self._sight.behind(place.submap, posed, place.pose) - usual)
        return 1.0 - on_walls * (1.0 - behind / (1.0 - usual))


class _Patience:
    """Which submaps to search, and when: after some path, or, standing, after a while.

    A robot that stands still has them searched in turn, those first that are likeliest; `goes_on`
    when others were searched before those due. After all of them it waits for twice as many scans
    as before.
    """

    def __init__(self, config: LocalizationConfig) -> None:
        self.config = config
        self._driven_m = config.fit_search_m
        self._scans, self._wait = 0, 1
        self._at: Pose2 | None = None
        self._tried: tuple[int, ...] = ()
        self._left: tuple[int, ...] = ()
        self.goes_on = False

    def drive(self, map_from_base: Pose2) -> None:
        """Take in where the next scan was taken."""
        if self._at is not None:
            self._driven_m += (self._at.inverse() @ map_from_base).distance
        self._at = map_from_base
        self._scans += 1

    def due(self, likely: Sequence[int], at_once: bool) -> tuple[int, ...]:
        """The submaps to search now, some of the `likely` ones; none when it is not time."""
        stands = self._driven_m < self.config.view_m
        left = tuple(i for i in likely if i not in self._tried) if stands else ()
        over = self._driven_m >= self.config.fit_search_m or self._scans >= self._wait
        if not (at_once or over or (stands and self._tried and left)):
            return ()
        self.goes_on = bool(left) and not at_once and bool(self._tried)
        if not left or at_once:
            self._tried, left = (), tuple(likely)
        due, self._left = left[: self.config.fit_submaps], left[self.config.fit_submaps :]
        self._tried += due
        return due

    def searched(self, found: bool) -> None:
        """Begin anew; after a search of all in vain the next one without motion comes later."""
        self._driven_m, self._scans = 0.0, 0
        if found:
            self._tried, self._wait = (), 1
        elif not self._left:
            self._wait *= 2


def _anywhere(field: ScoreField, points: FloatArray) -> list[Pose2]:
    """The poses of points (N, 2) anywhere on a field that fit it best, refined; at least one.

    The best by the field alone may be wrong: it does not know where the map saw nothing.
    """
    found = search_everywhere(field, points, count=_PLACES, step=_STEP_M, angle_step=_STEP_RAD)
    return [refine(field, points, match.pose).pose for match in found] or [IDENTITY]
