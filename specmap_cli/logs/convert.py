"""Converting any recording that can be read to MCAP with ROS 2 messages."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from specmap_cli.core.errors import LogError, UsageError
from specmap_cli.core.progress import Progress, Silent
from specmap_cli.logs.opening import open_log
from specmap_cli.logs.readers.recording import TopicInfo
from specmap_cli.logs.readers.typestore import SUPPORTED_TYPES
from specmap_cli.logs.writer import LogWriter


@dataclass(frozen=True, slots=True)
class Conversion:
    """What was written, what was left out as no stage reads it, and what was lost to damage."""

    path: Path
    written: list[TopicInfo]
    skipped: list[TopicInfo]
    damage: list[str]

    def lines(self) -> list[str]:
        """The result as lines for people."""
        told = [f"wrote {self.path}: {sum(t.count for t in self.written):,} messages"]
        told += [f"  {t.name}  {t.count:,}  {t.type}" for t in self.written]
        told += [f"left out {t.name}: {t.count:,} messages of {t.type}" for t in self.skipped]
        return told + [f"damage: {line}" for line in self.damage]


def convert(
    paths: Path | str | Sequence[Path | str],
    out: Path | str,
    *,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> Conversion:
    """Write the scans, odometry and transforms of a log to the MCAP file `out`.

    Messages keep their topics, header stamps and log times. Raises UsageError when `out` exists
    (unless `overwrite`) or cannot be written, LogError when the log holds nothing to convert.
    """
    target = Path(out)
    progress = progress or Silent()
    if target.exists() and not overwrite:
        raise UsageError(f"{target}: exists already; use --overwrite to replace it")
    with open_log(paths) as log:
        topics = log.topics()
        wanted = {t.name for t in topics if t.type in SUPPORTED_TYPES and t.count}
        if not wanted:
            there = ", ".join(f"{t.name} ({t.type})" for t in topics) or "no messages at all"
            raise LogError(f"{log.name}: no scans, odometry or transforms; it has {there}")
        counts: dict[tuple[str, str], int] = {}
        progress.start("converting", sum(t.count for t in topics if t.name in wanted))
        with LogWriter(target) as writer:
            for message in log.messages(wanted):
                if message.type in SUPPORTED_TYPES:
                    writer.raw(message.topic, message.type, message.data, message.time_ns)
                    key = (message.topic, message.type)
                    counts[key] = counts.get(key, 0) + 1
                progress.advance()
        return Conversion(
            path=target,
            written=[TopicInfo(*key, counts[key]) for key in sorted(counts)],
            skipped=[t for t in topics if t.type not in SUPPORTED_TYPES and t.count],
            damage=list(log.damage),
        )
