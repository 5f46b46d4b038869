"""Algorithm 1 and what follows it, on a simulated flat, and stages of a build by themselves."""

import gc
import itertools
import math
import time
import weakref
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from unittest.mock import Mock, call

import networkx as nx
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.scores import map_scores
from specmap_cli import build_map, read_map
from specmap_cli.core.config import load_config
from specmap_cli.core.errors import NoResultError, UsageError
from specmap_cli.core.geometry import IDENTITY, Pose2, wrap_angles
from specmap_cli.core.records import PlanarScan, PosedScan, Sweep, Trajectory
from specmap_cli.core.settings import Config
from specmap_cli.core.worker import Ahead
from specmap_cli.grids.keyframes import KeyframeSelector, KeyframeStore
from specmap_cli.layout.passes import METRES_A_RADIAN
from specmap_cli.layout.path_graph import chosen_nodes
from specmap_cli.layout.relaxation import relax
from specmap_cli.layout.result import along_walls
from specmap_cli.logs.opening import open_log
from specmap_cli.logs.stream import SweepStream
from specmap_cli.logs.writer import LogWriter
from specmap_cli.maps.store import Map
from specmap_cli.pipelines import exploration as module
from specmap_cli.pipelines import laying_out
from specmap_cli.pipelines.build import explore
from specmap_cli.pipelines.exploration import Exploration, online_labels
from specmap_cli.pipelines.finishing import finish
from specmap_cli.pipelines.laying_out import REFUTED, constraints_of, lay_out, nearest_pair, refute
from specmap_cli.pipelines.learning import Prior
from specmap_cli.pipelines.map_in_making import Explored, FinishedMap, laid_out_of_stored
from specmap_cli.pipelines.session import Session, Stopwatch
from specmap_cli.pipelines.simulate import SimulationResult
from specmap_cli.pipelines.tracking import Tracking, TrajectoryRecorder, track
from specmap_cli.registration.frontend import FrontEnd
from specmap_cli.segmentation.online import Region
from specmap_cli.simulation.worlds import RoomTruth
from tests.casting import keyframe
from tests.flats import QUICK, Explained
from tests.house import closure

Tour = list[tuple[Sweep, Pose2]]
TRACKED = Tracking(counts={}, warnings=(), seconds=0.0)


@dataclass(frozen=True)
class Finished:
    scans: Sequence[PosedScan]
    store: KeyframeStore
    explored: Explored
    finished: FinishedMap


def registered(sweeps: Iterator[Sweep]) -> Iterator[PosedScan]:
    return map(FrontEnd(Config().registration).register, sweeps)


def explored_by(
    scans: Iterator[PosedScan],
    store: KeyframeStore,
    config: Config,
    accepts: Callable[[PosedScan], bool] | None = None,
) -> Explored:
    accepts = accepts or KeyframeSelector(config.keyframes).accepts
    return explore(scans, Exploration(Session(config, store)), accepts)


def finished_by(explored: Explored, store: KeyframeStore, config: Config) -> FinishedMap:
    session = Session(config, store)
    laid = lay_out(session, explored, TRACKED, "flat.mcap")
    return finish(session, laid, Prior(explored.features))


@pytest.fixture(scope="module")
def flat_done(flat_tour: Tour) -> Iterator[Finished]:
    scans = list(registered(sweep for sweep, _ in flat_tour))
    with KeyframeStore() as store:
        explored = explored_by(iter(scans), store, QUICK)
        yield Finished(scans, store, explored, finished_by(explored, store, QUICK))


def test_every_scan_has_a_pose_and_every_keyframe_a_region(flat_done: Finished) -> None:
    explored, store = flat_done.explored, flat_done.store
    assert len(explored.trajectory.stamps_ns) == len(flat_done.scans)
    assert sorted(k for ks in explored.regions.values() for k in ks) == list(range(len(store)))
    labels = online_labels(explored.regions, explored.closures, len(store))
    assert (labels >= 0).all()
    assert set(labels.tolist()) <= set(explored.regions)


def test_the_map_is_connected_and_its_rooms_are_the_flat_s(
    flat_done: Finished, flat_tour: Tour, flat_rooms: RoomTruth
) -> None:
    finished = flat_done.finished
    graph = nx.Graph(list(finished.topology.edges))
    graph.add_nodes_from(finished.topology.submaps)
    assert nx.is_connected(graph)
    true = {sweep.stamp_ns: pose for sweep, pose in flat_tour}
    places = np.array([true[stamp] for stamp in flat_done.store.stamps_ns])
    scores = map_scores(flat_rooms, places, finished.laid.labels.submaps)
    assert scores.whole == 1.0
    assert scores.found == scores.doors
    assert scores.invented == 0
    assert scores.purity > 0.9


def test_ids_follow_the_first_visits_and_grids_hold_the_places_driven(flat_done: Finished) -> None:
    finished, keyframes = flat_done.finished, flat_done.finished.laid.labels
    labels = keyframes.submaps
    first = [int(np.argmax(labels == id_)) for id_ in sorted(finished.topology.submaps)]
    assert first == sorted(first)
    assert sorted(finished.topology.submaps) == list(range(len(first)))
    assert finished.classifiers.ids == sorted(finished.topology.submaps)
    for id_, submap in finished.topology.submaps.items():
        inside = submap.map_from_submap.inverse().apply(keyframes.poses[labels == id_][:, :2])
        assert (submap.grid.values_at(inside) == 0).mean() > 0.99


def test_a_map_can_be_laid_out_again_from_its_directory_alone(
    flat_map: Map, flat_log: SimulationResult
) -> None:
    """Keyframes, stays, closures and breaks say all that the layout was made of.

    But for what odometry was worth, which only its log tells: that is some millimetres.
    """
    topology, config = flat_map.topology, Config().relaxation
    assert any(closure.merged for closure in topology.closures)
    with open_log([flat_log.log]) as log:
        scans = list(track(SweepStream(log, Config().log), Config().registration))
    kept = set(flat_map.labels.stamps_ns.tolist())
    worth = [scan.odometry_slacks for scan in scans if scan.stamp_ns in kept]
    with flat_map.scans() as alone, KeyframeStore() as known:
        for number, slacks in enumerate(worth):
            known.append(replace(alone.posed(number), odometry_slacks=slacks))
        regions = laid_out_of_stored(flat_map).stays
        assert all(regions[stay.number][0] == stay.origin for stay in topology.stays)
        assert sorted(k for ks in regions.values() for k in ks) == list(range(len(known)))
        for store, within_m in ((known, 0.001), (alone, 0.005)):
            nodes = chosen_nodes(store.poses, ())
            constraints = constraints_of(topology.closures, regions, store, nodes)
            layout = relax(store, tuple(constraints.values()), {}, config)
            layout = along_walls(layout, store, config)
            off = np.abs(layout.poses[:, :2] - flat_map.labels.poses[:, :2])
            assert off.max() < within_m


def test_to_finish_changes_nothing_of_what_was_explored(flat_done: Finished) -> None:
    """The same exploration gives the same map again: stages hand on values."""
    again = finished_by(flat_done.explored, flat_done.store, QUICK)
    assert again.laid.labels.submaps.tolist() == flat_done.finished.laid.labels.submaps.tolist()
    assert again.classifiers.to_json() == flat_done.finished.classifiers.to_json()


def test_the_links_that_are_too_narrow_for_the_robot_are_told(flat_done: Finished) -> None:
    ways = QUICK.ways.model_copy(update={"robot_radius_m": 0.7})
    wide = QUICK.model_copy(update={"ways": ways})
    found = finished_by(flat_done.explored, flat_done.store, wide)
    (finding,) = (one for one in found.quality.findings if one.code == "too-narrow")
    edges = found.topology.edges
    narrow = {pair: edge.clearance_m for pair, edge in edges.items() if edge.path is None}
    fits = [f"{one}-{other} ({fits_m:.2f} m fits)" for (one, other), fits_m in narrow.items()]
    assert finding.message.endswith(f" 0.7 m radius: {', '.join(fits)}")


def test_keyframes_are_those_that_are_accepted(flat_done: Finished) -> None:
    """As the evaluation's hold-out does it: the rest is registered, and enters nothing else."""
    selector, turns = KeyframeSelector(QUICK.keyframes), itertools.cycle([False] * 4 + [True])
    with KeyframeStore() as store, KeyframeStore() as held_out:

        def accepts(scan: PosedScan) -> bool:
            if not selector.accepts(scan):
                return False
            if held := next(turns):
                held_out.append(scan)
            return not held

        explored = explored_by(iter(flat_done.scans[:200]), store, QUICK, accepts)
        assert len(explored.trajectory.stamps_ns) == 200
        assert not set(store.stamps_ns) & set(held_out.stamps_ns)
        assert len(held_out) == (len(store) + len(held_out)) // 5
        assert sum(map(len, explored.regions.values())) == len(store)


def test_scans_are_not_kept_in_memory(flat_tour: Tour) -> None:
    """Of the scans that went in, only those of the front end's window may be alive."""
    taken: list[weakref.ref[np.ndarray]] = []

    def sweeps() -> Iterator[Sweep]:
        for sweep, _ in flat_tour[:250]:
            ranges = sweep.planar.ranges.copy()
            taken.append(weakref.ref(ranges))
            yield replace(sweep, planar=replace(sweep.planar, ranges=ranges))

    with KeyframeStore() as store:
        explored_by(registered(sweeps()), store, QUICK)
        gc.collect()
        assert len(store) > 200
        assert sum(ref() is not None for ref in taken) < 60


@pytest.mark.parametrize("settings", [{"relaxation": {"enabled": False}}, {}], ids=["raw", "paper"])
def test_without_a_consistent_layout_the_online_submaps_stay(
    flat_done: Finished, settings: dict[str, dict[str, bool]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delattr(laying_out, "segment")
    little = {"recognition": {"rounds": 4}, "localization": {"augmentation": 20}}
    config = load_config(None, None if settings else "paper", {**little, **settings})
    with KeyframeStore() as store:
        explored = explored_by(iter(flat_done.scans[:250]), store, config)
        finished = finished_by(explored, store, config)
        online = online_labels(explored.regions, explored.closures, len(store))
        assert len(finished.topology.submaps) <= len(explored.regions)
        joined = np.column_stack([online, finished.laid.labels.submaps])
        assert np.unique(joined, axis=0, return_counts=True)[1].max() >= np.bincount(online).max()


def test_where_tracking_starts_afresh_a_new_submap_begins(flat_done: Finished) -> None:
    scans = [replace(s, restarted=k == 90) for k, s in enumerate(flat_done.scans[:180])]
    with KeyframeStore() as store:
        explored = explored_by(iter(scans), store, QUICK)
        (first,) = explored.breaks
        assert store.stamps_ns[first] == scans[90].stamp_ns
        assert all(min(ks) >= first or max(ks) < first for ks in explored.regions.values())
        quality = finished_by(explored, store, QUICK).quality
        (broken,) = (one for one in quality.findings if one.code == "tracking-break")
        assert f"before {scans[90].stamp_ns * 1e-9:.3f} s" in broken.message
        assert broken.where is not None
        assert broken.where.stamp_ns == scans[90].stamp_ns


def test_a_merge_that_the_layout_drops_is_taken_back(flat_done: Finished) -> None:
    """A closure that puts two far places on each other goes; the others stay as they were."""
    explored, store = flat_done.explored, flat_done.store
    merged = [closure for closure in explored.closures if closure.merged]
    assert merged
    wrong = replace(merged[0], old_from_new=Pose2(25.0, 25.0, 1.0))
    closures = tuple(wrong if c is merged[0] else c for c in explored.closures)
    constraints = constraints_of(closures, explored.regions, store, chosen_nodes(store.poses, ()))
    assert set(constraints) == {(c.old, c.new) for c in merged}
    finished = finished_by(replace(explored, closures=closures), store, QUICK)
    kept = refute(closures, constraints, finished.laid.layout)
    (reason,) = {c.reason for c in kept} - {c.reason for c in closures}
    assert reason.startswith(f"{REFUTED}: ")
    for before, after in zip(closures, kept, strict=True):
        if before is wrong:
            assert (after.merged, after.verified, after.old_from_new) == (False, False, None)
        else:
            assert after is before


def test_constraints_hold_between_the_nearest_keyframes_of_regions(flat_done: Finished) -> None:
    """Or between the nodes before these, from where the same is said of them."""
    explored, store = flat_done.explored, flat_done.store
    closures, regions = explored.closures, explored.regions
    of_all = constraints_of(closures, regions, store, np.arange(len(store)))
    nodes = chosen_nodes(store.poses, ())
    for pair, constraint in constraints_of(closures, regions, store, nodes).items():
        nearest = of_all[pair]
        for end in ("source", "target"):
            before = [number for number in nodes.tolist() if number <= getattr(nearest, end)]
            assert getattr(constraint, end) == max(before)
        moved = store.pose(constraint.source) @ constraint.source_from_target
        stays = store.pose(nearest.source) @ nearest.source_from_target
        there = store.pose(constraint.target).inverse() @ store.pose(nearest.target)
        assert (moved @ there).inverse() @ stays == pytest.approx(IDENTITY, abs=1e-9)
    assert of_all
    for (old, new), constraint in of_all.items():
        assert constraint.source in regions[old]
        assert constraint.target in regions[new]
        assert math.hypot(*constraint.source_from_target[:2]) < 1.0  # merged: the tracks overlap
        found = np.diag(constraint.information)
        np.testing.assert_allclose(found, [625.0, 625.0, 0.0087**-2], rtol=1e-12)


def test_what_a_build_tells_is_what_its_map_holds(flat_built: Explained) -> None:
    report, out = flat_built.report, flat_built.pictures.parent / "map"
    assert report.out == out
    stored = read_map(str(out))
    assert report.run["counts"]["submaps"] == len(stored.ids)
    assert report.run["counts"] == stored.run["counts"]
    assert stored.run["inputs"] == ["flat.mcap"]
    stages = "registration segmentation recognition layout audit grids training ways"
    assert sorted(stored.run["seconds"]) == sorted(stages.split())
    assert all(value >= 0.0 for value in stored.run["seconds"].values())
    assert report.as_dict()["out"] == str(out)
    assert report.lines()[0].startswith(f"{out}: {len(stored.ids)} submaps, ")
    assert report.lines()[1] == "quality: good"
    assert report.as_dict()["quality"] == stored.run["quality"]
    with stored.scans() as kept:  # all that a layout needs, without the log
        assert len(kept) == report.run["counts"]["keyframes"]
    assert report.run["counts"]["doors"] == len(stored.topology.doors) > 0
    for edge in stored.topology.edges.values():
        assert edge.path is not None
        ends = (stored.topology.submaps[id_].anchor for id_ in (edge.source, edge.target))
        assert edge.path[[0, -1]].tolist() == [list(anchor or ()) for anchor in ends]
    told = stored.record.graph.quality
    assert told is not None
    assert told.as_dict() == stored.run["quality"]


def test_without_a_grid_is_none_and_edits_stay(tiny_log: Path, tmp_path: Path) -> None:
    out, config = tmp_path / "map", load_config(overrides={"grid": {"max_area_m2": 0.01}})
    with pytest.raises(NoResultError, match=r"grid\.max_extent_m"):
        build_map(tiny_log, out, config)
    assert list(tmp_path.iterdir()) == []
    out.mkdir()
    (out / "topology.json").write_text('{"schema_version": 2}', encoding="utf-8")
    (out / "edits.toml").write_text('[submaps.0]\nname = "Kitchen"\n', encoding="utf-8")
    with pytest.raises(UsageError, match=r"edits\.toml holds .* --like"):
        build_map(tiny_log, out, overwrite=True)
    assert (out / "edits.toml").exists()


SECOND = 1_000_000_000
HUNG = range(12, 30)
BEARINGS = np.linspace(-np.pi, np.pi, 240, endpoint=False)


def in_a_room(x: float) -> np.ndarray:
    """Ranges to the walls of a room of 12 m by 6 m, seen from (x, 0)."""
    with np.errstate(divide="ignore"):
        across = np.where(np.cos(BEARINGS) > 0, 7.0 - x, -5.0 - x) / np.cos(BEARINGS)
        along = np.where(np.sin(BEARINGS) > 0, 3.0, -3.0) / np.sin(BEARINGS)
    return np.minimum(across, along)


def test_scans_that_a_hanging_driver_repeats_are_left_out_and_told(tmp_path: Path) -> None:
    """Of a robot that drives 3.2 m; the driver of its laser hangs for 1.8 s."""
    rng, held = np.random.default_rng(2), np.zeros(0)
    with LogWriter(tmp_path / "log.mcap") as written:
        for number in range(40):
            stamp, x = 100 * SECOND + number * SECOND // 10, 0.08 * number
            written.odometry("/odom", "odom", "base_link", stamp, Pose2(x, 0.0, 0.0))
            seen = in_a_room(x) + rng.normal(0.0, 0.01, len(BEARINGS))
            held = held if number in HUNG[1:] else seen
            step = float(BEARINGS[1] - BEARINGS[0])
            written.scan("/scan", "base_link", stamp, -np.pi, step, held, range_max=20.0)
    with open_log([tmp_path / "log.mcap"]) as log:
        tracking = Ahead(track(SweepStream(log, Config().log), Config().registration))
        scans, done = list(tracking), tracking.result
    assert [scan.index for scan in scans] == [k for k in range(40) if k not in HUNG[1:]]
    assert max([abs(scan.map_from_base.x - 0.08 * scan.index) for scan in scans]) < 0.03
    assert not any(scan.lost for scan in scans)
    assert done.counts["stale_scans"] == len(HUNG) - 1
    assert done.warnings == (
        "17 scans repeat the one before although odometry says that the robot moved, and were left "
        "out: the driver of the laser hung",
    )


@pytest.mark.parametrize("rolls", [{}, {1: (0.1, -0.2, 0.5), 3: (-0.3, 0.05, 2.0)}])
def test_tilt_is_kept_from_the_first_3d_pose(rolls: dict[int, tuple[float, float, float]]) -> None:
    """Scans before it, and planar ones between, are level; a planar trajectory has no tilt."""
    recorder = TrajectoryRecorder()
    for k in range(5):
        matrix = None
        if k in rolls:
            matrix = np.eye(4)
            matrix[:3, :3] = Rotation.from_euler("xyz", rolls[k]).as_matrix()
            matrix[:3, 3] = (k, 0.0, 0.25 * k)
        scan = PlanarScan(k, np.zeros(0), np.zeros(0), 1.0, False)
        posed = keyframe(scan, Pose2(k, 2.0 * k, 0.1 * k), IDENTITY, k)
        recorder.append(replace(posed, map_from_base_3d=matrix))
    found = recorder.trajectory()
    assert found.stamps_ns.tolist() == [0, 1, 2, 3, 4]
    assert found.poses[3].tolist() == pytest.approx([3.0, 6.0, 0.3])
    if not rolls:
        assert found.tilt is None
        return
    assert found.tilt is not None
    assert found.tilt.shape == (5, 3)
    for k, (roll, pitch, _) in rolls.items():
        assert found.tilt[k] == pytest.approx([0.25 * k, roll, pitch])
    assert np.abs(found.tilt[[0, 2, 4]]).max() == 0.0


def test_a_region_that_grew_is_compared_again_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "online_labels", Mock(return_value=np.zeros(0, dtype=np.int64)))
    monkeypatch.setattr(Exploration, "_stay", lambda self, number: list(self.regions[number]))
    with KeyframeStore() as store:
        exploration = Exploration(Session(load_config(), store))
        closer = exploration.closer = Mock()
        closer.consider.side_effect = [[], [closure(0, 1)]]
        closer.consider_again.return_value = [closure(1, 0, merged=True)]
        exploration.recognise([Region(0, (0, 1), None), Region(1, (2,), None), Region(2, (3,), 1)])
        exploration.recognise_again()
        assert closer.grow.mock_calls == [call([2, 3])]
        assert closer.consider_again.mock_calls == [call(1)]
        explored = exploration.explored(Trajectory(np.zeros(0, dtype=np.int64), np.zeros((0, 3))))
        assert explored.closures == (closure(1, 0, merged=True),)
        assert explored.regions == {0: (0, 1), 1: (2, 3)}
        closer.merge.assert_called_once_with(1, 0)


@pytest.mark.parametrize("seed", range(20))
def test_the_nearest_poses_of_two_tracks_are_those_of_all_pairs(seed: int) -> None:
    """There two tracks are tied: where they saw most alike."""
    rng = np.random.default_rng(seed)
    old, new = (rng.uniform(-3.0, 3.0, (count, 3)) for count in (40, 70))
    gaps = old[:, None] - new[None]
    apart = np.hypot(gaps[..., 0], gaps[..., 1])
    apart = apart + METRES_A_RADIAN * np.abs(wrap_angles(gaps[..., 2]))
    i, j = nearest_pair(old, new)
    assert i * len(new) + j == apart.argmin()
    row = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 3.0], [2.0, 0.0, 0.0]])
    assert nearest_pair(row, row + (0.0, 1.0, 0.0)) == (0, 0), "of those as near the first"


def test_each_stage_is_counted_once_though_it_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where each look at the clock takes a second."""
    ticks = itertools.count()
    monkeypatch.setattr(time, "perf_counter", lambda: float(next(ticks)))
    clock = Stopwatch()  # tick 0
    with clock.stage("outer"):  # tick 1
        time.perf_counter()  # tick 2: work of its own
        with clock.stage("inner"):  # tick 3
            pass  # tick 4
    # tick 5
    with clock.stage("outer"):  # tick 6
        pass  # tick 7
    assert clock.seconds == {"outer": 2.0 + 1.0 + 1.0, "inner": 1.0}
    with pytest.raises(RuntimeError), clock.stage("work"):
        raise RuntimeError
    assert clock.seconds["work"] == 1.0
