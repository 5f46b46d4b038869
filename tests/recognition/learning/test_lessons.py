"""TrainingData of a map: kept for the keyframes that are left, and learned from again."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from specmap_cli.core.settings import Config, LocalizationConfig, RecognitionConfig
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.grids.keyframes import KeyframeStore, integrate_keyframes
from specmap_cli.recognition.features.sets import KeyframeFeatures
from specmap_cli.recognition.learning.sampling import (
    NO_TRAINING_DATA,
    Samples,
    TrainingData,
    cast_samples,
    of_keyframes,
    raw_samples,
    together,
    track_samples,
)
from tests.recognition.posed import stored

SUBMAPS = {0: list(range(20)), 3: list(range(20, 60))}
STARTS = (40,)
VIRTUAL = LocalizationConfig(track_samples=30, augmentation=24, feature_set="table1")


def numbered(*keyframes: int) -> Samples:
    """Samples whose only feature is a hundred and the keyframe."""
    numbers = np.array(keyframes, dtype=np.intp)
    return Samples(100.0 + numbers[:, None].astype(np.float64), numbers)


@pytest.fixture(scope="module")
def store(building: Any) -> Iterator[KeyframeStore]:
    """Sixty keyframes in three rooms of the building."""
    poses = np.vstack([building.path(room, 1)[:20] for room in (0, 1, 2)])
    with stored(building.scans(poses), poses) as made:
        yield made


@pytest.fixture(scope="module")
def grids(store: KeyframeStore) -> dict[int, GridMap]:
    """The grids of both submaps, in the frame of the map, and so with a first pose of zero."""
    return {
        i: integrate_keyframes(store, own, store.poses[own], Config().grid).snapshot()
        for i, own in SUBMAPS.items()
    }


def kept(lessons: TrainingData) -> list[list[int]]:
    """The keyframes of all four kinds of samples."""
    kinds = lessons.raw, lessons.beside, lessons.along, lessons.cast
    return [samples.keyframes.tolist() for samples in kinds]


def test_lessons_of_keyframes_that_are_gone_are_gone() -> None:
    lessons = TrainingData(numbered(0, 3, 7), numbered(0, 7), numbered(3), numbered(0, 7, 7))
    left = lessons.left(np.array([1, 3, 7]))
    assert kept(left) == [[1, 2], [2], [1], [2, 2]]
    assert left.raw.features.ravel().tolist() == [103.0, 107.0]
    assert kept(NO_TRAINING_DATA.left(np.array([0]))) == [[]] * 4
    near = lessons.cast_near(np.arange(8) == 7)  # of cast samples those near some keyframes stay
    assert kept(near) == [[0, 3, 7], [0, 7], [3], [7, 7]]


def test_lessons_of_several_maps_are_one() -> None:
    one = TrainingData(numbered(0, 1), numbered(0), numbered(1), numbered())
    both = TrainingData.joined([one, NO_TRAINING_DATA, one.numbered_from(10)])
    assert kept(both) == [[0, 1, 10, 11], [0, 10], [1, 11], []]
    assert both.raw.features.ravel().tolist() == [100.0, 101.0, 100.0, 101.0]


def test_each_recording_gives_its_share_of_raw_scans_the_known_ones_first(
    store: KeyframeStore,
) -> None:
    config = Config(recognition=RecognitionConfig(positives=10, feature_set="table1"))
    nothing, numbers = KeyframeFeatures(store, "table1"), np.arange(20, 40)
    known = nothing.knowing(numbers, np.ones((20, 52)))
    found = raw_samples({3: SUBMAPS[3]}, config, known, STARTS)[3]
    old = found.keyframes < STARTS[0]
    assert int(old.sum()) == 5
    assert (found.features[old] == 1.0).all()
    assert not (found.features[~old] == 1.0).all(axis=1).any()
    known = nothing.knowing(numbers, np.ones((20, 52)))
    alone = raw_samples({3: SUBMAPS[3]}, config, known)[3]
    assert (alone.keyframes < STARTS[0]).all()  # of one recording the known ones are enough


def test_a_recording_whose_virtual_scans_are_known_is_not_looked_at_again(
    store: KeyframeStore,
) -> None:
    anew = track_samples(store, SUBMAPS, store.poses, VIRTUAL, starts=STARTS)
    before = Samples(np.ones((25, 52)), np.arange(10, 35))
    again = track_samples(store, SUBMAPS, store.poses, VIRTUAL, before, STARTS)
    found, fresh = together(again.values()), together(anew.values())
    old = found.keyframes < STARTS[0]
    assert int(old.sum()) == 20  # two thirds of thirty
    assert set(found.keyframes[old].tolist()) <= set(range(10, 35))
    assert (found.features[old] == 1.0).all()
    late = fresh.keyframes >= STARTS[0]
    assert np.array_equal(found.features[~old], fresh.features[late])


def test_submaps_with_known_cast_scans_are_not_cast_again(
    store: KeyframeStore, grids: dict[int, GridMap]
) -> None:
    poses = store.poses.copy()
    poses[[20, 0]] = 0.0  # the frames of the submaps are that of the map
    known = Samples(np.ones((40, 52)), np.full(40, 25))
    rng = np.random.default_rng(0)
    found = cast_samples(SUBMAPS, poses, grids, VIRTUAL, rng, known)
    assert (found[3].features == 1.0).all()
    assert 0 < len(found[3].features) < 24
    assert not (found[0].features == 1.0).all(axis=1).any()


def test_samples_are_put_together_by_submap() -> None:
    both, *others = TrainingData.of({4: numbered(1), 2: numbered(0, 5)}, {}, {}, {}).kinds
    assert both.keyframes.tolist() == [0, 5, 1]
    assert of_keyframes(both, [1, 5, 9]).keyframes.tolist() == [5, 1]
    assert [len(samples.keyframes) for samples in others] == [0, 0, 0]
