"""All that was learned of a map: what tells its submaps apart, and the laser it was seen with."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import PlanarScan
from specmap_cli.core.text import to_exact_json
from specmap_cli.recognition.learning.boosting import OneVsAll
from specmap_cli.recognition.learning.calibration import Calibration
from specmap_cli.recognition.learning.familiarity import Familiarity
from specmap_cli.recognition.learning.json_fields import field, mapping, number, refuse
from specmap_cli.recognition.learning.misfit import HeldOutMisfit

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


SCHEMA_VERSION = 1
_JSON_LEVELS = 5  # file, kind of scan, classifiers, submap, rounds: a round a line
_MOST_BEAMS = 1_000_000  # of a laser in a file: a hundred times what any has
_FULL_CIRCLE = 2.0 * math.pi + 1e-6  # with the rounding of drivers


@dataclass(frozen=True, slots=True)
class Recogniser:
    """What was learned of one kind of scans: which submap fits best, and whether any does.

    `classifiers` are fitted. `familiarity` is fitted, or None when scans of unknown places cannot
    be told: the feature set holds no histogram, or there were too few scans.
    """

    classifiers: OneVsAll
    familiarity: Familiarity | None

    @property
    def feature_set(self) -> str:
        """The features that it asks for."""
        return self.classifiers.feature_set

    @property
    def ids(self) -> tuple[int, ...]:
        """The submaps, ascending: the columns of `margins`."""
        return self.classifiers.classes_

    def margins(self, X: NDArray[Any]) -> FloatArray:
        """(n, m) margins of features X (n, F), columns in the order of `ids`."""
        return self.classifiers.margins(X)

    def strangeness(self, X: NDArray[Any]) -> FloatArray:
        """(n,) how little features X (n, F) look like any place: above one where nothing fits.

        -inf when that is not known.
        """
        if self.familiarity is None:
            return np.full(len(X), -math.inf)
        return self.familiarity.strangeness(X)

    def to_dict(self) -> dict[str, Any]:
        """Ready for JSON."""
        known = {} if self.familiarity is None else {"exemplars": self.familiarity.to_dict()}
        return self.classifiers.to_dict() | known

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Recogniser:
        """What `to_dict` described; MapError names what makes no sense."""
        classifiers = OneVsAll.from_dict(data)
        if "exemplars" not in data:
            return cls(classifiers, None)
        exemplars = mapping(data, "exemplars")
        return cls(classifiers, Familiarity.from_dict(exemplars, classifiers.feature_set))


@dataclass(frozen=True, slots=True, kw_only=True)
class ClassifierSet:
    """The classifiers of a map: of raw scans, and of virtual full-circle scans where wanted.

    `misfit` says how well the map's own scans fit its walls, `calibration` how sure the classifiers
    are; None in maps made before they were kept.
    """

    sensor: Sensor
    raw: Recogniser
    virtual: Recogniser | None = None
    misfit: HeldOutMisfit | None = None
    calibration: Calibration | None = None

    @property
    def ids(self) -> list[int]:
        """The submaps, ascending: the columns of `margins`."""
        return list(self.raw.ids)

    def margins(self, X: NDArray[Any]) -> FloatArray:
        """(n, m) margins of raw scans' features X (n, F), columns in the order of `ids`."""
        return self.raw.margins(X)

    def to_json(self) -> str:
        """Readable JSON: sensor, then every classifier's rounds by feature name."""
        data: dict[str, Any] = {
            "schema_version": SCHEMA_VERSION,
            "sensor": {
                "beams": self.sensor.beams,
                "field_of_view": self.sensor.field_of_view,
                "range_max": self.sensor.range_max,
                "full_circle": self.sensor.full_circle,
            },
            "raw": self.raw.to_dict(),
        }
        if self.virtual is not None:
            data["virtual"] = self.virtual.to_dict()
        if self.misfit is not None:
            data["misfit"] = self.misfit.to_dict()
        if self.calibration is not None:
            data["calibration"] = self.calibration.to_dict()
        return to_exact_json(data, _JSON_LEVELS)

    @classmethod
    def from_json(cls, text: str) -> ClassifierSet:
        """The set that `to_json` wrote; MapError in one line for anything else."""
        try:
            data = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise refuse("file", f"is no JSON ({error})") from None
        field(data, "schema_version", {SCHEMA_VERSION: SCHEMA_VERSION}, "file")
        sensor = _sensor(mapping(data, "sensor"))
        raw = Recogniser.from_dict(mapping(data, "raw"))
        virtual = Recogniser.from_dict(mapping(data, "virtual")) if "virtual" in data else None
        if virtual is not None and virtual.ids != raw.ids:
            raise refuse("file", "raw and virtual classifiers are of different submaps")
        misfit, calibration = "misfit" in data, "calibration" in data
        return cls(
            sensor=sensor,
            raw=raw,
            virtual=virtual,
            misfit=HeldOutMisfit.from_dict(mapping(data, "misfit")) if misfit else None,
            calibration=Calibration.from_dict(mapping(data, "calibration"))
            if calibration
            else None,
        )


def _sensor(data: Mapping[str, Any]) -> Sensor:
    beams = int(number(data, "beams", "sensor"))
    view, reach = number(data, "field_of_view", "sensor"), number(data, "range_max", "sensor")
    if not 1 <= beams <= _MOST_BEAMS or not 0.0 <= view <= _FULL_CIRCLE or reach <= 0.0:
        raise refuse("sensor", "beams, field of view or range are out of bounds")
    circle = data.get("full_circle")
    if not isinstance(circle, bool):
        raise refuse("sensor", "'full_circle' is neither true nor false")
    return Sensor(beams=beams, field_of_view=view, range_max=reach, full_circle=circle)
