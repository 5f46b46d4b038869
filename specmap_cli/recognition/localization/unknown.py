"""What speaks for unknown: scans that fit no walls, and views that look like no place of the map.

A scan is sought in the grids of the submaps that it is likely from, and followed from there by the
robot's motion. What walls and looks say stays what it is for metres of the way. So it counts by the
motion since it counted last, and a view of a robot that stands still counts once, by the mean of
its scans.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from operator import attrgetter

from specmap_cli.core.geometry import Pose2, moved
from specmap_cli.core.records import PlanarScan, PosedScan
from specmap_cli.core.settings import LocalizationConfig
from specmap_cli.recognition.learning.misfit import FIT_RANGE_M
from specmap_cli.recognition.localization.classification import ClassifiedScan
from specmap_cli.recognition.localization.filtering import (
    VIEW_M,
    VIEW_RAD,
    novelty,
)
from specmap_cli.recognition.localization.places import Place
from specmap_cli.recognition.localization.wall_fit import View, WallFit

FIT_SEARCH_M = 1.0  # path between searches while a scan fits no walls
_FIT_STEP_M = 0.2  # motion between looks at walls while a scan fits where it leads
_FIT_STEP_RAD = 0.2  # turn between looks at walls while a scan fits where it leads
_BACK_M = 3.0  # so near to the last place that fitted, motion is asked first for the next one
_STRANGE_FROM = 0.87  # from this share of the limit on, a scan speaks for unknown
_STRANGE_GAIN = 2.0  # log likelihood for unknown, per share of the limit beyond that
_STRANGE_MOST = 1.0  # the most of that likelihood: views that are strange come in a row


class WallCheck:
    """How well successive scans fit the walls of submaps.

    `found` tells whether the last scan was found by a search, `view` what was matched of it (None
    where it was not looked at).
    """

    def __init__(self, fit: WallFit, config: LocalizationConfig) -> None:
        self.fit = fit
        self.config = config
        self.found = False
        self.view: View | None = None
        self._place: Place | None = None  # the last that fitted
        self._fits = False
        self._patience = _Patience(config)

    def restart(self) -> None:
        """Forget the place: the next pose has nothing to do with the last one."""
        self._place, self._fits = None, False
        self._patience = _Patience(self.config)

    def unknown(self, posed: PosedScan, seen: PlanarScan, likely: Sequence[int]) -> float | None:
        """Log likelihood of unknown over `likely` submaps, in their order; None: nothing is known.

        `seen` is what is matched: the scan, or better all that was seen of late from where it was
        taken. What fits where the motion leads is not sought, and is looked at again only after
        some motion. All else is sought, in one submap after the other until it fits, but not at
        every scan: a search takes longer than the rest.
        """
        self.found, self.view = False, None
        self._patience.drive(posed.map_from_base)
        before = self._place if self._fits else None
        if before is not None:
            # it left the place, but is not yet at the next to look; one that stands still looks at
            # every scan: people pass
            track = before.map_from_base, posed.map_from_base
            if moved(*track, VIEW_M, VIEW_RAD) and not moved(*track, _FIT_STEP_M, _FIT_STEP_RAD):
                return None
        view = self.view = View.of(posed, seen, FIT_RANGE_M)
        if view is None:
            return None
        if before is not None:
            followed = self.fit.followed(view, before, before.submap)
            if followed is not None and followed.fits:
                self._place = followed.place
                return followed.against
        elif self._place is not None:
            # nearer, a robot that comes back from where the map saw little is known again
            away = self._place.map_from_base.inverse() @ posed.map_from_base
            self._place = None if away.distance > _BACK_M else self._place
        self._fits = False
        due = self._patience.due(likely, at_once=before is not None)
        return self._sought(view, due) if due else None

    def _sought(self, view: View, likely: Sequence[int]) -> float | None:
        """What the best place says, where motion leads or in the likely submaps; None: nothing.

        It is followed if it fits.
        """
        found = [] if self._place is None else self.fit.led(view, self._place)
        if not any(each.fits for each in found):
            for submap in likely:  # up to one where the view fits
                found += self.fit.anywhere(view, submap)
                if any(each.fits for each in found):
                    break
            found = [self.fit.best(found)] if found else []
        if not found:
            return None
        best = min(found, key=attrgetter("misfit"))
        self.found = self._fits = best.fits
        self._place = best.place if best.fits else self._place
        again = self._patience.goes_on and not self.found  # the likeliest said it already
        self._patience.searched(self.found)
        return None if again else best.against


class _Patience:
    """Which submaps to search, and when: after some path, or, standing, after a while.

    A robot that stands still has them searched in turn, those first that are likeliest; `goes_on`
    when others were searched before those due. After all of them it waits for twice as many scans
    as before.
    """

    def __init__(self, config: LocalizationConfig) -> None:
        self.config = config
        self._driven_m = FIT_SEARCH_M
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
        stands = self._driven_m < VIEW_M
        left = tuple(i for i in likely if i not in self._tried) if stands else ()
        over = self._driven_m >= FIT_SEARCH_M or self._scans >= self._wait
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


class UnknownOdds:
    """Log likelihood of unknown over known, a view after another."""

    def __init__(self, walls: WallCheck, config: LocalizationConfig) -> None:
        self.walls = walls
        self.config = config
        self._fits, self._appearance = _Clue(), _Clue()

    @property
    def of_walls(self) -> float | None:
        """Log likelihood of unknown by the last scan matched with walls; None where none was."""
        return self._fits.last

    def restart(self) -> None:
        """Forget every scan."""
        self.walls.restart()
        self._fits, self._appearance = _Clue(), _Clue()

    def worth(
        self, posed: PosedScan, scan: ClassifiedScan, likely: Sequence[int], again: bool
    ) -> float:
        """Log likelihood of the view that the scan is of; `again` when it is the last scan's view.

        `likely` are the submaps, the likeliest first.
        """
        for clue in (self._fits, self._appearance):
            clue.see(posed, again)
        if self.config.fit_submaps:
            said = self.walls.unknown(posed, scan.seen, likely)
            self._fits.add(said, instead=self.walls.found)
        if scan.strange != -math.inf:
            strange = _STRANGE_GAIN * (scan.strange - _STRANGE_FROM)
            if strange > 0.0:
                # what a short window of a narrow laser has seen so far looks strange anywhere
                strange *= scan.shown**2
            self._appearance.add(min(max(strange, -_STRANGE_MOST), _STRANGE_MOST))
        return self._fits.worth + self._appearance.worth


class _Clue:
    """One kind of clue: the mean of what is said in a view, by the motion since it last was."""

    def __init__(self) -> None:
        self._at: Pose2 | None = None
        self._motion = 1.0  # share of a view that says something new; what comes first does
        self._weight, self._sum, self._scans = 0.0, 0.0, 0
        self.last: float | None = None

    @property
    def worth(self) -> float:
        """What the view says so far; nothing as long as nothing was said of it."""
        return self._weight * self._sum / self._scans if self._scans else 0.0

    def see(self, posed: PosedScan, again: bool) -> None:
        """Take in where a scan was taken, and whether in the last view."""
        if not again:
            self._weight, self._sum, self._scans = 0.0, 0.0, 0
        if posed.lost:
            return
        self._motion = novelty(self._at, posed.map_from_base, self._motion)
        self._at = posed.map_from_base

    def add(self, said: float | None, instead: bool = False) -> None:
        """Take in what is said of a scan, if anything is; `instead` of what was of its view."""
        if said is None:
            return
        if not self._scans:
            self._weight, self._motion = min(1.0, self._motion), 0.0
        self.last = said
        if instead:
            self._sum, self._scans = 0.0, 0
        self._sum += said
        self._scans += 1
