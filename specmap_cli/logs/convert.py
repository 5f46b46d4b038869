"""Converting any recording that can be read to MCAP with ROS 2 messages."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from specmap_cli.core.arguments import Paths, path_of, paths_of
from specmap_cli.core.errors import OUTPUT_EXISTS, LogError, UsageError
from specmap_cli.core.progress import Progress, Silent
from specmap_cli.core.settings import LogConfig
from specmap_cli.core.text import counted, legible
from specmap_cli.logs.log import Log
from specmap_cli.logs.opening import open_log
from specmap_cli.logs.readers.recording import TopicInfo
from specmap_cli.logs.readers.typestore import SUPPORTED_TYPES
from specmap_cli.logs.writer import LogWriter


@dataclass(frozen=True, slots=True, kw_only=True)
class Conversion:
    """What was written, what was left out as no stage reads it, and what was lost to damage."""

    path: Path
    written: tuple[TopicInfo, ...]
    skipped: tuple[TopicInfo, ...]
    damage: tuple[str, ...]

    def lines(self) -> list[str]:
        """The result as lines for people."""
        total = sum(t.count for t in self.written)
        told = [f"wrote {self.path}: {counted(total, 'message')}"]
        told += [f"  {t.name}  {t.count:,}  {t.type}" for t in self.written]
        told += [
            f"left out {t.name}: {counted(t.count, 'message')} of {t.type}" for t in self.skipped
        ]
        return [legible(line) for line in told + [f"damage: {line}" for line in self.damage]]


def convert(
    paths: Paths,
    out: Path | str,
    *,
    overwrite: bool = False,
    progress: Progress | None = None,
    config: LogConfig | None = None,
) -> Conversion:
    """Write the scans, odometry and transforms of a log to the MCAP file `out`.

    `config` bounds what is unpacked, as in `open_log`. Messages keep their order, their topics and
    their header stamps; log times that step back become that of the message ahead. Raises
    UsageError when `out` exists (unless `overwrite`) or cannot be written, LogError when the log
    holds nothing to convert, TypeError for what is no path.
    """
    given, target = paths_of(paths, "paths"), path_of(out, "out")
    if target.exists() and not overwrite:
        raise UsageError(
            f"{target}: exists already; use --overwrite to replace it", code=OUTPUT_EXISTS
        )
    with open_log(given, config) as log:
        topics = log.topics()
        if not any(_is_wanted(topic) for topic in topics):
            there = ", ".join(f"{t.name} ({t.type})" for t in topics) or "no messages at all"
            nothing = f"{log.name}: no scans, odometry or transforms; it has {there}"
            raise LogError(legible(nothing))
        return Conversion(
            path=target,
            written=_written(log, target, progress or Silent()),
            skipped=tuple(t for t in topics if t.type not in SUPPORTED_TYPES and t.count),
            damage=tuple(log.damage),
        )


def _is_wanted(topic: TopicInfo) -> bool:
    return topic.type in SUPPORTED_TYPES and topic.count > 0


def _written(log: Log, target: Path, progress: Progress) -> tuple[TopicInfo, ...]:
    """Write what specmap reads of a log; the topics written and how much of each.

    Readers of MCAP sort by log time: one that steps back, as in a CARMEN log whose clock was set,
    would take its message away from its place.
    """
    wanted = [topic for topic in log.topics() if _is_wanted(topic)]
    counts: Counter[tuple[str, str]] = Counter()
    progress.start("converting", sum(topic.count for topic in wanted))
    latest_ns = 0
    with LogWriter(target) as writer:
        for message in log.messages({topic.name for topic in wanted}):
            if message.type in SUPPORTED_TYPES:
                latest_ns = max(latest_ns, message.time_ns)
                writer.raw(message.topic, message.type, message.data, latest_ns)
                counts[message.topic, message.type] += 1
                progress.advance()
    return tuple(TopicInfo(*key, counts[key]) for key in sorted(counts))
