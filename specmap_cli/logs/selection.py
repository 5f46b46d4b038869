"""Choosing what to read: the topics of scans and odometry, the frames, the clock."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import islice
from typing import Literal

from specmap_cli.core.config import LogConfig
from specmap_cli.core.errors import LogError, UsageError
from specmap_cli.core.geometry import FloatArray
from specmap_cli.logs.frames import Placement, dynamic_topics, place_laser, read_tree
from specmap_cli.logs.messages import (
    BadMessageError,
    CloudRecord,
    ScanRecord,
    decode_odometry,
    decode_scan,
)
from specmap_cli.logs.readers.recording import Log, TopicInfo
from specmap_cli.logs.readers.typestore import ODOMETRY, SCAN_TYPES
from specmap_cli.logs.transforms import TransformTree

_PEEKED = 50  # messages tried for one that can be decoded
_CLOCK_PEEKED = 3  # stamps that are all zero are no stamps


@dataclass(frozen=True, slots=True)
class Selection:
    """What a stream of sweeps is read from.

    `odometry` says whether it comes from an Odometry topic, from transforms `odom_frame` ->
    `base_frame`, or is not there. `band_m` is the height band of a 3D cloud, base frame.
    """

    scan_topic: str
    scan_type: str
    scans: int
    laser_frame: str
    base_frame: str
    base_from_laser: FloatArray
    floor_m: float | None
    odometry: Literal["topic", "tf"] | None
    odom_topics: tuple[str, ...]
    odom_frame: str | None
    use_log_time: bool
    tree: TransformTree
    band_m: tuple[float, float] | None = None
    warnings: list[str] = field(default_factory=list)

    @property
    def note(self) -> str:
        """One line on what was chosen."""
        kind = self.scan_type.rpartition("/")[2]
        parts = [f"scans from {self.scan_topic} ({kind}, {self.scans:,})"]
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
        return ", ".join(parts)


def select(log: Log, config: LogConfig) -> Selection:
    """Choose by type, by the settings where they say, and by a look at the first messages.

    Raises LogError for a log without usable scans, and UsageError, with the choices ready to
    paste, when a topic or frame must be chosen or the chosen one is not there.
    """
    scan = choose_scan_topic(log, config.scan_topic)
    first, use_log_time = _first_scan(log, scan)
    odometry = choose_odometry_topic(log, config.odom_topic) if config.use_odometry else None
    child = _odometry_child(log, odometry)
    bases = [frame for frame in (config.base_frame, child) if frame]
    tree = read_tree(log, first.frame, bases)
    placement = place_laser(tree, first.frame, config.base_frame, child)
    source, topics, odom_frame = _odometry_source(log, config, odometry, tree, placement)
    is_cloud = isinstance(first, CloudRecord)
    return Selection(
        scan_topic=scan.name,
        scan_type=scan.type,
        scans=scan.count,
        laser_frame=first.frame,
        base_frame=placement.base_frame,
        base_from_laser=placement.base_from_laser,
        floor_m=placement.floor_m,
        odometry=source,
        odom_topics=topics,
        odom_frame=odom_frame,
        use_log_time=use_log_time,
        tree=tree,
        band_m=(config.band_min_m, config.band_max_m) if is_cloud else None,
        warnings=[
            *placement.warnings,
            *_assumptions(scan, placement, tree, child, use_log_time, is_cloud),
        ],
    )


def _assumptions(
    scan: TopicInfo,
    placement: Placement,
    tree: TransformTree,
    odometry_child: str | None,
    use_log_time: bool,
    is_cloud: bool,
) -> Iterator[str]:
    """What is taken for granted as the log does not say it."""
    base = placement.base_frame
    if odometry_child is not None and tree.lookup(odometry_child, base) is None:
        yield (
            f"the odometry moves {odometry_child!r}, which no transform joins to {base!r}: "
            "the two are taken to be the same"
        )
    if use_log_time:
        yield f"{scan.name}: header stamps are zero: the recorder's times are used"
    if is_cloud and placement.floor_m is None:
        yield (
            "the lidar's height above the floor is unknown, as there is no transform from a base "
            "frame: the floor is taken to be where the lowest returns of the first cloud are"
        )


def choose_scan_topic(log: Log, asked: str | None) -> TopicInfo:
    """The topic of scans: the asked one, or the only one."""
    found = [t for t in log.topics() if t.type in SCAN_TYPES and t.count]
    if asked is not None:
        return _asked(log, found, asked, "--scan-topic", "scans")
    if not found:
        there = ", ".join(f"{t.name} ({t.type})" for t in log.topics()) or "no messages at all"
        raise LogError(
            f"{log.name}: no LaserScan, MultiEchoLaserScan or PointCloud2 in it; it has {there}"
        )
    return _only(log, found, "--scan-topic", "scans")


def choose_odometry_topic(log: Log, asked: str | None) -> TopicInfo | None:
    """The Odometry topic: the asked one, the only one, or None when there is none."""
    found = [t for t in log.topics() if t.type == ODOMETRY and t.count]
    if asked is not None:
        return _asked(log, found, asked, "--odom-topic", "odometry")
    return _only(log, found, "--odom-topic", "odometry") if found else None


def _only(log: Log, found: list[TopicInfo], option: str, what: str) -> TopicInfo:
    if len(found) > 1:
        choices = " or ".join(f"`{option} {t.name}` ({_describe(t)})" for t in found)
        raise UsageError(f"{log.name}: {len(found)} topics carry {what}: choose {choices}")
    return found[0]


def _asked(log: Log, found: list[TopicInfo], asked: str, option: str, what: str) -> TopicInfo:
    for topic in found:
        if topic.name.lstrip("/") == asked.lstrip("/"):
            return topic
    choices = ", ".join(f"{t.name} ({_describe(t)})" for t in found) or "none"
    raise UsageError(
        f"{log.name}: {option} {asked}: no {what} on such a topic; topics with {what}: {choices}"
    )


def _describe(topic: TopicInfo) -> str:
    noun = "message" if topic.count == 1 else "messages"
    return f"{topic.type.rpartition('/')[2]}, {topic.count:,} {noun}"


def _first_scan(log: Log, topic: TopicInfo) -> tuple[ScanRecord | CloudRecord, bool]:
    """The first scan that can be decoded, and whether the scans carry no stamps."""
    records: list[ScanRecord | CloudRecord] = []
    reason = "it holds no message"
    for message in islice(log.messages([topic.name]), _PEEKED):
        try:
            records.append(decode_scan(message))
        except BadMessageError as error:
            reason = str(error)
        if len(records) == _CLOCK_PEEKED:
            break
    if not records:
        raise LogError(f"{log.name}: {topic.name}: no usable scan: {reason}")
    return records[0], all(record.stamp_ns == 0 for record in records)


def _odometry_child(log: Log, topic: TopicInfo | None) -> str | None:
    """The frame that moves in an Odometry topic."""
    if topic is None:
        return None
    for message in islice(log.messages([topic.name]), _PEEKED):
        try:
            return decode_odometry(message).child or None
        except BadMessageError:
            continue
    return None


def _odometry_source(
    log: Log,
    config: LogConfig,
    topic: TopicInfo | None,
    tree: TransformTree,
    placement: Placement,
) -> tuple[Literal["topic", "tf"] | None, tuple[str, ...], str | None]:
    if topic is not None:
        return "topic", (topic.name,), None
    odom_frame = odometry_ancestor(tree, placement.base_frame) if config.use_odometry else None
    if odom_frame is None:
        return None, (), None
    return "tf", tuple(dynamic_topics(log.topics())), odom_frame


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
