"""Scans that classifiers did not learn: held-out pieces of the way, and new recordings."""

from __future__ import annotations

import math

import numpy as np
import pytest

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.settings import RecognitionConfig
from specmap_cli.recognition.features.sets import feature_names
from specmap_cli.recognition.learning.boosting import OneVsAll
from specmap_cli.recognition.learning.classifiers import ClassifierSet, Recogniser, Sensor
from specmap_cli.recognition.learning.sampling import Samples
from specmap_cli.recognition.learning.training import (
    Revisits,
    held_out_margins,
    in_pieces_held_out,
    known_places,
)

CONFIG = RecognitionConfig(rounds=10)
COLUMNS = len(feature_names("table1"))
FIRST = 2  # keyframes 0 and 1 are of the map, at (0, 0) and (10, 0), both facing along x


def straight(metres: float) -> np.ndarray:
    """Poses 0.1 m apart along a line."""
    x = np.arange(0.0, metres, 0.1) + 0.01
    return np.column_stack([x, np.zeros_like(x), np.zeros_like(x)])


def samples(centre: float, keyframes: np.ndarray) -> Samples:
    rng = np.random.default_rng(int(100 * centre))
    return Samples(rng.normal(centre, 1.0, (len(keyframes), COLUMNS)), keyframes)


def none() -> Samples:
    return samples(0.0, np.zeros(0, dtype=np.intp))


def test_only_places_that_the_rest_shows_are_tested() -> None:
    everywhere = samples(0.0, np.arange(600))
    line, there_and_back = straight(60.0), np.vstack([straight(30.0), straight(30.0)[::-1]])
    held_out = in_pieces_held_out(line)
    tested = known_places(everywhere, held_out, line).keyframes
    assert set(tested) < set(np.flatnonzero(held_out))
    assert {51, 97} <= set(tested)
    assert not {75} & set(tested)
    held_out = in_pieces_held_out(there_and_back)
    again = known_places(everywhere, held_out, there_and_back).keyframes
    assert len(again) == held_out.sum()
    own = samples(0.0, np.arange(55, 90))  # a submap of which nothing is left
    assert not len(known_places(own, in_pieces_held_out(line), line).keyframes)


def test_held_out_scans_are_told_by_what_was_learned_of_the_rest_of_two_submaps_or_more() -> None:
    rest = {2: samples(0.0, np.arange(40)), 5: samples(3.0, np.arange(40)), 7: none()}
    asked = {
        2: samples(0.1, np.arange(9)),
        5: samples(3.1, np.arange(7)),
        7: samples(6.0, np.arange(3)),
    }
    found = held_out_margins(rest, asked, "table1", CONFIG, np.random.default_rng(0))
    assert found.column.tolist() == [0] * 9 + [1] * 7
    assert (found.margins.argmax(axis=1) == found.column).mean() > 0.9
    assert (found.margins[:, 2] < -100.0).all()
    del rest[5], asked[5]
    alone = held_out_margins(rest, asked, "table1", CONFIG, np.random.default_rng(0))
    assert alone.margins.shape == (0, 2)
    assert not len(alone.column)


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
    new = found.told({7: asked(found)}, recogniser)
    assert new.column.tolist() == [], "submaps that are new are not asked for"
    assert new.margins.shape == (0, 2)


@pytest.mark.parametrize(
    ("place", "full_circle", "counts"),
    [
        ((1.4, 0.0, 0.0), False, True),
        ((1.6, 0.0, 0.0), False, False),
        ((0.0, 0.0, math.radians(25.0)), False, True),
        ((0.0, 0.0, math.radians(35.0)), False, False),
        ((0.0, 0.0, 3.0), True, True),  # a laser that looks all round may face any way
        ((0.0, 0.0, 2.0 * math.pi), False, True),
        ((1.2, 0.0, math.radians(25.0)), False, False),  # both together are too much
        ((10.0, 0.0, 0.0), False, False),  # known, but of another submap
    ],
)
def test_only_views_that_the_map_knew_count(
    recogniser: Recogniser, place: tuple[float, float, float], full_circle: bool, counts: bool
) -> None:
    found = revisits(recogniser, [place], full_circle=full_circle)
    assert len(found.told({1: asked(found)}, recogniser).column) == counts
