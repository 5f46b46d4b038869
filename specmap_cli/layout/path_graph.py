"""The path of the robot as a graph, and a layout of it in the making, drafted and solved.

Nodes are some of the keyframes. The motion from each to the next is that of the front end. Its
covariance has three parts: noise in proportion to the motion; what walls in sight, by their normals
(Censi, "On achievable accuracy for range-finder localization", ICRA 2007), and odometry leave
undetermined; and what without odometry the motion before had to tell: in a bare corridor all.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from specmap_cli.core.arrays import runs
from specmap_cli.core.geometry import (
    FloatArray,
    Pose2,
    compose,
    inverse3,
    invert,
    moved,
    step_lengths,
)
from specmap_cli.core.odometry import SIGMAS, unknown_slack
from specmap_cli.core.records import IntArray
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.grids.matching import observability
from specmap_cli.layout.pose_graph import (
    SETTLED,
    Link,
    LinkArrays,
    LinkKind,
    Solution,
    errors,
    solve,
    squared,
)

NODE_M = 0.3  # motion between nodes of the pose graph
_NODE_RAD = 0.25  # turn between nodes of the pose graph
LOOP_EVERY_M = 1.0  # least path between searches for nearby passes
LOOP_PATH_M = 6.0  # less path than this between is no pass
MATCH_RANGE_M = 30.0  # beyond it a heading that errs by 0.003 rad moves a wall out of its place

_STEP_SHARE = 0.03  # error of a motion, metres per metre driven
_TURN_SHARE = 0.02  # error of a motion's turn, radians per radian
# Error of a step of no length: registration ends within a fifth of a map cell of 5 cm, 3 m away.
_LEAST_M, _LEAST_RAD = 0.01, 0.003
GUESS_M = 0.3  # error of a motion that neither walls nor odometry tell, or over a break
_GUESS_RAD = 0.2  # error of the turn of such a motion
GUESS_INFORMATION = np.diag([GUESS_M**-2, GUESS_M**-2, _GUESS_RAD**-2])
_RANGE_NOISE_M = 0.1  # error of a reading; more than the laser's: neighbours err alike

_KERNEL_SIGMAS = 2.0  # closures and passes farther off than this pull less and less
_OUTLIER_CHI2 = 25.0  # closures and passes above it, five sigmas off, are dropped in the end
_SOLVE_ITERATIONS = 20  # steps of the solver at the most
_HASTY = 5  # steps at a width that the next one replaces
_ROUGHLY = 1e-3  # share of the cost below which a step moves nodes by a millimetre or two
_EXACT = 1e-8  # metres and radians: what rounding makes of a motion that fits
_DECIMALS = 9  # of poses solved: a nanometre; libraries differ from the fourteenth on
_NARROWER = 3.0  # from one width of the kernel to the next: outvoted closures let go one by one

RowPair = tuple[int, int]


@dataclass(frozen=True, slots=True)
class Bridge:
    """How well the motion over a break of the tracking is known, where odometry measured it.

    Standard deviations of the first pose after the break, seen from the last one before.
    """

    position_m: float
    heading_rad: float

    @property
    def information(self) -> FloatArray:
        """(3, 3) of the motion."""
        return np.diag([self.position_m**-2, self.position_m**-2, self.heading_rad**-2])


@dataclass(frozen=True, slots=True, kw_only=True)
class Graph:
    """The nodes of the pose graph in the order of the path, and the motions between them.

    `nodes` (M,) are keyframe numbers, ascending, `row` their places in it. `tracked` (n, 3) are the
    poses of all keyframes before any relaxing. A part is a piece of the path between breaks of the
    tracking that nothing bridged: `parts` (M,) numbers them from 0. `path` (M,) is the way driven
    up to each node, where a break counts as a way too long for nodes on either side of it to be
    successive. `odometry` are the M - 1 links from each node to the next.
    """

    nodes: IntArray
    row: Mapping[int, int]
    tracked: FloatArray
    parts: IntArray
    path: FloatArray
    odometry: tuple[Link, ...]

    @classmethod
    def of(cls, tracked: FloatArray, nodes: IntArray, odometry: tuple[Link, ...]) -> Graph:
        """The graph of the keyframes `nodes` (M,) of all at poses `tracked` (n, 3)."""
        after = [False, *(motion.kind != "odometry" for motion in odometry)]
        loose = [False, *(motion.kind == "loose" for motion in odometry)]
        steps = np.concatenate([[0.0], step_lengths(tracked[nodes])])
        return cls(
            nodes=nodes,
            row={number: row for row, number in enumerate(nodes.tolist())},
            tracked=tracked,
            parts=np.cumsum(loose).astype(np.int64),
            path=np.cumsum(np.where(after, 2 * LOOP_PATH_M, steps)),
            odometry=odometry,
        )

    @property
    def poses(self) -> FloatArray:
        """(M, 3) the poses of the nodes as tracked."""
        return self.tracked[self.nodes]

    @property
    def part_numbers(self) -> range:
        """The numbers of all parts."""
        return range(int(self.parts[-1]) + 1)


def graph_of(
    store: KeyframeStore,
    ends: Collection[int],
    breaks: Mapping[int, Bridge | None],
    known: dict[int, FloatArray] | None = None,
) -> Graph:
    """The graph of a store's keyframes, with nodes at the `ends` of closures and at `breaks`.

    `breaks` are the keyframes at which tracking started afresh, and what is known of the motion.
    `known` is as in `motion_links`.
    """
    fresh = {number: bridge for number, bridge in breaks.items() if number != 0}
    nodes = chosen_nodes(store.poses, {*ends, *fresh})
    return Graph.of(store.poses, nodes, motion_links(store, nodes, fresh, known))


def chosen_nodes(poses: FloatArray, always: Collection[int]) -> IntArray:
    """Keyframe numbers for the graph: the first, the last, one a step of the path, `always`."""
    chosen: list[int] = []
    last: Pose2 | None = None
    for number, row in enumerate(poses):
        pose = Pose2(*row.tolist())
        due = number in always or number == len(poses) - 1
        if due or moved(last, pose, NODE_M, _NODE_RAD):
            chosen.append(number)
            last = pose
    return np.array(chosen, dtype=np.int64)


def motion_links(
    store: KeyframeStore,
    nodes: IntArray,
    breaks: Mapping[int, Bridge | None],
    known: dict[int, FloatArray] | None = None,
) -> tuple[Link, ...]:
    """Links from each of the keyframes `nodes` (M,) to the next, as tracked.

    Those that end in one of `breaks`, where tracking started afresh, are bridges, or loose where
    nothing is known of the motion: a guess. Who asks often keeps in `known` what the walls seen
    from each keyframe tell of its place.
    """
    poses, ends = store.poses[nodes], nodes[1:].tolist()
    steps = [Pose2(*motion) for motion in compose(invert(poses[:-1]), poses[1:]).tolist()]
    guesses = np.diff(store.guessed_m[nodes], axis=0)
    back = compose(invert(poses[1:] * (0.0, 0.0, 1.0)), np.pad(guesses, ((0, 0), (0, 1))))
    known = {} if known is None else known
    for end in ends:
        if end not in known:
            known[end] = observability(store.points(end, MATCH_RANGE_M), _RANGE_NOISE_M)
    fisher = [np.zeros((3, 3)) if end in breaks else known[end] for end in ends]
    slacks = store.odometry_slacks[nodes[1:]]
    informations = step_information(steps, np.array(fisher).reshape(-1, 3, 3), slacks, back[:, :2])
    links = []
    for k, (source, end) in enumerate(zip(nodes[:-1].tolist(), ends, strict=True)):
        kind: LinkKind = "odometry"
        if end in breaks:
            bridge = breaks[end]
            kind = "loose" if bridge is None else "bridge"
            informations[k] = GUESS_INFORMATION if bridge is None else bridge.information
        links.append(
            Link(
                source=source,
                target=end,
                source_from_target=steps[k],
                information=informations[k],
                kind=kind,
            )
        )
    return tuple(links)


def step_information(
    steps: Sequence[Pose2], fisher: FloatArray, slacks: FloatArray, guessed_m: FloatArray
) -> FloatArray:
    """Information (L, 3, 3) of motions `steps` (L,), each weighed in the frame it ends in.

    `fisher` (L, 3, 3) is what the walls seen from its end tell of a place, `slacks` (L, 3) what
    odometry is worth there, see `PosedScan`. By `guessed_m` (L, 2) each may be off as it was
    guessed. A guess that goes on errs in one way, so that errors add up, and not their squares:
    each counts for more, the more there are in a row.
    """
    position = [_LEAST_M + _STEP_SHARE * step.distance for step in steps]
    angle = [_LEAST_RAD + _TURN_SHARE * abs(step.theta) for step in steps]
    sigmas = np.column_stack([position, position, angle])
    wheels = slacks * np.array([unknown_slack(step) for step in steps]).reshape(-1, 3) / SIGMAS
    wheels[:, :2] = wheels[:, :2].max(axis=1, keepdims=True)  # whatever way the robot went
    told = np.minimum(wheels, (GUESS_M, GUESS_M, _GUESS_RAD))[:, :, None]
    noise = sigmas[:, :, None] ** 2 * np.eye(3) + inverse3(fisher + np.eye(3) / told**2)
    sizes = np.hypot(guessed_m[:, 0], guessed_m[:, 1])
    for start, end in runs(sizes > 0.0):
        if sizes[start]:
            way = guessed_m[start:end] / np.sqrt(sizes[start:end, None])
            variance = sizes[start:end].sum() * way[:, :, None] * way[:, None, :]
            noise[start:end, :2, :2] += variance
    return inverse3(noise)


@dataclass(frozen=True, slots=True, kw_only=True)
class Draft:
    """A layout in the making: `poses` (M, 3) of the nodes, and `loops`, what else ties them.

    `tied` are the parts whose poses are better than a guess. `matched` holds, for pairs of rows
    that were matched, the guess that the match began with.
    """

    poses: FloatArray
    loops: tuple[Link, ...] = ()
    tied: frozenset[int] = frozenset({0})
    matched: Mapping[RowPair, Pose2] = field(default_factory=dict)

    def carried(self, before: Graph, graph: Graph) -> Draft:
        """The draft, which is of the graph `before`, for one of the same path with more nodes.

        These go with the node before them, as tracked. The last node of `before` may be gone.
        """
        rows = np.searchsorted(before.nodes, graph.nodes, side="right") - 1
        since = compose(invert(before.poses[rows]), graph.poses)
        row = [graph.row.get(number, -1) for number in before.nodes.tolist()]
        matched = {(row[old], row[new]): guess for (old, new), guess in self.matched.items()}
        return replace(self, poses=compose(self.poses[rows], since), matched=matched)

    def adding(self, links: Sequence[Link]) -> Draft:
        """The draft with some more loops, which have not moved it yet."""
        return replace(self, loops=(*self.loops, *links))


def solved(graph: Graph, draft: Draft, *, roughly: bool = False) -> Draft:
    """The draft with the poses that fit its links best; roughly to look for more from there."""
    solution = _solution(graph, draft, _KERNEL_SIGMAS, _ROUGHLY if roughly else SETTLED)
    return replace(draft, poses=solution.poses)


def tighten(graph: Graph, draft: Draft) -> Draft:
    """Loops pull over any drift at first; those outvoted are let go step by step.

    Graduated non-convexity (Yang et al., RA-L 2020): Cauchy's kernel starts wider than the largest
    error and narrows to its usual width. Solved roughly: others follow, `settle` the last of them.
    """
    solution = _solution(graph, draft, np.inf, _ROUGHLY)
    width = float(np.sqrt(solution.chi2[len(graph.odometry) :].max(initial=0.0)))
    while width > _KERNEL_SIGMAS:
        rounded = replace(draft, poses=np.round(solution.poses, _DECIMALS))
        solution = _solution(graph, rounded, width, _ROUGHLY, hasty=True)
        width /= _NARROWER
    return solved(graph, replace(draft, poses=solution.poses), roughly=True)


def settle(graph: Graph, draft: Draft) -> tuple[Draft, tuple[Link, ...]]:
    """The draft solved without the loops that do not fit, and these loops.

    What does not fit is dropped and the rest solved anew until all that is left fits.
    """
    dropped: list[Link] = []
    while True:
        solution = _solution(graph, draft, _KERNEL_SIGMAS)
        fits = solution.chi2[len(graph.odometry) :] <= _OUTLIER_CHI2
        dropped += [link for link, fit in zip(draft.loops, fits, strict=True) if not fit]
        loops = tuple(link for link, fit in zip(draft.loops, fits, strict=True) if fit)
        draft = replace(draft, poses=solution.poses, loops=loops)
        if fits.all():
            return draft, tuple(dropped)


def _solution(
    graph: Graph, draft: Draft, width: float, settled: float = SETTLED, *, hasty: bool = False
) -> Solution:
    """The solution with Cauchy's kernel of `width` sigmas on the loops."""
    widths = {"closure": width, "nearby": width, "loose": _KERNEL_SIGMAS, "bridge": _KERNEL_SIGMAS}
    motions = list(graph.odometry)
    for row, motion in enumerate(motions):
        # where a part was placed, the guess that led to it says nothing any more: it holds the part
        # where it is, so that it does not bend the path that closures tie
        if motion.kind == "loose" and int(graph.parts[row + 1]) in draft.tied:
            placed = compose(invert(draft.poses[row]), draft.poses[row + 1])
            motions[row] = replace(motion, source_from_target=Pose2(*placed.tolist()))
    links = LinkArrays.of((*motions, *draft.loops), graph.row, widths)
    steps = _HASTY if hasty else _SOLVE_ITERATIONS
    # what follows the last row that a link may move hangs on it by motions and goes with it
    missed = errors(draft.poses, links.i, links.j, links.z)
    pulls = np.abs(missed).max(axis=1, initial=0.0) > _EXACT
    pulls[len(motions) :] = True
    count = 1 + int(np.maximum(links.i, links.j)[pulls].max(initial=0))
    path, inner = draft.poses[:count], (links.i < count) & (links.j < count)
    some = LinkArrays._make(each[inner] for each in links)
    found = solve(path, some, steps, settled)
    tail = compose(invert(draft.poses[count - 1]), draft.poses[count:])
    poses = np.concatenate([found.poses, compose(found.poses[-1], tail)])
    return replace(found, poses=poses, chi2=squared(poses, links))


@dataclass(frozen=True, slots=True, kw_only=True)
class Ends:
    """Links as rows of poses: `i`, `j` (L,) with the older end first, and `z` (L, 3)."""

    i: IntArray
    j: IntArray
    z: FloatArray

    @classmethod
    def of(cls, row: Mapping[int, int] | range, links: Sequence[Link]) -> Ends:
        """The ends of links, turned round where the target is older; `row` of each keyframe."""
        i = np.array([row[link.source] for link in links], dtype=np.int64)
        j = np.array([row[link.target] for link in links], dtype=np.int64)
        z = np.array([link.source_from_target for link in links]).reshape(-1, 3)
        turned = i > j
        return cls(
            i=np.where(turned, j, i),
            j=np.where(turned, i, j),
            z=np.where(turned[:, None], invert(z), z),
        )

    def parts(self, graph: Graph) -> tuple[IntArray, IntArray]:
        """(L,) and (L,) the parts that the older and the newer end belong to."""
        return graph.parts[self.i], graph.parts[self.j]


def rows_every(path: FloatArray, every_m: float) -> list[int]:
    """Rows of a path (M,) to look around at: each the first that is `every_m` past the last."""
    chosen, visited_m = [], 0.0
    for row, way_m in enumerate(path.tolist()):
        if way_m - visited_m >= every_m:
            chosen.append(row)
            visited_m = way_m
    return chosen
