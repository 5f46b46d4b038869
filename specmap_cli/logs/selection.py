"""Choosing what to read, by a survey of the first messages: scans, odometry, frames, clock.

The tree of frames, and how the laser sits on the base, are found before scans are read.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import islice, pairwise

import numpy as np

from specmap_cli.core.errors import UsageError
from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.settings import LogConfig
from specmap_cli.core.text import legible, seconds
from specmap_cli.logs.clocks import Clock, OdometryKind, choose_clock, stamp_pairs
from specmap_cli.logs.messages import (
    BadMessageError,
    TransformRecord,
    decode_odometry,
    decode_transforms,
)
from specmap_cli.logs.opening import Log
from specmap_cli.logs.readers.encoding import NS_PER_S, ODOMETRY, TF_MESSAGE
from specmap_cli.logs.readers.recording import TopicInfo, time_text
from specmap_cli.logs.sensors import (
    TRIED_MESSAGES,
    Glance,
    ScanSensor,
    choose_scan_topic,
    choose_sensor,
    choose_topic,
    first_scans,
    glance,
    sensors_of,
    topics_beside,
)

_MAX_DEPTH = 100  # a longer chain of frames is a loop
_SAME_M, _SAME_RAD = 0.01, 0.0175  # two transforms that differ by less are one, measured twice


class TransformTree:
    """The latest transform of every frame from its parent; frames form a forest."""

    def __init__(self) -> None:
        self._edges: dict[str, TransformRecord] = {}  # by child
        self._first: dict[str, TransformRecord] = {}
        self._other: dict[str, TransformRecord] = {}  # the latest that is not as the first
        self.moving: set[str] = set()  # children of which a transform came on a dynamic topic

    def add(self, record: TransformRecord, *, dynamic: bool) -> None:
        """Take in one transform; a later one of the same child replaces it."""
        if record.parent == record.child:
            return
        self._edges[record.child] = record
        first = self._first.setdefault(record.child, record)
        if first.parent != record.parent:
            self._first[record.child] = record
            self._other.pop(record.child, None)
        elif not np.array_equal(first.parent_from_child, record.parent_from_child):
            self._other[record.child] = record
        if dynamic:
            self.moving.add(record.child)

    def changes(self, base: str, frame: str) -> Iterator[str]:
        """What is said of each transform between a frame and its base that is not always one."""
        for child in sorted({*self.ancestors(frame)} ^ {*self.ancestors(base)}):
            first, other = self._first[child], self._other.get(child)
            if other is None:
                continue
            off = np.linalg.inv(first.parent_from_child) @ other.parent_from_child
            turn = math.acos(float(np.clip((np.trace(off[:3, :3]) - 1.0) / 2.0, -1.0, 1.0)))
            shift_m = math.hypot(*off[:3, 3].tolist())
            if shift_m > _SAME_M or turn > _SAME_RAD:
                yield (
                    f"the transform {first.parent!r} -> {child!r} changes, by {shift_m:.2f} m and "
                    f"{math.degrees(turn):.0f} degrees: the laser is taken to sit on {base!r} "
                    "as the last one says; does it move, or do two robots name their frames alike?"
                )

    @property
    def frames(self) -> set[str]:
        """Every frame that occurs."""
        return set(self._edges) | {edge.parent for edge in self._edges.values()}

    def edges(self) -> list[TransformRecord]:
        """The transforms, by the name of the child; moving ones as they first were."""
        return [
            (self._first if child in self.moving else self._edges)[child]
            for child in sorted(self._edges)
        ]

    def ancestors(self, frame: str) -> Iterator[str]:
        """The frame and its parents up to the root."""
        for _ in range(_MAX_DEPTH):
            yield frame
            if frame not in self._edges:
                return
            frame = self._edges[frame].parent

    def lookup(self, target: str, source: str) -> FloatArray | None:
        """target_from_source (4, 4), None when no chain of transforms joins the frames."""
        above = list(self.ancestors(target))
        common = next((frame for frame in self.ancestors(source) if frame in above), None)
        if common is None:
            return None
        from_common = [np.eye(4), np.eye(4)]
        for number, frame in enumerate((target, source)):
            while frame != common:
                edge = self._edges[frame]
                from_common[number] = edge.parent_from_child @ from_common[number]
                frame = edge.parent
        up, down = from_common
        return np.asarray(np.linalg.inv(up) @ down)


_TILT_MAX_RAD = 0.175  # a planar laser, or the floor of clouds, that is tilted more is warned of
USUAL_BASES = ("base_link", "base_footprint", "base")  # by REP 105 and by custom
_FLOOR_FRAME = "base_footprint"  # by REP 120 the base's projection on the floor
_OPTICAL = ("_optical", "_optical_frame")  # of cameras: z looks ahead, x to the right (REP 103)
_STANDING = ("earth", "map", "world")  # no robot moves these, nor frames of odometry (REP 105)
_ABSURD_NAMED = 3  # transforms; with more of them the log is beyond help
_ENOUGH_MESSAGES = 2_000  # some seconds of transforms, in which every frame is heard of


def read_frames(
    log: Log,
    config: LogConfig,
    scan_topic: str = "",
    laser_frame: str = "",
    bases: Sequence[str] = (),
) -> tuple[TransformTree, list[str]]:
    """The frames of a log, by the first static and dynamic transforms, and warnings of these.

    The search goes on while none of `bases` is joined to the laser's frame, up to
    `config.transform_messages` of each kind. Reads only the topics of transforms that tell of the
    robot of a topic of scans.
    """
    tree = TransformTree()
    given_up, unreadable = False, 0
    absurd: dict[tuple[str, str], None] = {}  # in the order they were met
    for dynamic in (False, True):
        names = _transform_topics(log, scan_topic, dynamic=dynamic)
        for number, message in enumerate(log.messages(names) if names else ()):
            if number >= config.transform_messages:
                given_up = True
                break
            try:
                records, odd = decode_transforms(message)
            except BadMessageError:
                unreadable += 1
            else:
                for record in records:
                    tree.add(record, dynamic=dynamic)
                absurd.update(dict.fromkeys(odd))
            if number >= _ENOUGH_MESSAGES and _any_joined(tree, bases, laser_frame):
                break
    warnings = [
        f"the transform {parent!r} -> {child!r} is not finite or absurd, and was left out"
        for parent, child in list(absurd)[:_ABSURD_NAMED]
    ]
    if unreadable:
        warnings.append(f"messages of transforms that could not be read: {unreadable:,}")
    if given_up and not _any_joined(tree, bases, laser_frame):
        warnings.append(
            f"the laser's place was searched in the first {config.transform_messages:,} messages "
            "of transforms only: log.transform_messages says how many"
        )
    return tree, warnings


def _transform_topics(log: Log, scan_topic: str, *, dynamic: bool) -> list[str]:
    """The topics of transforms that tell of the robot of a topic of scans."""
    names = [topic.name for topic in topics_beside(log, {TF_MESSAGE}, scan_topic)]
    return [name for name in names if name.endswith("tf_static") != dynamic]


def usual_frames(names: Sequence[str], laser_frame: str) -> list[str]:
    """Frames of usual names that a laser may belong to, those of its own namespace first."""
    parts = laser_frame.split("/")[:-1]
    spaces = ["/".join(parts[:many]) + "/" for many in range(len(parts), 0, -1)]
    return [space + name for space in (*spaces, "") for name in names]


def _any_joined(tree: TransformTree, bases: Iterable[str], laser_frame: str) -> bool:
    return any(tree.lookup(base, laser_frame) is not None for base in bases)


def place_laser(
    tree: TransformTree,
    laser_frame: str,
    bases: Sequence[str],
    moving: str | None,
    asked: str | None,
    *,
    planar: bool = True,
) -> tuple[str, FloatArray, float | None, list[str]]:
    """The base frame, base_from_laser (4, 4) on it, the floor's height there, what was assumed.

    The height is None when it is unknown. The base is the first of `bases` that is joined to the
    laser's frame. Otherwise it is assumed: the frame `moving` in the odometry, or a usual one, or
    what carries the laser. Raises UsageError if one was `asked` for. Of a laser that is `planar` it
    is said that it is read as level.
    """
    joined = next((base for base in bases if tree.lookup(base, laser_frame) is not None), None)
    if joined is None and asked is not None:
        above = sorted({laser_frame, *tree.ancestors(laser_frame)})
        none = f"no transform joins it to the laser's frame {laser_frame!r}"
        hint, where = f"choose from {', '.join(above)}", f"--base-frame {bases[0]}"
        raise UsageError(none, legible(hint), mark=";", where=legible(where))
    carrier = joined or _carrier(tree, laser_frame)
    base = joined or moving or next((b for b in bases if b in tree.frames), carrier)
    base_from_laser = tree.lookup(carrier, laser_frame)
    assert base_from_laser is not None, "the carrier is joined to the laser"
    if not planar and carrier == laser_frame and laser_frame.endswith(_OPTICAL):
        base_from_laser[:3, :3] = [[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]
    floors = usual_frames((_FLOOR_FRAME,), laser_frame)
    heights = [tree.lookup(base, frame) for frame in floors if joined is not None]
    floor = next((float(one[2, 3]) for one in heights if one is not None), None)
    if floor is None and joined is not None:
        floor = 0.0
    warnings = list(tree.changes(carrier, laser_frame))
    tilt = math.acos(float(np.clip(base_from_laser[2, 2], -1.0, 1.0)))
    if planar and _TILT_MAX_RAD < tilt < np.pi - _TILT_MAX_RAD:
        warnings.append(
            f"the laser's frame {laser_frame!r} is tilted by {np.degrees(tilt):.0f} degrees "
            f"against {carrier!r}: a planar scan is read as if it were level"
        )
    if base != carrier:
        at_origin = f"the laser is taken to sit at the origin of {base!r}, looking ahead"
        told = at_origin if carrier == laser_frame else f"{carrier!r} is taken to be it"
        warnings.insert(
            0, f"no transform from {base!r} to the laser's frame {laser_frame!r}: {told}"
        )
    return base, base_from_laser, floor, warnings


def _carrier(tree: TransformTree, laser_frame: str) -> str:
    """The frame that odometry moves, by no name; else the highest that the laser is fixed to."""
    steps = list(pairwise(tree.ancestors(laser_frame)))
    for below, above in steps:
        if "odom" in above.lower() or above.rpartition("/")[2] in _STANDING:
            return below
    moved = next((below for below, _ in steps if below in tree.moving), None)
    return moved or (steps[-1][1] if steps else laser_frame)


_UNKNOWN_FLOOR = (
    "the lidar's tilt and height above the floor are unknown, as there is no transform "
    "from a base frame: each cloud is levelled by the floor that it shows"
)
_PARTS_OVERLAP_NS = 2_000_000_000  # parts of one recording may share a moment, not more


@dataclass(frozen=True, slots=True, kw_only=True)
class Selection:
    """What is read of a log: build, previews and `info` all go by it.

    `topic` is that of the scans, `sensor` the one of the `sensors` on it that is read, `clock` what
    stamps its scans. `band_m` is the height band of a 3D cloud in metres above the floor, None for
    planar scans and for clouds of planar lasers. `ceilings_m` are distances that stand for no
    return, as far as the first scans show. `base_from_laser` (4, 4) is the mounting, `floor_m` the
    height of the floor in the base frame, None when it is unknown. `odometry` says whether poses
    come from a topic, from transforms `odom_frame` -> `base_frame`, or not at all. `tree` are the
    transforms known beforehand.
    """

    topic: TopicInfo
    sensor: ScanSensor
    sensors: tuple[ScanSensor, ...]
    base_frame: str
    base_from_laser: FloatArray
    floor_m: float | None
    tree: TransformTree
    odometry: OdometryKind | None = None
    odom_topics: tuple[str, ...] = ()
    odom_frame: str | None = None
    clock: Clock = field(default_factory=Clock)
    band_m: tuple[float, float] | None = None
    ceilings_m: tuple[float, ...] = ()
    warnings: tuple[str, ...] = ()

    @property
    def in_space(self) -> bool:
        """Whether clouds are registered as they are, and not their planar scans.

        Floor and ceiling look the same wherever a robot goes: where odometry tells which way is up
        and how far it came, walls alone are the better guide.
        """
        return self.band_m is not None and self.odometry is None

    @property
    def note(self) -> str:
        """One line on what was chosen."""
        kind = self.topic.type.rpartition("/")[2]
        parts = [f"scans from {self.topic.name} ({kind}, {self.topic.count:,})"]
        if len(self.sensors) > 1:
            parts[0] += f" of sensor {self.sensor.name}"
        if self.band_m is not None:
            low, high = self.band_m
            alone = "" if self.in_space else ", registered by it alone"
            parts.append(f"height band {low:g} to {high:g} m above the floor{alone}")
        if self.odometry == "topic":
            parts.append(f"odometry from {self.odom_topics[0]}")
        elif self.odometry == "tf":
            parts.append(f"odometry from transforms {self.odom_frame} -> {self.base_frame}")
        else:
            parts.append("no odometry")
        parts.append(f"base frame {self.base_frame}")
        return legible(", ".join(parts))


def select(log: Log, config: LogConfig) -> Selection:
    """Choose by type, by the settings where they say, and by a look at the first messages.

    Raises LogError for a log without usable scans, and UsageError, with the choices ready to
    paste, when a topic or frame must be chosen or the chosen one is not there.
    """
    topic = choose_scan_topic(log, config.scan_topic)
    scans = first_scans(log, topic)
    sensors = tuple(sensors_of(scans))
    sensor = choose_sensor(log.name, topic.name, sensors, config)
    scans = [scan for scan in scans if sensor.made(scan)]
    odometry_topic = None
    if config.use_odometry:
        choice = config.odom_topic, "--odom-topic", "odometry"
        odometry_topic = choose_topic(log, {ODOMETRY}, *choice, topic.name)
    child = None  # the frame that moves, by the first message that can be read
    if odometry_topic is not None:
        for message in islice(log.messages([odometry_topic.name]), TRIED_MESSAGES):
            with suppress(BadMessageError):
                child = decode_odometry(message).child or None
                break
    usual = ([child] if child else []) + usual_frames(USUAL_BASES, sensor.frame)
    bases = usual if config.base_frame is None else [config.base_frame.lstrip("/")]
    tree, left_out = read_frames(log, config, topic.name, sensor.frame, bases)
    base, base_from_laser, floor_m, assumed = place_laser(
        tree, sensor.frame, bases, child, config.base_frame, planar=not sensor.is_cloud
    )
    shown = glance(log, topic, sensor, base_from_laser)
    floor_m, of_floor = _floor(shown, floor_m, base, config)
    odometry: OdometryKind | None = None
    topics: tuple[str, ...] = ()
    odom_frame = None
    if odometry_topic is not None:
        odometry, topics = "topic", (odometry_topic.name,)
    elif config.use_odometry:
        odom_frame = odometry_ancestor(tree, base)
        if odom_frame is not None:
            odometry, topics = "tf", tuple(_transform_topics(log, topic.name, dynamic=True))
    pairs = stamp_pairs(log, topic.name, sensor, topics, odom_frame)
    clock = choose_clock([(scan.stamp_ns, scan.time_ns) for scan in scans], pairs)
    return Selection(
        topic=topic,
        sensor=sensor,
        sensors=sensors,
        base_frame=base,
        base_from_laser=base_from_laser,
        floor_m=floor_m,
        tree=tree,
        odometry=odometry,
        odom_topics=topics,
        odom_frame=odom_frame,
        clock=clock,
        band_m=(config.band_min_m, config.band_max_m) if shown.has_height else None,
        ceilings_m=shown.ceilings_m,
        warnings=(
            *shown.warnings,
            *_assumptions(log, topic.name, base, [*assumed, *left_out], tree, child, clock),
            *of_floor,
        ),
    )


def _floor(
    shown: Glance, floor_m: float | None, base: str, config: LogConfig
) -> tuple[float | None, list[str]]:
    """The floor's height in the base frame, None where each cloud tells it; what is said of it.

    Clouds tell it where the log does not, and where the first ones contradict the log: the floor
    is tilted, or it would be seen as walls, or half of the band of heights would look above walls.
    """
    if floor_m is None:
        return None, [_UNKNOWN_FLOOR] if shown.has_height else []
    tilt_rad = shown.tilt_rad or 0.0
    above_m = 0.0 if shown.floor_m is None else shown.floor_m - floor_m
    most_below_m = 0.5 * (config.band_max_m - config.band_min_m)
    if tilt_rad > _TILT_MAX_RAD:
        lies = f"is tilted by {math.degrees(tilt_rad):.0f} degrees against {base!r}"
        why = "the transform to the lidar is wrong, or the robot stands on a ramp"
    elif not -most_below_m <= above_m <= config.band_min_m:
        lies = f"lies {abs(above_m):.2f} m {'above' if above_m > 0.0 else 'below'} that of {base!r}"
        why = f"the lidar has a wrong height, or {base!r} is not on the floor"
    else:
        return floor_m, []
    told = f"the first clouds show a floor that {lies}: {why}"
    return None, [f"{told}; each cloud is levelled by the floor that it shows"]


def _assumptions(
    log: Log,
    topic: str,
    base: str,
    of_frames: Sequence[str],
    tree: TransformTree,
    odometry_child: str | None,
    clock: Clock,
) -> Iterator[str]:
    """What is taken for granted of files, frames and stamps as the log does not say it."""
    for earlier, later, shared_ns in log.side_by_side(topic) if len(log.paths) > 1 else ():
        if shared_ns > _PARTS_OVERLAP_NS:
            yield (
                f"{earlier} and {later} both hold {topic} for the same {seconds(shared_ns):.0f} s: "
                "if they are not parts of one recording, build a map of one of them and add the "
                "other with `specmap update`"
            )
    yield from of_frames
    if odometry_child is not None and tree.lookup(odometry_child, base) is None:
        yield (
            f"the odometry moves {odometry_child!r}, which no transform joins to {base!r}: "
            "the two are taken to be the same"
        )
    if clock.source == "recorder":
        yield f"{topic}: {clock.why}: the recorder's times are used"
    elif clock.source == "order":
        yield (
            f"{topic}: {clock.why}, and the recorder's times do not ascend: scans are stamped by "
            f"their order, {clock.interval_ns / NS_PER_S:g} s apart"
        )
    apart_ns = clock.odometry_shift_ns or clock.odometry_apart_ns
    side = "behind" if apart_ns > 0 else "ahead of"
    if clock.odometry_apart_ns:
        yield (
            f"the stamps of the odometry are {time_text(abs(apart_ns))} {side} those of the scans "
            "recorded beside it: either these were recorded at another time than it, which is "
            "harmless, or its clock is wrong, which bends the map where the robot turns"
        )
    if clock.odometry_shift_ns:
        yield (
            f"the stamps of the odometry are {time_text(abs(apart_ns))} {side} those of the scans "
            "recorded beside it: it has another clock, and is shifted to theirs"
        )


def odometry_ancestor(tree: TransformTree, base_frame: str) -> str | None:
    """The frame of odometry above the base in the tree, None without a moving one."""
    for below, frame in pairwise(tree.ancestors(base_frame)):
        if "odom" in frame.lower() and below in tree.moving:
            return frame
    return None
