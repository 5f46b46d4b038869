"""Localisation: in which submap was each scan of another log taken? (Section IV-B, Figure 6)

The classifiers and the exemplars of the map are asked of each scan; a hidden Markov model and the
places where the robot may be weigh what they say.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice

import numpy as np

from specmap_cli.core.errors import InputError
from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.records import PlanarScan, PosedScan
from specmap_cli.core.settings import LocalizationConfig
from specmap_cli.recognition.features.sets import scans_features
from specmap_cli.recognition.features.virtual import WINDOW_M, RecentScans
from specmap_cli.recognition.learning.calibration import Calibration, steadiness
from specmap_cli.recognition.learning.classifiers import ClassifierSet, Sensor
from specmap_cli.recognition.localization.filtering import Clue, HiddenMarkovFilter, ViewGrouping
from specmap_cli.recognition.localization.places import Estimate, WeighedPlaces
from specmap_cli.recognition.localization.walls import MapWalls

_STRANGE_ALONE = 1.0  # a single scan is unknown beyond this share of the limit
_STRANGE_FROM = 0.87  # from this share of the limit on, a scan speaks for unknown
_STRANGE_GAIN = 2.0  # log likelihood for unknown, per share of the limit beyond that
_STRANGE_MOST = 1.0  # the most of that likelihood: views that are strange come in a row
_SOMEBODY = 0.05  # of a view: a body three metres away covers as much of half a circle
_TOGETHER = 32  # scans whose features are computed at once

_VIEW_SLACK_RAD = 0.0873  # a laser is refused that sees by more than this less
_RANGE_SHARE = 0.5  # a laser is refused that sees less far than this share of the map's laser


@dataclass(frozen=True, slots=True, kw_only=True)
class Label:
    """Where one scan was taken; a submap of None means unknown: nothing fits.

    `margin` is the winner's margin over `runner_up`'s in the raw vote, `probability` how likely it
    is by this scan alone, if the scan is from the map. The filtered label uses all scans so far
    (all scans of the log after smoothing) and has a probability, too.
    """

    stamp_ns: int
    submap: int | None
    margin: float
    runner_up: int | None
    filtered_submap: int | None
    filtered_probability: float
    probability: float


@dataclass(frozen=True, slots=True)
class Fix:
    """A scan's pose in the map, its covariance (3, 3) in x, y and angle, its score in [0, 1].

    `probability` is that of the place in the map; the covariance is that of all that it may be.
    """

    pose: Pose2
    covariance: FloatArray
    score: float
    probability: float


@dataclass(frozen=True, slots=True)
class Where:
    """What is known of the place of one scan: its label, and its pose in the map where one leads.

    `track_from_base` is where it was registered, `restarted` that this has nothing to do with the
    scan before. `evidence` (m + 1,) is what its view says of the submaps and of unknown, so far;
    `again` that it is one more scan of that view.
    """

    label: Label
    fix: Fix | None
    track_from_base: Pose2
    restarted: bool
    evidence: FloatArray
    again: bool


class Localizer:
    """Tells where the scans of a log were taken, one after another, in a map; it keeps none.

    `adjacency` are the neighbours of its submaps. `with_walls` asks for poses even where walls do
    not count for the labels.
    """

    def __init__(
        self,
        classifiers: ClassifierSet,
        adjacency: Mapping[int, Collection[int]],
        walls: MapWalls,
        config: LocalizationConfig,
        *,
        with_walls: bool = False,
    ) -> None:
        self.classifiers = classifiers
        self.config = config
        self.filter = HiddenMarkovFilter({i: adjacency.get(i, ()) for i in classifiers.ids}, config)
        self.places = WeighedPlaces(walls, self.filter.ids, config)
        self._classifier = ScanClassifier(classifiers, config)
        self._uses_walls = with_walls or config.unknown
        self._walls, self._looks = Clue(), Clue()
        self._views = ViewGrouping()

    @property
    def note(self) -> str:
        """How the log's laser is made to fit the classifiers; empty when it is the same."""
        return self._classifier.note

    def add(self, posed: PosedScan) -> Where:
        """Where the next scan was taken. Raises InputError when its laser sees too little."""
        return self._add(posed, self._classifier.classified([posed])[0])

    def located(self, scans: Iterable[PosedScan]) -> Iterator[Where]:
        """As `add`, of many scans, some read ahead: many at once are cheaper to see."""
        left = iter(scans)
        while some := list(islice(left, _TOGETHER)):
            for posed, scan in zip(some, self._classifier.classified(some), strict=True):
                yield self._add(posed, scan)

    def _add(self, posed: PosedScan, scan: ClassifiedScan) -> Where:
        """The places first, then the filter by what they and the classifiers say of the view."""
        if posed.restarted:
            self._walls, self._looks = Clue(), Clue()
            self._views = ViewGrouping()
            self.filter.reset()
            self.places.restart()
        again = not self._views.begins(posed)
        known = self._views.mean(scan.all)
        known = min(1.0, self._views.motion / steadiness(known)) * known
        log_likelihoods = np.append(known, -math.inf)
        if self._uses_walls:
            expected = self.filter.predicted(again)[:-1] * np.exp(known - known.max())
            worth = self._worth(posed, scan, expected, again)
            if self.config.unknown:
                log_likelihoods = self.filter.with_unknown(known, worth, again)
        belief = self.filter.update(log_likelihoods, again)
        fix = None
        if self._uses_walls:
            fix = self._fix(posed, belief[:-1])
            belief = np.append(self.places.mixed(belief[:-1]), belief[-1])
        label = self._filtered(self._raw_label(posed.stamp_ns, scan), belief)
        return Where(label, fix, posed.map_from_base, posed.restarted, log_likelihoods, again)

    def _worth(
        self, posed: PosedScan, scan: ClassifiedScan, belief: FloatArray, again: bool
    ) -> float:
        """Log likelihood of unknown by the view that a scan is of: its walls, and its looks."""
        for clue in (self._walls, self._looks):
            clue.see(posed, again)
        self._walls.add(self.places.see(posed, scan.seen, belief))
        if scan.strange != -math.inf:
            strange = _STRANGE_GAIN * (scan.strange - _STRANGE_FROM)
            if strange > 0.0:
                # what a short window of a narrow laser has seen so far looks strange anywhere
                strange *= scan.shown**2
                # and so does a view with somebody in it, where walls fit all the same
                strange *= max(0.0, 1.0 - self.places.front / _SOMEBODY)
            self._looks.add(min(max(strange, -_STRANGE_MOST), _STRANGE_MOST))
        return self._walls.worth + self._looks.worth

    def _fix(self, posed: PosedScan, belief: FloatArray) -> Fix | None:
        """The pose of the place that leads; its covariance is that of all places that fit."""
        leader = self.places.follow(posed, belief)
        if leader is None or not leader.has_pose:
            return None
        chances = self.places.chances(belief)
        covariance = np.zeros((3, 3))
        for each, chance in zip(self.places.places, chances.tolist(), strict=True):
            off = each.moved(posed.map_from_base).estimate.off(leader.estimate.pose)
            covariance += chance * (each.estimate.covariance + off[:, None] * off)
        return Fix(
            leader.estimate.pose,
            covariance / float(chances.sum()),
            leader.score,
            float(chances.max()),
        )

    def smoothed(self, told: Sequence[Where]) -> list[Where]:
        """What was told of all scans of a log, with labels that are given the whole of it.

        And with the poses that the place tells which led there, or that leads later. What comes
        after a loss of tracking says nothing of what was before.
        """
        tracks, view_of = list[list[FloatArray]](), list[int]()
        for where in told:
            if where.restarted or not tracks:
                tracks.append([])
            if where.again:
                tracks[-1].pop()
            tracks[-1].append(where.evidence)  # the last scan of a view knows all of it
            view_of.append((view_of[-1] if view_of else -1) + (not where.again))
        beliefs = [row for track in tracks for row in self.filter.smooth(np.array(track))]
        found = []
        for where, view, fix in zip(told, view_of, _looking_back(told), strict=True):
            led = belief = beliefs[view]
            if fix is not None:
                led = (1.0 - fix.probability) * belief
                owner = self.filter.ids.index(self.places.walls.owner(fix.pose))
                led[owner] += fix.probability * float(belief[:-1].sum())
                led[-1] = belief[-1]
            found.append(replace(where, label=self._filtered(where.label, led), fix=fix))
        return found

    def _raw_label(self, stamp_ns: int, scan: ClassifiedScan) -> Label:
        """The label of the single scan by the most votes; nothing is filtered yet."""
        order = np.argsort(-scan.margins, kind="stable")
        ids, margins = self.filter.ids, scan.margins[order]
        # of no place is what fits no walls or, if that is not known, what is strange
        of_walls = self._walls.last
        strange = scan.strange > _STRANGE_ALONE if of_walls is None else of_walls > 0.0
        known = not (self.config.unknown and strange)
        return Label(
            stamp_ns=stamp_ns,
            submap=ids[order[0]] if known else None,
            margin=float(margins[0]) - (float(margins[1]) if len(order) > 1 else 0.0),
            runner_up=ids[order[1]] if len(order) > 1 else None,
            filtered_submap=None,
            filtered_probability=0.0,
            probability=math.exp(scan.raw[order[0]]),
        )

    def _filtered(self, label: Label, belief: FloatArray) -> Label:
        """The label with the likeliest submap; unknown if all of them together are less likely."""
        unknown = len(self.filter.ids)
        state = unknown if belief[unknown] > belief[:unknown].sum() else int(belief[:-1].argmax())
        submap = self.filter.ids[state] if state < unknown else None
        probability = float(belief[state])
        return replace(label, filtered_submap=submap, filtered_probability=probability)


def _looking_back(told: Sequence[Where]) -> list[Fix | None]:
    """The pose of each scan; where none led, by the next that has one within a window of way."""
    filled: list[Fix | None] = []
    later: tuple[Where, Fix] | None = None
    for where in reversed(told):
        fix = where.fix
        if fix is not None:
            later = where, fix
        elif later is not None:
            back = later[0].track_from_base.inverse() @ where.track_from_base
            before = Estimate(later[1].pose, later[1].covariance).moved(back)
            if back.distance <= WINDOW_M:
                fix = replace(later[1], pose=before.pose, covariance=before.covariance)
        filled.append(fix)
        later = None if where.restarted else later
    return filled[::-1]


def resampling(seen: Sensor, known: Sensor) -> str:
    """What is said of scans of the laser `seen` that are made to look like those of `known`.

    Empty where they look the same. Raises InputError when the laser seen sees less.
    """
    narrower = seen.field_of_view < known.field_of_view - _VIEW_SLACK_RAD
    if narrower or seen.range_max < _RANGE_SHARE * known.range_max:
        raise InputError(
            f"the laser ({seen}) sees less than that of the map ({known})",
            "build the map again with this laser",
            mark=";",
        )
    same = seen.sees_as(known)
    return "" if same else f"the laser ({seen}) is resampled to that of the map ({known})"


def resampled(scan: PlanarScan, known: Sensor) -> PlanarScan:
    """The scan at the known laser's bearings, cut to its range."""
    if not len(scan.bearings):
        return scan
    wanted, turn = known.bearings(), 2.0 * math.pi
    # of the scan's bearings, which ascend, the nearest to each wanted one, around the circle
    around = np.concatenate([scan.bearings - turn, scan.bearings, scan.bearings + turn])
    right = np.clip(np.searchsorted(around, wanted), 1, len(around) - 1)
    left_is_nearer = wanted - around[right - 1] < around[right] - wanted
    ranges = scan.ranges[(right - left_is_nearer) % len(scan.bearings)]
    with np.errstate(invalid="ignore"):
        ranges = np.where(ranges >= known.range_max, np.inf, ranges)
    return PlanarScan(
        stamp_ns=scan.stamp_ns,
        bearings=wanted,
        ranges=ranges,
        range_max=known.range_max,
        full_circle=known.full_circle,
    )


@dataclass(frozen=True, slots=True)
class ClassifiedScan:
    """What is said of one scan, and of the last virtual one of the window before it.

    `raw` (m,) log probabilities of the submaps by the single scan, `margins` (m,) its votes, `all`
    (m,) log probabilities with the virtual scan; `strange` is how little it looks like any place of
    the map: above one where nothing fits, -inf when not known.
    `seen` is what is matched with walls: the scan of a laser that sees all round, else the virtual
    one, where it was taken; `shown` in [0, 1] is how much of the robot's surroundings the virtual
    one holds.
    """

    margins: FloatArray
    raw: FloatArray
    all: FloatArray
    strange: float
    seen: PosedScan
    shown: float


class ScanClassifier:
    """Asks the classifiers of a map of the scans of a log, in turn.

    `note` says how the log's laser is made to fit the classifiers; empty when it is the same.
    """

    def __init__(self, classifiers: ClassifierSet, config: LocalizationConfig) -> None:
        self.classifiers = classifiers
        self.config = config
        self._calibration = classifiers.calibration or Calibration()
        self._recent = RecentScans()
        self._windows: list[PosedScan] = []  # the last virtual scan, as long as there is one
        self._said = np.zeros((0, len(classifiers.ids) + 1))  # of it: its margins, how strange
        self._seen: Sensor | None = None  # the log's laser, once a scan has shown it
        self.note = ""

    def classified(self, scans: Sequence[PosedScan]) -> list[ClassifiedScan]:
        """What is said of the next scans, in turn; many at once are cheaper than one by one.

        Where tracking starts afresh the window does, too. Raises InputError when the laser sees too
        little.
        """
        raw = self.classifiers.raw
        if self._seen is None:
            laser = Sensor.of(scans[0].planar)
            self.note, self._seen = resampling(laser, self.classifiers.sensor), laser
        planar = [posed.planar for posed in scans]
        if self.note:
            planar = [resampled(scan, self.classifiers.sensor) for scan in planar]
        features = scans_features(planar, raw.feature_set)
        margins, strange = raw.margins(features), raw.strangeness(features)
        alone = both = self._calibration.alone(margins)
        seen, shown = list(scans), [1.0] * len(scans)
        virtual = self.classifiers.virtual
        if virtual is not None and self.config.virtual:
            of_window, shown = self._driven(scans)
            features = scans_features(
                (window.planar for window in self._windows[len(self._said) :]), virtual.feature_set
            )
            new = np.column_stack([virtual.margins(features), virtual.strangeness(features)])
            said = np.vstack([self._said, new])[of_window]
            both = self._calibration.together(margins, said[:, :-1])
            if virtual.familiarity is not None:
                strange = said[:, -1]
            seen = [
                posed if posed.planar.full_circle else self._windows[k]
                for posed, k in zip(scans, of_window, strict=True)
            ]
            self._windows, self._said = self._windows[-1:], said[-1:]
        columns = margins, alone, both, strange.tolist(), seen, shown
        return [ClassifiedScan(*each) for each in zip(*columns, strict=True)]

    def _driven(self, scans: Sequence[PosedScan]) -> tuple[list[int], list[float]]:
        """The number of each scan's virtual one, and how much of the surroundings this holds."""
        of_window, shown = list[int](), list[float]()
        view = self.classifiers.sensor.field_of_view / (2.0 * math.pi)
        for posed in scans:
            if posed.restarted:  # this pose has nothing to do with the last one
                self._recent.clear()
            scan = partial(getattr, posed, "planar")
            added = not posed.lost and self._recent.add(
                posed.map_from_base, posed.base_from_laser, scan
            )
            if added or posed.restarted or not self._windows:
                window = self._recent.scan(posed.stamp_ns, posed.map_from_laser)
                self._windows.append(replace(posed, planar=window))
            of_window.append(len(self._windows) - 1)
            shown.append(max(self._recent.filled, view))
        return of_window, shown
