"""Keyframes: which scans go on to mapping, and their store on disk.

Every scan is registered. Only those taken after the robot moved or turned are kept, and their
readings go to a temporary file: in memory a keyframe takes 48 bytes, however many beams its scan
has.
"""

from __future__ import annotations

import math
import os
import tempfile
from array import array
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from types import TracebackType
from typing import IO

import numpy as np

from specmap_cli.core.files import temporary_files
from specmap_cli.core.geometry import FloatArray, Pose2, compose, moved
from specmap_cli.core.records import IntArray, PlanarScan, PosedScan
from specmap_cli.core.settings import GridConfig, KeyframeConfig
from specmap_cli.grids.occupancy import OccupancyGrid

_AT_ONCE = 32  # keyframes read and integrated in one go: bounds the memory, and fits a cache
# A pass leaves some six keyframes in a place, so that two or three passes are taken in whole.
PLACE_M, DIRECTION_RAD, LOOKS = 0.5, math.pi / 6.0, 16
_READING = np.dtype(np.float32)  # a bearing or a range on disk: good to a micrometre in 10 m


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
    store: KeyframeStore, numbers: Iterable[int], poses: FloatArray, config: GridConfig
) -> OccupancyGrid:
    """A grid of keyframes `numbers` of the store taken at `poses` (n, 3), grid frame from base.

    `refused` of the result counts the scans that reach beyond the largest grid allowed. A robot
    that patrols sees a place again and again: see `telling`.
    """
    grid = OccupancyGrid(config)
    taken = list(zip(numbers, poses, strict=True))
    chosen = telling(np.asarray(poses))
    add_keyframes(grid, store, [taken[place][0] for place in chosen.tolist()], poses[chosen])
    return grid


def telling(poses: FloatArray) -> IntArray:
    """Which of the poses (n, 3) say enough about a map between them, ascending (k,).

    Of those that look from one place, half a metre wide, into one direction, a twelfth of a turn,
    sixteen, evenly spread. A cell's share of hits is known from so many, and the work that a map
    takes follows the building, however often the robot drives through it.
    """
    looks = np.floor(poses / (PLACE_M, PLACE_M, DIRECTION_RAD)).astype(np.int64)
    _, look, counts = np.unique(looks, axis=0, return_inverse=True, return_counts=True)
    order = np.argsort(look.reshape(-1), kind="stable")
    place = np.arange(len(poses)) - np.repeat(np.cumsum(counts) - counts, counts)
    many = np.maximum(np.repeat(counts, counts), LOOKS)
    told = (place + 1) * LOOKS // many > place * LOOKS // many
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

    Memory grows by 48 bytes a keyframe, not by its beams.
    """

    def __init__(self) -> None:
        with temporary_files():
            self._file = tempfile.TemporaryFile(prefix="specmap-")  # noqa: SIM115 (closed by close)
        self._stamps_ns, self._poses = array("q"), array("d")
        # readings of each in the file, bearings and then ranges: where they begin, and their bytes
        self._begins, self._bytes = array("q"), array("q")
        self._lasers: list[_Laser] = []
        self._number_of: dict[_Laser, int] = {}
        self._laser_of = array("l")  # the number of each one's laser

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
        self._bytes.append(readings.nbytes)
        if laser not in self._number_of:
            self._number_of[laser] = len(self._lasers)
            self._lasers.append(laser)
        self._laser_of.append(self._number_of[laser])
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
        for column in (self._stamps_ns, self._begins, self._bytes, self._laser_of):
            column[:] = array(column.typecode, np.array(column)[numbers].tolist())
        self._poses = array("d", np.ascontiguousarray(poses).tobytes())

    def __len__(self) -> int:
        return len(self._stamps_ns)

    @property
    def poses(self) -> FloatArray:
        """(n, 3) map_from_base as registered, metres and radians."""
        return self.poses_of(range(len(self)))

    @property
    def stamps_ns(self) -> tuple[int, ...]:
        """Header stamp of each keyframe."""
        return tuple(self._stamps_ns)

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
        data = _read_at(self._file, self._begins[number], self._bytes[number])
        readings = np.frombuffer(data, dtype=_READING)
        bearings, ranges = readings.astype(np.float64).reshape(2, -1)
        laser = self._laser(number)
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
        )

    def base_from_laser(self, number: int) -> Pose2:
        """Mounting of the laser of one keyframe."""
        return self._laser(number).base_from_laser

    def _laser(self, number: int) -> _Laser:
        return self._lasers[self._laser_of[number]]

    def points(self, number: int, max_range: float = np.inf) -> FloatArray:
        """Returns (N, 2) of one keyframe in the base frame."""
        return self.base_from_laser(number).apply(self.scan(number).hits(max_range))

    def close(self) -> None:
        """Delete the file."""
        with suppress(OSError):  # a full disk refuses the last bytes
            self._file.close()

    def __enter__(self) -> KeyframeStore:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


def _read_at(file: IO[bytes], offset: int, size: int) -> bytes:
    """Bytes of a file; its place, which forked processes share, stays where it is."""
    if hasattr(os, "pread"):
        return os.pread(file.fileno(), size, offset)
    file.seek(offset)  # no such call on this system, which does not fork either
    data = file.read(size)
    file.seek(0, os.SEEK_END)
    return data
