"""How well a view fits the walls of a submap: where motion leads, and anywhere.

In its own place nearly all of its returns lie on walls, elsewhere hardly ever. And few of them lie
behind walls: few walls of a narrow scan fit many corners of many buildings, but where a return lies
farther away than a wall that the map has on the way to it, the scan is of another place.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter

import numpy as np

from specmap_cli.core.arrays import evenly
from specmap_cli.core.geometry import IDENTITY, FloatArray, Pose2
from specmap_cli.core.records import PlanarScan, PosedScan
from specmap_cli.core.settings import LocalizationConfig
from specmap_cli.grids.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap, cast_rays
from specmap_cli.grids.matching import refine, search_everywhere
from specmap_cli.grids.score_field import ScoreField
from specmap_cli.recognition.learning.misfit import FIT_RANGE_M, HeldOutMisfit, near_returns, pooled
from specmap_cli.recognition.localization.places import BESIDE, Place

_MOST_RAYS = 120  # of a scan, one every three degrees all round: what is cast costs grows with them
# What the pose of a match and the cells of a grid leave open, in heading and sideways. Along a wall
# that moves the end of a ray by metres: so a ray may reach as far as any that passes so near.
_SLANT_RAD, _SIDE_M = math.radians(3.0), 0.15
_BEHIND_M = 0.3  # farther than a match is off, and than a wall is thick in a grid
_FIT_MOST = 4.0  # log likelihood that walls give at the most
_BEHIND_USUAL = 0.2  # share of a scan behind walls of its own place that moved
_UNSEEN_WEIGHT = 0.25  # weight of returns off the walls where the map saw nothing
# Share of returns off the walls of other places where they fit best, on average.
_FOREIGN_MISFIT = 0.32
_FOREIGN_MISFIT_SPREAD = 0.13  # standard deviation of that share, seen on plans and logs
_LEAST_POINTS = 10  # fewer fit anywhere
_OFF = 0.95  # a point that much off is a quarter of a metre from walls: behind none by noise
# Of the search, coarse: what it finds within 0.3 m and a few degrees is mended by the refinement.
_STEP_M, _PLACES = 0.3, 4
_ALL_ROUND = np.arange(0.0, 2.0 * math.pi, math.radians(5.0)).tolist()
# By how much the place that fits best is better than the next one, on average: of scans from
# elsewhere, which fit by chance, and of the map's own.
_FOREIGN_GAP, _OWN_GAP = 0.06, 0.15


class Surroundings:
    """Score fields of submaps, each in its own frame; made when asked for.

    `frames` are the frames of the grids in the layout. A submap without one stands alone.
    """

    def __init__(
        self,
        grids: Mapping[int, GridMap],
        adjacency: Mapping[int, Collection[int]],
        frames: Mapping[int, Pose2],
    ) -> None:
        self.grids = grids
        self.adjacency = adjacency
        self.frames = frames
        self._fields: dict[int, ScoreField] = {}

    def field(self, submap: int) -> ScoreField:
        """The walls in and around a submap, as far as its grid reaches.

        Those of its neighbours are drawn in the cells that it never saw.
        """
        if submap in self._fields:
            return self._fields[submap]
        own = self.grids[submap]
        cells = own.cells.copy()
        for neighbour in sorted(self.adjacency.get(submap, ())):
            if neighbour != submap and {submap, neighbour} <= self.frames.keys():
                own_from_other = self.frames[submap].inverse() @ self.frames[neighbour]
                other = self.grids[neighbour]
                walls = own_from_other.apply(other.centres_of(np.argwhere(other.occupied)))
                places = own.cells_of(walls)
                rows, columns = places[own.inside(places)].T
                unseen = cells[rows, columns] == UNKNOWN
                cells[rows[unseen], columns[unseen]] = OCCUPIED
        field = ScoreField.from_grid(GridMap(cells, own.resolution, own.origin))
        self._fields[submap] = field
        return field


class Sightlines:
    """Casts rays in the grids of submaps, in their frames, as far as `reach_m`."""

    def __init__(self, grids: Mapping[int, GridMap], reach_m: float) -> None:
        self.grids = grids
        self.reach_m = reach_m
        self._distances: dict[int, FloatArray] = {}

    def behind(self, submap: int, posed: PosedScan, submap_from_base: Pose2) -> float:
        """Share of a scan's returns that lie behind walls within reach; 0 without returns.

        A wall counts when the rays beside it meet walls, too: one that ends there may be passed.
        """
        planar = posed.planar
        returned = np.isfinite(planar.ranges)
        bearings = evenly(planar.bearings[returned], _MOST_RAYS)
        if not len(bearings):
            return 0.0
        laser = submap_from_base @ posed.base_from_laser
        if submap not in self._distances:
            self._distances[submap] = self.grids[submap].obstacle_distance()
        origins = np.tile([laser.x, laser.y], (len(bearings), 1))
        grid, angles = self.grids[submap], bearings + laser.theta
        ranges = cast_rays(self._distances[submap], grid, origins, angles, self.reach_m)
        around = np.maximum(_SLANT_RAD, _SIDE_M / np.maximum(ranges, grid.resolution))
        first = np.searchsorted(bearings, bearings - around)
        last = np.searchsorted(bearings, bearings + around, side="right")
        farthest = np.array([ranges[a:b].max() for a, b in zip(first, last, strict=True)])
        return float(np.mean(evenly(planar.ranges[returned], _MOST_RAYS) > farthest + _BEHIND_M))


class Ratio:
    """Log likelihood of unknown over known, by the misfit of a scan; never past `_FIT_MOST`.

    Misfits in known places are exponential, of the mean that the map's own views had; in other
    places, where they fit best, they are normal. What fits worse than those on average is no more
    of a known place for it.
    """

    def __init__(self, held_out: HeldOutMisfit | None, config: LocalizationConfig) -> None:
        self.known = pooled(held_out, config)

    def of(self, misfit: float, gap: float = 0.0) -> float:
        """The log likelihood at a misfit in [0, 1]; it never falls with it.

        The next best place's misfit is more by `gap`. What fits by chance fits nearly as well in
        several places. So a place that stands out may be the right one where the map saw little of
        what is seen there. Places that are alike say nothing: a map has such.
        """
        foreign, spread = _FOREIGN_MISFIT, _FOREIGN_MISFIT_SPREAD
        off = (min(misfit, foreign) - foreign) / spread
        unknown = -0.5 * off**2 - math.log(spread * math.sqrt(2.0 * math.pi))
        known = -misfit / self.known - math.log(self.known)
        elsewhere = -gap / _FOREIGN_GAP - math.log(_FOREIGN_GAP)
        own = -gap / _OWN_GAP - math.log(_OWN_GAP)
        said = unknown - known + min(0.0, elsewhere - own)
        return min(max(said, -_FIT_MOST), _FIT_MOST)


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """What is matched of a scan: `points` (N, 2) of all that was seen, `own` (N, 2) of it alone.

    Both are in the base frame, as far as `FIT_RANGE_M`.
    """

    posed: PosedScan
    points: FloatArray
    own: FloatArray

    @classmethod
    def of(cls, posed: PosedScan, seen: PlanarScan, reach_m: float) -> View | None:
        """The view of a scan, of which all that was `seen` of late; None if it shows too little."""
        laser = posed.base_from_laser
        points, own = (laser.apply(near_returns(each, reach_m)) for each in (seen, posed.planar))
        return None if posed.lost or len(points) < _LEAST_POINTS else cls(posed, points, own)


@dataclass(frozen=True, slots=True)
class Fitted:
    """A place where a view may be from, its misfit in [0, 1], and what walls say there.

    `against` is the log likelihood of unknown over known. Below nought, the view fits.
    """

    place: Place
    misfit: float
    against: float

    @property
    def fits(self) -> bool:
        """Whether the place is more likely than none of the map."""
        return self.against < 0.0


class WallFit:
    """Fits views to the walls of submaps, of which `grids` hold what was seen from them.

    `frames` are the frames of the grids in the layout, where it is known.
    """

    def __init__(
        self,
        grids: Mapping[int, GridMap],
        around: Surroundings,
        ratio: Ratio,
        frames: Mapping[int, Pose2] | None = None,
    ) -> None:
        self.around = around
        self.ratio = ratio
        self.frames = frames or {}
        self._sight = Sightlines(grids, FIT_RANGE_M)

    def followed(self, view: View, before: Place, submap: int) -> Fitted | None:
        """Where a view is in a submap to which motion leads from a place; None: it is not known."""
        guess = before.led_to(submap, view.posed.map_from_base, self.frames)
        return None if guess is None else self._near(view, submap, guess)

    def led(self, view: View, before: Place) -> list[Fitted]:
        """Where a view is to which motion leads: in each submap that saw the place."""
        found = []
        for submap, grid in sorted(self._sight.grids.items()):
            guess = before.led_to(submap, view.posed.map_from_base, self.frames)
            if guess is not None and grid.values_at(np.array([[guess.x, guess.y]]))[0] == FREE:
                found.append(self._near(view, submap, guess))
        return found

    def anywhere(self, view: View, submap: int) -> list[Fitted]:
        """The places in a submap that fit best, the best first; at least one.

        The best by the field alone may be wrong: it does not know where the map saw nothing.
        """
        matches = search_everywhere(
            self.around.field(submap), view.points, _PLACES, _STEP_M, _ALL_ROUND
        )
        guesses = [match.pose for match in matches] or [IDENTITY]
        found = [self._refined(view, view.points, submap, guess) for guess in guesses]
        return sorted(found, key=attrgetter("misfit"))

    def best(self, found: Sequence[Fitted]) -> Fitted:
        """The place of those found that fits best, the better if it stands out among them."""
        best = min(found, key=attrgetter("misfit"))
        if best.fits:
            return best
        others = [f.misfit for f in found if not best.place.is_near(f.place, self.frames, *BESIDE)]
        if not others:
            return best
        gap = min(others) - best.misfit
        return replace(best, against=self.ratio.of(best.misfit, gap))

    def _near(self, view: View, submap: int, guess: Pose2) -> Fitted:
        """The place near a guess.

        Where all that was seen of late does not fit, the scan alone may: legs of chairs and tables,
        which hide behind each other, are in the one and hardly in the map.
        """
        fitted = self._refined(view, view.points, submap, guess)
        if fitted.fits or len(view.own) < _LEAST_POINTS:
            return fitted
        alone = self._refined(view, view.own, submap, guess)
        return min(fitted, alone, key=attrgetter("misfit"))

    def _refined(self, view: View, points: FloatArray, submap: int, guess: Pose2) -> Fitted:
        """The place near a guess where points (N, 2) fit best."""
        field = self.around.field(submap)
        place = Place(submap, refine(field, points, guess).pose, view.posed.map_from_base)
        # beyond what doors, people and moved things explain
        behind = self._sight.behind(submap, view.posed, place.pose) - _BEHIND_USUAL
        behind = max(0.0, behind) / (1.0 - _BEHIND_USUAL)
        placed = place.pose.apply(points)
        off = 1.0 - np.asarray(field.at(placed), dtype=np.float64)
        # where the map saw nothing counts less
        unseen = (self._sight.grids[submap].values_at(placed) == UNKNOWN) & (off > _OFF)
        on_walls = 1.0 - float(np.mean(np.where(unseen, _UNSEEN_WEIGHT, 1.0) * off))
        misfit = 1.0 - on_walls * (1.0 - behind)
        return Fitted(place, misfit, self.ratio.of(misfit))
