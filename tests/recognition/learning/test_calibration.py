"""How sure margins are, what held-out scans say of it, and which scans look like no place."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.distance import cdist

from specmap_cli.core.arrays import evenly
from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import Labels, PlanarScan
from specmap_cli.core.settings import RecognitionConfig
from specmap_cli.recognition.features.sets import feature_names, histogram_columns
from specmap_cli.recognition.learning.boosting import OneVsAll
from specmap_cli.recognition.learning.calibration import (
    Calibration,
    Familiarity,
    HeldOutMargins,
    HeldOutMisfit,
    calibrated,
    held_out_misfit,
    near_returns,
    steadiness,
)
from specmap_cli.recognition.learning.classifiers import ClassifierSet, Recogniser, Sensor
from specmap_cli.recognition.learning.sampling import Samples
from specmap_cli.recognition.learning.training import (
    Revisits,
    held_out_margins,
    in_pieces_held_out,
    known_places,
)
from tests.casting import store_of
from tests.recognition.learning.made_up import SMALL, samples_of

NOTHING = HeldOutMargins(np.zeros((0, 3)), np.zeros(0, dtype=np.intp))


def drawn(ratio: float, scans: int, submaps: int = 8) -> HeldOutMargins:
    """Margins of which the truth is drawn as a calibration of this ratio says."""
    rng = np.random.default_rng(5)
    margins = rng.normal(-10.0, 12.0, (scans, submaps))
    told = np.exp(Calibration(raw=ratio).alone(margins))
    column = [int(rng.choice(submaps, p=row / row.sum())) for row in told]
    return HeldOutMargins(margins, np.array(column, dtype=np.intp))


@pytest.mark.parametrize("virtual", [None, [[0.0, -3.0, 2.0]]])
def test_probabilities_sum_to_one_and_rise_with_the_margin(virtual: Any) -> None:
    seen = None if virtual is None else np.array(virtual)
    for first in (-400.0, -4.0, 0.0, 4.0, 400.0):
        told = np.exp(Calibration().together(np.array([[first, -1.0, 0.0]]), seen))
        assert told.sum() == pytest.approx(1.0)
        assert told.min() > 0.0
        more = np.exp(Calibration().together(np.array([[first + 3.0, -1.0, 0.0]]), seen))
        assert more[0, 0] >= told[0, 0]


def test_by_how_much_a_submap_refuses_a_scan_says_nothing() -> None:
    near, far = (Calibration().alone(np.array([[5.0, m, m]])) for m in (-60.0, -600.0))
    assert near == pytest.approx(far, abs=1e-6)
    unclaimed = np.exp(Calibration().alone(np.array([[-60.0, -90.0, -300.0]])))
    assert unclaimed == pytest.approx(np.full((1, 3), 1.0 / 3.0), abs=1e-3)


def test_scans_that_were_held_out_say_how_sure_a_map_is() -> None:
    usual = calibrated(drawn(0.48, 4000), None)
    assert usual.raw == pytest.approx(1.0, rel=0.15)
    assert (usual.virtual, usual.views) == (1.0, 400)
    sure, unsure = (calibrated(drawn(0.48 * ratio, 4000), None).raw for ratio in (4.0, 0.25))
    assert unsure < 0.7 * usual.raw < usual.raw < sure / 1.3
    assert unsure < calibrated(drawn(0.48 * 0.25, 12), None).raw


def test_both_kinds_are_calibrated_apart_and_without_a_scan_held_out_as_usual() -> None:
    found = calibrated(drawn(0.1, 400), drawn(2.0, 400))
    assert found.raw < 1.0 < found.virtual
    assert found.views == 800
    assert calibrated(NOTHING, None) == calibrated(NOTHING, NOTHING) == Calibration()


def test_a_view_that_leaves_more_open_goes_on_for_longer() -> None:
    def among(count: int) -> FloatArray:
        told: FloatArray = Calibration().alone(np.where(np.arange(9) < count, 50.0, -99.0)[None])
        return np.asarray(told[0])

    found = [steadiness(among(count)) for count in (1, 2, 9)]
    assert found == pytest.approx([0.3, 0.6, 2.7], rel=0.12)


def misfit_of(building: Any, poses: FloatArray, noise_m: float = 0.0) -> HeldOutMisfit:
    """What the scans from some poses of one submap say, with noise in their ranges."""
    rng = np.random.default_rng(3)
    noisy = []
    for scan in building.posed(poses):
        ranges = scan.planar.ranges + rng.normal(0.0, noise_m, len(scan.planar.ranges))
        noisy.append(replace(scan, planar=replace(scan.planar, ranges=ranges)))
    with store_of(noisy) as store:
        return held_out_misfit(store, {5: range(len(poses))}, store.poses)


def test_views_of_one_room_fit_the_rest_and_noise_shows(building: Any) -> None:
    poses = building.path(0, 2)
    clear, noisy = misfit_of(building, poses), misfit_of(building, poses, 0.15)
    assert clear.views == noisy.views == 40
    assert clear.typical < 0.05
    assert noisy.typical > clear.typical + 0.02


def test_views_of_what_was_seen_only_then_or_only_once_are_not_held_out(building: Any) -> None:
    """A robot that never moved a metre, and two keyframes metres apart: nothing is left."""
    way = building.path(0, 2)
    standing = np.zeros((12, 3)) + way[:1]
    standing[:, 0] += 0.05 * np.arange(12)
    for poses in (standing, way[[0, 20]]):
        assert misfit_of(building, poses) == HeldOutMisfit(0.0, 0)


def test_near_returns_are_those_in_reach_or_the_nearer_half() -> None:
    bearings = np.linspace(-1.0, 1.0, 41)
    scan = PlanarScan(0, bearings, np.linspace(1.0, 21.0, 41), 30.0, full_circle=False)
    for reach, farthest in ((15.0, 15.0), (3.0, 11.0)):
        assert np.hypot(*near_returns(scan, reach).T).max() == pytest.approx(farthest)
    assert len(near_returns(PlanarScan(0, bearings, np.full(41, np.inf), 30.0, False), 8.0)) == 0


WIDTH = len(feature_names("pairs"))


def places(seed: int, counts: tuple[int, ...]) -> dict[int, FloatArray]:
    """Features of submaps 3, 6, ...: any shares in the histograms, anything in other columns."""
    rng = np.random.default_rng(seed)
    return {3 * k + 3: rng.uniform(0.0, 1.0, (count, WIDTH)) for k, count in enumerate(counts)}


@given(st.integers(0, 999))
def test_distances_are_those_of_scipy_to_the_nearest_exemplar(seed: int) -> None:
    made = places(seed, (30, 41))
    known = Familiarity("pairs", per_submap=10).fit(made)
    columns = histogram_columns("pairs")
    kept = np.vstack([evenly(X, 10) for X in made.values()])[:, columns]
    assert known.exemplars_.tolist() == np.round(255.0 * np.sqrt(kept)).tolist()
    fresh = places(seed + 1, (25,))[3]
    expected = cdist(np.sqrt(fresh[:, columns]), known.exemplars_ / 255.0, "cityblock").min(axis=1)
    assert known.strangeness(fresh) == pytest.approx(expected / known.limit_, rel=1e-4)


@pytest.mark.parametrize("share", [0.02, 0.1, 0.4])
def test_about_the_wanted_share_of_samples_is_strange(share: float) -> None:
    known = Familiarity("pairs", share).fit(places(1, (400, 400)))
    fresh = np.vstack(list(places(2, (400, 400)).values()))
    assert (known.strangeness(fresh) > 1.0).mean() == pytest.approx(share, abs=0.06)


def test_columns_that_are_no_histogram_do_not_count_and_shares_are_cut_to_their_bounds() -> None:
    made = samples_of(SMALL)
    known = Familiarity("pairs").fit(made)
    changed = made[4].copy()
    changed[:, np.setdiff1d(np.arange(WIDTH), histogram_columns("pairs"))] = -1e6
    assert known.strangeness(changed).tolist() == known.strangeness(made[4]).tolist()
    bounds, beyond = (np.where(np.arange(WIDTH) % 2, *ends)[None] for ends in ((0, 1.0), (-3, 4.0)))
    assert known.strangeness(beyond).tolist() == known.strangeness(bounds).tolist()


@pytest.mark.parametrize(
    ("feature_set", "counts", "can"),
    [
        ("pairs", (40,), True),
        ("pairs", (39,), False),  # 20 exemplars, 19 left for the limit
        ("pairs", (20, 20), True),
        ("pairs", (1,) * 100, False),  # a single sample of a submap is its exemplar
        ("pairs", (), False),
        ("table1", (60,), True),
    ],
)
def test_a_limit_needs_enough_samples(feature_set: str, counts: tuple[int, ...], can: bool) -> None:
    width = len(feature_names(feature_set))
    made = {k: np.zeros((count, width)) for k, count in enumerate(counts)}
    assert Familiarity(feature_set).can_fit(made) is can


def test_samples_that_are_all_alike_leave_a_limit_of_nought() -> None:
    known = Familiarity("pairs").fit({0: np.full((60, WIDTH), 0.25)})
    assert known.limit_ == pytest.approx(0.0, abs=0.2)  # 0.5 is between two steps of 1 / 255
    other = np.full((1, WIDTH), 0.5)
    assert np.isfinite(known.strangeness(other)).all()
    assert known.strangeness(other)[0] > 1.0


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


def test_only_places_that_the_rest_shows_are_tested() -> None:
    everywhere = samples(0.0, np.arange(600))
    line, there_and_back = straight(60.0), np.vstack([straight(30.0), straight(30.0)[::-1]])
    held_out = in_pieces_held_out(line)
    tested = known_places(everywhere, held_out, line).keyframes
    assert set(tested) < set(np.flatnonzero(held_out))
    assert {51, 97} <= set(tested)
    assert not {75} & set(tested)
    held_out = in_pieces_held_out(there_and_back)
    assert len(known_places(everywhere, held_out, there_and_back).keyframes) == held_out.sum()
    own = samples(0.0, np.arange(55, 90))  # a submap of which nothing is left
    assert not len(known_places(own, in_pieces_held_out(line), line).keyframes)


def test_held_out_scans_are_told_by_what_was_learned_of_the_rest_of_two_submaps_or_more() -> None:
    rest = {2: samples(0.0, np.arange(40)), 5: samples(3.0, np.arange(40))}
    rest[7] = samples(0.0, np.arange(0))
    asked = {2: samples(0.1, np.arange(9)), 5: samples(3.1, np.arange(7))}
    asked[7] = samples(6.0, np.arange(3))
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
    poses = np.array([(0.0, 0.0, 0.0), (10.0, 0.0, 0.0), *places])
    submaps = np.array([1, 4, *[1] * len(places)])
    labels = Labels(stamps_ns=np.arange(len(poses)), poses=poses, submaps=submaps)
    return Revisits(ClassifierSet(sensor=sensor, raw=recogniser), FIRST, labels)


def asked(found: Revisits) -> Samples:
    """A sample of every keyframe of submap 1."""
    own = np.flatnonzero(found.labels.submaps == 1)
    return Samples(features(*np.linspace(0.0, 0.2, len(own)).tolist()), own)


def test_scans_of_a_recording_are_told_by_the_classifiers_before_it(recogniser: Recogniser) -> None:
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
