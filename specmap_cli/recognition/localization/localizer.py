"""Localisation: in which submap was each scan of another log taken? (Section IV-B, Figure 6)"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from specmap_cli.core.config import LocalizationConfig
from specmap_cli.core.errors import InputError
from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import PlanarScan, PosedScan
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.recognition.features.sets import scan_features
from specmap_cli.recognition.features.virtual import RecentScans
from specmap_cli.recognition.learning.classifiers import ClassifierSet, Sensor
from specmap_cli.recognition.learning.familiarity import Familiarity
from specmap_cli.recognition.localization.filtering import HiddenMarkovFilter
from specmap_cli.recognition.localization.metric import MetricTracker

# a scan at this share of the limit speaks neither for nor against unknown; log likelihood per share
# beyond it, and at most: strange views come in a row, so that none of them may weigh much
_STRANGE_ALONE = 1.2  # a single scan is called unknown from here
_STRANGE_FROM, _STRANGE_GAIN, _STRANGE_MOST = 0.87, 2.0, 0.2


@dataclass(frozen=True, slots=True)
class Label:
    """Where one scan was taken; a submap of None means unknown: nothing fits.

    `margin` is the winner's margin over `runner_up`'s in the raw vote; the filtered label uses all
    scans so far (all scans of the log after smoothing) and has a probability.
    """

    stamp_ns: int
    submap: int | None
    margin: float
    runner_up: int | None
    filtered_submap: int | None
    filtered_probability: float


class Localizer:
    """Labels the scans of a log, one at a time, by the classifiers and topology of a map."""

    def __init__(
        self,
        classifiers: ClassifierSet,
        adjacency: Mapping[int, Collection[int]],
        grids: Mapping[int, GridMap],
        config: LocalizationConfig,
    ) -> None:
        self.classifiers = classifiers
        self.config = config
        self.filter = HiddenMarkovFilter(
            {i: adjacency.get(i, ()) for i in classifiers.ids}, config.stay
        )
        self.tracker = MetricTracker(grids)
        self._recent = RecentScans(config.window_m, config.virtual_beams, config.virtual_range_m)
        self._sampler: BeamSampler | None = None
        self._labels: list[Label] = []
        self._evidence: list[FloatArray] = []

    @property
    def note(self) -> str:
        """How the log's laser is made to fit the classifiers; empty when it is the same."""
        return self._sampler.note if self._sampler is not None else ""

    def update(self, posed: PosedScan) -> Label:
        """The label of the next scan. Raises InputError when its laser sees too little."""
        if self._sampler is None:
            self._sampler = BeamSampler(Sensor.of(posed.planar), self.classifiers.sensor)
        if posed.restarted:
            self._recent.clear()
            self.filter.reset()
        raw = self.classifiers.raw
        features = scan_features(self._sampler.apply(posed.planar), raw.feature_set)[None]
        margins = raw.margins(features)[0]
        evidence, strange = margins, _strangeness(self.classifiers.raw_known, features)
        virtual = self.classifiers.virtual
        if virtual is not None and self.config.virtual:
            features = scan_features(self._virtual_scan(posed), virtual.feature_set)[None]
            share = self.config.raw_weight * self._recent.filled + 1.0 - self._recent.filled
            evidence = share * margins + virtual.margins(features)[0]
            if self.classifiers.virtual_known is not None:
                strange = _strangeness(self.classifiers.virtual_known, features)
        log_likelihoods = self._log_likelihoods(evidence, strange)
        label = self._raw_label(posed.stamp_ns, margins, strange)
        label = self._filtered(label, self.filter.update(log_likelihoods))
        self._labels.append(label)
        self._evidence.append(log_likelihoods)
        return label

    def smoothed(self) -> list[Label]:
        """All labels so far, the filtered ones given the whole log."""
        if not self._labels:
            return []
        beliefs = self.filter.smooth(np.array(self._evidence))
        return [self._filtered(a, b) for a, b in zip(self._labels, beliefs, strict=True)]

    def _virtual_scan(self, posed: PosedScan) -> PlanarScan:
        """What a full circle would have seen from here, of the last metres."""
        if not posed.lost:
            self._recent.add(posed)
        return self._recent.scan(posed.stamp_ns, posed.map_from_laser)

    def _log_likelihoods(self, evidence: FloatArray, strange: float) -> FloatArray:
        """(m + 1,) log likelihoods of every submap and, last, of unknown."""
        known = self.config.sharpness * evidence
        if not self.config.unknown or strange == -math.inf:
            return np.append(known, -math.inf)
        worth = _STRANGE_GAIN * (strange - _STRANGE_FROM)
        worth = min(max(worth, -_STRANGE_MOST), _STRANGE_MOST)
        if worth > 0.0 and self.classifiers.virtual is not None:
            # what a short window of a narrow laser has seen so far looks strange anywhere
            view = self.classifiers.sensor.field_of_view / (2.0 * math.pi)
            worth *= max(self._recent.filled, view) ** 2
        return self.filter.with_unknown(known, worth)

    def _raw_label(self, stamp_ns: int, margins: FloatArray, strange: float) -> Label:
        order = np.argsort(-margins, kind="stable")
        best = float(margins[order[0]])
        second = self.filter.ids[order[1]] if len(order) > 1 else None
        lead = best - float(margins[order[1]]) if len(order) > 1 else best
        known = strange <= _STRANGE_ALONE or not self.config.unknown
        return Label(
            stamp_ns, self.filter.ids[order[0]] if known else None, lead, second, None, 0.0
        )

    def _filtered(self, label: Label, belief: FloatArray) -> Label:
        state = int(np.argmax(belief))
        submap = self.filter.ids[state] if state < len(self.filter.ids) else None
        return Label(
            label.stamp_ns,
            label.submap,
            label.margin,
            label.runner_up,
            submap,
            float(belief[state]),
        )


def _strangeness(known: Familiarity | None, features: FloatArray) -> float:
    """How little features (1, F) look like any place of the map; -inf when that is not known."""
    return -math.inf if known is None else float(known.strangeness(features)[0])


class BeamSampler:
    """Makes scans of one laser look like those of the laser that the classifiers know.

    Raises InputError when the log's laser sees less than the map's did.
    """

    def __init__(self, seen: Sensor, known: Sensor) -> None:
        self.known = known
        self.same = seen.sees_as(known)
        self.note = (
            "" if self.same else f"the log's laser ({seen}) is resampled to the map's ({known})"
        )
        narrower = seen.field_of_view < known.field_of_view - math.radians(5.0)
        if narrower or seen.range_max < 0.5 * known.range_max:
            raise InputError(
                f"the log's laser ({seen}) sees less than the laser of the map ({known}); "
                "build the map again with this laser"
            )

    def apply(self, scan: PlanarScan) -> PlanarScan:
        """The scan at the known laser's bearings, cut to its range."""
        if self.same or not len(scan.bearings):
            return scan
        wanted = self.known.bearings()
        nearest = _nearest(scan.bearings, wanted)
        ranges = scan.ranges[nearest]
        with np.errstate(invalid="ignore"):
            ranges = np.where(ranges >= self.known.range_max, np.inf, ranges)
        return PlanarScan(
            scan.stamp_ns, wanted, ranges, self.known.range_max, self.known.full_circle
        )


def _nearest(bearings: FloatArray, wanted: FloatArray) -> Sequence[int]:
    """Index of the bearing (B,) ascending nearest to each wanted one (W,), around the circle."""
    around = np.concatenate([bearings[-1:] - 2 * math.pi, bearings, bearings[:1] + 2 * math.pi])
    right = np.clip(np.searchsorted(around, wanted), 1, len(around) - 1)
    left_is_nearer = wanted - around[right - 1] < around[right] - wanted
    index = (right - left_is_nearer - 1) % len(bearings)
    return np.asarray(index).tolist()  # type: ignore[no-any-return]
