"""Scans of a new recording as a test of the classifiers that a map had before it."""

from __future__ import annotations

import math

import numpy as np
import pytest

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.settings import RecognitionConfig
from specmap_cli.recognition.features.sets import feature_names
from specmap_cli.recognition.learning.boosting import OneVsAll
from specmap_cli.recognition.learning.classifiers import ClassifierSet, Recogniser, Sensor
from specmap_cli.recognition.learning.training import Revisits
from specmap_cli.recognition.learning.training_data import Samples

COLUMNS = len(feature_names("table1"))
FIRST = 2  # keyframes 0 and 1 are of the map, at (0, 0) and (10, 0), both facing along x


def features(*values: float) -> FloatArray:
    """Rows whose every feature has the value."""
    return np.repeat(np.array(values)[:, None], COLUMNS, axis=1)


@pytest.fixture(scope="module")
def recogniser() -> Recogniser:
    """Tells values around 0, of submap 1, from values around 5, of submap 4."""
    config = RecognitionConfig(rounds=4, booster="stumps")
    samples = {1: features(0.0, 0.1, 0.2), 4: features(5.0, 5.1, 5.2)}
    return Recogniser(OneVsAll("table1", config).fit(samples, np.random.default_rng(0)), None)


def revisits(
    recogniser: Recogniser, places: list[tuple[float, float, float]], *, full_circle: bool = False
) -> Revisits:
    """A map of keyframe 0 in submap 1 and 1 in submap 4, and a recording at some places of 1."""
    sensor = Sensor(beams=180, field_of_view=math.pi, range_max=20.0, full_circle=full_circle)
    return Revisits(
        classifiers=ClassifierSet(sensor=sensor, raw=recogniser),
        first=FIRST,
        poses=np.array([(0.0, 0.0, 0.0), (10.0, 0.0, 0.0), *places]),
        submaps=np.array([1, 4, *[1] * len(places)]),
        reach_m=1.5,
    )


def asked(found: Revisits) -> Samples:
    """A sample of every keyframe of submap 1."""
    own = np.flatnonzero(found.submaps == 1)
    return Samples(features(*np.linspace(0.0, 0.2, len(own)).tolist()), own)


def test_scans_of_the_recording_are_told_by_the_classifiers_before_it(
    recogniser: Recogniser,
) -> None:
    found = revisits(recogniser, [(0.5, 0.0, 0.0), (1.0, 0.0, 0.0)])
    told = found.told({1: asked(found)}, recogniser)
    assert told.column.tolist() == [0, 0]
    assert told.margins.shape == (2, 2)
    assert (told.margins[:, 0] > told.margins[:, 1]).all()


@pytest.mark.parametrize(
    ("place", "counts"),
    [
        ((1.4, 0.0, 0.0), True),
        ((1.6, 0.0, 0.0), False),
        ((0.0, 0.0, math.radians(25.0)), True),
        ((0.0, 0.0, math.radians(35.0)), False),
        ((0.0, 0.0, 2.0 * math.pi), True),
        ((1.2, 0.0, math.radians(25.0)), False),  # both together are too much
        ((10.0, 0.0, 0.0), False),  # known, but of another submap
    ],
)
def test_only_views_that_the_map_knew_count(
    recogniser: Recogniser, place: tuple[float, float, float], counts: bool
) -> None:
    found = revisits(recogniser, [place])
    assert len(found.told({1: asked(found)}, recogniser).column) == counts


def test_a_laser_that_looks_all_round_may_face_any_way(recogniser: Recogniser) -> None:
    found = revisits(recogniser, [(0.0, 0.0, 3.0)], full_circle=True)
    assert len(found.told({1: asked(found)}, recogniser).column) == 1


def test_submaps_that_are_new_are_not_asked_for(recogniser: Recogniser) -> None:
    found = revisits(recogniser, [(0.0, 0.0, 0.0)])
    told = found.told({7: asked(found)}, recogniser)
    assert told.column.tolist() == []
    assert told.margins.shape == (0, 2)
