"""What the classifiers and the exemplars of a map say of each scan of a log."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from specmap_cli.core.errors import InputError
from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import PlanarScan, PosedScan
from specmap_cli.core.settings import LocalizationConfig
from specmap_cli.recognition.features.sets import scans_features
from specmap_cli.recognition.features.virtual import RecentScans
from specmap_cli.recognition.learning.calibration import Calibration
from specmap_cli.recognition.learning.classifiers import ClassifierSet, Sensor

_VIEW_SLACK_RAD = 0.0873  # a laser is refused that sees by more than this less
_RANGE_SHARE = 0.5  # a laser is refused that sees less far than this share of the map's laser


class BeamSampler:
    """Makes scans of the laser `seen` look like those of `known`, which the classifiers know.

    Raises InputError when the laser seen sees less than that of the map did.
    """

    def __init__(self, seen: Sensor, known: Sensor) -> None:
        self.known = known
        self.same = seen.sees_as(known)
        self.note = (
            "" if self.same else f"the log's laser ({seen}) is resampled to the map's ({known})"
        )
        narrower = seen.field_of_view < known.field_of_view - _VIEW_SLACK_RAD
        if narrower or seen.range_max < _RANGE_SHARE * known.range_max:
            raise InputError(
                f"the log's laser ({seen}) sees less than the laser of the map ({known})",
                "build the map again with this laser",
                mark=";",
            )

    def apply(self, scan: PlanarScan) -> PlanarScan:
        """The scan at the known laser's bearings, cut to its range."""
        if self.same or not len(scan.bearings):
            return scan
        wanted, turn = self.known.bearings(), 2.0 * math.pi
        # of the scan's bearings, which ascend, the nearest to each wanted one, around the circle
        around = np.concatenate([scan.bearings - turn, scan.bearings, scan.bearings + turn])
        right = np.clip(np.searchsorted(around, wanted), 1, len(around) - 1)
        left_is_nearer = wanted - around[right - 1] < around[right] - wanted
        ranges = scan.ranges[(right - left_is_nearer) % len(scan.bearings)]
        with np.errstate(invalid="ignore"):
            ranges = np.where(ranges >= self.known.range_max, np.inf, ranges)
        return PlanarScan(
            stamp_ns=scan.stamp_ns,
            bearings=wanted,
            ranges=ranges,
            range_max=self.known.range_max,
            full_circle=self.known.full_circle,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
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
        self._sampler: BeamSampler | None = None
        self.note = ""

    def classified(self, scans: Sequence[PosedScan]) -> list[ClassifiedScan]:
        """What is said of the next scans, in turn; many at once are cheaper than one by one.

        Where tracking starts afresh the window does, too. Raises InputError when the laser sees too
        little.
        """
        raw = self.classifiers.raw
        if self._sampler is None:
            self._sampler = BeamSampler(Sensor.of(scans[0].planar), self.classifiers.sensor)
            self.note = self._sampler.note
        resampled = [self._sampler.apply(posed.planar) for posed in scans]
        features = scans_features(resampled, raw.feature_set)
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
        return [
            ClassifiedScan(
                margins=margins[k],
                raw=alone[k],
                all=both[k],
                strange=float(strange[k]),
                seen=seen[k],
                shown=shown[k],
            )
            for k in range(len(scans))
        ]

    def _driven(self, scans: Sequence[PosedScan]) -> tuple[list[int], list[float]]:
        """The number of each scan's virtual one, and how much of the surroundings this holds.

        It is what a full circle would have seen of the last metres, from where the last scan was
        added to these: in between nothing new is seen.
        """
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
