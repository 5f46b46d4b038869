"""Localisation: in which submap was each scan of another log taken? (Section IV-B, Figure 6)"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from specmap_cli.config import LocalizationConfig
from specmap_cli.errors import InputError
from specmap_cli.geometry import FloatArray
from specmap_cli.gridmap import GridMap
from specmap_cli.recognition.classifiers import ClassifierSet, OneVsAll, Sensor
from specmap_cli.recognition.features import scan_features
from specmap_cli.recognition.filtering import HiddenMarkovFilter
from specmap_cli.recognition.metric import MetricTracker
from specmap_cli.recognition.virtual import RecentScans
from specmap_cli.records import PlanarScan, PosedScan


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
        margins = self._margins(self.classifiers.raw, self._sampler.apply(posed.planar))
        evidence = self._with_unknown(margins, self.classifiers.unknown_margin)
        label = self._raw_label(posed.stamp_ns, evidence)
        if self.classifiers.virtual is not None and self.config.virtual:
            evidence = evidence + self._virtual_evidence(posed, self.classifiers.virtual)
        log_likelihoods = self.config.sharpness * evidence
        belief = self.filter.update(log_likelihoods)
        label = self._filtered(label, belief)
        self._labels.append(label)
        self._evidence.append(log_likelihoods)
        return label

    def smoothed(self) -> list[Label]:
        """All labels so far, the filtered ones given the whole log."""
        if not self._labels:
            return []
        beliefs = self.filter.smooth(np.array(self._evidence))
        return [self._filtered(a, b) for a, b in zip(self._labels, beliefs, strict=True)]

    def _margins(self, model: OneVsAll, scan: PlanarScan) -> FloatArray:
        return np.asarray(model.margins(scan_features(scan, model.feature_set)[None])[0])

    def _virtual_evidence(self, posed: PosedScan, model: OneVsAll) -> FloatArray:
        """(m + 1,) evidence of the virtual scan at this pose."""
        if posed.restarted:
            self._recent.clear()
        if not posed.lost:
            self._recent.add(posed)
        scan = self._recent.scan(posed.stamp_ns, posed.map_from_laser)
        return self._with_unknown(
            self._margins(model, scan), self.classifiers.virtual_unknown_margin
        )

    def _with_unknown(self, margins: FloatArray, limit: float | None) -> FloatArray:
        """(m + 1,) margins with that of "unknown" last."""
        last = limit if limit is not None and self.config.unknown else -math.inf
        return np.append(margins, last)

    def _raw_label(self, stamp_ns: int, evidence: FloatArray) -> Label:
        order = np.argsort(-evidence[:-1], kind="stable")
        best = float(evidence[order[0]])
        second = float(evidence[order[1]]) if len(order) > 1 else -math.inf
        known = best >= evidence[-1]
        return Label(
            stamp_ns,
            self.filter.ids[order[0]] if known else None,
            best - second if len(order) > 1 else best,
            self.filter.ids[order[1]] if len(order) > 1 else None,
            None,
            0.0,
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
