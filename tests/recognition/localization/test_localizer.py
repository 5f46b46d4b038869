"""Localisation: training from a map's keyframes, then another tour of the same rooms."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import pytest

from specmap_cli.core.config import Config, load_config
from specmap_cli.core.errors import InputError
from specmap_cli.core.geometry import IDENTITY, Pose2, compose, invert
from specmap_cli.core.records import PlanarScan, PosedScan
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.grids.keyframes import KeyframeStore, integrate_keyframes
from specmap_cli.pipelines.simulate import SimulationOptions, simulate_sweeps
from specmap_cli.recognition.features.virtual import (
    RecentScans,
    cast_circles,
    circle,
    nearest_returns,
)
from specmap_cli.recognition.learning.classifiers import ClassifierSet, Sensor
from specmap_cli.recognition.learning.training import train_localizer
from specmap_cli.recognition.localization.localizer import BeamSampler, Localizer
from specmap_cli.recognition.localization.metric import MetricTracker

CONFIG = load_config(
    overrides={"recognition": {"rounds": 60}, "localization": {"augmentation": 120}}
)
ADJACENCY = {1: [4], 2: [4], 3: [4], 4: [1, 2, 3]}


def posed_tour(plan: GridMap, seed: int, **options: Any) -> list[PosedScan]:
    """Scans of a tour at their true poses."""
    chosen = SimulationOptions(
        **({"field_of_view_deg": 360, "beams": 180, "range_max_m": 12, "rate_hz": 2} | options),
        seed=seed,
    )
    return [
        PosedScan(s.index, s.stamp_ns, pose, s.planar, s.base_from_laser)
        for s, pose in simulate_sweeps(plan, chosen)
    ]


class Trained(NamedTuple):
    classifiers: ClassifierSet
    grids: dict[int, GridMap]
    frames: dict[int, Pose2]


def train(tour: list[PosedScan], labels: np.ndarray[Any, Any], config: Config) -> Trained:
    """Classifiers of the rooms that a tour went through."""
    with KeyframeStore() as store:
        for scan in tour:
            store.append(scan)
        submaps = {int(i): np.flatnonzero(labels == i).tolist() for i in np.unique(labels) if i}
        grids, frames = {}, {}
        for i, numbers in submaps.items():
            frames[i] = store.pose(numbers[0])
            track = compose(invert(store.poses[numbers[0]]), store.poses[numbers])
            grids[i] = integrate_keyframes(store, numbers, track, config.grid).snapshot()
        rng = np.random.default_rng(0)
        classifiers = train_localizer(store, submaps, store.poses, grids, config, rng)
    return Trained(classifiers, grids, frames)


@pytest.fixture(scope="module")
def tour(flat: GridMap) -> list[PosedScan]:
    return posed_tour(flat, 1)


@pytest.fixture(scope="module")
def again(flat: GridMap) -> list[PosedScan]:
    return posed_tour(flat, 7, spacing_m=1.5)


def rooms_of(flat_rooms: Any, scans: list[PosedScan]) -> np.ndarray[Any, Any]:
    return np.asarray(flat_rooms.at(np.array([s.map_from_base for s in scans])))


@pytest.fixture(scope="module")
def trained(tour: list[PosedScan], flat_rooms: Any) -> Trained:
    return train(tour, rooms_of(flat_rooms, tour), CONFIG)


def localizer(trained: Trained, config: Config = CONFIG) -> Localizer:
    return Localizer(trained.classifiers, ADJACENCY, trained.grids, config.localization)


def test_another_tour_is_labelled_with_its_rooms(
    trained: Trained, again: list[PosedScan], flat_rooms: Any
) -> None:
    truth = rooms_of(flat_rooms, again)
    guide = localizer(trained)
    labels = [guide.update(scan) for scan in again]
    raw = np.mean([a.submap == b for a, b in zip(labels, truth, strict=True)])
    filtered = np.mean([a.filtered_submap == b for a, b in zip(labels, truth, strict=True)])
    smoothed = np.mean(
        [a.filtered_submap == b for a, b in zip(guide.smoothed(), truth, strict=True)]
    )
    assert raw > 0.8
    assert filtered > 0.85
    assert smoothed > 0.85
    assert guide.note == ""
    for label, scan in zip(labels, again, strict=True):
        assert label.stamp_ns == scan.stamp_ns
        assert label.runner_up != label.submap
        assert 0.0 < label.filtered_probability <= 1.0


def test_the_file_localises_as_well(trained: Trained, again: list[PosedScan]) -> None:
    direct = localizer(trained)
    read = localizer(
        trained._replace(classifiers=ClassifierSet.from_json(trained.classifiers.to_json()))
    )
    for scan in again[:40]:
        a, b = direct.update(scan), read.update(scan)
        assert (a.submap, a.filtered_submap) == (b.submap, b.filtered_submap)


def test_scans_of_another_place_are_unknown(trained: Trained, building: Any) -> None:
    guide = localizer(trained)
    labels = []
    for room in (1, 2):
        poses = building.path(room, 5)
        for k, (pose, scan) in enumerate(zip(poses, building.scans(poses), strict=True)):
            at = Pose2(*pose.tolist())
            labels.append(guide.update(PosedScan(k, k, at, scan, IDENTITY, restarted=k == 0)))
    assert np.mean([label.submap is None for label in labels]) > 0.6
    assert np.mean([label.filtered_submap is None for label in labels]) > 0.8


def test_unknown_can_be_switched_off(trained: Trained, building: Any) -> None:
    config = load_config(overrides={"localization": {"unknown": False}})
    guide = localizer(trained, config)
    poses = building.path(2, 5)
    for k, (pose, scan) in enumerate(zip(poses, building.scans(poses), strict=True)):
        label = guide.update(PosedScan(k, k, Pose2(*pose.tolist()), scan, IDENTITY))
        assert label.submap is not None
        assert label.filtered_submap is not None


def test_a_map_of_one_submap(tour: list[PosedScan]) -> None:
    for preset in ("default", "paper"):
        rounds = {"recognition": {"rounds": 10}, "localization": {"augmentation": 60}}
        config = load_config(preset=preset, overrides=rounds)
        single = train(tour[:60], np.full(60, 3), config)
        guide = Localizer(single.classifiers, {3: []}, single.grids, config.localization)
        labels = [guide.update(scan) for scan in tour[:60]]
        assert np.mean([label.filtered_submap == 3 for label in labels]) > 0.8
        assert all(label.runner_up is None for label in labels)


def test_a_narrower_laser_is_refused_in_one_line(trained: Trained, flat: GridMap) -> None:
    narrow = posed_tour(flat, 1, field_of_view_deg=180, beams=90, max_duration_s=1.0)[0]
    with pytest.raises(InputError, match="90 beams over 1") as error:
        localizer(trained).update(narrow)
    assert "\n" not in str(error.value)


def test_a_finer_laser_is_resampled_and_said(
    trained: Trained, flat: GridMap, flat_rooms: Any
) -> None:
    fine = posed_tour(flat, 3, beams=720, range_max_m=30, max_duration_s=25.0)
    guide = localizer(trained)
    labels = [guide.update(scan) for scan in fine]
    assert "720 beams" in guide.note
    truth = rooms_of(flat_rooms, fine)
    right = [a.filtered_submap == b for a, b in zip(labels, truth, strict=True)]
    assert np.mean(right) > 0.8


def test_resampling_takes_the_nearest_beam() -> None:
    known = Sensor(5, math.pi, 10.0, False)
    bearings = np.linspace(-math.pi, math.pi, 360, endpoint=False)
    scan = PlanarScan(4, bearings, 9.0 + bearings, 30.0, True)
    sampled = BeamSampler(Sensor.of(scan), known).apply(scan)
    assert sampled.bearings == pytest.approx(np.linspace(-math.pi / 2, math.pi / 2, 5))
    assert sampled.ranges[:3] == pytest.approx(9.0 + sampled.bearings[:3], abs=0.01)
    assert (sampled.ranges[4:] == np.inf).all()


def test_the_pose_within_the_submap_is_found_and_followed(
    trained: Trained, again: list[PosedScan], flat_rooms: Any
) -> None:
    tracker = MetricTracker(trained.grids)
    rooms = rooms_of(flat_rooms, again)
    close = []
    for scan, room in list(zip(again, rooms.tolist(), strict=True))[:60]:
        match = tracker.locate(scan, room)
        truth = trained.frames[room].inverse() @ scan.map_from_base
        error = truth.inverse() @ match.pose
        close.append(error.distance < 0.1 and abs(error.theta) < 0.05 and match.score > 0.5)
    assert np.mean(close) > 0.85


def test_a_virtual_scan_is_what_the_grid_shows(flat: GridMap) -> None:
    origin = np.array([[1.6, 4.0]])
    cast = cast_circles(flat, origin, 90, 12.0)[0]
    rows, columns = np.nonzero(flat.occupied)
    walls = flat.centres_of(np.column_stack([rows, columns]))
    seen = nearest_returns(walls - origin, 90, 12.0)
    assert seen.bearings == pytest.approx(circle(90))
    assert np.median(np.abs(seen.ranges - cast.ranges)) < 0.06


def test_recent_scans_forget_what_lies_a_window_back() -> None:
    recent = RecentScans(2.0, 36, 10.0)
    assert np.isinf(recent.scan(0, IDENTITY).ranges).all()
    for k in range(30):
        recent.add_points(np.array([[0.0, 1.0]]), Pose2(0.25 * k, 0.0, 0.0), IDENTITY)
    assert recent.filled == 1.0
    here = recent.scan(0, Pose2(0.25 * 29, 0.0, 0.0))
    assert here.ranges.min() == pytest.approx(1.0)
    assert np.isinf(recent.scan(0, Pose2(-20.0, 0.0, 0.0)).ranges).all()
    recent.clear()
    assert recent.filled == 0.0
