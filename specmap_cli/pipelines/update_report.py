"""What `update` tells of the map that it made."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from specmap_cli.core.findings import Quality
from specmap_cli.core.text import counted
from specmap_cli.pipelines.run_record import told
from specmap_cli.recognition.closure.alignment import Alignment
from specmap_cli.topology.identity import BorderChange
from specmap_cli.topology.regions import NOBODY

_MOVED_IOU = 0.9  # below it a border is not the one that people knew


@dataclass(frozen=True, slots=True, kw_only=True)
class UpdateReport:
    """What `update` did: the map directory, its run.json, and which submaps are new.

    `visited` are the ids of the old map's submaps that the recording came to; `borders` tells what
    became of all of them; `dropped` older keyframes were let go since newer ones show the same;
    `unapplied` tells which of a person's edits do not apply.
    """

    out: Path
    run: Mapping[str, Any]
    quality: Quality
    alignment: Alignment
    visited: tuple[int, ...]
    new: tuple[int, ...]
    borders: tuple[BorderChange, ...]
    dropped: int = 0
    unapplied: tuple[str, ...] = ()

    @property
    def moved(self) -> tuple[BorderChange, ...]:
        """The old submaps whose borders are not where they were."""
        return tuple(change for change in self.borders if change.iou < _MOVED_IOU)

    def as_dict(self) -> dict[str, Any]:
        """The same for a machine."""
        motion = self.alignment.old_from_new
        return {
            "out": str(self.out),
            **self.run["counts"],
            "aligned": self.alignment.reason,
            "old_from_new": None if motion is None else list(motion),
            "visited": list(self.visited),
            "new": list(self.new),
            "borders_moved": [_record(change) for change in self.moved],
            "keyframes_dropped": self.dropped,
            "unapplied": list(self.unapplied),
            "quality": self.run["quality"],
            "warnings": self.run["warnings"],
        }

    def lines(self) -> list[str]:
        """A summary: what makes the map doubtful or poor comes first."""
        counts = self.run["counts"]
        fresh = f"{len(self.new)} new"
        if self.new:
            fresh += f" ({', '.join(str(id_) for id_ in self.new)})"
        made = (
            f"{self.out}: {counted(counts['submaps'], 'submap')}: "
            f"{len(self.visited)} visited again, {fresh}; "
            f"{counted(counts['scans'], 'scan')} over {counts['path_m']:.0f} m"
        )
        borders = [f"{self.out}: {_words(change, self.new)}" for change in self.moved]
        lines = [f"{self.out}: {self.alignment.reason}", made, *borders]
        if self.dropped:
            lines.append(
                f"{self.out}: {counted(counts['keyframes'], 'keyframe')}; "
                f"{self.dropped} older keyframes dropped, newer ones show the same"
            )
        return told(self.out, self.quality, *lines)


def _record(change: BorderChange) -> dict[str, Any]:
    """A border that moved, for a machine."""
    return {
        "submap": change.submap,
        "iou": change.iou,
        "was_m2": change.was_m2,
        "given": _areas(change.given),
        "taken": _areas(change.taken),
    }


def _areas(areas: Mapping[int, float]) -> list[dict[str, Any]]:
    """Square metres by submap, null for none."""
    return [{"submap": None if i == NOBODY else i, "m2": m2} for i, m2 in areas.items()]


def _words(change: BorderChange, new: Sequence[int]) -> str:
    """How a border moved, and why: `new` are the submaps that were entered for the first time."""
    entered = {i: m2 for i, m2 in change.given.items() if i in new}
    lost = {i: m2 for i, m2 in change.given.items() if i not in new}
    whys = [
        _part(entered, "that were only looked into are in {}, entered now"),
        _part(lost, "are in {} now"),
        _part(change.taken, "of {} are in it now"),
    ]
    moved = f"the border of submap {change.submap} moved (IoU {change.iou:.2f})"
    return f"{moved}: {'; '.join(why for why in whys if why)}"


def _part(areas: Mapping[int, float], words: str) -> str:
    """So many square metres and whose they are, in `words`; empty for none."""
    names = ["no submap" if i == NOBODY else str(i) for i in areas]
    return f"{sum(areas.values()):.1f} m2 " + words.format(", ".join(names)) if areas else ""
