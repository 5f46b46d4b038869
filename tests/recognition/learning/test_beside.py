"""Scans as the laser would have taken them just beside its way."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from specmap_cli.core.config import load_config
from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.settings import Config
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.recognition.features.virtual import seen_from
from specmap_cli.recognition.learning import sampling
from specmap_cli.recognition.learning.sampling import augmented_samples, together
from tests.recognition.posed import stored

Seen = list[tuple[FloatArray, float, Pose2, FloatArray]]
SUBMAPS = {1: list(range(0, 30)), 4: list(range(32, 38))}  # keyframes 30 and 31 are in none


def settings(augmentation: int) -> Config:
    chosen = {"feature_set": "table1", "augmentation": augmentation}
    return load_config(overrides={"recognition": chosen})


@pytest.fixture(scope="module")
def store(building: Any) -> Iterator[KeyframeStore]:
    """Keyframes on the way through a room of the building."""
    poses = building.path(0, 1)[:38]
    with stored(building.scans(poses), poses) as made:
        yield made


@pytest.fixture
def seen(monkeypatch: pytest.MonkeyPatch) -> Seen:
    """How far, from where what was seen: bearings, reach, pose and ranges of every scan."""
    calls: Seen = []

    def watched(lines: FloatArray, pose: Pose2, bearings: FloatArray, reach_m: float) -> FloatArray:
        ranges = seen_from(lines, pose, bearings, reach_m)
        calls.append((bearings, reach_m, pose, ranges))
        return ranges

    monkeypatch.setattr(sampling, "seen_from", watched)
    return calls


def test_a_submap_gets_the_scans_that_it_lacks(store: KeyframeStore) -> None:
    rng = np.random.default_rng(0)
    found = augmented_samples(store, SUBMAPS, store.poses, settings(90), rng)
    # of 30 and 6 keyframes; what comes to lie in the other submap is left out
    assert 0.85 * 60 < len(found[1].keyframes) <= 60
    assert 0.5 * 84 < len(found[4].keyframes) <= 84
    assert all(set(own.keyframes) <= set(SUBMAPS[i]) for i, own in found.items())
    assert all(own.features.shape[0] == len(own.keyframes) for own in found.values())
    enough = augmented_samples(store, SUBMAPS, store.poses, settings(30), rng)
    assert not len(enough[1].keyframes)
    assert len(enough[4].keyframes)


def test_they_lie_a_step_aside_and_look_as_scans_taken_there(
    store: KeyframeStore, seen: Seen, building: Any
) -> None:
    rng = np.random.default_rng(1)
    found = augmented_samples(store, SUBMAPS, store.poses, settings(60), rng)
    assert len(seen) == sum(len(own.keyframes) for own in found.values())
    keyframes = np.concatenate([found[i].keyframes for i in sorted(found)])
    poses = np.array([pose for *_, pose, _ in seen])
    laser = store.scan(3)
    assert all(b.tolist() == laser.bearings.tolist() and r == laser.range_max for b, r, *_ in seen)
    away = np.hypot(*(poses - store.poses[keyframes])[:, :2].T)
    assert 0.02 < np.median(away) < 0.2
    off = []
    for scan, (*_, ranges) in zip(building.scans(poses), seen, strict=True):
        both = np.isfinite(scan.ranges) & np.isfinite(ranges)
        assert both.sum() > 0.8 * np.isfinite(scan.ranges).sum()
        off.append(np.median(np.abs(scan.ranges - ranges)[both]))
    assert np.median(off) < 0.03


def test_a_map_of_one_keyframe_is_seen_from_beside_it(store: KeyframeStore) -> None:
    found = augmented_samples(store, {0: [7]}, store.poses, settings(6), np.random.default_rng(0))
    assert found[0].keyframes.tolist() == [7] * 5


def test_those_that_are_known_are_not_made_again(store: KeyframeStore, seen: Seen) -> None:
    first = augmented_samples(store, SUBMAPS, store.poses, settings(90), np.random.default_rng(0))
    made, known = len(seen), together(first.values())
    again = augmented_samples(
        store, SUBMAPS, store.poses, settings(40), np.random.default_rng(1), known
    )
    assert len(seen) == made > 40
    assert [len(again[i].keyframes) for i in (1, 4)] == [10, 34]
    of_first = {row.tobytes() for row in known.features}
    assert all(row.tobytes() in of_first for own in again.values() for row in own.features)


def test_they_are_the_same_for_a_seed_and_differ_for_another(store: KeyframeStore) -> None:
    first, again, other = (
        augmented_samples(store, SUBMAPS, store.poses, settings(50), np.random.default_rng(seed))
        for seed in (3, 3, 4)
    )
    assert first[1].features.tolist() == again[1].features.tolist()
    assert first[1].features.tolist() != other[1].features.tolist()
