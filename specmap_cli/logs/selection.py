"""Choosing what to read, by a survey of the first messages: scans, odometry, frames, clock."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import islice, pairwise

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.settings import LogConfig
from specmap_cli.core.text import legible, seconds
from specmap_cli.logs.clocks import (
    Clock,
    OdometryKind,
    choose_clock,
    stamp_pairs,
)
from specmap_cli.logs.frames import (
    USUAL_BASES,
    Frames,
    Placement,
    TransformTree,
    place_laser,
    read_frames,
)
from specmap_cli.logs.messages import BadMessageError, decode_odometry
from specmap_cli.logs.opening import Log
from specmap_cli.logs.readers.encoding import NS_PER_S, ODOMETRY, TF_MESSAGE
from specmap_cli.logs.readers.recording import TopicInfo, time_text
from specmap_cli.logs.sensors import (
    TRIED_MESSAGES,
    ScanSensor,
    ceilings_m,
    choose_scan_topic,
    choose_sensor,
    choose_topic,
    first_scans,
    is_flat,
    sensors_of,
)

_ABSURD_NAMED = 3  # transforms; with more of them the log is beyond help
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
    def note(self) -> str:
        """One line on what was chosen."""
        kind = self.topic.type.rpartition("/")[2]
        parts = [f"scans from {self.topic.name} ({kind}, {self.topic.count:,})"]
        if len(self.sensors) > 1:
            parts[0] += f" of sensor {self.sensor.name}"
        if self.band_m is not None:
            low, high = self.band_m
            parts.append(f"height band {low:g} to {high:g} m above the floor")
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
    in_space = sensor.is_cloud and not is_flat(log, topic, sensor)
    odometry_topic = None
    if config.use_odometry:
        asked = config.odom_topic
        odometry_topic = choose_topic(log, {ODOMETRY}, asked, "--odom-topic", "odometry")
    child = None  # the frame that moves, by the first message that can be read
    if odometry_topic is not None:
        for message in islice(log.messages([odometry_topic.name]), TRIED_MESSAGES):
            with suppress(BadMessageError):
                child = decode_odometry(message).child or None
                break
    usual = [frame for frame in (child, *USUAL_BASES) if frame]
    bases = usual if config.base_frame is None else [config.base_frame.lstrip("/")]
    frames = read_frames(log, sensor.frame, bases, config)
    placement = place_laser(frames.tree, sensor.frame, child, config)
    odometry: OdometryKind | None = None
    topics: tuple[str, ...] = ()
    odom_frame = None
    if odometry_topic is not None:
        odometry, topics = "topic", (odometry_topic.name,)
    elif config.use_odometry:
        odom_frame = odometry_ancestor(frames.tree, placement.base_frame)
        if odom_frame is not None:
            odometry = "tf"
            of_tf = [topic.name for topic in log.topics() if topic.type == TF_MESSAGE]
            topics = tuple(name for name in of_tf if not name.endswith("tf_static"))
    pairs = stamp_pairs(log, topic.name, sensor, topics, odom_frame)
    clock = choose_clock([(scan.stamp_ns, scan.time_ns) for scan in scans], pairs)
    return Selection(
        topic=topic,
        sensor=sensor,
        sensors=sensors,
        base_frame=placement.base_frame,
        base_from_laser=placement.base_from_laser,
        floor_m=placement.floor_m,
        tree=frames.tree,
        odometry=odometry,
        odom_topics=topics,
        odom_frame=odom_frame,
        clock=clock,
        band_m=(config.band_min_m, config.band_max_m) if in_space else None,
        ceilings_m=ceilings_m(log, topic, sensor),
        warnings=(
            *_assumptions(log, topic.name, placement, frames, child, clock, config),
            *([_UNKNOWN_FLOOR] if in_space and placement.floor_m is None else []),
        ),
    )


def _assumptions(
    log: Log,
    topic: str,
    placement: Placement,
    frames: Frames,
    odometry_child: str | None,
    clock: Clock,
    config: LogConfig,
) -> Iterator[str]:
    """What is taken for granted of files, frames and stamps as the log does not say it."""
    base = placement.base_frame
    for earlier, later, shared_ns in log.side_by_side(topic) if len(log.paths) > 1 else ():
        if shared_ns > _PARTS_OVERLAP_NS:
            yield (
                f"{earlier} and {later} both hold {topic} for the same {seconds(shared_ns):.0f} s: "
                "if they are not parts of one recording, build a map of one of them and add the "
                "other with `specmap update`"
            )
    yield from placement.warnings
    for parent, child in frames.absurd[:_ABSURD_NAMED]:
        yield f"the transform {parent!r} -> {child!r} is not finite or absurd, and was left out"
    if frames.unreadable:
        yield f"messages of transforms that could not be read: {frames.unreadable:,}"
    if not frames.complete:
        yield (
            f"the laser's place was searched in the first {config.transform_messages:,} messages "
            "of transforms only: log.transform_messages says how many"
        )
    if odometry_child is not None and frames.tree.lookup(odometry_child, base) is None:
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
    if clock.odometry_shift_ns:
        side = "behind" if clock.odometry_shift_ns > 0 else "ahead of"
        yield (
            f"the stamps of the odometry are {time_text(abs(clock.odometry_shift_ns))} {side} "
            "those of the scans recorded beside it: it has another clock, and is shifted to theirs"
        )


def odometry_ancestor(tree: TransformTree, base_frame: str) -> str | None:
    """The frame of odometry above the base in the tree, None without a moving one."""
    moving = {child for _, child, _, dynamic in tree.edges() if dynamic}
    for below, frame in pairwise(tree.ancestors(base_frame)):
        if "odom" in frame.lower() and below in moving:
            return frame
    return None
