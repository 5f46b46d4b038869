"""The layout: poses of all keyframes made consistent over everything the robot saw again.

A pose graph over a thinned set of keyframes, tied by the front end's motion, by verified loop
closures of any drift, and by edges between nearby passes which are looked for here, once the
closures have brought the passes near each other. Robust, and what does not fit in the end is
dropped and reported.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components, dijkstra

from specmap_cli.core.config import RelaxationConfig
from specmap_cli.core.geometry import FloatArray, Pose2, compose, invert
from specmap_cli.core.records import IntArray, Trajectory
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.layout.motion_edges import LOOSE_INFORMATION, step_information
from specmap_cli.layout.nearby_passes import NearbyPasses, Walls
from specmap_cli.layout.parts import agreed, corrections, moved
from specmap_cli.layout.pose_graph import Edges, Link, Solution, solve

_KERNEL = 2.0  # width of Cauchy's kernel, in sigmas
_FIRM_M = 0.5  # what any closure may mend, and shares of the way between its ends:
_TIED_SHARE, _DRIFT_SHARE = 0.04, 0.15  # where nearby passes shorten that way, and elsewhere
_OUTLIER_CHI2 = 25.0
_STRAY_VOTES = 3  # matches that must agree on where a lost piece of the path belongs


@dataclass(frozen=True, slots=True)
class Constraint:
    """A verified loop closure between two keyframes, by their numbers in the store.

    `information` (3, 3) weighs the error of `source_from_target` in the target's frame.
    """

    source: int
    target: int
    source_from_target: Pose2
    information: FloatArray


@dataclass(frozen=True, slots=True)
class Layout:
    """Relaxed poses (n, 3) of all keyframes, and the pose graph they come from.

    `nodes` are the keyframe numbers in the graph; `odometry`, `kept` and `dropped` its edges, the
    last two being closures and nearby passes; `chi2` the cost that remains. `loose` are the
    keyframes at which tracking restarted and whose place, and that of what follows, is a guess.
    """

    poses: FloatArray
    nodes: IntArray
    odometry: list[Link]
    kept: list[Link]
    dropped: list[Link]
    chi2: float
    warnings: list[str]
    loose: list[int] = field(default_factory=list)


def relax(
    store: KeyframeStore,
    constraints: Sequence[Constraint],
    breaks: Sequence[int],
    config: RelaxationConfig,
) -> Layout:
    """The consistent layout of the store's keyframes.

    `constraints` come from verified closures and may span any drift; `breaks` are the numbers of
    keyframes at which tracking started afresh. Scans are read from the store, a few at a time.
    With `config.enabled` false the poses stay as they were tracked.
    """
    if not config.enabled or len(store) < 2:
        return Layout(store.poses, np.arange(0, dtype=np.int64), [], [], [], 0.0, [])
    return _Relaxation(store, constraints, breaks, config).run()


class _Relaxation:
    """The graph while it is being built; rows are nodes, in the order of the path."""

    def __init__(
        self,
        store: KeyframeStore,
        constraints: Sequence[Constraint],
        breaks: Sequence[int],
        config: RelaxationConfig,
    ) -> None:
        self.config, self.breaks, self.store = config, set(breaks) - {0}, store
        self.tracked = store.poses
        ends = {k for c in constraints for k in (c.source, c.target)}
        self.nodes = chosen_nodes(self.tracked, ends | self.breaks, config)
        self.row = {number: row for row, number in enumerate(self.nodes.tolist())}
        self.poses = self.tracked[self.nodes]
        self.odometry = self._odometry()
        self.loops = [
            Link(c.source, c.target, c.source_from_target, c.information, "closure")
            for c in constraints
        ]
        fresh = np.isin(self.nodes, sorted(self.breaks))
        self.part: IntArray = np.cumsum(fresh).astype(np.int64)
        steps = np.hypot(*np.diff(self.poses[:, :2], axis=0, prepend=self.poses[:1, :2]).T)
        self.path = np.cumsum(np.where(fresh, 2 * config.loop_path_m, steps))
        walls = Walls(store, self.nodes.tolist(), config)
        self.passes = NearbyPasses(walls, self.nodes.tolist(), self.path, self.part, config)

    def run(self) -> Layout:
        """Nearby passes, the closures that drift allows, then what these brought near."""
        self._place_parts()
        closures, self.loops = self.loops, []
        self._find_passes()
        self._solve()
        near, far, refuted = self._sorted_by_drift(closures)
        self.loops += near + far
        if far:
            self._tighten()
            self._find_passes()
        dropped, chi2 = self._settle()
        dropped = refuted + dropped
        return Layout(
            carried(self.tracked, self.nodes, self.poses),
            self.nodes,
            self.odometry,
            self.loops,
            dropped,
            chi2,
            self._warnings(dropped),
            self._loose(),
        )

    def _odometry(self) -> list[Link]:
        """Edges between successive nodes, loose where tracking started afresh."""
        motions = compose(invert(self.poses[:-1]), self.poses[1:])
        links = []
        for k, motion in enumerate(motions):
            source, target = int(self.nodes[k]), int(self.nodes[k + 1])
            step = Pose2(*motion.tolist())
            if target in self.breaks:
                links.append(Link(source, target, step, LOOSE_INFORMATION, "loose"))
                continue
            seen = self.store.points(target, self.config.match_range_m)
            links.append(Link(source, target, step, step_information(step, seen), "odometry"))
        return links

    def _place_parts(self) -> None:
        """Move each part to where most closures with older parts put it."""
        for part in range(1, int(self.part[-1]) + 1):
            self._place(part, self.loops, 1)

    def _place(self, part: int, links: Sequence[Link], votes: int) -> bool:
        """Move a part to where the links put it when enough of them agree."""
        motions = corrections(links, part, self.part, self.row, self.poses)
        best = agreed(motions, self.poses[self.part == part, :2].mean(axis=0))
        if best is None or best[1] < votes:
            return False
        self.poses = moved(self.poses, self.part, part, best[0])
        self.passes.tie(part)
        return True

    def _sorted_by_drift(
        self, closures: Sequence[Link]
    ) -> tuple[list[Link], list[Link], list[Link]]:
        """Closures that agree with the layout, that drift explains, and that nothing explains.

        Drift grows along the shortest chain of edges between the two keyframes: in look-alike rooms
        off one corridor the chain is short, and a closure between them impossible.
        """
        near: list[Link] = []
        far: list[Link] = []
        refuted: list[Link] = []
        for closure, chain in zip(closures, self._chains(closures), strict=True):
            source, target = self.row[closure.source], self.row[closure.target]
            expected = Pose2(*self.poses[source].tolist()).inverse() @ Pose2(
                *self.poses[target].tolist()
            )
            away = (closure.source_from_target.inverse() @ expected).distance
            tied = chain < 0.9 * abs(self.path[target] - self.path[source])
            if away > _FIRM_M + (_TIED_SHARE if tied else _DRIFT_SHARE) * chain:
                refuted.append(closure)
            else:
                (near if away <= _FIRM_M else far).append(closure)
        return near, far, refuted

    def _chains(self, closures: Sequence[Link]) -> FloatArray:
        """(c,) metres along the shortest chain of edges between the ends of each closure."""
        if not closures:
            return np.zeros(0)
        edges = [link for link in [*self.odometry, *self.loops] if link.kind != "loose"]
        rows = [self.row[link.source] for link in edges]
        columns = [self.row[link.target] for link in edges]
        lengths = [max(link.source_from_target.distance, 1e-3) for link in edges]
        count = len(self.nodes)
        graph = csr_array((lengths, (rows, columns)), shape=(count, count))
        starts = [self.row[closure.source] for closure in closures]
        ends = [self.row[closure.target] for closure in closures]
        unique, which = np.unique(starts, return_inverse=True)
        return np.asarray(dijkstra(graph, directed=False, indices=unique)[which, ends])

    def _tighten(self) -> None:
        """Closures pull over any drift at first; those outvoted are let go step by step.

        Graduated non-convexity: Cauchy's kernel starts wider than the largest error.
        """
        chi2 = self._solve(np.inf).chi2[len(self.odometry) :]
        width = float(np.sqrt(chi2.max()))
        while width > _KERNEL:
            self._solve(width)
            width /= 3.0
        self._solve()

    def _find_passes(self) -> None:
        """Look for nearby passes along the path, solving again as edges come in."""
        config, fresh = self.config, 0
        visited = tied = 0.0
        strays: list[Link] = []
        for node in range(len(self.nodes)):
            if self.path[node] - visited < config.loop_every_m:
                continue
            visited = float(self.path[node])
            if self.passes.is_stray(node):
                strays += self.passes.links_of_stray(node, self.poses)
                if not self._place(int(self.part[node]), strays, _STRAY_VOTES):
                    continue
                found, strays = strays, []
            else:
                found = self.passes.links(node, self.poses, _drift(visited - tied))
            if found:
                self.loops += found
                tied, fresh = visited, fresh + len(found)
            if fresh >= config.solve_every:
                self._solve()
                fresh = 0

    def _solve(self, width: float = 0.0) -> Solution:
        """Optimise with Cauchy's kernel of `width` (the usual one if 0) on all but odometry."""
        wide = max(width, _KERNEL)
        widths = {"closure": wide, "nearby": wide, "loose": _KERNEL}
        solution = solve(self.poses, Edges.of([*self.odometry, *self.loops], self.row, widths))
        self.poses = solution.poses
        return solution

    def _settle(self) -> tuple[list[Link], float]:
        """Drop what does not fit and solve again; returns what was dropped and the last cost."""
        dropped: list[Link] = []
        while True:
            solution = self._solve()
            bad = solution.chi2[len(self.odometry) :] > _OUTLIER_CHI2
            if not bad.any():
                return dropped, solution.cost
            dropped += [link for link, out in zip(self.loops, bad, strict=True) if out]
            self.loops = [link for link, out in zip(self.loops, bad, strict=True) if not out]

    def _warnings(self, dropped: Sequence[Link]) -> list[str]:
        """What a user should know about the layout."""
        warnings = []
        closures = sum(link.kind == "closure" for link in dropped)
        if closures:
            warnings.append(f"layout: {closures} loop closures contradict the rest: left out")
        for keyframe in self._loose():
            stamp = self.store.stamps_ns[keyframe]
            warnings.append(f"layout: a guess only places what follows {stamp * 1e-9:.3f} s")
        return warnings

    def _loose(self) -> list[int]:
        """First keyframes of the parts that no edge ties to the first part, nor over others."""
        count = int(self.part[-1]) + 1
        ends = [(self.row[link.source], self.row[link.target]) for link in self.loops]
        parts = self.part[np.array(ends, dtype=np.intp).reshape(-1, 2)]
        ties = csr_array((np.ones(len(parts)), (parts[:, 0], parts[:, 1])), shape=(count, count))
        _, piece = connected_components(ties, directed=False)
        apart = np.flatnonzero(piece != piece[0])
        return [int(self.nodes[np.argmax(self.part == part)]) for part in apart]


def _drift(path_m: float) -> float:
    """How far a path may have drifted, metres: 0.3 m and 4 %, searched up to 2 m."""
    return float(np.clip(0.3 + 0.04 * path_m, 0.3, 2.0))


def chosen_nodes(poses: FloatArray, always: set[int], config: RelaxationConfig) -> IntArray:
    """Keyframe numbers for the graph: the first, the last, one a step of the path, `always`."""
    chosen: list[int] = []
    last: Pose2 | None = None
    for number, row in enumerate(poses.tolist()):
        pose = Pose2(*row)
        if last is not None and number not in always and number != len(poses) - 1:
            step = last.inverse() @ pose
            if step.distance < config.node_m and abs(step.theta) < config.node_rad:
                continue
        chosen.append(number)
        last = pose
    return np.array(chosen, dtype=np.int64)


def carried(tracked: FloatArray, anchors: IntArray, relaxed: FloatArray) -> FloatArray:
    """Poses (n, 3) moved with their last anchor: its relaxed pose o the tracked motion since.

    `anchors` (m,) ascending rows of `tracked` (n, 3), `relaxed` (m, 3) their new poses.
    """
    if not len(anchors):
        return np.array(tracked)
    last = np.maximum(np.searchsorted(anchors, np.arange(len(tracked)), side="right") - 1, 0)
    motion = compose(invert(tracked[anchors[last]]), tracked)
    return compose(relaxed[last], motion)


def corrected(trajectory: Trajectory, store: KeyframeStore, layout: Layout) -> Trajectory:
    """The trajectory of every registered scan, moved with the keyframes of a layout."""
    anchors = keyframe_rows(trajectory, store)
    poses = carried(trajectory.poses, anchors, layout.poses)
    return Trajectory(trajectory.stamps_ns, poses, trajectory.tilt)


def keyframe_rows(trajectory: Trajectory, store: KeyframeStore) -> IntArray:
    """Rows of the trajectory that are the store's keyframes, in order.

    Stamps may repeat or step back, so that the two are walked together.
    """
    stamps, tracked = store.stamps_ns, store.poses
    rows: list[int] = []
    for row, stamp in enumerate(trajectory.stamps_ns.tolist()):
        k = len(rows)
        if k == len(stamps):
            break
        if stamp == stamps[k] and np.array_equal(trajectory.poses[row], tracked[k]):
            rows.append(row)
    return np.array(rows, dtype=np.int64)
