"""A look at the first scans of a topic: which sensors share it, and how they say `no return`."""

from __future__ import annotations

from contextlib import suppress
from itertools import islice

import numpy as np

from specmap_cli.core.errors import LogError
from specmap_cli.core.text import counted, legible
from specmap_cli.logs.clouds import cloud_points
from specmap_cli.logs.log import Log
from specmap_cli.logs.messages import BadMessageError, CloudRecord, decode_scan
from specmap_cli.logs.planar import LEVEL, ScanLeveller
from specmap_cli.logs.readers.recording import Message, TopicInfo
from specmap_cli.logs.sensors import Glimpse, ScanSensor

TRIED_MESSAGES = 50  # messages of a topic tried in search of one that can be read
LOOK_SCANS = 100  # first scans looked at: which sensors share the topic, what stamps are worth
_FLAT_M = 0.02  # heights of a planar laser's points, which a driver may round
_FLAT_POINTS = 30  # fewer tell nothing of a lidar
_LOOK_BYTES = 32_000_000  # of messages that are looked at: some twenty clouds


def first_scans(log: Log, topic: TopicInfo) -> list[Glimpse]:
    """The first scans that can be decoded; raises LogError where none of the first can be."""
    found: list[Glimpse] = []
    reason, size = "it holds no message", 0
    for tried, message in enumerate(log.messages([topic.name]), start=1):
        size += len(message.data)
        try:
            found.append(_glimpse(message))
        except BadMessageError as error:
            reason = f"{error}; tried {counted(tried, 'message')}"
        if found and (tried >= LOOK_SCANS or size >= _LOOK_BYTES):
            break
        if not found and tried >= TRIED_MESSAGES:
            break
    if not found:
        raise LogError(legible(f"{log.name}: {topic.name}: no usable scan: {reason}"))
    return found


def _glimpse(message: Message) -> Glimpse:
    record = decode_scan(message)
    layout = None if isinstance(record, CloudRecord) else record.layout
    return Glimpse(record.stamp_ns, message.time_ns, record.frame, layout)


def is_flat(log: Log, topic: TopicInfo, sensor: ScanSensor) -> bool:
    """Whether the first clouds have all their points at one height: those of a planar laser."""
    size, points = 0, 0
    for message in islice(log.messages([topic.name]), LOOK_SCANS):
        size += len(message.data)
        with suppress(BadMessageError):
            record = decode_scan(message)
            if isinstance(record, CloudRecord) and sensor.made(record):
                heights = cloud_points(record, record.stamp_ns).points[:, 2]
                points += len(heights)
                if len(heights) and float(np.ptp(heights)) > _FLAT_M:
                    return False
        if size >= _LOOK_BYTES:
            break
    return points >= _FLAT_POINTS


def ceilings_m(log: Log, topic: TopicInfo, sensor: ScanSensor) -> tuple[float, ...]:
    """The distances that stand for no return in the first planar scans."""
    if sensor.is_cloud:
        return ()
    leveller = ScanLeveller(LEVEL)
    for message in islice(log.messages([topic.name]), LOOK_SCANS):
        with suppress(BadMessageError):
            record = decode_scan(message)
            if not isinstance(record, CloudRecord) and sensor.made(record):
                leveller.level(record, record.stamp_ns)
    return leveller.ceiling.values_m
