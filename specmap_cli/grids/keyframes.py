"""Keyframes: which scans go on to mapping, their store on disk, and which a map can do without.

Every scan is registered. Only those taken after the robot moved or turned are kept, and their
readings go to a temporary file: in memory a keyframe takes 88 bytes, however many beams its scan
has.

A place is shown well by as many scans as it takes for every cell of a surface to be hit, as far as
the grid reaches. Where newer recordings have so many from the same place, in the same direction,
older ones add nothing, but for walls that nobody else looks at.
"""

from __future__ import annotations

import math
import os
import tempfile
from array import array
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from itertools import pairwise, product

import numpy as np

from specmap_cli.core.files import temporary_files
from specmap_cli.core.geometry import FloatArray, Pose2, compose, moved, wrap_angles
from specmap_cli.core.odometry import Slack
from specmap_cli.core.records import BoolArray, IntArray, PlanarScan, PosedScan
from specmap_cli.core.settings import GridConfig, KeyframeConfig
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.grids.occupancy import OccupancyGrid

_AT_ONCE = 32  # keyframes read and integrated in one go: bounds the memory, and fits a cache
# A pass leaves some six keyframes in a place, so that two or three passes are taken in whole.
PLACE_M, DIRECTION_RAD, ENOUGH_VIEWS = 0.5, math.pi / 6.0, 16
_READING = np.dtype(np.float32)  # a bearing or a range on disk: good to a micrometre in 10 m

_ROUNDING = 1e-9  # of shares that add up to one
_LASER_M = 1.0  # how far from the middle of the robot a laser may stand
_STRIDE = 8  # neighbours show the same: first one of so many is asked, then the others


class KeyframeSelector:
    """Accepts a scan when the robot moved or turned enough since the last accepted one."""

    def __init__(self, config: KeyframeConfig) -> None:
        self.config = config
        self._last: Pose2 | None = None

    def accepts(self, scan: PosedScan) -> bool:
        """Whether `scan` is a keyframe; lost scans never are, the first after them always is."""
        if scan.lost:
            return False
        last = None if scan.restarted else self._last
        if not moved(last, scan.map_from_base, self.config.distance_m, self.config.angle_rad):
            return False
        self._last = scan.map_from_base
        return True


def integrate_keyframes(
    store: KeyframeStore,
    numbers: Sequence[int],
    poses: FloatArray,
    config: GridConfig,
    starts: Collection[int] = (),
) -> OccupancyGrid:
    """A grid of keyframes `numbers` (n,) of the store taken at `poses` (n, 3), grid from base.

    `refused` of the result counts the scans that reach beyond the largest grid allowed. A robot
    that patrols sees a place again and again: see `informative`. Recordings after the first one
    begin with the keyframes `starts`; then the numbers ascend, and what a later recording looked at
    often enough is as that one saw it.
    """
    whole = OccupancyGrid(config)
    taken = list(zip(numbers, poses, strict=True))
    bounds = np.searchsorted(numbers, sorted(starts)).tolist()
    for first, end in pairwise([0, *bounds, len(taken)]):
        grid = OccupancyGrid(config) if first else whole
        chosen = first + informative(poses[first:end])
        add_keyframes(grid, store, [taken[place][0] for place in chosen.tolist()], poses[chosen])
        if first:
            whole.include(grid, renewing=True)
    return whole


def informative(poses: FloatArray) -> IntArray:
    """Which of the poses (n, 3) say enough about a map between them, ascending (k,).

    Of those that look from one place, half a metre wide, into one direction, a twelfth of a turn,
    sixteen, evenly spread. A cell's share of hits is known from so many, and the work that a map
    takes follows the building, however often the robot drives through it.
    """
    looks = np.floor(poses / (PLACE_M, PLACE_M, DIRECTION_RAD)).astype(np.int64)
    _, look, counts = np.unique(looks, axis=0, return_inverse=True, return_counts=True)
    order = np.argsort(look.reshape(-1), kind="stable")
    place = np.arange(len(poses)) - np.repeat(np.cumsum(counts) - counts, counts)
    many = np.maximum(np.repeat(counts, counts), ENOUGH_VIEWS)
    told = (place + 1) * ENOUGH_VIEWS // many > place * ENOUGH_VIEWS // many
    return np.sort(order[told])


def add_keyframes(
    grid: OccupancyGrid, store: KeyframeStore, numbers: Iterable[int], poses: FloatArray
) -> None:
    """Add keyframes `numbers` of the store, taken at `poses` (n, 3), to a grid."""
    taken = list(zip(numbers, poses, strict=True))
    for first in range(0, len(taken), _AT_ONCE):
        some, at = zip(*taken[first : first + _AT_ONCE], strict=True)
        lasers = compose(np.array(at), np.array([store.base_from_laser(k) for k in some]))
        grid.integrate([store.scan(k) for k in some], lasers, np.array(at))


@dataclass(frozen=True, slots=True)
class _Laser:
    """What the scans of one laser have in common."""

    range_max: float
    full_circle: bool
    base_from_laser: Pose2


class KeyframeStore:
    """Keyframes by number 0, 1, ...: scans on disk, poses in memory. Close it, or use `with`.

    Memory grows by 88 bytes a keyframe, not by its beams.
    """

    def __init__(self) -> None:
        with temporary_files():
            self._file = tempfile.TemporaryFile(prefix="specmap-")  # noqa: SIM115 (closed by close)
        self._stamps_ns, self._poses = array("q"), array("d")
        self._guessed, self._slacks = array("d"), array("d")
        # readings of each in the file, bearings and then ranges: where they begin, and their bytes
        self._begins, self._bytes = array("q"), array("q")
        self._lasers: dict[_Laser, _Laser] = {}  # one of equal ones
        self._laser_of: list[_Laser] = []

    def append(self, scan: PosedScan) -> int:
        """Store one keyframe and return its number. UsageError when there is no room for it."""
        planar = scan.planar
        laser = _Laser(planar.range_max, planar.full_circle, scan.base_from_laser)
        readings = np.stack([planar.bearings, planar.ranges]).astype(_READING)
        with temporary_files():
            self._begins.append(self._file.tell())
            self._file.write(readings.tobytes())
            self._file.flush()  # a process forked from this one must not write it again
        self._stamps_ns.append(scan.stamp_ns)
        self._poses.extend(scan.map_from_base)
        self._guessed.extend(scan.guessed_m)
        self._slacks.extend(scan.odometry_slacks)
        self._bytes.append(readings.nbytes)
        self._laser_of.append(self._lasers.setdefault(laser, laser))
        return len(self) - 1

    def extend(self, other: KeyframeStore) -> None:
        """Store all keyframes of another store behind the own ones, in their order."""
        for number in range(len(other)):
            self.append(other.posed(number))

    def keep(self, numbers: IntArray, poses: FloatArray) -> None:
        """Keep the keyframes `numbers` (k,), ascending, alone: they get the numbers 0, 1, ... anew.

        `poses` (k, 3) are theirs as registered from now on. The readings of the others stay in the
        file until it is closed.
        """
        for column in (self._stamps_ns, self._begins, self._bytes):
            column[:] = array(column.typecode, np.array(column)[numbers].tolist())
        self._laser_of = [self._laser_of[number] for number in numbers.tolist()]
        self._poses = array("d", np.ascontiguousarray(poses).tobytes())
        self._guessed = array("d", self.guessed_m[numbers].tobytes())
        self._slacks = array("d", self.odometry_slacks[numbers].tobytes())

    def __len__(self) -> int:
        return len(self._stamps_ns)

    @property
    def poses(self) -> FloatArray:
        """(n, 3) map_from_base as registered, metres and radians."""
        return self.poses_of(range(len(self)))

    @property
    def guessed_m(self) -> FloatArray:
        """(n, 2) how far off what was guessed up to each keyframe may be, see `PosedScan`."""
        return np.array(self._guessed).reshape(-1, 2)

    @property
    def odometry_slacks(self) -> FloatArray:
        """(n, 3) how far odometry may be off at each keyframe, see `PosedScan`."""
        return np.array(self._slacks).reshape(-1, 3)

    @property
    def stamps_ns(self) -> IntArray:
        """(n,) header stamp of each keyframe."""
        return np.array(self._stamps_ns, dtype=np.int64)

    def poses_of(self, numbers: Sequence[int]) -> FloatArray:
        """(n, 3) map_from_base of some keyframes as registered."""
        if not len(numbers):
            return np.zeros((0, 3))
        return np.array(np.frombuffer(self._poses).reshape(-1, 3)[np.asarray(numbers)])

    def pose(self, number: int) -> Pose2:
        """map_from_base of one keyframe as registered."""
        return Pose2(*self._poses[3 * number : 3 * number + 3])

    def scan(self, number: int) -> PlanarScan:
        """The planar scan of one keyframe, read from disk, without the times of its beams."""
        # the file's own place, which forked processes share, stays
        data = os.pread(self._file.fileno(), self._bytes[number], self._begins[number])
        readings = np.frombuffer(data, dtype=_READING)
        bearings, ranges = readings.astype(np.float64).reshape(2, -1)
        laser = self._laser_of[number]
        stamp_ns = self._stamps_ns[number]
        return PlanarScan(stamp_ns, bearings, ranges, laser.range_max, laser.full_circle)

    def posed(self, number: int) -> PosedScan:
        """One keyframe as it was registered."""
        return PosedScan(
            index=number,
            stamp_ns=self._stamps_ns[number],
            map_from_base=self.pose(number),
            planar=self.scan(number),
            base_from_laser=self.base_from_laser(number),
            guessed_m=(self._guessed[2 * number], self._guessed[2 * number + 1]),
            odometry_slacks=Slack(*self._slacks[3 * number : 3 * number + 3]),
        )

    def base_from_laser(self, number: int) -> Pose2:
        """Mounting of the laser of one keyframe."""
        return self._laser_of[number].base_from_laser

    def points(self, number: int, max_range: float = np.inf) -> FloatArray:
        """Returns (N, 2) of one keyframe in the base frame."""
        return self.base_from_laser(number).apply(self.scan(number).hits(max_range))

    def close(self) -> None:
        """Delete the file."""
        with suppress(OSError):  # a full disk refuses the last bytes
            self._file.close()

    def __enter__(self) -> KeyframeStore:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def views_needed(scan: PlanarScan, config: GridConfig) -> int:
    """How many scans from one place show every cell of a surface, as far as the grid reaches.

    There two beams of a scan are as many cells apart, at most; and no cell needs more than
    `ENOUGH_VIEWS`.
    """
    spacing = float(scan.bearings[-1] - scan.bearings[0]) / max(len(scan.bearings) - 1, 1)
    reach_m = min(scan.range_max, config.max_range_m)
    return min(ENOUGH_VIEWS, max(1, math.ceil(reach_m * spacing / config.resolution_m)))


@dataclass(frozen=True, slots=True, kw_only=True)
class Recorded:
    """Keyframes at `poses` (n, 3) of the recordings `of` (n,), 0, 1, ... in the order of adding.

    For each recording: `enough` (R,) scans of it show a place, and whether these look `all_round`
    (R,), so that it does not matter which way the robot faced.
    """

    poses: FloatArray
    of: IntArray
    enough: IntArray
    all_round: BoolArray


def repeated(recorded: Recorded, needed: BoolArray) -> BoolArray:
    """(n,) the keyframes that the map can do without, none of those `needed` (n,) for themselves.

    The last recording was there, and it and the ones between, of what is kept of them, were there
    often enough.
    """
    from scipy.spatial import cKDTree  # slow to load, and only an update asks

    gone = np.zeros(len(needed), dtype=bool)
    last = len(recorded.enough) - 1
    for recording in reversed(range(last)):
        own = np.flatnonzero((recorded.of == recording) & ~needed)
        newer = np.flatnonzero((recorded.of > recording) & ~gone)
        if not len(own) or not len(newer):
            continue
        # pairs that look alike: places in `own`, and numbers of newer ones
        places, there = (cKDTree(recorded.poses[some, :2]) for some in (own, newer))
        found = places.sparse_distance_matrix(there, PLACE_M, output_type="ndarray")
        old, new = found["i"].astype(np.int64), newer[found["j"]]
        turn = np.abs(wrap_angles(recorded.poses[own[old], 2] - recorded.poses[new, 2]))
        alike = recorded.all_round[recorded.of[new]] | (turn <= DIRECTION_RAD)
        old, new = old[alike], new[alike]
        share = np.bincount(old, 1.0 / recorded.enough[recorded.of[new]], len(own))
        again = np.bincount(old, recorded.of[new] == last, len(own))
        gone[own[(again > 0) & (share >= 1.0 - _ROUNDING)]] = True
    return gone


def sole_views(
    store: KeyframeStore,
    gone: BoolArray,
    poses: FloatArray,
    walls: GridMap,
    unseen: BoolArray,
    max_range_m: float,
) -> IntArray:
    """Those of the keyframes `gone` (n,) that show walls which no other one shows, ascending (k,).

    The first n keyframes of the store stood at `poses` (n, 3) in the map of the grid `walls`; its
    cells `unseen` (H, W) are those of walls that recordings after these did not look at. Of several
    that show such a wall the last one stays.
    """
    shown = partial(_shown, store, poses, walls, max_range_m)
    claims, left = {}, np.asarray(unseen).copy()
    for number, cells in shown(np.flatnonzero(gone)[::-1], left):
        claims[number] = cells[left[cells[:, 0], cells[:, 1]]]
    claimed = np.zeros(unseen.shape, dtype=bool)
    for cells in claims.values():
        claimed[cells[:, 0], cells[:, 1]] = True
    others = np.flatnonzero(~gone)
    for _ in shown(others[np.argsort(others % _STRIDE, kind="stable")], claimed):
        pass  # what others show is claimed no more
    stay = [number for number, cells in claims.items() if claimed[cells[:, 0], cells[:, 1]].any()]
    return np.array(sorted(stay), dtype=np.int64)


def _shown(
    store: KeyframeStore,
    poses: FloatArray,
    walls: GridMap,
    max_range_m: float,
    numbers: IntArray,
    wanted: BoolArray,
) -> Iterator[tuple[int, IntArray]]:
    """Keyframes, in turn, that hit cells `wanted` (H, W) by then; these are wanted no more."""
    from scipy.spatial import cKDTree  # slow to load, and only an update asks

    centres = walls.centres_of(np.argwhere(wanted))
    if not len(centres) or not len(numbers):
        return
    reach_m = max_range_m + _LASER_M
    away = cKDTree(centres).query(poses[numbers, :2], distance_upper_bound=reach_m)[0]
    for number in numbers[np.isfinite(away)].tolist():
        hits = Pose2(*poses[number].tolist()).apply(store.points(number, max_range_m))
        cells = walls.cells_of(hits)
        cells = cells[walls.inside(cells)]
        if wanted[cells[:, 0], cells[:, 1]].any():
            yield number, cells
            rows, columns = wanted.shape
            for down, right in product((-1, 0, 1), repeat=2):
                down_to = np.clip(cells[:, 0] + down, 0, rows - 1)
                wanted[down_to, np.clip(cells[:, 1] + right, 0, columns - 1)] = False
            if not wanted.any():
                return
