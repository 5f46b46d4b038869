"""Training for localisation: which scans are learned from, made beside the way, and kept."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from specmap_cli.core.config import load_config
from specmap_cli.core.errors import MapError
from specmap_cli.core.geometry import FloatArray, Pose2, compose, invert
from specmap_cli.core.records import Labels
from specmap_cli.core.settings import Config, RecognitionConfig
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.grids.keyframes import KeyframeStore, integrate_keyframes
from specmap_cli.pipelines.learning import Learned, Prior, learn
from specmap_cli.pipelines.session import Session
from specmap_cli.recognition.features.sets import (
    KeyframeFeatures,
    feature_names,
    feature_sets,
    scans_features,
)
from specmap_cli.recognition.features.virtual import seen_from
from specmap_cli.recognition.learning import sampling
from specmap_cli.recognition.learning.boosting import OneVsAll
from specmap_cli.recognition.learning.calibration import Familiarity
from specmap_cli.recognition.learning.classifiers import ClassifierSet, Recogniser
from specmap_cli.recognition.learning.training import _EXEMPLARS, train_and_test
from specmap_cli.recognition.localization.localizer import Localizer
from tests.casting import store_of
from tests.recognition.posed import walls_of
from tests.recognition.watching import watched
from tests.turning import turn

SUBMAPS = {0: list(range(0, 40)), 2: list(range(44, 80))}  # keyframes 40 to 43 are in none


def settings(**localization: Any) -> Config:
    """Few rounds and few samples, so that training takes a moment."""
    chosen = {"augmentation": 60, "track_samples": 30, "feature_set": "table1"} | localization
    few = {"rounds": 8, "feature_set": "table1", "augmentation": 60}
    return load_config(overrides={"recognition": few, "localization": chosen})


@pytest.fixture(scope="module")
def store(building: Any) -> Iterator[KeyframeStore]:
    """Forty keyframes in each of two rooms of the building."""
    poses = np.vstack([building.path(room, 1) for room in (0, 2)])
    with store_of(building.posed(poses)) as made:
        yield made


def track(store: KeyframeStore, submaps: Any = SUBMAPS, starts: Any = ()) -> sampling.Track:
    return sampling.Track(store, store.poses, submaps, starts)


@pytest.fixture(scope="module")
def grids(store: KeyframeStore) -> dict[int, GridMap]:
    """The grid of each room in the frame of its first keyframe."""
    made = {}
    for submap, keyframes in SUBMAPS.items():
        track = compose(invert(store.poses[keyframes[0]]), store.poses[keyframes])
        made[submap] = integrate_keyframes(store, keyframes, track, Config().grid).snapshot()
    return made


def test_of_a_submap_seen_often_the_scans_with_known_features_are_learned_from(
    store: KeyframeStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = Config(recognition=RecognitionConfig(positives=12))
    features = KeyframeFeatures(store, "full")
    features.of([*range(5, 35), 50, 51])
    asked = watched(monkeypatch, KeyframeFeatures, "of")
    sampling.raw_samples(track(store), config, features)
    (_, enough), (_, few) = asked
    assert (len(enough), enough[0], enough[-1]) == (12, 5, 34)
    assert set(enough) <= set(range(5, 35))
    assert (len(few), few[0], few[-1]) == (12, 44, 79)
    assert {50, 51} < set(few)
    assert few == sorted(few)


def test_raw_classifiers_learn_from_the_keyframes_of_the_submaps(store: KeyframeStore) -> None:
    config = settings()
    learned = raw_of(store, config)
    assert learned.ids == (0, 2)
    samples = {
        i: scans_features([store.scan(k) for k in keyframes], "table1")
        for i, keyframes in SUBMAPS.items()
    }
    beside = sampling.augmented_samples(track(store), config, np.random.default_rng(0))
    assert all(len(own.keyframes) for own in beside.values())
    both = {i: np.vstack([X, beside[i].features]) for i, X in samples.items()}
    classifiers = OneVsAll("table1", config.recognition).fit(both, np.random.default_rng(0))
    looks = Familiarity("table1", config.localization.false_unknown, _EXEMPLARS)
    assert learned.to_dict() == Recogniser(classifiers, looks.fit(samples)).to_dict()
    known = KeyframeFeatures(store, "table1")
    known.of(range(50))
    shared = sampling.raw_samples(track(store), config, known)
    rng = np.random.default_rng(0)
    again, _ = train_and_test(shared, beside, store.poses, config, rng, virtual=False)
    assert again.to_dict() == learned.to_dict()


def learned(store: KeyframeStore, config: Config) -> Learned:
    """What a build learns of two submaps, with the keyframes that lie between in the former."""
    labels = np.where(np.arange(len(store)) < min(SUBMAPS[2]), 0, 2)
    session = Session(config, store)
    known = Labels(stamps_ns=np.arange(len(labels)), poses=store.poses, submaps=labels)
    return learn(session, known, Prior.of(session))


def test_virtual_classifiers_are_left_out_when_not_wanted(store: KeyframeStore) -> None:
    assert learned(store, settings()).classifiers.virtual is not None
    assert learned(store, settings(virtual=False)).classifiers.virtual is None


def raw_of(store: KeyframeStore, config: Config) -> Recogniser:
    features = KeyframeFeatures(store, config.recognition.feature_set)
    samples = sampling.raw_samples(track(store), config, features)
    beside = sampling.augmented_samples(track(store), config, np.random.default_rng(0))
    rng = np.random.default_rng(0)
    return train_and_test(samples, beside, store.poses, config, rng, virtual=False)[0]


def samples_of(
    store: KeyframeStore, grids: dict[int, GridMap], seed: int = 0, **localization: Any
) -> dict[int, FloatArray]:
    config = settings(**localization).localization
    along = sampling.track_samples(track(store), config)
    cast = sampling.cast_samples(track(store), grids, config, np.random.default_rng(seed))
    return {i: np.vstack([along[i].features, cast[i].features]) for i in SUBMAPS}


def test_virtual_scans_are_cast_from_free_cells_near_the_submap_s_own_track(
    store: KeyframeStore, grids: dict[int, GridMap], monkeypatch: pytest.MonkeyPatch
) -> None:
    cast = watched(monkeypatch, sampling, "cast_circles")
    turn("recognition", augmentation_clearance_m=0.4, augmentation_reach_m=0.8)
    samples_of(store, grids, augmentation=100)
    assert [grid for grid, *_ in cast] == [grids[0], grids[2]]
    for (grid, origins, *_), keyframes in zip(cast, SUBMAPS.values(), strict=True):
        assert 0 < len(origins) <= 60
        rows, columns = grid.cells_of(origins).T
        assert (grid.clearance()[rows, columns] > 0.4).all()
        frame = Pose2(*store.poses[keyframes[0]].tolist())
        own = store.poses[keyframes][:, :2]
        gaps = np.linalg.norm(frame.apply(origins)[:, None] - own[None], axis=2).min(axis=1)
        assert (gaps < 0.8).all()


@pytest.mark.parametrize(("most", "along"), [(1, 1), (30, 30), (10_000, 76)])
def test_the_track_gives_evenly_spread_samples_of_its_own_submaps(
    store: KeyframeStore, grids: dict[int, GridMap], most: int, along: int
) -> None:
    found = samples_of(store, grids, augmentation=0, track_samples=most)
    assert sum(len(X) for X in found.values()) == along
    if most > 1:
        assert len(found[0]) / along == pytest.approx(40 / 76, abs=0.05)
    assert all(X.shape[1] == len(feature_names("table1")) for X in found.values())


def test_a_submap_without_a_free_cell_has_the_samples_of_its_track(
    store: KeyframeStore, grids: dict[int, GridMap]
) -> None:
    closed = dict(grids)
    closed[2] = GridMap(np.ones_like(grids[2].cells), 0.05, grids[2].origin)
    found = samples_of(store, closed)
    assert len(found[2]) == len(samples_of(store, grids, augmentation=0)[2])
    assert len(found[0]) > len(found[2])


def test_a_feature_set_of_another_package_is_trained_and_used(
    store: KeyframeStore, install: Callable[..., None], building: Any
) -> None:
    """From an entry point to labels, by way of a file; without the package, one clear line."""
    install("mine")
    raw = {"rounds": 20, "feature_set": "mine"}
    virtual = {"augmentation": 60, "feature_set": "mine"}
    config = load_config(overrides={"recognition": raw, "localization": virtual})
    text = learned(store, config).classifiers.to_json()
    assert '"rings_middle"' in text
    read = ClassifierSet.from_json(text)
    assert read.raw.familiarity is not None
    assert read.raw.familiarity.exemplars_.shape[1] == 3
    walls = walls_of(building.plan, submaps={0: slice(0, 190), 2: slice(390, 570)})
    guide = Localizer(read, {0: [2], 2: [0]}, walls, config.localization)
    labels = []
    for room in (0, 2):
        first, *others = building.posed(building.path(room, 5))
        labels += [guide.add(scan).label for scan in (replace(first, restarted=True), *others)]
    right = [label.filtered_submap == (0, 2)[k // 40] for k, label in enumerate(labels)]
    assert np.mean(right) > 0.8

    feature_sets.cache_clear()
    with pytest.MonkeyPatch.context() as gone:
        gone.setattr("specmap_cli.core.plugins.entry_points", lambda **_: [])
        with pytest.raises(MapError) as error:
            ClassifierSet.from_json(text)
    assert str(error.value) == (
        "classifiers: file: its feature set 'mine' is not installed: install the package that "
        "offers it, or build the map again"
    )


@pytest.mark.parametrize("augmentation", [0, 40, 400])
def test_cast_scans_are_dealt_out_half_alike_and_half_by_area(
    store: KeyframeStore,
    grids: dict[int, GridMap],
    monkeypatch: pytest.MonkeyPatch,
    augmentation: int,
) -> None:
    cast = watched(monkeypatch, sampling, "cast_circles")
    turn("recognition", augmentation_clearance_m=0.0, augmentation_reach_m=50.0)
    found = samples_of(store, grids, augmentation=augmentation)
    areas = {i: grid.free_area_m2 for i, grid in grids.items()}
    for (_, origins, *_), submap in zip(cast, SUBMAPS, strict=True):
        share = 0.25 + 0.5 * areas[submap] / sum(areas.values())
        assert len(origins) == round(augmentation * share)
    along = sum(len(X) for X in found.values()) - sum(len(origins) for _, origins, *_ in cast)
    assert along == 30


def test_another_seed_draws_other_samples(store: KeyframeStore, grids: dict[int, GridMap]) -> None:
    first, again, other = (samples_of(store, grids, seed)[0].tolist() for seed in (0, 0, 1))
    assert first == again
    assert first != other


def test_exemplars_and_the_share_given_up_are_settings(store: KeyframeStore) -> None:
    turn("recognition", exemplars=5)
    few: Any = raw_of(store, settings()).familiarity
    turn("recognition", exemplars=12)
    many: Any = raw_of(store, settings(false_unknown=0.4)).familiarity
    assert (len(few.exemplars_), len(many.exemplars_)) == (10, 24)
    assert many.limit_ < few.limit_


BESIDE = {1: list(range(0, 30)), 4: list(range(32, 38))}  # all in the first room


def beside(
    store: KeyframeStore,
    wanted: int,
    seed: int = 0,
    known: sampling.Samples = sampling.NO_SAMPLES,
    submaps: dict[int, list[int]] = BESIDE,
) -> dict[int, sampling.Samples]:
    """Scans as taken beside the way, by which each submap has as many samples as are wanted."""
    config = Config(recognition=RecognitionConfig(feature_set="table1", augmentation=wanted))
    rng = np.random.default_rng(seed)
    return sampling.augmented_samples(track(store, submaps), config, rng, known)


def test_a_submap_gets_the_scans_beside_its_way_that_it_lacks(store: KeyframeStore) -> None:
    found = beside(store, 90)
    # of 30 and 6 keyframes; what comes to lie in the other submap is left out
    assert 0.85 * 60 < len(found[1].keyframes) <= 60
    assert 0.5 * 84 < len(found[4].keyframes) <= 84
    assert all(set(own.keyframes) <= set(BESIDE[i]) for i, own in found.items())
    assert all(own.features.shape[0] == len(own.keyframes) for own in found.values())
    again, other = beside(store, 90), beside(store, 90, seed=1)
    assert found[1].features.tolist() == again[1].features.tolist() != other[1].features.tolist()
    enough = beside(store, 30)
    assert not len(enough[1].keyframes)
    assert len(enough[4].keyframes)


def test_scans_beside_the_way_lie_a_step_aside_and_look_as_scans_taken_there(
    store: KeyframeStore, building: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = watched(monkeypatch, sampling, "seen_from")
    found = beside(store, 60, seed=1)
    assert len(seen) == sum(len(own.keyframes) for own in found.values())
    keyframes = np.concatenate([found[i].keyframes for i in sorted(found)])
    poses = np.array([pose for _, pose, _, _ in seen])
    laser = store.scan(3)
    assert all(b.tolist() == laser.bearings.tolist() and r == laser.range_max for *_, b, r in seen)
    assert 0.02 < np.median(np.hypot(*(poses - store.poses[keyframes])[:, :2].T)) < 0.2
    off = []
    for scan, given in zip(building.scans(poses), seen, strict=True):
        ranges = seen_from(*given)
        both = np.isfinite(scan.ranges) & np.isfinite(ranges)
        assert both.sum() > 0.8 * np.isfinite(scan.ranges).sum()
        off.append(np.median(np.abs(scan.ranges - ranges)[both]))
    assert np.median(off) < 0.03


def test_a_map_of_one_keyframe_is_seen_from_beside_it(store: KeyframeStore) -> None:
    assert beside(store, 6, submaps={0: [7]})[0].keyframes.tolist() == [7] * 5


def test_known_scans_are_made_once(store: KeyframeStore, monkeypatch: pytest.MonkeyPatch) -> None:
    seen = watched(monkeypatch, sampling, "seen_from")
    known = sampling.together(beside(store, 90).values())
    made, again = len(seen), beside(store, 40, seed=1, known=known)
    assert len(seen) == made > 40
    assert [len(again[i].keyframes) for i in (1, 4)] == [10, 34]
    of_first = {row.tobytes() for row in known.features}
    assert all(row.tobytes() in of_first for own in again.values() for row in own.features)


STARTS = (62,)
VIRTUAL = settings(augmentation=24).localization


def numbered(*keyframes: int) -> sampling.Samples:
    """Samples whose only feature is a hundred and the keyframe."""
    numbers = np.array(keyframes, dtype=np.intp)
    return sampling.Samples(100.0 + numbers[:, None].astype(np.float64), numbers)


def kept(lessons: sampling.TrainingData) -> list[list[int]]:
    """The keyframes of all four kinds of samples."""
    kinds = lessons.raw, lessons.beside, lessons.along, lessons.cast
    return [samples.keyframes.tolist() for samples in kinds]


def test_lessons_of_keyframes_that_are_gone_are_gone() -> None:
    seen, cast = numbered(0, 3, 7), numbered(0, 7, 7)
    lessons = sampling.TrainingData(seen, numbered(0, 7), numbered(3), cast)
    left = lessons.left(np.array([1, 3, 7]))
    assert kept(left) == [[1, 2], [2], [1], [2, 2]]
    assert left.raw.features.ravel().tolist() == [103.0, 107.0]
    assert kept(sampling.NO_TRAINING_DATA.left(np.array([0]))) == [[]] * 4


def test_lessons_of_several_maps_are_one() -> None:
    one = sampling.TrainingData(numbered(0, 1), numbered(0), numbered(1), numbered())
    both = sampling.TrainingData.joined(
        [one, sampling.NO_TRAINING_DATA, one.left(np.arange(2), 10)]
    )
    assert kept(both) == [[0, 1, 10, 11], [0, 10], [1, 11], []]
    assert both.raw.features.ravel().tolist() == [100.0, 101.0, 100.0, 101.0]


def test_each_recording_gives_its_share_of_raw_scans_known_ones_first(store: KeyframeStore) -> None:
    config = Config(recognition=RecognitionConfig(positives=10, feature_set="table1"))
    nothing, numbers = KeyframeFeatures(store, "table1"), np.arange(44, 62)
    known = nothing.knowing(numbers, np.ones((18, 52)))
    found = sampling.raw_samples(track(store, {2: SUBMAPS[2]}, STARTS), config, known)[2]
    old = found.keyframes < STARTS[0]
    assert int(old.sum()) == 5
    assert (found.features[old] == 1.0).all()
    assert not (found.features[~old] == 1.0).all(axis=1).any()
    known = nothing.knowing(numbers, np.ones((18, 52)))
    alone = sampling.raw_samples(track(store, {2: SUBMAPS[2]}), config, known)[2]
    assert (alone.keyframes < STARTS[0]).all()  # of one recording the known ones are enough


def test_a_recording_of_known_virtual_scans_is_not_looked_at_again(store: KeyframeStore) -> None:
    anew = sampling.track_samples(track(store, SUBMAPS, STARTS), VIRTUAL)
    before = sampling.Samples(np.ones((25, 52)), np.arange(10, 35))
    again = sampling.track_samples(track(store, SUBMAPS, STARTS), VIRTUAL, before)
    found, fresh = sampling.together(again.values()), sampling.together(anew.values())
    old = found.keyframes < STARTS[0]
    assert int(old.sum()) == 23  # of thirty, as 58 of 76 keyframes are in the first recording
    assert set(found.keyframes[old].tolist()) <= set(range(10, 35))
    assert (found.features[old] == 1.0).all()
    assert np.array_equal(found.features[~old], fresh.features[fresh.keyframes >= STARTS[0]])


def test_known_casts_are_not_cast_again(store: KeyframeStore, grids: dict[int, GridMap]) -> None:
    known, rng = sampling.Samples(np.ones((40, 52)), np.full(40, 50)), np.random.default_rng(0)
    found = sampling.cast_samples(track(store), grids, VIRTUAL, rng, known)
    assert (found[2].features == 1.0).all()
    assert 0 < len(found[2].features) < 24
    assert not (found[0].features == 1.0).all(axis=1).any()


def test_samples_are_put_together_by_submap() -> None:
    both, *others = sampling.TrainingData.of({4: numbered(1), 2: numbered(0, 5)}, {}, {}, {}).kinds
    assert both.keyframes.tolist() == [0, 5, 1]
    assert sampling.of_keyframes(both, [1, 5, 9]).keyframes.tolist() == [5, 1]
    assert [len(samples.keyframes) for samples in others] == [0, 0, 0]
