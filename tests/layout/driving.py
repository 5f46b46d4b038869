"""A ring of corridor to drive in, and graphs made by hand."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import pairwise

import numpy as np

from specmap_cli.core.geometry import IDENTITY, FloatArray, Pose2, compose, invert
from specmap_cli.core.records import PlanarScan, PosedScan
from specmap_cli.core.settings import RelaxationConfig
from specmap_cli.grids.gridmap import FREE, OCCUPIED, GridMap
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.layout.path_graph import Bridge, Draft, Graph
from specmap_cli.layout.pose_graph import Link, LinkKind
from specmap_cli.layout.relaxation import relax
from specmap_cli.layout.result import Layout
from tests.casting import keyframe, ranges_at, store_of
from tests.turning import turned

CONFIG = RelaxationConfig()
Drive = tuple[FloatArray, list[PlanarScan]]  # true poses, and the scans taken there
Laps = tuple[KeyframeStore, Graph]
SECOND_LAP = 480  # keyframe with which it begins

STIFF = np.diag([1 / 0.04**2, 1 / 0.04**2, 1 / 0.01**2])
SOFT = np.diag([1 / 0.05**2, 1 / 0.05**2, 1 / 0.03**2])


def building() -> GridMap:
    """A ring of corridor, 17 m x 13 m and 2 m wide, with rooms of all sizes off it."""
    cells = np.full((300, 380), OCCUPIED, dtype=np.uint8)
    cells[30:270, 30:350] = FREE
    cells[70:230, 70:310] = OCCUPIED
    for bottom, top, left, right in (
        (66, 110, 90, 130),  # off the lower corridor
        (66, 140, 170, 190),
        (66, 90, 220, 300),
        (190, 234, 80, 180),  # off the upper one
        (210, 234, 240, 260),
        (120, 160, 60, 110),  # off the left one
        (4, 34, 60, 100),  # outwards
        (4, 34, 200, 215),
        (10, 34, 250, 330),
        (266, 290, 100, 160),
        (266, 296, 280, 300),
        (120, 150, 346, 376),
        (200, 260, 346, 366),
        (90, 130, 8, 34),
    ):
        cells[bottom:top, left:right] = FREE
    return GridMap(cells, 0.05)


def round_trip() -> FloatArray:
    """True poses every 10 cm along the middle of the ring, one and a half laps."""
    corners = np.array([[2.5, 2.5], [16.5, 2.5], [16.5, 12.5], [2.5, 12.5]])
    poses = []
    for a, b in pairwise([*corners, *corners[:3]]):
        heading = float(np.arctan2(*(b - a)[::-1]))
        steps = int(np.hypot(*(b - a)) / 0.1)
        poses += [(*(a + (b - a) * k / steps), heading) for k in range(steps)]
    return np.array(poses)


def scans_of(grid: GridMap, poses: FloatArray, beams: int = 120) -> list[PlanarScan]:
    """What a noisy full-circle laser sees at true poses."""
    bearings = np.linspace(-np.pi, np.pi, beams, endpoint=False)
    rng = np.random.default_rng(0)
    return [
        PlanarScan(k * 10**8, bearings, ranges + rng.normal(0, 0.01, beams), 12.0, full_circle=True)
        for k, ranges in enumerate(ranges_at(grid, poses, bearings, 10.0))
    ]


def chained(first: FloatArray, steps: FloatArray) -> FloatArray:
    """Poses (N + 1, 3) from one to the next by steps (N, 3)."""
    poses = [first]
    for step in steps:
        poses.append(compose(poses[-1], step))
    return np.array(poses)


def drifted(truth: FloatArray, bias: float = 0.0003) -> FloatArray:
    """Tracked poses: each step turns a little too far."""
    return chained(truth[0], compose(invert(truth[:-1]), truth[1:]) + (0.0, 0.0, bias))


def moved_from(first: int, poses: FloatArray, motion: Sequence[float]) -> FloatArray:
    """The poses, those from the `first` on moved by a motion of the map."""
    return np.concatenate([poses[:first], compose(np.array(motion), poses[first:])])


def stored(tracked: FloatArray, scans: Sequence[PlanarScan]) -> KeyframeStore:
    return store_of(posed(tracked, scans))


def posed(tracked: FloatArray, scans: Sequence[PlanarScan]) -> list[PosedScan]:
    return [
        keyframe(scan, Pose2(*pose.tolist()), number=k)
        for k, (pose, scan) in enumerate(zip(tracked, scans, strict=True))
    ]


def laid_out(
    tracked: FloatArray,
    scans: Sequence[PlanarScan],
    closures: Sequence[Link] = (),
    breaks: Mapping[int, Bridge | None] | None = None,
) -> Layout:
    with stored(tracked, scans) as store:
        return relax(store, closures, breaks or {}, CONFIG)


def corridor(beams: int = 720) -> FloatArray:
    """What is seen in the middle of a bare corridor along x, 2 m wide and very long."""
    cells = np.full((60, 1000), OCCUPIED, dtype=np.uint8)
    cells[10:50] = FREE
    (scan,) = scans_of(GridMap(cells, 0.05), np.array([[25.0, 1.5, 0.0]]), beams)
    return scan.hits(6.0)


def worst(poses: FloatArray, truth: FloatArray) -> float:
    """Largest error of the place, seen from the first pose."""
    seen = compose(invert(poses[0]), poses)
    true = compose(invert(truth[0]), truth)
    return float(np.hypot(*(seen - true)[:, :2].T).max())


def between(poses: FloatArray, source: int, target: int) -> Pose2:
    """The target's pose in the frame of the source."""
    return Pose2(*compose(invert(poses[source]), poses[target]).tolist())


def link(
    source: int,
    target: int,
    motion: Sequence[float],
    kind: LinkKind = "nearby",
    information: FloatArray = STIFF,
) -> Link:
    """A link of the pose graph, stiff."""
    return Link(
        source=source,
        target=target,
        source_from_target=Pose2(*motion),
        information=information,
        kind=kind,
    )


def true_link(truth: FloatArray, source: int, target: int, kind: LinkKind = "nearby") -> Link:
    return link(source, target, between(truth, source, target), kind)


def closure(truth: FloatArray, source: int, target: int, off: Pose2 = IDENTITY) -> Link:
    """A closure that is right, or off by a motion of the place in the frame of its source."""
    motion = np.add(true_link(truth, source, target).source_from_target, off)
    return link(source, target, motion.tolist(), "closure")


def graph_by_hand(tracked: FloatArray, breaks: Collection[int] = ()) -> Graph:
    """The graph of tracked poses (n, 3), each a node; motions are as tracked."""
    odometry = tuple(
        link(k, k + 1, motion.tolist(), "loose" if k + 1 in breaks else "odometry", SOFT)
        for k, motion in enumerate(compose(invert(tracked[:-1]), tracked[1:]))
    )
    return Graph.of(tracked, np.arange(len(tracked)), odometry)


def as_tracked(graph: Graph, *loops: Link) -> Draft:
    """The draft in which nothing has moved yet."""
    return Draft(poses=graph.poses, loops=loops, tied=frozenset(graph.part_numbers))


def missed(truth: Pose2, found: Pose2) -> tuple[float, float]:
    """How far a pose is from the truth, metres and radians."""
    off = truth.inverse() @ found
    return off.distance, abs(off.theta)


def away_m(graph: Graph, claim: Link) -> float:
    """How far a claim would move its end, metres."""
    return missed(between(graph.tracked, claim.source, claim.target), claim.source_from_target)[0]


def arc(count: int, turn: float = 0.05) -> FloatArray:
    """Poses half a metre apart along a wide arc."""
    return chained(np.zeros(3), np.tile([0.5, 0.0, turn], (count - 1, 1)))


@contextmanager
def closures_alone() -> Iterator[None]:
    """No pass mends what closures do."""
    with turned("layout.passes", LOOPS_PER_NODE=0, _WIDE_EVERY_M=1e9):
        yield
