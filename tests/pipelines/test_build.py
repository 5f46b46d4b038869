"""Algorithm 1 on a simulated flat: from sweeps to a finished map."""

from __future__ import annotations

import gc
import json
import weakref
from collections.abc import Iterator

import networkx as nx
import numpy as np
import pytest

from specmap_cli.core.config import Config, load_config
from specmap_cli.core.errors import NoResultError
from specmap_cli.core.geometry import Pose2
from specmap_cli.core.progress import Silent
from specmap_cli.core.records import PlanarScan, Sweep
from specmap_cli.evaluation.rooms import map_scores
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.pipelines import finishing
from specmap_cli.pipelines.finishing import FinishedMap, finish_map
from specmap_cli.pipelines.mapper import Mapper
from specmap_cli.simulation.worlds import RoomTruth

Tour = list[tuple[Sweep, Pose2]]


@pytest.fixture(scope="module")
def tour(flat_tour: Tour) -> Tour:
    return flat_tour


@pytest.fixture(scope="module")
def store() -> Iterator[KeyframeStore]:
    with KeyframeStore() as keyframes:
        yield keyframes


@pytest.fixture(scope="module")
def mapper(tour: Tour, store: KeyframeStore) -> Mapper:
    mapper = Mapper(Config(), store)
    for sweep, _ in tour:
        mapper.add(sweep)
    mapper.finish()
    return mapper


@pytest.fixture(scope="module")
def finished(mapper: Mapper) -> FinishedMap:
    return finish_map(mapper, Silent())


def test_every_scan_has_a_pose_and_every_keyframe_a_region(
    mapper: Mapper, store: KeyframeStore, tour: Tour
) -> None:
    assert len(mapper.trajectory) == len(tour)
    assert sorted(k for ks in mapper.regions.values() for k in ks) == list(range(len(store)))
    assert (mapper.labels() >= 0).all()


def test_the_map_is_connected_and_its_rooms_are_the_flat_s(
    finished: FinishedMap, store: KeyframeStore, tour: Tour, flat_rooms: RoomTruth
) -> None:
    graph = nx.Graph(list(finished.topology.edges))
    graph.add_nodes_from(finished.topology.submaps)
    assert nx.is_connected(graph)
    true = {sweep.stamp_ns: pose for sweep, pose in tour}
    places = np.array([true[stamp] for stamp in store.stamps_ns])
    scores = map_scores(flat_rooms, places, finished.labels.submaps)
    assert scores.whole == 1.0
    assert scores.found == scores.doors
    assert scores.invented == 0
    assert scores.purity > 0.9


def test_ids_follow_the_first_visits_and_grids_hold_the_places_driven(
    finished: FinishedMap,
) -> None:
    labels = finished.labels.submaps
    first = [int(np.argmax(labels == id_)) for id_ in sorted(finished.topology.submaps)]
    assert first == sorted(first)
    assert sorted(finished.topology.submaps) == list(range(len(first)))
    for id_, submap in finished.topology.submaps.items():
        poses = finished.labels.poses[labels == id_]
        inside = submap.map_from_submap.inverse().apply(poses[:, :2])
        assert (submap.grid.values_at(inside) == 0).mean() > 0.99


def test_there_is_a_classifier_for_every_submap(finished: FinishedMap) -> None:
    document = json.loads(finished.classifiers)
    assert set(map(int, document["raw"]["classifiers"])) == set(finished.topology.submaps)


def test_held_out_scans_are_in_neither_map_nor_regions(tour: Tour) -> None:
    with KeyframeStore() as store, KeyframeStore() as held_out:
        mapper = Mapper(Config(), store, hold_out=lambda k: k % 5 == 4, held_out=held_out)
        for sweep, _ in tour[:300]:
            mapper.add(sweep)
        mapper.finish()
        assert len(mapper.trajectory) == 300
        assert not set(store.stamps_ns) & set(held_out.stamps_ns)
        assert len(held_out) == (len(store) + len(held_out)) // 5
        assert sum(map(len, mapper.regions.values())) == len(store)


def test_scans_are_not_kept_in_memory(tour: Tour) -> None:
    """Of the scans that went in, only those of the front end's window may be alive."""
    taken: list[weakref.ref[np.ndarray]] = []
    with KeyframeStore() as store:
        mapper = Mapper(Config(), store)
        for sweep, _ in tour:
            ranges = sweep.planar.ranges.copy()
            taken.append(weakref.ref(ranges))
            planar = sweep.planar
            scan = PlanarScan(
                planar.stamp_ns, planar.bearings, ranges, planar.range_max, planar.full_circle
            )
            odometry = sweep.odom_from_base
            mapper.add(Sweep(sweep.index, sweep.stamp_ns, scan, sweep.base_from_laser, odometry))
        del scan, ranges
        gc.collect()
        assert len(store) > 200
        assert sum(ref() is not None for ref in taken) < 60


def test_a_log_without_a_usable_scan_gives_no_map(tour: Tour) -> None:
    blank = np.full_like(tour[0][0].planar.ranges, np.nan)
    with KeyframeStore() as store:
        mapper = Mapper(Config(), store)
        for sweep, _ in tour[:20]:
            planar = sweep.planar
            scan = PlanarScan(sweep.stamp_ns, planar.bearings, blank, planar.range_max, False)
            mapper.add(Sweep(sweep.index, sweep.stamp_ns, scan, sweep.base_from_laser))
        mapper.finish()
        with pytest.raises(NoResultError, match="nothing to map"):
            finish_map(mapper, Silent())


@pytest.mark.parametrize("settings", [{"relaxation": {"enabled": False}}, {}], ids=["raw", "paper"])
def test_without_a_consistent_layout_the_online_submaps_stay(
    tour: Tour, settings: dict[str, dict[str, bool]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delattr(finishing, "regions_of")
    config = load_config(None, None if settings else "paper", settings)
    with KeyframeStore() as store:
        mapper = Mapper(config, store)
        for sweep, _ in tour[:400]:
            mapper.add(sweep)
        mapper.finish()
        finished = finish_map(mapper, Silent())
        assert len(finished.topology.submaps) <= len(mapper.regions)
        joined = np.column_stack([mapper.labels(), finished.labels.submaps])
        commonest = np.unique(joined, axis=0, return_counts=True)[1].max()
        assert commonest >= np.bincount(mapper.labels()).max()
