"""All that was learned of a map: what tells its submaps apart, and the laser it was seen with."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationError

from specmap_cli.core.errors import MapError
from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import PlanarScan
from specmap_cli.core.settings import RecognitionConfig
from specmap_cli.core.text import first_finding, to_exact_json
from specmap_cli.recognition.features.sets import feature_names, feature_sets
from specmap_cli.recognition.learning.boosting import (
    BoosterPart,
    OneVsAll,
    Part,
    WrongPartError,
    as_part,
    booster_of,
)
from specmap_cli.recognition.learning.calibration import Calibration, Familiarity, HeldOutMisfit

# Two lasers see the same when they differ by less: drivers round angles and the number of beams,
# and features change slowly with the density of beams and with the range.
_SAME_VIEW_RAD = math.radians(3.0)
_SAME_DENSITY_LOG = 0.1
_SAME_RANGE_SHARE = 0.25
_MOST_BEAMS = 1_000_000  # of a laser in a file: a hundred times what any has
_FULL_CIRCLE = 2.0 * math.pi + 1e-6  # with the rounding of drivers
SCHEMA_VERSION = 1
_JSON_LEVELS = 5  # file, kind of scan, classifiers, submap, rounds: a round a line
_Hexadecimal = Annotated[str, Field(pattern="^([0-9a-fA-F]{2})*$")]
_TINY = 1e-6  # keeps a laser of one beam from dividing by nought


@as_part
@dataclass(frozen=True, slots=True, kw_only=True)
class Sensor:
    """The laser that classifiers were trained on: `field_of_view` in radians, `range_max` in m."""

    beams: Annotated[int, Field(ge=1, le=_MOST_BEAMS)]
    field_of_view: Annotated[float, Field(ge=0.0, le=_FULL_CIRCLE)]
    range_max: Annotated[float, Field(gt=0.0)]
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
        densities = (each.beams / max(each.field_of_view, _TINY) for each in (self, other))
        mine, others = (max(density, _TINY) for density in densities)
        return (
            self.full_circle == other.full_circle
            and abs(self.field_of_view - other.field_of_view) < _SAME_VIEW_RAD
            and abs(math.log(mine / others)) < _SAME_DENSITY_LOG
            and abs(self.range_max - other.range_max)
            < _SAME_RANGE_SHARE * max(self.range_max, _TINY)
        )

    def __str__(self) -> str:
        degrees = math.degrees(self.field_of_view)
        return f"{self.beams} beams over {degrees:.0f} degrees, {self.range_max:g} m"


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
        boosters = {str(i): booster.to_dict() for i, booster in self.classifiers.boosters_.items()}
        known = {} if self.familiarity is None else {"exemplars": self.familiarity.to_dict()}
        return {"feature_set": self.feature_set, "classifiers": boosters, **known}

    @classmethod
    def of(cls, part: _RecogniserPart, where: str) -> Recogniser:
        """What `to_dict` described. Raises MapError for a set of features that is not installed,
        WrongPartError for what it has not.
        """
        feature_set, known = part.feature_set, part.exemplars
        if feature_set not in feature_sets():
            raise MapError(
                f"file: its feature set {feature_set!r} is not installed",
                "install the package that offers it, or build the map again",
                where="classifiers",
            )
        names = feature_names(feature_set)
        boosters = {
            int(i): booster_of(part.classifiers[i], names, f"{where}.classifiers.{i}")
            for i in sorted(part.classifiers, key=int)
        }
        classifiers = OneVsAll(feature_set, RecognitionConfig()).become(boosters)
        if known is None:
            return cls(classifiers, None)
        place = f"{where}.exemplars"
        return cls(classifiers, Familiarity.of(feature_set, known.limit, known.rows, place))


class _ExemplarsPart(Part):
    limit: Annotated[float, Field(ge=0.0)]
    rows: Annotated[list[_Hexadecimal], Field(min_length=1)]


class _RecogniserPart(Part):
    feature_set: str
    classifiers: Annotated[
        dict[Annotated[str, Field(pattern=r"^[0-9]{1,18}$")], BoosterPart], Field(min_length=1)
    ]
    exemplars: _ExemplarsPart | None = None


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
        """The submaps, ascending: the columns of all margins."""
        return list(self.raw.ids)

    def to_json(self) -> str:
        """Readable JSON: sensor, then every classifier's rounds by feature name."""
        data = {
            "schema_version": SCHEMA_VERSION,
            "sensor": asdict(self.sensor),
            "raw": self.raw.to_dict(),
            "virtual": self.virtual and self.virtual.to_dict(),
            "misfit": self.misfit and asdict(self.misfit),
            "calibration": self.calibration and asdict(self.calibration),
        }
        told = {key: value for key, value in data.items() if value is not None}
        return to_exact_json(told, _JSON_LEVELS)

    @classmethod
    def from_json(cls, text: str) -> ClassifierSet:
        """The set that `to_json` wrote; MapError in one line for anything else."""
        try:
            data = _ClassifiersPart.model_validate_json(text)
            raw = Recogniser.of(data.raw, "raw")
            virtual = None if data.virtual is None else Recogniser.of(data.virtual, "virtual")
            if virtual is not None and virtual.ids != raw.ids:
                raise WrongPartError("raw and virtual classifiers are of different submaps")
        except WrongPartError as error:
            found = str(error)
        except ValidationError as error:
            found = first_finding(error)
        else:
            return cls(
                sensor=data.sensor,
                raw=raw,
                virtual=virtual,
                misfit=data.misfit,
                calibration=data.calibration,
            )
        raise MapError(found, "build the map again", mark=";", where="classifiers")


class _ClassifiersPart(Part):
    schema_version: Literal[1]
    sensor: Sensor
    raw: _RecogniserPart
    virtual: _RecogniserPart | None = None
    misfit: HeldOutMisfit | None = None
    calibration: Calibration | None = None
