"""The topology of the submap of each keyframe, what a new log inherits, and moved borders."""

import random
from collections.abc import Collection, Sequence
from dataclasses import replace
from itertools import groupby, pairwise
from typing import Any

import networkx as nx
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.geometry import FloatArray, Pose2, compose
from specmap_cli.core.records import Closure, IntArray, Labels
from specmap_cli.grids.gridmap import FREE, OCCUPIED, GridMap
from specmap_cli.topology.graph import (
    build_topology,
    inherited,
    stays_of,
    submap_of_regions,
    walled_off,
)
from specmap_cli.topology.identity import carried, redrawn, undone
from specmap_cli.topology.regions import divide
from specmap_cli.topology.topological_map import (
    BorderEdit,
    Break,
    LogInfo,
    Merge,
    Split,
    Stay,
    TopologicalMap,
    driven_m,
    fences_of,
    heirs,
    ways_m,
)
from tests.house import closure
from tests.strategies import pose_arrays


def line_of_poses(count: int, step_m: float = 1.0) -> FloatArray:
    poses = np.zeros((count, 3))
    poses[:, 0] = np.arange(count) * step_m
    return poses


def labelled(poses: FloatArray, submaps: IntArray | None = None) -> Labels:
    """Keyframes of some submaps, or all of submap 0."""
    own = np.zeros(len(poses), dtype=np.int64) if submaps is None else submaps
    return Labels(stamps_ns=np.arange(len(poses)), poses=poses, submaps=own)


def topology_of(
    labels: Sequence[int],
    breaks: Collection[int] = (),
    closures: Sequence[Closure] = (),
    poses: FloatArray | None = None,
    submap_of_region: dict[int, int] | None = None,
) -> TopologicalMap:
    """Keyframes a metre and 1000 ns apart, on a line unless `poses` say where."""
    return build_topology(
        labels=Labels(
            stamps_ns=1000 * np.arange(len(labels)),
            poses=line_of_poses(len(labels)) if poses is None else poses,
            submaps=np.array(labels, dtype=np.int64),
        ),
        breaks=[Break(int(keyframe)) for keyframe in breaks],
        closures=closures,
        stays=[
            Stay(number=region, submap=submap, runs=((0, 0),), origin=0, start_ns=0, end_ns=0)
            for region, submap in (submap_of_region or {label: label for label in labels}).items()
        ],
        grids={label: GridMap(np.full((2, 2), FREE, dtype=np.uint8), 0.1) for label in set(labels)},
    )


def test_visits_traversals_and_frames_follow_the_robot() -> None:
    topology = topology_of([0, 0, 1, 1, 0, 2])
    assert [len(topology.submaps[i].visits) for i in (0, 1, 2)] == [2, 1, 1]
    assert topology.submaps[0].keyframes == (0, 1, 4)
    assert [(v.start_ns, v.end_ns) for v in topology.submaps[0].visits] == [(0, 1000), (4000, 4000)]
    kinds = {key: edge.kind for key, edge in topology.edges.items()}
    assert kinds == {(0, 1): "traversed", (0, 2): "traversed"}
    there, back = topology.edges[0, 1].traversals
    assert (there.source, there.target, there.x, there.stamp_ns) == (0, 1, 1.5, 2000)
    assert (back.source, back.target, back.x, back.stamp_ns) == (1, 0, 3.5, 4000)
    assert topology.edges[0, 1].crossing == (2.5, 0.0)
    assert topology.edges[0, 1].source_from_target == Pose2(2.0, 0.0, 0.0)


def test_the_robot_looks_ahead_where_it_crosses_from_the_smaller_id() -> None:
    """Headings have no mean: that of the first keyframe on the other side is taken."""
    poses = np.array([[0.0, 0.0, 3.1], [1.0, 2.0, -3.1]])
    (crossing,) = topology_of([0, 1], poses=poses).edges[0, 1].traversals
    assert (crossing.x, crossing.y, crossing.theta) == (0.5, 1.0, -3.1)
    poses = np.array([[2.0, 1.0, np.pi / 2], [0.0, 0.0, 0.0]])
    (edge,) = topology_of([5, 3], poses=poses).edges.values()
    assert (edge.source, edge.target) == (3, 5)
    assert edge.source_from_target == pytest.approx((2.0, 1.0, np.pi / 2))


def test_a_loss_of_tracking_leaves_a_loose_edge_until_the_robot_drives_across() -> None:
    loose = topology_of([0, 1], breaks=(1,)).edges[0, 1]
    assert (loose.kind, loose.crossing, loose.traversals) == ("loose", None, ())
    for breaks in ((1,), [2], {1}, np.array([1])):
        driven = topology_of([0, 1, 0], breaks=breaks).edges[0, 1]
        assert driven.kind == "traversed"
        assert len(driven.traversals) == 1
    assert not topology_of([0, 0], breaks=(1,)).edges, "within a submap it links nothing"


def test_a_verified_closure_is_an_edge_where_the_tracks_meet_within_half_a_metre() -> None:
    labels, poses = [0, 0, 1, 1, 2, 2], line_of_poses(6)
    poses[4] = poses[0]  # the robot comes back to where it was in submap 0
    verified = (closure(0, 2), closure(1, 2))
    topology = topology_of(labels, closures=verified, poses=poses)
    assert topology.edges[0, 2].kind == "closure"
    assert topology.edges[0, 2].traversals == ()
    assert topology.edges[1, 2].kind == "traversed"
    for refused in (closure(0, 2, verified=False), closure(0, 2, merged=True)):
        found = topology_of(labels, closures=[refused], poses=poses)
        assert (0, 2) not in found.edges
        assert found.closures == (refused,), "all that were considered are kept"
    for metres, meets in ((0.49, True), (0.51, False)):
        poses[4] = poses[0] + (0.0, metres, 2.0)
        found = topology_of(labels, closures=verified, poses=poses)
        assert ((0, 2) in found.edges) is meets, metres


def test_a_closure_names_regions_whose_submaps_may_have_changed() -> None:
    poses = line_of_poses(3, 10.0)
    poses[2] = poses[0]
    regions = {7: 0, 9: 2, 11: 0}
    assert topology_of([0, 1, 2], (), [closure(7, 9)], poses, regions).edges[0, 2].kind == "closure"
    same = topology_of([0, 1, 2], (), [closure(7, 11)], poses, regions)
    assert set(same.edges) == {(0, 1), (1, 2)}, "both became one submap"
    with pytest.raises(KeyError):
        topology_of([0, 1, 2], (), [closure(7, 8)], poses, regions)
    broken = topology_of([0, 1], (1,), [closure(0, 1)], np.zeros((2, 3)))
    assert broken.edges[0, 1].kind == "closure", "stronger than the guess over a break"


@given(st.lists(st.integers(0, 4), min_size=1, max_size=30), st.sets(st.integers(0, 29)))
def test_the_graph_of_a_driven_tour_is_connected_and_complete_and_visits_are_its_stays(
    labels: list[int], breaks: set[int]
) -> None:
    topology = topology_of(labels, breaks)
    graph = nx.Graph()
    graph.add_nodes_from(topology.submaps)
    graph.add_edges_from(topology.edges)
    assert nx.is_connected(graph)
    keyframes = sorted(k for submap in topology.submaps.values() for k in submap.keyframes)
    assert keyframes == list(range(len(labels)))
    borders = [k for k in range(1, len(labels)) if labels[k] != labels[k - 1]]
    crossings = sum(len(edge.traversals) for edge in topology.edges.values())
    assert crossings == len(set(borders) - breaks)
    for (low, high), edge in topology.edges.items():
        assert (edge.source, edge.target) == (low, high)
        assert low < high
        assert (edge.kind == "traversed") == bool(edge.traversals)
        assert [t.stamp_ns for t in edge.traversals] == sorted(t.stamp_ns for t in edge.traversals)
    start, expected = 0, dict[int, list[tuple[int, int]]]()
    for label, stay in groupby(labels):
        end = start + len(list(stay)) - 1
        expected.setdefault(label, []).append((1000 * start, 1000 * end))
        start = end + 1
    assert list(topology.submaps) == list(expected), "in order of first visit"
    for id_, submap in topology.submaps.items():
        assert [(visit.start_ns, visit.end_ns) for visit in submap.visits] == expected[id_]
        assert submap.map_from_submap.x == labels.index(id_), "the frame is its first keyframe's"


@given(
    st.lists(st.tuples(st.integers(0, 12), st.integers(0, 12)), max_size=20),
    st.randoms(use_true_random=False),
)
def test_merging_agrees_with_connected_components_in_any_order(
    pairs: list[tuple[int, int]], shuffle: random.Random
) -> None:
    graph = nx.empty_graph(13)
    graph.add_edges_from(pairs)
    expected = {k: min(part) for part in nx.connected_components(graph) for k in part}
    assert submap_of_regions(range(13), pairs) == expected
    swapped = [(b, a) for a, b in shuffle.sample(pairs, len(pairs))]
    assert submap_of_regions(shuffle.sample(range(13), 13), swapped) == expected
    assert submap_of_regions([], []) == {}
    with pytest.raises(KeyError):
        submap_of_regions([4, 9], [(4, 3)])


def test_a_stay_has_its_keyframes_and_the_submap_of_most_of_them() -> None:
    labels = labelled(line_of_poses(6), np.array([2, 0, 0, 1, 1, 0]))
    regions = {7: (2, 3, 1), 3: (0,), 5: (4, 5)}  # the robot came back, and the second one grew
    found = stays_of(regions, labels)
    assert found == (
        Stay(number=3, submap=2, runs=((0, 0),), origin=0, start_ns=0, end_ns=0),
        # the smaller of equals
        Stay(number=5, submap=0, runs=((4, 5),), origin=4, start_ns=4, end_ns=5),
        Stay(number=7, submap=0, runs=((1, 3),), origin=2, start_ns=1, end_ns=3),
    )
    assert [stay.keyframes for stay in found] == [(0,), (4, 5), (1, 2, 3)]


def test_the_map_keeps_its_stays_and_breaks_and_knows_the_next_id() -> None:
    topology = topology_of([0, 3, 3], breaks=(1,))
    assert [stay.submap for stay in topology.stays] == [0, 3]
    assert topology.breaks == (Break(1),)
    assert topology.next_id == 4
    nothing = topology_of([])
    assert (nothing.submaps, nothing.edges, nothing.closures) == ({}, {}, ())


def rooms(count: int) -> GridMap:
    """Rooms of 4 m x 4 m in a row, with doors 1 m wide, in cells of 0.1 m."""
    cells = np.full((44, 41 * count + 1), OCCUPIED, dtype=np.uint8)
    for k in range(count):
        cells[2:42, 41 * k + 1 : 41 * k + 41] = FREE
        if k:
            cells[17:27, 41 * k] = FREE
    return GridMap(cells, 0.1)


def way(start_m: float, end_m: float, y: float = 2.2) -> FloatArray:
    """Poses every 0.1 m, along the middle of the rooms unless told otherwise."""
    x = np.arange(start_m, end_m, 0.1 if start_m < end_m else -0.1)
    return np.column_stack([x, np.full_like(x, y), np.zeros_like(x)])


def room_of(poses: FloatArray) -> IntArray:
    return (poses[:, 0] // 4.1).astype(np.int64)


def labels_after(
    known: GridMap,
    first: FloatArray,
    second: FloatArray,
    *,
    next_id: int = 2,
    joint: int | None = None,
    moved: FloatArray | None = None,
) -> tuple[IntArray, IntArray]:
    """Labels of the keyframes of a map of some rooms, and of a second tour.

    The joint division says the room and `joint`, or one submap for all; the layout may have moved.
    """
    old = labelled(first, room_of(first))
    poses = np.concatenate([first, second])
    division = np.zeros_like(room_of(poses)) if joint is None else joint + room_of(poses)
    there = poses if moved is None else compose(moved, poses)
    labels = inherited(old, divide(known, old), next_id, there, division, 1.0)
    return labels[: len(first)], labels[len(first) :]


def test_a_new_room_gets_an_id_that_no_other_ever_had() -> None:
    first, second = way(1.0, 7.5), way(2.0, 14.0)
    kept, labels = labels_after(rooms(2), first, second, next_id=7, joint=10)
    assert kept.tolist() == room_of(first).tolist()
    expected = np.array([0, 1, 7, 8])[room_of(second)]
    assert (labels != expected).sum() <= 2, "a door may be counted either way"
    assert set(kept.tolist()) | set(labels.tolist()) == {0, 1, 7, 8}


@pytest.mark.parametrize(
    ("second", "moved"),
    [(way(7.0, 1.5), None), (way(2.0, 7.0), np.array([5.0, -3.0, 1.0]))],
    ids=["in place", "moved"],
)
def test_old_borders_stay_where_the_joint_division_differs_and_move_with_the_keyframes(
    second: FloatArray, moved: FloatArray | None
) -> None:
    _, labels = labels_after(rooms(2), way(1.0, 7.5), second, moved=moved)
    assert (labels != room_of(second)).sum() <= 2


def test_a_new_room_only_looked_into_is_none_and_all_in_new_space_is_a_submap() -> None:
    for second, ids in ((way(7.0, 8.6), {0, 1}), (way(8.5, 9.0), {0, 1, 2})):
        both = labels_after(rooms(2), way(1.0, 7.5), second, joint=0)
        assert set(np.concatenate(both).tolist()) == ids
    assert set(both[1].tolist()) == {2}


@pytest.mark.parametrize(
    ("wall", "reach_m", "parts"),
    [
        ((slice(0, 44), slice(28, 30)), 4.0, [0, 5]),
        ((slice(3, 41), slice(28, 30)), 4.0, [0, 5]),  # beams graze the walls beside it
        ((slice(7, 44), slice(28, 30)), 4.0, [0]),  # half a metre is left
        ((slice(0, 44), slice(28, 30)), 3.4, [0]),  # hardly driven on
        ((slice(0, 44), slice(12, 14)), 4.0, [5, 0]),  # most of the way is behind it
        ((slice(16, 28), slice(20, 36)), 4.0, [0]),  # a thing of which the laser sees the sides
    ],
)
def test_a_wall_across_a_submap_makes_two_of_it(
    wall: tuple[slice, slice], reach_m: float, parts: list[int]
) -> None:
    """A room with a way from one side to the other, seen again by a robot on the left."""
    world, poses = rooms(1), np.concatenate([way(0.5, reach_m), way(0.5, 1.0)])
    labels = np.zeros(len(poses), dtype=np.int64)
    old = divide(world, labelled(poses, labels))
    now = replace(world, cells=world.cells.copy())
    now.cells[wall] = OCCUPIED
    inside = tuple(slice(side.start + 1, side.stop - 1) for side in wall)
    now.cells[inside] = world.cells[inside]
    found = walled_off(labels, poses, old, now, 5, 0.5)
    beyond = poses[:, 0] // 0.1 - wall[1].start
    assert set(found[beyond < 0].tolist()) == {parts[0]}
    assert set(found[beyond > 2].tolist()) == {parts[-1]}
    assert not labels.any(), "given labels stay as they are"


def test_pieces_that_hung_together_nowhere_are_left_alone() -> None:
    """A person may have made one submap of two rooms."""
    poses = np.concatenate([way(0.5, 4.0), way(4.6, 8.0)])
    labels = np.zeros(len(poses), dtype=np.int64)
    apart = rooms(2)
    apart.cells[:, 41] = OCCUPIED
    old = divide(apart, labelled(poses, labels))
    assert not walled_off(labels, poses, old, apart, 5, 1.0).any()


def test_a_room_that_was_only_looked_into_is_new() -> None:
    first, second = way(1.0, 3.5), way(2.0, 7.8)
    owner = divide(rooms(2), labelled(first, room_of(first))).owner
    assert (owner[:, 50:80] == 0).any(), "seen through the door, and nobody else's"
    _, found = labels_after(rooms(2), first, second, next_id=1, joint=10)
    assert (found != room_of(second)).sum() <= 3


ACROSS = ((2.0, 1.9), (2.0, 0.1))  # seen along it, the left part of the hall is on its right


def hall() -> GridMap:
    """A hall of 4 m x 2 m and a room of 2 m x 2 m beside it, behind a wall with a door."""
    cells = np.full((22, 64), OCCUPIED, dtype=np.uint8)
    cells[1:21, 1:41] = FREE
    cells[1:21, 42:62] = FREE
    cells[8:14, 41] = FREE
    return GridMap(cells, 0.1, (-0.1, -0.1))


def driven() -> Labels:
    """Keyframes along the middle, from left to right: ten a metre, the hall is 0, the room 1."""
    poses = way(0.3, 5.9, 1.0)
    return labelled(poses, (poses[:, 0] > 4.05).astype(np.int64))


def after(*wished: BorderEdit) -> tuple[IntArray, Any]:
    found = redrawn(hall(), driven(), (), wished, 2)
    assert not found.skipped
    return found.submaps, found.borders


def test_a_merge_takes_all_keyframes_and_those_that_came_later_are_parted_by_the_nearest() -> None:
    labels = driven()
    submaps, borders = after(Merge((1, 0)))
    (merge,) = borders
    assert set(submaps.tolist()) == {1}
    assert merge.keyframes == tuple(np.flatnonzero(labels.submaps == 0).tolist())
    assert merge.known == len(submaps)
    poses = np.concatenate([labels.poses, [[1.0, 1.2, 0.0], [5.0, 0.8, 0.0]]])
    later = labelled(poses, np.append(submaps, [1, 1]))
    assert undone(hall(), later, borders)[-2:].tolist() == [0, 1]
    (moved,) = carried(borders, hall(), labels.poses, poses[-2:])
    assert isinstance(moved, Merge)
    assert (moved.keyframes, moved.known) == ((0,), 2)


def test_what_came_after_a_merge_goes_to_no_room_behind_the_wall() -> None:
    """A keyframe of the room stood nearer to the new one than any of the hall, behind the wall."""
    whole, there = hall(), driven()
    poses = np.concatenate([there.poses, [[4.5, 1.8, 0.0]]])
    labels = labelled(poses, np.append(there.submaps, 1))
    found = redrawn(whole, labels, (), [Merge((1, 0))], 2)
    places = np.concatenate([poses, [[3.8, 1.8, 0.0]]])
    later = labelled(places, np.append(found.submaps, 1))
    assert undone(whole, later, found.borders).tolist() == [*labels.submaps.tolist(), 0]
    (moved,) = carried(found.borders, whole, poses, places[-1:])
    assert isinstance(moved, Merge)
    assert moved.keyframes == (0,), "the hall came with the merge"


def test_a_split_gives_what_is_right_of_the_line_a_new_id() -> None:
    submaps, (split,) = after(Split(submap=0, line=ACROSS))
    x = driven().poses[:, 0]
    assert (submaps == 2).tolist() == (x < 2.0).tolist()
    assert split.new == 2
    (_, top), (_, bottom) = split.fence
    assert top == pytest.approx(2.0, abs=0.11)
    assert bottom == pytest.approx(0.0, abs=0.11)
    turned, _ = after(Split(submap=0, line=ACROSS[::-1]))
    assert (turned == 2).tolist() == ((x > 2.0) & (x < 4.05)).tolist()


def test_no_region_crosses_the_fence() -> None:
    """The robot stood near the line on one side only: its region still ends there."""
    labels, whole = driven(), hall()
    kept = np.flatnonzero((labels.poses[:, 0] < 0.8) | (labels.poses[:, 0] > 2.2))
    seen = labelled(labels.poses[kept], labels.submaps[kept])
    found = redrawn(whole, seen, (), [Split(submap=0, line=ACROSS, new=5)], 2)
    divided = replace(seen, submaps=found.submaps)
    regions = divide(whole, divided, fences_of(found.borders))
    centres = whole.centres_of(np.argwhere(regions.owner == 5))
    assert centres[:, 0].max() == pytest.approx(2.0, abs=0.16)
    others = whole.centres_of(np.argwhere(regions.owner == 0))
    assert others[:, 0].min() == pytest.approx(2.0, abs=0.16)
    assert found.next_id == 6
    assert whole.centres_of(np.argwhere(divide(whole, divided).owner == 5))[:, 0].max() < 1.8


def test_a_keyframe_on_the_fence_takes_nothing_beyond_it() -> None:
    whole, poses = hall(), np.array([[1.0, 1.0, 0.0], [2.0, 1.0, 0.0], [3.0, 1.0, 0.0]])
    owner = divide(whole, labelled(poses, np.array([0, 0, 1])), [ACROSS]).owner
    for submap, side in ((0, np.max), (1, np.min)):
        x = whole.centres_of(np.argwhere(owner == submap))[:, 0]
        assert side(x) == pytest.approx(2.0, abs=0.16)


def test_a_line_through_one_leg_of_a_building_splits_on_foot() -> None:
    """Two corridors side by side, joined at one end: the line crosses one of them only."""
    cells = np.full((22, 42), OCCUPIED, dtype=np.uint8)
    cells[1:9, 1:41] = FREE
    cells[13:21, 1:41] = FREE
    cells[1:21, 33:41] = FREE
    whole = GridMap(cells, 0.1)
    there = way(0.5, 3.6, 0.5)
    poses = np.concatenate([there, way(3.5, 0.45, 1.7)])
    found = redrawn(whole, labelled(poses), (), [Split(submap=0, line=((2.0, 0.8), (2.0, 0.2)))], 1)
    assert np.flatnonzero(found.submaps == 1).tolist() == np.flatnonzero(there[:, 0] < 2).tolist()


def test_changes_are_made_in_order_and_undone() -> None:
    wished: list[BorderEdit] = [Split(submap=0, line=ACROSS, new=7), Merge((1, 0)), Merge((7, 1))]
    submaps, borders = after(*wished)
    assert set(submaps.tolist()) == {7}
    labels = driven()
    changed = replace(labels, submaps=submaps)
    assert undone(hall(), changed, borders).tolist() == labels.submaps.tolist()
    assert set(redrawn(hall(), changed, borders, wished[:2], 8).submaps.tolist()) == {1, 7}
    same = redrawn(hall(), changed, borders, wished, 8)
    assert same.submaps.tolist() == submaps.tolist()
    assert same.borders == borders


def test_what_cannot_be_made_is_told_and_the_rest_made() -> None:
    outside, at_the_end = ((9.0, 9.0), (8.0, 8.0)), ((0.05, 1.9), (0.05, 0.1))
    one_side = "the robot was on one side of the line only in submap 0"
    refused: list[tuple[BorderEdit, str]] = [
        (Merge((0, 9)), "there is no submap 9"),
        (Split(submap=9, line=ACROSS), "there is no submap 9"),
        (Split(submap=0, line=outside), "the line does not cross submap 0"),
        (Split(submap=0, line=at_the_end), one_side),
        (Split(submap=0, line=ACROSS, new=1), "submap 1 exists already"),
    ]
    wished = [*(edit for edit, _ in refused), Split(submap=0, line=ACROSS)]
    found = redrawn(hall(), driven(), (), wished, 2)
    assert found.skipped == dict(enumerate(why for _, why in refused))
    assert len(found.borders) == 1
    assert (found.submaps == 2).any()


def test_heirs_are_what_a_submap_became() -> None:
    borders: list[BorderEdit] = [Split(submap=5, line=ACROSS, new=7), Merge((3, 5)), Merge((2, 9))]
    assert heirs(5, borders) == {3, 7}
    assert heirs(3, borders) == {3}
    assert heirs(5, borders[1:]) == {3}


@given(st.lists(pose_arrays(), min_size=1, max_size=3), st.booleans())
def test_the_way_of_a_map_is_that_of_recordings(tracks: list[np.ndarray], dropped: bool) -> None:
    """Nobody drove from one to the next; of a recording that lost keyframes it was kept."""
    poses, ends = np.concatenate(tracks), np.cumsum([len(track) for track in tracks])
    labels = labelled(poses)
    logs = [
        LogInfo(f"{end}.bag", keyframes=(end - len(track), end - 1) if len(track) else None)
        for track, end in zip(tracks, ends.tolist(), strict=True)
    ]
    steps = [[float(np.linalg.norm(b[:2] - a[:2])) for a, b in pairwise(track)] for track in tracks]
    if dropped and len(tracks[0]):
        logs[0], steps[0] = replace(logs[0], path_m=99.0), [99.0]
    assert ways_m(logs, labels) == pytest.approx([sum(own) for own in steps])
    assert driven_m(logs, labels) == pytest.approx(sum(map(sum, steps)))
