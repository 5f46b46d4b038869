"""Classifiers of a map: one against all, the sensor, files edited by hand into nonsense."""

import json
import math
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.errors import MapError
from specmap_cli.core.records import PlanarScan
from specmap_cli.core.settings import Config
from specmap_cli.recognition.features.sets import feature_names
from specmap_cli.recognition.learning.boosting import OneVsAll
from specmap_cli.recognition.learning.calibration import Calibration, Familiarity, HeldOutMisfit
from specmap_cli.recognition.learning.classifiers import ClassifierSet, Recogniser, Sensor
from tests.recognition.learning.made_up import PAPER, SMALL, samples_of

CIRCLE = Sensor(beams=360, field_of_view=2.0 * math.pi, range_max=20.0, full_circle=True)


def recogniser(config: Config, seed: int = 0) -> Recogniser:
    made, feature_set = samples_of(config), config.recognition.feature_set
    classifiers = OneVsAll(feature_set, config.recognition)
    known = Familiarity(feature_set).fit(made)
    return Recogniser(classifiers.fit(made, np.random.default_rng(seed)), known)


def classifier_set(config: Config = SMALL) -> ClassifierSet:
    return ClassifierSet(
        sensor=CIRCLE,
        raw=recogniser(config),
        virtual=recogniser(config, 1),
        misfit=HeldOutMisfit(0.0371, 55),
        calibration=Calibration(1.25, 0.8, 120),
    )


@pytest.mark.parametrize("config", [SMALL, PAPER])
def test_every_class_claims_its_own(config: Config) -> None:
    model, made = recogniser(config), samples_of(config)
    assert model.ids == (0, 2, 4)
    for k, i in enumerate(model.ids):
        assert (model.margins(made[i]).argmax(axis=1) == k).mean() > 0.97


@pytest.mark.parametrize("config", [SMALL, PAPER])
def test_a_file_gives_the_same_set_back(config: Config) -> None:
    model = classifier_set(config)
    back = ClassifierSet.from_json(model.to_json())
    assert back.to_json() == model.to_json()
    assert back.sensor == CIRCLE
    assert back.misfit == model.misfit
    assert back.calibration == model.calibration
    assert back.ids == model.ids == [0, 2, 4]
    X = np.vstack(list(samples_of(config).values()))
    for kind in ("raw", "virtual"):
        read, learned = getattr(back, kind), getattr(model, kind)
        assert read.feature_set == learned.feature_set
        assert read.margins(X).tolist() == learned.margins(X).tolist()
        assert read.strangeness(X).tolist() == learned.strangeness(X).tolist()


def test_older_files_lack_what_maps_had_not_yet() -> None:
    data = json.loads(classifier_set().to_json())
    for key in ("virtual", "misfit", "calibration"):
        del data[key]
    del data["raw"]["exemplars"]
    back = ClassifierSet.from_json(json.dumps(data))
    assert (back.virtual, back.misfit, back.calibration) == (None, None, None)
    assert back.raw.strangeness(np.zeros((3, 118))).tolist() == [-math.inf] * 3
    assert json.loads(back.to_json()) == data


def test_the_file_has_a_round_a_line_and_is_plain_json() -> None:
    text = classifier_set().to_json()
    assert text == classifier_set().to_json(), "training is repeatable"
    lines = [line for line in text.splitlines() if '"votes"' in line]
    assert len(lines) == 2 * 3 * 25  # raw and virtual, three submaps, 25 rounds
    for line in lines:
        assert set(json.loads(line.strip().rstrip(","))) == {"root", "below", "above", "votes"}
    assert text.endswith("}\n")
    assert json.loads(text) == json.loads(json.dumps(json.loads(text), allow_nan=False))


votes = st.floats(-10.0, 10.0)
split = {"feature": st.sampled_from(feature_names("table1")), "threshold": st.floats(-1e9, 1e9)}
splits = st.fixed_dictionaries(split)
stumps = st.fixed_dictionaries({**split, "polarity": st.sampled_from([1, -1]), "votes": votes})
nodes = dict.fromkeys(("root", "below", "above"), splits)
trees = st.fixed_dictionaries({**nodes, "votes": st.lists(votes, min_size=4, max_size=4)})
boosters = st.one_of(
    st.builds(lambda r: {"kind": "stumps", "rounds": r}, st.lists(stumps, max_size=3)),
    st.builds(lambda r: {"kind": "trees", "rounds": r}, st.lists(trees, max_size=3)),
)


@given(st.dictionaries(st.integers(0, 99), boosters, min_size=1, max_size=4))
def test_dump_after_load_is_identity(classifiers: dict[int, Any]) -> None:
    """Also of sets that no training makes: mixed kinds, other numbers of rounds, none at all."""
    data = json.loads(ClassifierSet(sensor=CIRCLE, raw=recogniser(PAPER)).to_json())
    by_name = {str(i): booster for i, booster in classifiers.items()}
    data["raw"] = {"feature_set": "table1", "classifiers": by_name}
    back = ClassifierSet.from_json(json.dumps(data))
    assert json.loads(back.to_json()) == data
    assert back.ids == sorted(classifiers)
    X = np.random.default_rng(0).normal(size=(3, len(feature_names("table1"))))
    alone = [back.raw.classifiers.boosters_[i].margins(X) for i in back.ids]
    assert back.raw.margins(X) == pytest.approx(np.column_stack(alone))
    assert back.raw.margins(X[:0]).shape == (0, len(classifiers))


@cache
def classifier_json() -> str:
    return classifier_set().to_json()


def edited(path: str, value: Any) -> str:
    """The file with another value at a place."""
    data = place = json.loads(classifier_json())
    *parents, last = path.split("/")
    for key in parents:
        place = place[int(key) if isinstance(place, list) else key]
    place[int(last) if isinstance(place, list) else last] = value
    return json.dumps(data)


STUMP = {"feature": "area", "threshold": 0.5, "polarity": 1, "votes": 0.3}
BARE = {"kind": "trees", "rounds": []}
NAN, HUGE = float("nan"), 10**400
NONSENSE: dict[str, list[Any]] = {
    "schema_version": [99],
    "sensor": ["a laser", None],
    "sensor/beams": [-4, 10**12, HUGE],
    "sensor/field_of_view": [7.0],
    "sensor/full_circle": ["yes"],
    "sensor/range_max": [float("inf")],
    "raw": [[]],
    "raw/feature_set": ["mine"],
    "raw/classifiers": [{}],
    "raw/classifiers/0": [
        3,
        {"kind": "stumps", "rounds": [STUMP | {"polarity": 0}]},
        {"kind": "stumps", "rounds": [{"feature": "area"}]},
    ],
    "raw/classifiers/0/kind": ["oracle"],
    "raw/classifiers/0/rounds": [{}],
    "raw/classifiers/0/rounds/2": [7],
    "raw/classifiers/0/rounds/2/root/feature": ["height", ["f1"]],
    "raw/classifiers/0/rounds/2/root/threshold": ["high", NAN, True],
    "raw/classifiers/0/rounds/2/below": ["f1"],
    "raw/classifiers/0/rounds/2/votes": [[1.0, 2.0, 3.0, None], [1, 2, 3], [1, 2, 3, HUGE]],
    "raw/classifiers/first": [BARE],
    "raw/classifiers/" + "9" * 5000: [BARE],
    "virtual/classifiers": [{"1": BARE}],
    "virtual/exemplars": [[]],
    "virtual/exemplars/rows": [[], 3],
    "virtual/exemplars/rows/0": ["zz", "00", "0"],
    "virtual/exemplars/limit": [None, -0.1],
    "virtual": [None],
    "misfit": [[], {}, None],
    "misfit/typical": [-0.1, NAN, 1.1],
    "misfit/views": [HUGE, 1.5, -1, 61],
    "calibration/raw": [0.0, 1e9],
    "calibration/virtual": [-1.0],
    "calibration/views": [1.5, -1, "7"],
}


@pytest.mark.parametrize(
    ("path", "value"),
    [(path, value) for path, values in NONSENSE.items() for value in values],
    ids=lambda part: str(part)[:60] if isinstance(part, str) else None,
)
def test_a_file_edited_into_nonsense_is_refused_in_one_line(path: str, value: Any) -> None:
    with pytest.raises(MapError) as error:
        ClassifierSet.from_json(edited(path, value))
    assert "\n" not in str(error.value)
    assert "build the map again" in str(error.value)
    assert len(str(error.value)) < 300


@pytest.mark.parametrize(
    ("path", "value", "found"),
    [
        (
            "raw/classifiers/4/rounds/7/below/feature",
            "height",
            "raw.classifiers.4.rounds.7: 'height' is no feature of the set",
        ),
        (
            "virtual/classifiers/0/rounds/0/root/feature",
            "height",
            "virtual.classifiers.0.rounds.0: 'height' is no feature of the set",
        ),
        ("raw/exemplars/rows/1", "00", "raw.exemplars: rows are not of 88 values"),
        ("virtual/exemplars/rows/1", "00", "virtual.exemplars: rows are not of 88 values"),
        ("virtual/exemplars", None, "virtual.exemplars: null is not what belongs here"),
        ("calibration", None, "calibration: null is not what belongs here"),
    ],
)
def test_what_is_at_fault_is_named(path: str, value: Any, found: str) -> None:
    with pytest.raises(MapError) as error:
        ClassifierSet.from_json(edited(path, value))
    assert str(error.value) == f"classifiers: {found}; build the map again"


def test_a_mistake_in_the_program_is_no_fault_of_the_file(monkeypatch: pytest.MonkeyPatch) -> None:
    def mistaken(*_: Any) -> None:
        raise ValueError("shapes do not fit")

    monkeypatch.setattr(Familiarity, "_keep", mistaken)
    with pytest.raises(ValueError, match="shapes do not fit"):
        ClassifierSet.from_json(classifier_json())


@pytest.mark.parametrize("text", ["", "{", "[]", "null", "7", "[" * 100_000])
def test_what_is_no_object_is_refused(text: str) -> None:
    with pytest.raises(MapError):
        ClassifierSet.from_json(text)


HALF = Sensor(beams=181, field_of_view=math.pi, range_max=20.0, full_circle=False)


def scan(bearings: Any, full: bool = False) -> PlanarScan:
    return PlanarScan(0, np.asarray(bearings), np.ones(len(bearings)), 20.0, full_circle=full)


def test_the_sensor_of_a_scan_and_its_words_and_that_of_hardly_a_beam() -> None:
    assert Sensor.of(scan(np.linspace(-np.pi / 2, np.pi / 2, 181))) == HALF
    assert Sensor.of(scan(np.linspace(-np.pi, np.pi, 360, endpoint=False), full=True)) == CIRCLE
    assert str(HALF) == "181 beams over 180 degrees, 20 m"
    assert str(replace(CIRCLE, range_max=7.5)) == "360 beams over 360 degrees, 7.5 m"
    none, one = Sensor.of(scan([])), Sensor.of(scan([0.3]))
    assert (none.beams, none.field_of_view) == (0, 0.0)
    assert (one.beams, one.field_of_view) == (1, 0.0)


@given(
    st.builds(
        Sensor,
        beams=st.integers(1, 2000),
        field_of_view=st.floats(0.0, 2.0 * math.pi),
        range_max=st.floats(0.5, 100.0),
        full_circle=st.booleans(),
    )
)
def test_bearings_are_even_and_symmetric_and_a_laser_sees_as_itself(sensor: Sensor) -> None:
    assert sensor.sees_as(sensor)
    bearings = sensor.bearings()
    assert len(bearings) == sensor.beams
    if sensor.beams > 1:
        assert np.diff(bearings, n=2) == pytest.approx(0.0, abs=1e-9)
        step = sensor.field_of_view / (sensor.beams - (0 if sensor.full_circle else 1))
        assert bearings[1] - bearings[0] == pytest.approx(step, abs=1e-9)
        ends = bearings[0] + bearings[-1] + (step if sensor.full_circle else 0.0)
        assert ends == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    ("change", "same"),
    [
        ({"beams": 380}, True),
        ({"beams": 400}, False),
        ({"beams": 180}, False),
        ({"range_max": 24.0}, True),
        ({"range_max": 26.0}, False),
        ({"field_of_view": 2.0 * math.pi - math.radians(2.5)}, True),
        ({"field_of_view": 2.0 * math.pi - math.radians(3.5)}, False),
        ({"full_circle": False}, False),
    ],
)
def test_small_differences_are_none(change: dict[str, Any], same: bool) -> None:
    assert CIRCLE.sees_as(replace(CIRCLE, **change)) is same
