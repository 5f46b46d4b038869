"""One classifier a submap, one against all others (Section III-A), and the sensor they know."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.config import RecognitionConfig
from specmap_cli.core.errors import MapError
from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import PlanarScan
from specmap_cli.core.sampling import evenly
from specmap_cli.recognition.features.sets import FEATURE_SETS
from specmap_cli.recognition.learning.boosting import Booster, StumpBoost, booster_from_dict
from specmap_cli.recognition.learning.familiarity import Familiarity
from specmap_cli.recognition.learning.json_fields import field, mapping, number, refuse
from specmap_cli.recognition.learning.trees import Forest, Quantiser, TreeBoost

SCHEMA_VERSION = 1


@dataclass(frozen=True, slots=True)
class Sensor:
    """The laser that classifiers were trained on: beams, field of view in radians, range."""

    beams: int
    field_of_view: float
    range_max: float
    full_circle: bool

    @classmethod
    def of(cls, scan: PlanarScan) -> Sensor:
        """The sensor that took `scan`."""
        span = float(scan.bearings[-1] - scan.bearings[0]) if len(scan.bearings) else 0.0
        view = 2.0 * math.pi if scan.full_circle else span
        return cls(len(scan.bearings), view, scan.range_max, scan.full_circle)

    def bearings(self) -> FloatArray:
        """(beams,) evenly spread bearings of this sensor, symmetric about its x axis."""
        half = 0.5 * self.field_of_view
        return np.linspace(-half, half, self.beams, endpoint=not self.full_circle)

    def sees_as(self, other: Sensor) -> bool:
        """Whether features of the two sensors mean the same: field of view, density, range."""
        density = self.beams / max(self.field_of_view, 1e-6)
        other_density = other.beams / max(other.field_of_view, 1e-6)
        return (
            self.full_circle == other.full_circle
            and abs(self.field_of_view - other.field_of_view) < math.radians(3.0)
            and abs(math.log(max(density, 1e-6) / max(other_density, 1e-6))) < 0.1
            and abs(self.range_max - other.range_max) < 0.25 * max(self.range_max, 1e-6)
        )

    def __str__(self) -> str:
        degrees = math.degrees(self.field_of_view)
        return f"{self.beams} beams over {degrees:.0f} degrees, {self.range_max:g} m"


class OneVsAll:
    """A booster for each class, each against all others. `ids` ascending after `fit`."""

    def __init__(self, feature_set: str, config: RecognitionConfig) -> None:
        self.feature_set = feature_set
        self.config = config
        self.boosters: dict[int, Booster] = {}
        self._forest: Forest | None = None

    @property
    def ids(self) -> list[int]:
        """The classes, ascending: the columns of `margins`."""
        return list(self.boosters)

    def fit(self, samples: Mapping[int, FloatArray], rng: np.random.Generator) -> OneVsAll:
        """Learn from features (n, F) of every class; returns self."""
        ids = sorted(samples)
        X = np.vstack([samples[i] for i in ids])
        owner = np.repeat(ids, [len(samples[i]) for i in ids])
        quantiser = Quantiser.of(X)
        codes = quantiser.codes(X)
        for i in ids:
            seed = int(rng.integers(2**31))
            positive = np.flatnonzero(owner == i)
            chosen = np.concatenate(
                [positive, evenly(np.flatnonzero(owner != i), self.config.negatives)]
            )
            y = np.where(owner[chosen] == i, 1, -1)
            booster = self._booster(seed)
            if isinstance(booster, TreeBoost):
                booster.fit_codes(codes[:, chosen], quantiser, y)
            else:
                booster.fit(X[chosen], y)
            self.boosters[i] = booster
        self._forest = None
        return self

    def margins(self, X: NDArray[Any]) -> FloatArray:
        """(n, m) margin of every class, columns in the order of `ids`."""
        X = np.asarray(X, dtype=np.float64)
        trees = [b for b in self.boosters.values() if isinstance(b, TreeBoost)]
        if len(trees) < len(self.boosters) or len({len(b.forest_.votes) for b in trees}) != 1:
            return np.column_stack([b.margins(X) for b in self.boosters.values()])
        if self._forest is None:
            self._forest = Forest(
                np.vstack([b.forest_.features for b in trees]),
                np.vstack([b.forest_.thresholds for b in trees]),
                np.vstack([b.forest_.votes for b in trees]),
            )
        votes = self._forest.tree_votes(X)
        return np.asarray(votes.reshape(len(X), len(trees), -1).sum(axis=2))

    def _booster(self, seed: int) -> Booster:
        names, config = FEATURE_SETS[self.feature_set], self.config
        if config.booster == "stumps":
            return StumpBoost(names, config.rounds)
        return TreeBoost(names, config.rounds, config.shrinkage, config.feature_share, seed)

    def to_dict(self) -> dict[str, Any]:
        """Feature set and classifiers by class, ready for JSON."""
        return {
            "feature_set": self.feature_set,
            "classifiers": {str(i): b.to_dict() for i, b in self.boosters.items()},
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any], config: RecognitionConfig) -> OneVsAll:
        """What `to_dict` described; MapError names the entry that makes no sense."""
        feature_set = field(data, "feature_set", {name: name for name in FEATURE_SETS}, "file")
        model = cls(feature_set, config)
        entries = mapping(data, "classifiers")
        for key in sorted(entries, key=_submap_id):
            try:
                booster = booster_from_dict(entries[key], FEATURE_SETS[feature_set])
            except MapError as error:
                raise MapError(str(error).replace("classifiers:", f"submap {key}:", 1)) from None
            model.boosters[_submap_id(key)] = booster
        if not model.boosters:
            raise refuse("file", "it holds no classifier")
        return model


class ClassifierSet:
    """The classifiers of a map: of raw scans, and of virtual full-circle scans where trained.

    `raw_known` and `virtual_known` tell whether a scan looks like any place of the map at all.
    """

    def __init__(
        self,
        sensor: Sensor,
        raw: OneVsAll,
        virtual: OneVsAll | None = None,
        raw_known: Familiarity | None = None,
        virtual_known: Familiarity | None = None,
    ) -> None:
        self.sensor = sensor
        self.raw = raw
        self.virtual = virtual
        self.raw_known = raw_known
        self.virtual_known = virtual_known

    @classmethod
    def train(
        cls,
        samples: Mapping[int, FloatArray],
        sensor: Sensor,
        config: RecognitionConfig,
        rng: np.random.Generator,
    ) -> ClassifierSet:
        """Classifiers of raw scans from features (n, F) of every submap's scans."""
        return cls(sensor, OneVsAll(config.feature_set, config).fit(samples, rng))

    @property
    def ids(self) -> list[int]:
        """The submaps, ascending: the columns of `margins`."""
        return self.raw.ids

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
            "raw": self.raw.to_dict() | _known(self.raw_known),
        }
        if self.virtual is not None:
            data["virtual"] = self.virtual.to_dict() | _known(self.virtual_known)
        return _readable(data)

    @classmethod
    def from_json(cls, text: str, config: RecognitionConfig | None = None) -> ClassifierSet:
        """The set that `to_json` wrote; MapError in one line for anything else."""
        config = config or RecognitionConfig()
        try:
            data = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise refuse("file", f"is no JSON ({error})") from None
        field(data, "schema_version", {SCHEMA_VERSION: SCHEMA_VERSION}, "file")
        sensor = _sensor(mapping(data, "sensor"))
        raw_data = mapping(data, "raw")
        raw = OneVsAll.from_dict(raw_data, config)
        virtual, virtual_known = None, None
        if "virtual" in data:
            virtual_data = mapping(data, "virtual")
            virtual = OneVsAll.from_dict(virtual_data, config)
            virtual_known = _familiarity(virtual_data, virtual.feature_set)
            if virtual.ids != raw.ids:
                raise refuse("file", "raw and virtual classifiers are of different submaps")
        raw_known = _familiarity(raw_data, raw.feature_set)
        return cls(sensor, raw, virtual, raw_known, virtual_known)


def _sensor(data: Mapping[str, Any]) -> Sensor:
    beams = int(number(data, "beams", "sensor"))
    view, reach = number(data, "field_of_view", "sensor"), number(data, "range_max", "sensor")
    if beams < 1 or not 0.0 <= view <= 2.0 * math.pi + 1e-6 or reach <= 0.0:
        raise refuse("sensor", "beams, field of view or range are out of bounds")
    circle = data.get("full_circle")
    if not isinstance(circle, bool):
        raise refuse("sensor", "'full_circle' is neither true nor false")
    return Sensor(beams, view, reach, circle)


def _known(known: Familiarity | None) -> dict[str, Any]:
    return {} if known is None else {"exemplars": known.to_dict()}


def _familiarity(data: Mapping[str, Any], feature_set: str) -> Familiarity | None:
    if "exemplars" not in data:
        return None
    return Familiarity.from_dict(mapping(data, "exemplars"), feature_set)


def _submap_id(key: str) -> int:
    if not key.isdecimal():
        raise refuse("file", f"{key!r} is no submap id")
    return int(key)


def _readable(data: Any) -> str:
    """JSON, indented to the rounds and a round a line."""
    return _indented(data, 5, "") + "\n"


def _indented(value: Any, levels: int, margin: str) -> str:
    """JSON with keys sorted, a line an entry in the outer `levels`, compact below."""
    if not levels or not value or not isinstance(value, dict | list):
        return json.dumps(value, sort_keys=True)
    inner = margin + " "
    if isinstance(value, dict):
        entries = [
            f"{json.dumps(key)}: {_indented(value[key], levels - 1, inner)}"
            for key in sorted(value)
        ]
    else:
        entries = [_indented(entry, levels - 1, inner) for entry in value]
    brackets = "{}" if isinstance(value, dict) else "[]"
    lines = f",\n{inner}".join(entries)
    return f"{brackets[0]}\n{inner}{lines}\n{margin}{brackets[1]}"
