"""Classifiers of a map: one against all, the sensor, files edited by hand into nonsense."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from specmap_cli.core.config import RecognitionConfig
from specmap_cli.core.errors import MapError
from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import PlanarScan
from specmap_cli.recognition.features.sets import FEATURE_SETS
from specmap_cli.recognition.learning.classifiers import ClassifierSet, OneVsAll, Sensor
from specmap_cli.recognition.learning.familiarity import Familiarity

SENSOR = Sensor(360, 2 * math.pi, 20.0, True)
SMALL = RecognitionConfig(rounds=25, feature_set="pairs")
PAPER = RecognitionConfig(rounds=10, feature_set="table1", booster="stumps")


def samples(config: RecognitionConfig, classes: int = 3, n: int = 90) -> dict[int, FloatArray]:
    """Samples of classes 0, 2, 4, ... that differ in a few columns."""
    rng = np.random.default_rng(1)
    width = len(FEATURE_SETS[config.feature_set])
    made = {}
    for k in range(classes):
        X = rng.uniform(0.0, 0.2, (n, width))
        X[:, 3 * k : 3 * k + 3] += 0.3
        made[2 * k] = X
    return made


def trained(config: RecognitionConfig = SMALL) -> ClassifierSet:
    made = samples(config)
    model = ClassifierSet.train(made, SENSOR, config, np.random.default_rng(0))
    model.virtual = OneVsAll(config.feature_set, config).fit(made, np.random.default_rng(1))
    model.virtual_known = Familiarity.of(config.feature_set, made, 0.05)
    return model


@pytest.mark.parametrize("config", [SMALL, PAPER])
def test_every_class_claims_its_own(config: RecognitionConfig) -> None:
    made = samples(config)
    model = ClassifierSet.train(made, SENSOR, config, np.random.default_rng(0))
    assert model.ids == [0, 2, 4]
    for k, i in enumerate(model.ids):
        assert (model.margins(made[i]).argmax(axis=1) == k).mean() > 0.97


@pytest.mark.parametrize("config", [SMALL, PAPER])
def test_margins_are_those_of_the_boosters(config: RecognitionConfig) -> None:
    model = trained(config)
    X = samples(config)[2]
    expected = np.column_stack([b.margins(X) for b in model.raw.boosters.values()])
    assert model.margins(X) == pytest.approx(expected)
    assert model.margins(X[:1]) == pytest.approx(expected[:1])


@pytest.mark.parametrize("config", [SMALL, PAPER])
def test_a_file_gives_the_same_set_back(config: RecognitionConfig) -> None:
    model = trained(config)
    back = ClassifierSet.from_json(model.to_json())
    assert back.to_json() == model.to_json()
    assert back.sensor == SENSOR
    X = np.vstack(list(samples(config).values()))
    assert back.margins(X) == pytest.approx(model.margins(X))
    assert back.virtual is not None
    if model.virtual_known is not None:
        assert back.virtual_known is not None
        assert back.virtual_known.distance(X) == pytest.approx(model.virtual_known.distance(X))


def test_the_file_names_features_and_holds_no_pickled_thing() -> None:
    data = json.loads(trained().to_json())
    first = data["raw"]["classifiers"]["0"]["rounds"][0]
    assert first["root"]["feature"] in FEATURE_SETS["pairs"]
    assert set(first) == {"root", "below", "above", "votes"}


def test_one_class_is_enough() -> None:
    made = {7: samples(SMALL)[0]}
    model = ClassifierSet.train(made, SENSOR, SMALL, np.random.default_rng(0))
    assert model.ids == [7]
    assert (model.margins(made[7]) > 0.0).all()


def test_training_is_repeatable() -> None:
    assert trained().to_json() == trained().to_json()


def edit(path: str, value: Any) -> Callable[[dict[str, Any]], None]:
    def change(data: dict[str, Any]) -> None:
        *parents, last = path.split("/")
        for key in parents:
            data = data[int(key)] if isinstance(data, list) else data[key]
        data[int(last) if isinstance(data, list) else last] = value

    return change


@pytest.mark.parametrize(
    "change",
    [
        edit("schema_version", 99),
        edit("sensor", "a laser"),
        edit("sensor/beams", -4),
        edit("sensor/full_circle", "yes"),
        edit("sensor/range_max", float("inf")),
        edit("raw", []),
        edit("raw/feature_set", "mine"),
        edit("raw/classifiers", {}),
        edit("raw/classifiers/0", 3),
        edit("raw/classifiers/0/kind", "oracle"),
        edit("raw/classifiers/0/rounds/2/root/feature", "height"),
        edit("raw/classifiers/0/rounds/2/votes", [1, 2, 3]),
        edit("raw/classifiers/first", {"kind": "trees", "rounds": []}),
        edit("virtual/classifiers", {"1": {"kind": "trees", "rounds": []}}),
        edit("virtual/exemplars/rows/0", "zz"),
        edit("virtual/exemplars/rows/0", "00"),
        edit("virtual/exemplars/limit", None),
    ],
)
def test_a_file_edited_into_nonsense_is_refused_in_one_line(
    change: Callable[[dict[str, Any]], None],
) -> None:
    data = json.loads(trained().to_json())
    change(data)
    with pytest.raises(MapError) as error:
        ClassifierSet.from_json(json.dumps(data))
    assert "\n" not in str(error.value)
    assert "build the map again" in str(error.value)


@pytest.mark.parametrize("text", ["", "{", "[]", "null", "7", "[" * 100_000])
def test_what_is_no_object_is_refused(text: str) -> None:
    with pytest.raises(MapError):
        ClassifierSet.from_json(text)


def test_sensors_are_told_apart() -> None:
    bearings = np.linspace(-np.pi / 2, np.pi / 2, 181)
    half = Sensor.of(PlanarScan(0, bearings, np.ones(181), 20.0, False))
    assert half.field_of_view == pytest.approx(math.pi)
    assert half.sees_as(half)
    assert not half.sees_as(SENSOR)
    assert not SENSOR.sees_as(Sensor(180, 2 * math.pi, 20.0, True))
    assert half.bearings() == pytest.approx(bearings)
    assert "181 beams over 180 degrees" in str(half)


def test_strange_samples_are_far_from_every_exemplar() -> None:
    made = samples(SMALL)
    known = Familiarity.of("pairs", made, 0.05)
    assert known is not None
    assert (known.strangeness(made[2]) <= 1.0).mean() > 0.9
    foreign = made[2].copy()
    foreign[:, 60:] += 0.4
    assert (known.strangeness(foreign) > 1.0).all()


def test_a_set_without_histograms_knows_nothing_strange() -> None:
    assert Familiarity.of("table1", {0: np.zeros((5, len(FEATURE_SETS["table1"])))}, 0.1) is None
