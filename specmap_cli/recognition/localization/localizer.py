"""Localisation: in which submap was each scan of another log taken? (Section IV-B, Figure 6)"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

import numpy as np

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import PlanarScan, PosedScan
from specmap_cli.core.settings import LocalizationConfig
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.recognition.features.sets import scan_features
from specmap_cli.recognition.features.virtual import RecentScans
from specmap_cli.recognition.learning.classifiers import ClassifierSet
from specmap_cli.recognition.learning.sensor import Sensor
from specmap_cli.recognition.localization.beam_sampler import BeamSampler
from specmap_cli.recognition.localization.filtering import HiddenMarkovFilter
from specmap_cli.recognition.localization.metric import MetricTracker

# Log likelihood for unknown per share of the limit beyond `strange_from`, and the most of it: views
# that are strange come in a row, so that none of them may weigh much. Tuned on simulated tours.
_STRANGE_GAIN, _STRANGE_MOST = 2.0, 0.2


@dataclass(frozen=True, slots=True, kw_only=True)
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


@dataclass(frozen=True, slots=True)
class _Evidence:
    """What the classifiers say of one scan.

    `raw` (m,) margins of the single scan, `all` (m,) those with the virtual scan; `strange` is how
    little it looks like any place of the map: above one where nothing fits, -inf when not known.
    """

    raw: FloatArray
    all: FloatArray
    strange: float


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
        self.filter = HiddenMarkovFilter({i: adjacency.get(i, ()) for i in classifiers.ids}, config)
        self.tracker = MetricTracker(grids, config)
        self._recent = RecentScans(config)
        self._sampler: BeamSampler | None = None
        self._labels: list[Label] = []
        self._likelihoods: list[list[FloatArray]] = [[]]  # a list for each unbroken track

    @property
    def note(self) -> str:
        """How the log's laser is made to fit the classifiers; empty when it is the same."""
        return self._sampler.note if self._sampler is not None else ""

    def update(self, posed: PosedScan) -> Label:
        """The label of the next scan. Raises InputError when its laser sees too little."""
        if posed.restarted:
            self._recent.clear()
            self.filter.reset()
            self._likelihoods.append([])
        evidence = self._evidence(posed)
        log_likelihoods = self._log_likelihoods(evidence)
        label = self._raw_label(posed.stamp_ns, evidence)
        label = self._filtered(label, self.filter.update(log_likelihoods))
        self._labels.append(label)
        self._likelihoods[-1].append(log_likelihoods)
        return label

    def smoothed(self) -> list[Label]:
        """All labels so far, the filtered ones given the whole track that they belong to.

        A loss of tracking ends a track: what comes after it says nothing of what was before.
        """
        tracks = [np.array(track) for track in self._likelihoods if track]
        beliefs = [belief for track in tracks for belief in self.filter.smooth(track)]
        return [self._filtered(a, b) for a, b in zip(self._labels, beliefs, strict=True)]

    def _evidence(self, posed: PosedScan) -> _Evidence:
        """What the classifiers say of a scan, and of the virtual one of the window before it."""
        raw, virtual = self.classifiers.raw, self.classifiers.virtual
        features = scan_features(self._resampled(posed.planar), raw.feature_set)[None]
        margins = raw.margins(features)[0]
        strange = float(raw.strangeness(features)[0])
        if virtual is None or not self.config.virtual:
            return _Evidence(margins, margins, strange)
        features = scan_features(self._virtual_scan(posed), virtual.feature_set)[None]
        # the virtual scan says less while the window fills
        weight = self.config.raw_weight * self._recent.filled + 1.0 - self._recent.filled
        both = weight * margins + virtual.margins(features)[0]
        if virtual.familiarity is not None:
            strange = float(virtual.strangeness(features)[0])
        return _Evidence(margins, both, strange)

    def _resampled(self, scan: PlanarScan) -> PlanarScan:
        """The scan as the laser of the map would have taken it."""
        if self._sampler is None:
            self._sampler = BeamSampler(Sensor.of(scan), self.classifiers.sensor, self.config)
        return self._sampler.apply(scan)

    def _virtual_scan(self, posed: PosedScan) -> PlanarScan:
        """What a full circle would have seen from here, of the last metres."""
        if not posed.lost:
            self._recent.add(posed)
        return self._recent.scan(posed.stamp_ns, posed.map_from_laser)

    def _log_likelihoods(self, evidence: _Evidence) -> FloatArray:
        """(m + 1,) log likelihoods of every submap and, last, of unknown."""
        known = self.config.sharpness * evidence.all
        if not self.config.unknown or evidence.strange == -math.inf:
            return np.append(known, -math.inf)
        worth = _STRANGE_GAIN * (evidence.strange - self.config.strange_from)
        worth = min(max(worth, -_STRANGE_MOST), _STRANGE_MOST)
        if worth > 0.0 and self.classifiers.virtual is not None:
            # what a short window of a narrow laser has seen so far looks strange anywhere
            view = self.classifiers.sensor.field_of_view / (2.0 * math.pi)
            worth *= max(self._recent.filled, view) ** 2
        return self.filter.with_unknown(known, worth)

    def _raw_label(self, stamp_ns: int, evidence: _Evidence) -> Label:
        """The label of the single scan by the most votes; nothing is filtered yet."""
        order = np.argsort(-evidence.raw, kind="stable")
        ids, margins = self.filter.ids, evidence.raw[order]
        known = evidence.strange <= self.config.strange_alone or not self.config.unknown
        return Label(
            stamp_ns=stamp_ns,
            submap=ids[order[0]] if known else None,
            margin=float(margins[0]) - (float(margins[1]) if len(order) > 1 else 0.0),
            runner_up=ids[order[1]] if len(order) > 1 else None,
            filtered_submap=None,
            filtered_probability=0.0,
        )

    def _filtered(self, label: Label, belief: FloatArray) -> Label:
        """The label with the most likely state, of which the last one is unknown."""
        state = int(np.argmax(belief))
        submap = self.filter.ids[state] if state < len(self.filter.ids) else None
        probability = float(belief[state])
        return replace(label, filtered_submap=submap, filtered_probability=probability)
