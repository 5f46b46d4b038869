"""What the classifiers and the exemplars of a map say of one scan."""

from __future__ import annotations

import math
from dataclasses import dataclass

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import PlanarScan, PosedScan
from specmap_cli.core.settings import LocalizationConfig
from specmap_cli.recognition.features.sets import scan_features
from specmap_cli.recognition.features.virtual import RecentScans
from specmap_cli.recognition.learning.classifiers import ClassifierSet
from specmap_cli.recognition.learning.sensor import Sensor
from specmap_cli.recognition.localization.beam_sampler import BeamSampler


@dataclass(frozen=True, slots=True, kw_only=True)
class Impression:
    """What is said of one scan, and of the virtual one of the window before it.

    `raw` (m,) margins of the single scan, `all` (m,) those with the virtual scan; `strange` is how
    little it looks like any place of the map: above one where nothing fits, -inf when not known.
    `seen` is what is matched with walls: the scan of a laser that sees all round, else the virtual
    one; `shown` in [0, 1] is how much of the robot's surroundings the virtual one holds.
    """

    raw: FloatArray
    all: FloatArray
    strange: float
    seen: PlanarScan
    shown: float


class Witness:
    """Asks the classifiers of a map of the scans of a log, in turn."""

    def __init__(self, classifiers: ClassifierSet, config: LocalizationConfig) -> None:
        self.classifiers = classifiers
        self.config = config
        self._recent = RecentScans(config)
        self._sampler: BeamSampler | None = None

    @property
    def note(self) -> str:
        """How the log's laser is made to fit the classifiers; empty when it is the same."""
        return self._sampler.note if self._sampler is not None else ""

    def restart(self) -> None:
        """Forget the window: the next pose has nothing to do with the last one."""
        self._recent.clear()

    def evidence(self, posed: PosedScan) -> Impression:
        """What is said of the next scan. Raises InputError when its laser sees too little."""
        raw, virtual = self.classifiers.raw, self.classifiers.virtual
        features = scan_features(self._resampled(posed.planar), raw.feature_set)[None]
        margins = raw.margins(features)[0]
        strange = float(raw.strangeness(features)[0])
        if virtual is None or not self.config.virtual:
            planar = posed.planar
            return Impression(raw=margins, all=margins, strange=strange, seen=planar, shown=1.0)
        seen = self._virtual_scan(posed)
        features = scan_features(seen, virtual.feature_set)[None]
        # the virtual scan says less while the window fills
        weight = self.config.raw_weight * self._recent.filled + 1.0 - self._recent.filled
        both = weight * margins + virtual.margins(features)[0]
        if virtual.familiarity is not None:
            strange = float(virtual.strangeness(features)[0])
        view = self.classifiers.sensor.field_of_view / (2.0 * math.pi)
        return Impression(
            raw=margins,
            all=both,
            strange=strange,
            seen=posed.planar if posed.planar.full_circle else seen,
            shown=max(self._recent.filled, view),
        )

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
