"""Choosing what to read: the topics of scans and odometry, the frames, the clock."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.settings import LogConfig
from specmap_cli.core.text import legible, seconds
from specmap_cli.logs.clocks import (
    Clock,
    OdometryKind,
    OdometrySource,
    choose_clock,
    clock_warnings,
    odometry_beside,
)
from specmap_cli.logs.first_scans import TRIED_MESSAGES, ceilings_m, first_scans, is_flat
from specmap_cli.logs.frames import (
    USUAL_BASES,
    Frames,
    Placement,
    place_laser,
    read_frames,
)
from specmap_cli.logs.log import Log
from specmap_cli.logs.messages import BadMessageError, decode_odometry
from specmap_cli.logs.readers.recording import Message, TopicInfo
from specmap_cli.logs.sensors import Glimpse, ScanSensor, choose_sensor, sensors_of
from specmap_cli.logs.topics import choose_odometry_topic, choose_scan_topic, dynamic_topics
from specmap_cli.logs.transforms import TransformTree

_ABSURD_NAMED = 3  # transforms; with more of them the log is beyond help
_PARTS_OVERLAP_NS = 2_000_000_000  # parts of one recording may share a moment, not more


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanSource:
    """Where the scans come from: which of the `sensors` on the topic, and what stamps them.

    `band_m` is the height band of a 3D cloud in metres above the floor, None for planar scans and
    for clouds of planar lasers.
    `ceilings_m` are distances that stand for no return, as far as the first scans show.
    """

    topic: TopicInfo
    sensor: ScanSensor
    sensors: tuple[ScanSensor, ...]
    clock: Clock = field(default_factory=Clock)
    band_m: tuple[float, float] | None = None
    ceilings_m: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Selection:
    """What a stream of sweeps is read from; `tree` are the transforms known beforehand."""

    scan: ScanSource
    placement: Placement
    odometry_source: OdometrySource
    tree: TransformTree
    warnings: tuple[str, ...] = ()

    @property
    def scan_topic(self) -> str:
        """The topic of the scans."""
        return self.scan.topic.name

    @property
    def scan_type(self) -> str:
        """The ROS 2 type of the scans."""
        return self.scan.topic.type

    @property
    def laser_frame(self) -> str:
        """The frame of the scans."""
        return self.scan.sensor.frame

    @property
    def band_m(self) -> tuple[float, float] | None:
        """The height band of a 3D cloud, metres above the floor."""
        return self.scan.band_m

    @property
    def base_frame(self) -> str:
        """The frame whose poses are estimated."""
        return self.placement.base_frame

    @property
    def base_from_laser(self) -> FloatArray:
        """The mounting of the laser, (4, 4)."""
        return self.placement.base_from_laser

    @property
    def odometry(self) -> OdometryKind | None:
        """Whether odometry comes from a topic, from transforms, or not at all."""
        return self.odometry_source.kind

    @property
    def odom_topics(self) -> tuple[str, ...]:
        """The topics read for odometry."""
        return self.odometry_source.topics

    @property
    def note(self) -> str:
        """One line on what was chosen."""
        kind = self.scan_type.rpartition("/")[2]
        parts = [f"scans from {self.scan_topic} ({kind}, {self.scan.topic.count:,})"]
        if len(self.scan.sensors) > 1:
            parts[0] += f" of sensor {self.scan.sensor.name}"
        if self.band_m is not None:
            low, high = self.band_m
            parts.append(f"height band {low:g} to {high:g} m above the floor")
        if self.odometry == "topic":
            parts.append(f"odometry from {self.odom_topics[0]}")
        elif self.odometry == "tf":
            source = self.odometry_source.frame
            parts.append(f"odometry from transforms {source} -> {self.base_frame}")
        else:
            parts.append("no odometry")
        parts.append(f"base frame {self.base_frame}")
        return legible(", ".join(parts))


def select(log: Log, config: LogConfig) -> Selection:
    """Choose by type, by the settings where they say, and by a look at the first messages.

    Raises LogError for a log without usable scans, and UsageError, with the choices ready to
    paste, when a topic or frame must be chosen or the chosen one is not there.
    """
    scan, glimpses = _scan_source(log, choose_scan_topic(log, config.scan_topic), config)
    topic = choose_odometry_topic(log, config.odom_topic) if config.use_odometry else None
    child = _odometry_child(log, topic)
    usual = [frame for frame in (child, *USUAL_BASES) if frame]
    bases = usual if config.base_frame is None else [config.base_frame.lstrip("/")]
    frames = read_frames(log, scan.sensor.frame, bases, config)
    placement = place_laser(frames.tree, scan.sensor.frame, child, config)
    odometry = _odometry_source(log, topic, frames.tree, placement, config)
    clock = _clock(log, scan, odometry, glimpses)
    scan = replace(scan, clock=clock, ceilings_m=ceilings_m(log, scan.topic, scan.sensor))
    return Selection(
        scan=scan,
        placement=placement,
        odometry_source=odometry,
        tree=frames.tree,
        warnings=(
            *_doubled(log, scan.topic.name),
            *placement.warnings,
            *_assumptions(scan, placement, frames, child, config),
        ),
    )


def _doubled(log: Log, topic: str) -> Iterator[str]:
    """Files that look like recordings of their own, not like parts of one."""
    if len(log.paths) == 1:
        return
    for earlier, later, shared_ns in log.side_by_side(topic):
        if shared_ns > _PARTS_OVERLAP_NS:
            yield (
                f"{earlier} and {later} both hold {topic} for the same {seconds(shared_ns):.0f} s: "
                "if they are not parts of one recording, build a map of one of them and add the "
                "other with `specmap update`"
            )


def _assumptions(
    scan: ScanSource,
    placement: Placement,
    frames: Frames,
    odometry_child: str | None,
    config: LogConfig,
) -> Iterator[str]:
    """What is taken for granted as the log does not say it."""
    base = placement.base_frame
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
    yield from clock_warnings(scan.clock, scan.topic.name)
    if scan.band_m is not None and placement.floor_m is None:
        yield (
            "the lidar's tilt and height above the floor are unknown, as there is no transform "
            "from a base frame: each cloud is levelled by the floor that it shows"
        )


def _scan_source(log: Log, topic: TopicInfo, config: LogConfig) -> tuple[ScanSource, list[Glimpse]]:
    """The sensor to read, and its first scans."""
    glimpses = first_scans(log, topic)
    sensors = tuple(sensors_of(glimpses))
    sensor = choose_sensor(f"{log.name}: {topic.name}", sensors, config)
    source = ScanSource(
        topic=topic,
        sensor=sensor,
        sensors=sensors,
        band_m=_band_m(log, topic, sensor, config),
    )
    return source, [glimpse for glimpse in glimpses if sensor.made(glimpse)]


def _band_m(
    log: Log, topic: TopicInfo, sensor: ScanSensor, config: LogConfig
) -> tuple[float, float] | None:
    """The heights of a 3D cloud that count as walls; None for all that planar lasers give."""
    if not sensor.is_cloud or is_flat(log, topic, sensor):
        return None
    return config.band_min_m, config.band_max_m


def _clock(
    log: Log,
    scan: ScanSource,
    odometry: OdometrySource,
    glimpses: Sequence[Glimpse],
) -> Clock:
    """What stamps the scans, by the first of them and the odometry beside these."""
    besides = odometry_beside(log, scan.topic.name, scan.sensor, odometry)
    return choose_clock(glimpses, besides)


def _odometry_child(log: Log, topic: TopicInfo | None) -> str | None:
    """The frame that moves in an Odometry topic."""
    if topic is None:
        return None
    for message in _first_messages(log, topic):
        try:
            return decode_odometry(message).child or None
        except BadMessageError:
            continue
    return None


def _first_messages(log: Log, topic: TopicInfo) -> Iterator[Message]:
    return islice(log.messages([topic.name]), TRIED_MESSAGES)


def _odometry_source(
    log: Log,
    topic: TopicInfo | None,
    tree: TransformTree,
    placement: Placement,
    config: LogConfig,
) -> OdometrySource:
    if topic is not None:
        return OdometrySource(kind="topic", topics=(topic.name,))
    frame = odometry_ancestor(tree, placement.base_frame) if config.use_odometry else None
    if frame is None:
        return OdometrySource()
    return OdometrySource(kind="tf", topics=tuple(dynamic_topics(log.topics())), frame=frame)


def odometry_ancestor(tree: TransformTree, base_frame: str) -> str | None:
    """The frame of odometry above the base in the tree, None without a moving one."""
    moving = {child for _, child, _, dynamic in tree.edges() if dynamic}
    chain: Iterator[str] = tree.ancestors(base_frame)
    below = next(chain)
    for frame in chain:
        if "odom" in frame.lower() and below in moving:
            return frame
        below = frame
    return None
