"""What a command that made a map tells of it: run.json, and a summary for people and machines."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from specmap_cli.core.findings import Quality, summary
from specmap_cli.core.geometry import Pose2
from specmap_cli.core.process import peak_memory_mb, versions
from specmap_cli.core.text import counted
from specmap_cli.logs.selection import Selection
from specmap_cli.maps import filenames
from specmap_cli.maps.edits import Edits, in_words
from specmap_cli.pipelines.map_in_making import FinishedMap
from specmap_cli.pipelines.session import Session
from specmap_cli.recognition.closure.alignment import Alignment
from specmap_cli.topology.identity import BorderChange
from specmap_cli.topology.regions import NOBODY

SCHEMA_VERSION = 1  # of run.json: schemas/run.schema.json

_MOVED_IOU = 0.9  # below it a border is not the one that people knew


def run_record(
    session: Session,
    finished: FinishedMap,
    inputs: Sequence[Path],
    selection: Selection | None = None,
    **made_by: Any,
) -> dict[str, Any]:
    """The contents of run.json: what is to be told of a map that was made in a session of `inputs`.

    `selection` is of the log that was read, None where none was. Last is what it was `made_by`
    besides: `updates` are those that made the map, as run.json of the map before had them, and the
    last one; `like` is the map in whose frame this one is.
    """
    beyond, clock = finished.laid.beyond, session.clock
    return {
        "schema_version": SCHEMA_VERSION,
        "inputs": [path.name for path in inputs],
        "selection": None
        if selection is None
        else {
            "scan_topic": selection.topic.name,
            "scan_type": selection.topic.type,
            "odometry": selection.odometry,
            "odom_topics": list(selection.odom_topics),
            "base_frame": selection.base_frame,
            "laser_frame": selection.sensor.frame,
            "base_from_laser": [
                round(value, 6) for value in Pose2.from_matrix(selection.base_from_laser)
            ],
            "height_band_m": selection.band_m and list(selection.band_m),
        },
        "config": session.config.model_dump(mode="json", by_alias=True),
        "versions": versions(),
        "counts": finished.counts,
        "limits": {"max_extent_m": beyond} if beyond else {},
        "seconds": {name: round(value, 3) for name, value in clock.seconds.items()},
        "wall_s": round(time.perf_counter() - clock.began, 3),
        "memory_mb": peak_memory_mb(),
        "quality": finished.quality.as_dict(),
        "warnings": summary(finished.quality.warnings),
        **made_by,
    }


@dataclass(frozen=True, slots=True, kw_only=True)
class MapReport(ABC):
    """A map that was made: its directory, its run.json, and what is thought of it.

    `unapplied` tells which of a person's edits do not apply.
    """

    out: Path
    run: Mapping[str, Any]
    quality: Quality
    unapplied: tuple[str, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """The counts, what this command has to tell beside them, and what is thought of the map."""
        return {
            "out": str(self.out),
            **self.run["counts"],
            **self.own(),
            "unapplied": list(self.unapplied),
            "quality": self.run["quality"],
            "warnings": self.run["warnings"],
        }

    def lines(self) -> list[str]:
        """A summary: what makes the map doubtful or poor comes first."""
        verdict = self.quality.verdict
        trust = "" if verdict == "good" else f"{self.out}: this map is {verdict}: "
        return [
            *(trust + line for line in summary(self.quality.worst)),
            *(f"{self.out}: {line}" for line in self.made()),
            *(["quality: good"] if verdict == "good" else []),
            f"look at {self.out / filenames.OVERVIEW}",
        ]

    def own(self) -> dict[str, Any]:
        """What only this command tells, for a machine."""
        return {}

    @abstractmethod
    def made(self) -> list[str]:
        """What it made, a line each."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BuildReport(MapReport):
    """What `build` did; only with `--like` there are edits of a person."""

    def made(self) -> list[str]:
        """Its submaps and the way of the robot."""
        counts = self.run["counts"]
        return [
            f"{counted(counts['submaps'], 'submap')}, {counted(counts['edges'], 'edge')}, "
            f"{counted(counts['merges'], 'revisit')} recognised; "
            f"{counted(counts['scans'], 'scan')} over {counts['path_m']:.0f} m, "
            f"{counts['lost']} lost"
        ]


@dataclass(frozen=True, slots=True, kw_only=True)
class UpdateReport(MapReport):
    """What `update` did, and which submaps are new.

    `visited` are the ids of the old map's submaps that the recording came to; `borders` tells what
    became of all of them; `cut_off` are the parts that a wall cuts off from some of them now;
    `dropped` older keyframes were let go since newer ones show the same.
    """

    alignment: Alignment
    visited: tuple[int, ...]
    new: tuple[int, ...]
    cut_off: tuple[int, ...]
    borders: tuple[BorderChange, ...]
    dropped: int = 0

    @property
    def moved(self) -> tuple[BorderChange, ...]:
        """The old submaps whose borders are not where they were."""
        return tuple(change for change in self.borders if change.iou < _MOVED_IOU)

    def own(self) -> dict[str, Any]:
        """Where the recording lies, and what became of the submaps."""
        motion = self.alignment.old_from_new
        return {
            "aligned": self.alignment.reason,
            "old_from_new": None if motion is None else list(motion),
            "visited": list(self.visited),
            "new": list(self.new),
            "cut_off": list(self.cut_off),
            "borders_moved": [
                {
                    "submap": change.submap,
                    "iou": change.iou,
                    "was_m2": change.was_m2,
                    "given": _areas(change.given),
                    "taken": _areas(change.taken),
                }
                for change in self.moved
            ],
            "keyframes_dropped": self.dropped,
        }

    def made(self) -> list[str]:
        """The same in words."""
        counts = self.run["counts"]
        ids = f" ({', '.join(str(id_) for id_ in self.new)})" if self.new else ""
        dropped = (
            f"{counted(counts['keyframes'], 'keyframe')}; "
            f"{self.dropped:,} older keyframes dropped, newer ones show the same"
        )
        return [
            self.alignment.reason,
            f"{counted(counts['submaps'], 'submap')}: "
            f"{len(self.visited)} visited again, {len(self.new)} new{ids}; "
            f"{counted(counts['scans'], 'scan')} over {counts['path_m']:.0f} m",
            *(_words(change, self.new, self.cut_off) for change in self.moved),
            *([dropped] if self.dropped else []),
        ]


def _areas(areas: Mapping[int, float]) -> list[dict[str, Any]]:
    """Square metres by submap, null for none."""
    return [{"submap": None if i == NOBODY else i, "m2": m2} for i, m2 in areas.items()]


def _words(change: BorderChange, new: Sequence[int], cut_off: Sequence[int]) -> str:
    """How a border moved, and why: `new` are the submaps that were entered for the first time."""
    entered = {i: m2 for i, m2 in change.given.items() if i in new}
    walled = {i: m2 for i, m2 in change.given.items() if i in cut_off}
    lost = {i: m2 for i, m2 in change.given.items() if i not in (*new, *cut_off)}
    whys = [
        _part(entered, "that were only looked into are in {}, entered now"),
        _part(walled, "are in {}, cut off by a wall now"),
        _part(lost, "are in {} now"),
        _part(change.taken, "of {} are in it now"),
    ]
    moved = f"the border of submap {change.submap} moved (IoU {change.iou:.2f})"
    return f"{moved}: {'; '.join(why for why in whys if why)}"


def _part(areas: Mapping[int, float], words: str) -> str:
    """So many square metres and whose they are, in `words`; empty for none."""
    names = ["no submap" if i == NOBODY else str(i) for i in areas]
    return f"{sum(areas.values()):.1f} m2 " + words.format(", ".join(names)) if areas else ""


@dataclass(frozen=True, slots=True, kw_only=True)
class MergeReport(MapReport):
    """What `merge` did.

    `parts` are the names of the maps that hang together, a list a part. `ids` tells, map by map,
    which submap of the result each submap became.
    """

    parts: tuple[tuple[str, ...], ...]
    ids: Mapping[str, Mapping[int, int]]

    def own(self) -> dict[str, Any]:
        """Which maps overlap, and what became of their submaps."""
        return {
            "parts": [list(part) for part in self.parts],
            "ids": {
                name: {str(old): new for old, new in own.items()} for name, own in self.ids.items()
            },
        }

    def made(self) -> list[str]:
        """The same in words."""
        counts = self.run["counts"]
        parts = "; ".join(", ".join(part) for part in self.parts)
        apart = f"{len(self.parts)} parts that do not meet: {parts}"
        return [
            *([apart] if len(self.parts) > 1 else []),
            f"{counted(len(self.ids), 'map')} merged: "
            f"{counted(counts['submaps'], 'submap')}, {counted(counts['scans'], 'scan')} over "
            f"{counts['path_m']:.0f} m",
        ]


@dataclass(frozen=True, slots=True, kw_only=True)
class EditReport:
    """What `edit` did: the map directory, its edits, which of them do not apply, and its submaps.

    `remade` tells whether borders changed, so that grids and classifiers are new. `names` are those
    of all submaps, `forbidden` the links that are.
    """

    out: Path
    edits: Edits
    unapplied: tuple[str, ...]
    names: Mapping[int, str]
    forbidden: tuple[tuple[int, int], ...]
    remade: bool

    def as_dict(self) -> dict[str, Any]:
        """The same for a machine."""
        return {
            "out": str(self.out),
            "remade": self.remade,
            "submaps": [{"id": id_, "name": name} for id_, name in sorted(self.names.items())],
            "forbidden": [list(pair) for pair in self.forbidden],
            "edits": self.edits.model_dump(mode="json", exclude_none=True),
            "unapplied": list(self.unapplied),
        }

    def lines(self) -> list[str]:
        """A summary: what was decided, a line each."""
        how = "made anew" if self.remade else "edited"
        told = [f"{self.out}: {how}: {counted(len(self.names), 'submap')}"]
        for id_, edit in sorted(self.edits.submaps.items()):
            said = [edit.name or "", edit.kind or ""]
            said += [f"{key}={value}" for key, value in edit.properties.items()]
            told.append(f"  submap {id_}: {', '.join(word for word in said if word)}")
        for number, change in enumerate(self.edits.changes, start=1):
            told.append(f"  change {number}: {in_words(change)}")
        told += [f"  not applied: {line}" for line in self.unapplied]
        return [*told, f"look at {self.out / filenames.OVERVIEW}"]
