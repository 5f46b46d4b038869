"""The laser that classifiers were trained with, and whether another one sees the same."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import PlanarScan

# Two lasers see the same when they differ by less: drivers round angles and the number of beams,
# and features change slowly with the density of beams and with the range.
_SAME_VIEW_RAD = math.radians(3.0)
_SAME_DENSITY_LOG = 0.1
_SAME_RANGE_SHARE = 0.25
_TINY = 1e-6  # keeps a laser of one beam from dividing by nought


@dataclass(frozen=True, slots=True, kw_only=True)
class Sensor:
    """The laser that classifiers were trained on: `field_of_view` in radians, `range_max` in m."""

    beams: int
    field_of_view: float
    range_max: float
    full_circle: bool

    @classmethod
    def of(cls, scan: PlanarScan) -> Sensor:
        """The sensor that took `scan`."""
        span = float(scan.bearings[-1] - scan.bearings[0]) if len(scan.bearings) else 0.0
        return cls(
            beams=len(scan.bearings),
            field_of_view=2.0 * math.pi if scan.full_circle else span,
            range_max=scan.range_max,
            full_circle=scan.full_circle,
        )

    def bearings(self) -> FloatArray:
        """(beams,) evenly spread bearings of this sensor, symmetric about its x axis."""
        half = 0.5 * self.field_of_view
        return np.linspace(-half, half, self.beams, endpoint=not self.full_circle)

    def sees_as(self, other: Sensor) -> bool:
        """Whether features of the two sensors mean the same: field of view, density, range."""
        ratio = max(self._density, _TINY) / max(other._density, _TINY)
        return (
            self.full_circle == other.full_circle
            and abs(self.field_of_view - other.field_of_view) < _SAME_VIEW_RAD
            and abs(math.log(ratio)) < _SAME_DENSITY_LOG
            and abs(self.range_max - other.range_max)
            < _SAME_RANGE_SHARE * max(self.range_max, _TINY)
        )

    @property
    def _density(self) -> float:
        """Beams per radian."""
        return self.beams / max(self.field_of_view, _TINY)

    def __str__(self) -> str:
        degrees = math.degrees(self.field_of_view)
        return f"{self.beams} beams over {degrees:.0f} degrees, {self.range_max:g} m"
