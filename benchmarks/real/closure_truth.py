"""Loop closures held against true poses: which merges are right, which revisits were found."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np

from specmap_cli.core.geometry import FloatArray, Pose2, compose, invert, wrap_angle, wrap_angles
from specmap_cli.evaluation.trajectories import associate
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.grids.matching import refine
from specmap_cli.layout.path_graph import Graph, graph_of
from specmap_cli.layout.pose_graph import Link
from specmap_cli.layout.relaxation import measured
from specmap_cli.layout.walls import PLACE_NODES, Place, Walls
from specmap_cli.maps.text_files import read_tum
from specmap_cli.pipelines.laying_out import constraints_of
from specmap_cli.pipelines.map_in_making import Explored
from specmap_cli.recognition.closure.verification import tracks_overlap
from specmap_cli.topology.graph import submap_of_regions

REVISIT = 0.4  # share of both tracks within a metre of each other: a region comes back
STEADY = 10  # keyframes on either side of one that steady its pose, which others' SLAM made
_RIGHT = 0.25  # the same, of a merge that is no mistake
_BESIDE = Pose2(0.05, -0.05, 0.01)  # from where a constraint is found again
_STEPS = 20  # to the optimum nearby
_WRONG_M, _WRONG_DEG = 0.6, 7.0  # off the truth: another transform, not a bad one


@dataclass(frozen=True, slots=True)
class Judged:
    """The closures of a build.

    `errors` (n, 2) are metres and degrees between its constraints and the truth, `repeats` (m, 2)
    those between the same constraint from the one half of the scans and from the other half: what
    of the errors is its own, and not that of a truth which others' SLAM made.
    """

    regions: int
    merges: int
    right: int
    found: int
    revisits: int
    errors: FloatArray
    repeats: FloatArray

    @property
    def wrong(self) -> int:
        """How many constraints are of another transform than the true one."""
        far, turned = self.errors[:, 0] > _WRONG_M, self.errors[:, 1] > _WRONG_DEG
        return int(np.count_nonzero(far | turned))

    @property
    def median(self) -> tuple[float, float]:
        """Metres and degrees, NaN without a constraint."""
        return _median(self.errors)

    def __str__(self) -> str:
        (metres, degrees), (apart, turned) = self.median, _median(self.repeats)
        return (
            f"{self.regions} regions, {self.merges} merges, {self.right} right | "
            f"{self.found}/{self.revisits} | {len(self.errors)}, {self.wrong} wrong, "
            f"{100 * metres:.1f} cm {degrees:.2f} deg | {100 * apart:.1f} cm {turned:.2f} deg"
        )


def _median(errors: FloatArray) -> tuple[float, float]:
    """Of metres and degrees (n, 2), NaN of none."""
    if not len(errors):
        return np.nan, np.nan
    metres, degrees = np.median(errors, axis=0).tolist()
    return metres, degrees


def true_poses(path: Path, store: KeyframeStore, *, of_laser: bool = True) -> FloatArray:
    """(n, 3) true poses of the base at all keyframes, NaN where none is given.

    A file of TUM poses is of the laser or of the base.
    """
    truth = read_tum(path)
    known, found = associate(truth.stamps_ns, store.stamps_ns, 5_000_000)
    poses = np.full((len(store), 3), np.nan)
    for keyframe, row in zip(known.tolist(), found.tolist(), strict=True):
        pose = Pose2(*truth.poses[row].tolist())
        poses[keyframe] = pose @ store.base_from_laser(keyframe).inverse() if of_laser else pose
    return poses


def judged(explored: Explored, store: KeyframeStore, truth: FloatArray, reach: int = 0) -> Judged:
    """The closures of a build against true base poses (n, 3) of its keyframes, NaN if unknown.

    `reach` is how many keyframes before and after one steady its true pose: see `steadied`.
    """
    known = np.isfinite(truth[:, 0])
    tracks = {r: truth[[k for k in ks if known[k]]] for r, ks in explored.regions.items()}
    overlap = _overlaps({r: track for r, track in tracks.items() if len(track)})
    merges = [c for c in explored.closures if c.merged]
    submap = submap_of_regions(explored.regions, [(c.old, c.new) for c in merges])
    graph, walls, constraints = _measured(explored, store)
    again = [pair for pair, share in overlap.items() if share >= REVISIT]
    found = {b for a, b in again if submap[a] == submap[b]}
    return Judged(
        regions=len(explored.regions),
        merges=len(merges),
        right=sum(
            overlap.get((min(c.old, c.new), max(c.old, c.new)), 0.0) > _RIGHT for c in merges
        ),
        found=len(found),
        revisits=len({b for _, b in again}),
        errors=_constraint_errors(constraints, store, truth, reach),
        repeats=_repeats(graph, walls, constraints),
    )


def _overlaps(tracks: Mapping[int, FloatArray]) -> dict[tuple[int, int], float]:
    """How much of both tracks of two regions, the smaller number first, is near the other."""
    here = Pose2(0.0, 0.0, 0.0)
    return {
        (a, b): tracks_overlap(tracks[a], tracks[b], here, 1.0)
        for a, b in combinations(sorted(tracks), 2)
    }


def _constraint_errors(
    constraints: Iterable[Link], store: KeyframeStore, truth: FloatArray, reach: int
) -> FloatArray:
    """(n, 2) metres and degrees between each verified transform and the truth, where it ties."""
    errors = []
    for constraint in constraints:
        ends = [steadied(truth, store, k, reach) for k in (constraint.source, constraint.target)]
        if all(np.isfinite(end.x) for end in ends):
            errors.append(_off(ends[0].inverse() @ ends[1], constraint.source_from_target))
    return np.array(errors).reshape(-1, 2)


def _measured(explored: Explored, store: KeyframeStore) -> tuple[Graph, Walls, list[Link]]:
    """The constraints of a build as its layout measures them, with the graph they tie."""
    graph = graph_of(store, (), explored.breaks)
    rough = constraints_of(explored.closures, explored.regions, store, graph.nodes)
    walls = Walls(store, graph)
    return graph, walls, [measured(graph, walls, link) or link for link in rough.values()]


def _repeats(graph: Graph, walls: Walls, constraints: Iterable[Link]) -> FloatArray:
    """(n, 2) metres and degrees between each constraint by one half of the scans and the other."""
    apart = []
    for constraint in constraints:
        guess = constraint.source_from_target @ _BESIDE
        rows = [graph.row[end] for end in (constraint.source, constraint.target)]
        halves = []
        for which in (0, 1):
            old, new = (_half(graph, walls, row, which) for row in rows)
            field = Place.of(old).walls
            near = refine(field, new, guess, _STEPS)
            halves.append(refine(field.sharper(), new, near.pose, _STEPS).pose)
        apart.append(_off(*halves))
    return np.array(apart).reshape(-1, 2)


def _half(graph: Graph, walls: Walls, row: int, which: int) -> FloatArray:
    """What every other node of a place, and its own, shows: (N, 2) in the frame of the row."""
    low, high = max(0, row - PLACE_NODES), min(len(graph.nodes), row + PLACE_NODES + 1)
    near = [k for k in range(low, high) if k % 2 == which or k == row]
    relative = compose(invert(graph.poses[row]), graph.poses[near]).tolist()
    views = zip(near, relative, strict=True)
    return np.concatenate([Pose2(*pose).apply(walls.sides(k).points) for k, pose in views])


def _off(a: Pose2, b: Pose2) -> tuple[float, float]:
    """Metres and degrees between two poses."""
    off = a.inverse() @ b
    return off.distance, float(abs(np.degrees(wrap_angle(off.theta))))


def steadied(truth: FloatArray, store: KeyframeStore, k: int, reach: int) -> Pose2:
    """The true pose of keyframe `k`, the median of what those around it say by the tracked path.

    Poses of others' SLAM jitter from scan to scan by more than scans that follow one another can be
    mistaken by: on fr079 by 2 cm and 0.33 degrees, matched scans by 1 cm and 0.1 degrees.
    """
    around = np.arange(max(0, k - reach), min(len(truth), k + reach + 1))
    around = around[np.isfinite(truth[around, 0])]
    if not len(around):
        return Pose2(np.nan, np.nan, np.nan)
    steps = compose(invert(store.poses[k]), store.poses[around])
    turns = wrap_angles(truth[around, 2] - steps[:, 2] - truth[around[0], 2])
    heading = float(truth[around[0], 2] + np.median(turns))
    places = truth[around, :2] - Pose2(0.0, 0.0, heading).apply(steps[:, :2])
    x, y = np.median(places, axis=0).tolist()
    return Pose2(x, y, heading)
