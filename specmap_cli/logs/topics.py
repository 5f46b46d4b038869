"""Topics by what they carry, and the one to read where several fit."""

from __future__ import annotations

from collections.abc import Iterable

from specmap_cli.core.errors import CHOICE, LogError, UsageError
from specmap_cli.core.text import counted, legible
from specmap_cli.logs.log import Log
from specmap_cli.logs.readers.recording import TopicInfo
from specmap_cli.logs.readers.typestore import ODOMETRY, SCAN_TYPES, TF_MESSAGE


def static_topics(topics: Iterable[TopicInfo]) -> list[str]:
    """Topics of transforms that never change."""
    return [t.name for t in topics if t.type == TF_MESSAGE and t.name.endswith("tf_static")]


def dynamic_topics(topics: Iterable[TopicInfo]) -> list[str]:
    """Topics of transforms that may change."""
    return [t.name for t in topics if t.type == TF_MESSAGE and not t.name.endswith("tf_static")]


def choose_scan_topic(log: Log, asked: str | None) -> TopicInfo:
    """The topic of scans: the asked one, or the only one."""
    found = [t for t in log.topics() if t.type in SCAN_TYPES and t.count]
    if asked is not None:
        return _asked(log, found, asked, "--scan-topic", "scans")
    if not found:
        there = ", ".join(f"{t.name} ({t.type})" for t in log.topics()) or "no messages at all"
        raise LogError(
            legible(
                f"{log.name}: no LaserScan, MultiEchoLaserScan or PointCloud2 in it; it has {there}"
            )
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
        several = f"{log.name}: {len(found)} topics carry {what}: choose {choices}"
        raise UsageError(legible(several), code=CHOICE)
    return found[0]


def _asked(log: Log, found: list[TopicInfo], asked: str, option: str, what: str) -> TopicInfo:
    for topic in found:
        if topic.name.lstrip("/") == asked.lstrip("/"):
            return topic
    choices = ", ".join(f"{t.name} ({_describe(t)})" for t in found) or "none"
    none = f"{log.name}: {option} {asked}: no {what} on such a topic"
    raise UsageError(legible(f"{none}; topics with {what}: {choices}"))


def _describe(topic: TopicInfo) -> str:
    return f"{topic.type.rpartition('/')[2]}, {counted(topic.count, 'message')}"
