"""keyframes.mcap: the keyframes of a map as a recording, written and read back.

It is an ordinary recording in the frames of ROS's REP 105, so that any tool opens it. `odom` ->
`base_link` is each pose as registered, `map` -> `odom` what the layout corrects of it. The i-th
scan is keyframe i. Log times rise from scan to scan, whatever the stamps do, to keep that order.

A message has evenly spaced beams. A laser's own scans have them already. Those taken in motion do
not once they are de-skewed: each beam of the message then takes the reading nearest to its bearing.
A scan that has all bearings of a circle, but whose sensor does not look all around, goes without
those it never looked at.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from specmap_cli.core.errors import TOO_LARGE, LogError, MapError
from specmap_cli.core.geometry import FloatArray, Pose2, compose, invert
from specmap_cli.core.records import IntArray, PlanarScan, PosedScan
from specmap_cli.core.settings import LimitsConfig
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.logs.messages import BadMessageError, CloudRecord, decode_scan, decode_transforms
from specmap_cli.logs.planar import covers_circle, increment
from specmap_cli.logs.readers.encoding import (
    LASER_SCAN,
    TF_MESSAGE,
    TF_STATIC,
    Transform,
    in_space,
    scan_cdr,
    transforms_cdr,
)
from specmap_cli.logs.readers.mcap import McapFile
from specmap_cli.logs.readers.recording import Message

SCAN_TOPIC, TF = "/scan", "/tf"
_HEADING_DECIMALS = 12  # of a mounting: its quaternion does not keep the last bits
MAP_FRAME, ODOM_FRAME, BASE_FRAME, LASER_FRAME = "map", "odom", "base_link", "laser"
# Poses are kept to a micrometre and a quarter of a microradian, in powers of two, of which most
# bytes are zero and cost nothing. Ranges are kept to a millimetre: no laser of a robot is finer.
_PER_UNIT, _MM_PER_M = np.array([2.0**20, 2.0**20, 2.0**22]), 1000.0


def write_keyframes(path: Path, store: KeyframeStore, poses: FloatArray) -> None:
    """Write all keyframes of a store, which lie at `poses` (n, 3) in the finished map.

    Raises UsageError when the file cannot be written.
    """
    from specmap_cli.logs.writer import LogWriter  # who reads a map needs none

    odom_from_base = _cut(store.poses)
    map_from_odom = _cut(compose(poses, invert(odom_from_base)))
    links = (MAP_FRAME, ODOM_FRAME), (ODOM_FRAME, BASE_FRAME)
    chains = zip(_in_space(map_from_odom), _in_space(odom_from_base), strict=True)
    stamps = store.stamps_ns.tolist()
    lasers: dict[Pose2, tuple[str, EvenSpacing]] = {}  # each has a frame of its own
    with LogWriter(path) as log:
        for base_from_laser in map(store.base_from_laser, range(len(store))):
            if base_from_laser not in lasers:
                frame = f"{LASER_FRAME}_{len(lasers) + 1}" if lasers else LASER_FRAME
                lasers[base_from_laser] = frame, EvenSpacing()
                x, y, theta = base_from_laser
                pose = in_space((x, y, round(theta, _HEADING_DECIMALS)))
                mounting = Transform(BASE_FRAME, frame, *pose)
                start_ns = stamps[0]
                log.raw(TF_STATIC, TF_MESSAGE, transforms_cdr(start_ns, [mounting]), start_ns)
        time_ns = -1
        for number, (stamp_ns, chain) in enumerate(zip(stamps, chains, strict=True)):
            time_ns = max(stamp_ns, time_ns + 1)
            moved = [Transform(*link, *motion) for link, motion in zip(links, chain, strict=True)]
            log.raw(TF, TF_MESSAGE, transforms_cdr(stamp_ns, moved), time_ns)
            frame, spacing = lasers[store.base_from_laser(number)]
            scan = store.scan(number)
            even = spacing.beams(scan)
            data = scan_cdr(
                frame,
                scan.stamp_ns,
                even.angle_min,
                even.increment,
                np.round(even.ranges * _MM_PER_M) / _MM_PER_M,
                range_max=scan.range_max,
            )
            log.raw(SCAN_TOPIC, LASER_SCAN, data, time_ns)


def _cut(poses: FloatArray) -> FloatArray:
    """Poses (n, 3) with the digits that the file keeps."""
    return np.asarray(np.round(poses * _PER_UNIT) / _PER_UNIT)


def _in_space(poses: FloatArray) -> Iterator[tuple[list[float], list[float]]]:
    """Places and quaternions of poses (n, 3), these in single precision: half as many bytes."""
    for pose in poses:
        place, turn = in_space(Pose2(*pose.tolist()))
        yield list(place), np.array(turn, dtype=np.float32).tolist()


def read_keyframes(
    path: Path, most: int, limits: LimitsConfig | None = None, wanted: IntArray | None = None
) -> KeyframeStore:
    """The keyframes of a map, `most` or fewer, with poses as registered: close the store after use.

    Of the numbers `wanted` alone, if given: the others are not decoded. They pass through a
    temporary file, as in a build. Raises MapError for a file that is missing, damaged or beyond its
    limits, UsageError when there is no room for the temporary file.
    """
    most_mb = (LimitsConfig() if limits is None else limits).keyframes_max_mb
    try:
        size, regular = path.stat().st_size, path.is_file()
    except OSError as error:
        raise MapError.of_system(error, "cannot read the keyframes", where=path) from None
    if not regular:
        raise MapError.damaged("not a regular file", path)
    if size > most_mb * 1e6:
        raise MapError(
            f"larger than {most_mb:g} MB",
            "if it is meant, raise limits.keyframes_max_mb",
            mark=";",
            where=path,
            code=TOO_LARGE,
        )
    store = KeyframeStore()
    try:
        for scan in _scans(path, None if wanted is None else set(wanted.tolist())):
            if len(store) == most:
                raise MapError.damaged(f"has more than {most:,} scans", path)
            store.append(scan)
    except BaseException:
        store.close()
        raise
    return store


def _scans(path: Path, wanted: Collection[int] | None) -> Iterator[PosedScan]:
    """The keyframes in a file, one in memory at a time; MapError for what is not whole."""
    try:
        with closing(McapFile(path)) as recording:
            yield from _posed(recording.messages([TF_STATIC, TF, SCAN_TOPIC]), wanted)
            if recording.damage:
                found = recording.damage[0].removeprefix(f"{path}: ")
                raise MapError.damaged(found, path)
    except (LogError, BadMessageError) as error:
        found = str(error).removeprefix(f"{path}: ")
        raise MapError.damaged(found, path) from None


def _posed(messages: Iterable[Message], wanted: Collection[int] | None) -> Iterator[PosedScan]:
    """Scans with their poses and mountings, which come in messages of their own."""
    lasers: dict[str, Pose2] = {}
    moved: Message | None = None  # the transforms before a scan
    pose: tuple[int, Pose2] | None = None  # with its stamp
    number = -1
    for message in messages:
        if message.topic == TF:
            moved = message
            continue
        if message.topic != SCAN_TOPIC:
            for each in decode_transforms(message)[0]:
                x, y, theta = Pose2.from_matrix(each.parent_from_child)
                lasers[each.child] = Pose2(x, y, round(theta, _HEADING_DECIMALS))
            continue
        number += 1
        if wanted is not None and number not in wanted:
            continue
        for each in decode_transforms(moved)[0] if moved is not None else ():
            if each.child == BASE_FRAME:
                pose = each.stamp_ns, Pose2.from_matrix(each.parent_from_child)
        moved = None
        record = decode_scan(message)
        if isinstance(record, CloudRecord):
            raise BadMessageError(f"scan {number} is a cloud")
        if pose is None or pose[0] != record.stamp_ns:
            raise BadMessageError(f"scan {number} has no pose")
        if record.frame not in lasers:
            raise BadMessageError(f"scan {number} is of no known laser: {record.frame!r}")
        beams, step = record.layout.beams, increment(record.layout)
        placed = _cut(np.array(pose[1]))  # as it was before its quaternion was cut
        yield PosedScan(
            index=number,
            stamp_ns=record.stamp_ns,
            map_from_base=Pose2(*placed.tolist()),
            planar=PlanarScan(  # the ranges mean what they do in the message
                stamp_ns=record.stamp_ns,
                bearings=record.layout.angle_min + step * np.arange(beams, dtype=np.float64),
                ranges=record.ranges.astype(np.float64),
                range_max=record.range_max,
                full_circle=covers_circle(beams, step),
            ),
            base_from_laser=lasers[record.frame],
        )


_FULL_CIRCLE = 2.0 * math.pi
_EVEN_RAD = 1e-5  # a fifth of a millimetre at 20 m; single precision alone takes a thirtieth of it


@dataclass(frozen=True, slots=True)
class EvenBeams:
    """Beams from `angle_min` on, `increment` apart, radians, and what each met, `ranges` (B,).

    The angles are of single precision, as in a message.
    """

    angle_min: float
    increment: float
    ranges: FloatArray


class EvenSpacing:
    """Evenly spaced beams for the scans of one laser, one after the other.

    A scan that is not evenly spaced is put on the bearings of the last one with as many beams that
    was, so that the laser's field of view stays what it is while the robot turns.
    """

    def __init__(self) -> None:
        self._known: dict[int, FloatArray] = {}  # evenly spaced bearings by their number

    def beams(self, scan: PlanarScan) -> EvenBeams:
        """The scan with evenly spaced beams."""
        bearings, ranges = scan.bearings, scan.ranges
        count, step = len(bearings), _step(bearings)
        known = self._known.get(count)
        if known is None or not np.array_equal(known, bearings):
            first, numbers = float(bearings[0]), np.arange(count, dtype=np.float64)
            if np.abs(bearings - (first + step * numbers)).max() <= _EVEN_RAD:
                self._known[count] = bearings
            else:
                over_view = _FULL_CIRCLE / count if scan.full_circle else step
                bearings = first + over_view * numbers if known is None else known
                ranges, step = _nearest(scan, bearings), _step(bearings)
        if not scan.full_circle and covers_circle(count, step):
            bearings, ranges = _looked_at(bearings, ranges)
        return EvenBeams(float(np.float32(bearings[0])), float(np.float32(step)), ranges)


def _step(bearings: FloatArray) -> float:
    """The angle from beam to beam; 0 for a single one."""
    return float(bearings[-1] - bearings[0]) / max(len(bearings) - 1, 1)


def _nearest(scan: PlanarScan, bearings: FloatArray) -> FloatArray:
    """The reading nearest to each of evenly spaced bearings, NaN where none is within a beam."""
    known, ranges = scan.bearings, scan.ranges
    if scan.full_circle:
        known = np.concatenate([known[-1:] - _FULL_CIRCLE, known, known[:1] + _FULL_CIRCLE])
        ranges = np.concatenate([ranges[-1:], ranges, ranges[:1]])
    after = np.clip(np.searchsorted(known, bearings), 1, max(len(known) - 1, 1))
    after -= np.abs(known[after - 1] - bearings) <= np.abs(known[after] - bearings)
    within = np.abs(known[after] - bearings) <= _step(bearings)
    return np.where(within, ranges[after], np.nan)


def _looked_at(bearings: FloatArray, ranges: FloatArray) -> tuple[FloatArray, FloatArray]:
    """A circle of beams without the longest run that saw nothing: the first, two beams at least."""
    count, seen = len(ranges), np.flatnonzero(~np.isnan(ranges))
    start, length = 0, count
    if len(seen):
        lengths = np.diff(seen, append=seen[0] + count) - 1
        longest = int(np.argmax(lengths))
        start, length = int(seen[longest] + 1) % count, int(lengths[longest])
    kept = max(count - max(length, 2), 1)
    order = np.roll(np.arange(count), -(start + length))[:kept]
    turned = np.where(order < order[0], bearings[order] + _FULL_CIRCLE, bearings[order])
    return turned, ranges[order]
