"""What a person decided about a map: names, kinds, properties, merges, splits, forbidden doors.

Names, kinds, properties and forbidden doors are written into a map at once. Where borders change,
it is made anew from its keyframes: grids, classifiers, regions and links; its layout stays.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from specmap_cli.core.arguments import instance_of, path_of
from specmap_cli.core.errors import MapError, UsageError
from specmap_cli.core.process import one_blas_thread, versions
from specmap_cli.core.progress import Progress, Silent
from specmap_cli.core.records import NO_SUBMAP, IntArray
from specmap_cli.core.settings import Config
from specmap_cli.core.text import counted
from specmap_cli.maps import filenames
from specmap_cli.maps.directory import OutputDirectory
from specmap_cli.maps.edits import Edits, borders_in, edits_text, in_words
from specmap_cli.maps.edits_text import written
from specmap_cli.maps.store import StoredMap, opened_map
from specmap_cli.maps.writing import write_map
from specmap_cli.pipelines.edited import (
    Drawn,
    drawn,
    edits_of_stored,
    named,
    number_of,
    tell_unapplied,
)
from specmap_cli.pipelines.finished_map import FinishedMap
from specmap_cli.pipelines.kept_map import kept_of_stored
from specmap_cli.pipelines.learning import known_of
from specmap_cli.pipelines.localize import settings_for
from specmap_cli.pipelines.relabelling import carry_over, quality_of_stored, write_relabelled
from specmap_cli.pipelines.remaking import divided_anew
from specmap_cli.pipelines.stopwatch import Stopwatch
from specmap_cli.pipelines.stored_lessons import lessons_left, lessons_of_stored
from specmap_cli.pipelines.wishes import Wishes, with_wishes
from specmap_cli.recognition.learning.lessons import Lessons
from specmap_cli.topology.regions import Regions
from specmap_cli.topology.topological_map import TopologicalMap, default_name

# What no border changes: copied, so that nothing is rounded again.
_OF_THE_LAYOUT = frozenset({filenames.KEYFRAMES, filenames.TRAJECTORY, filenames.POSE_GRAPH})


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


@one_blas_thread()
def edit_map(
    map_: StoredMap | Path | str,
    wishes: Wishes | None = None,
    out: Path | str | None = None,
    config: Config | None = None,
    *,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> EditReport:
    """Make edits hold in a map: those of its edits.toml, and what is wished beside them.

    Without `out` the map itself is replaced, complete or not at all. Where it must be made anew, it
    is with `config`, by default with the settings that it was built with. Raises UsageError for a
    wish that does not apply; MapError for a damaged map or edits.toml, and for a merge or a split
    in a map without keyframes.
    """
    progress, wishes = progress or Silent(), wishes or Wishes()
    limits = None if config is None else config.limits
    stored = opened_map(map_, "map_", limits)
    if config is not None:
        instance_of(config, Config, "config")
    if stored.note:
        progress.note(stored.note)
    target = stored.path if out is None else path_of(out, "out")
    in_place = os.path.realpath(target) == os.path.realpath(stored.path)
    found = _drawn(stored, with_wishes(edits_of_stored(stored), wishes))
    _refuse_absent(found.submaps, wishes)
    _refuse_unapplied(_skipped(found), found, wishes)
    anew = found.borders != stored.record.graph.edits.borders
    with OutputDirectory(target, overwrite or in_place, progress) as partial:
        if anew:
            edited = _made_anew(stored, found, config, progress, partial)
        else:
            edited = _relabelled(stored, found, partial)
        _refuse_unapplied(edited.unapplied, found, wishes)
    tell_unapplied(edited.unapplied, progress)
    submaps, edges = edited.topology.submaps, edited.topology.edges
    return EditReport(
        out=target,
        edits=found.edits,
        unapplied=edited.unapplied,
        names={id_: submap.name or default_name(id_) for id_, submap in submaps.items()},
        forbidden=tuple(pair for pair, edge in sorted(edges.items()) if edge.forbidden),
        remade=anew,
    )


@dataclass(frozen=True, slots=True)
class _Edited:
    """A map that was written, and which edits do not apply to it."""

    topology: TopologicalMap
    unapplied: tuple[str, ...]


def _drawn(stored: StoredMap, edits: Edits) -> Drawn:
    """The keyframes with the borders of the edits; a finished grid has none that could be moved."""
    graph = stored.record.graph
    if not borders_in(edits) and not graph.edits.borders:
        return Drawn(np.array(stored.ids, dtype=np.int64), (), graph.next_id, edits)
    if not (stored.path / filenames.KEYFRAMES).exists():
        raise MapError(
            f"{stored.path}: has no {filenames.KEYFRAMES}: merges and splits need the scans of a "
            "map that this version of `specmap build` made of a recording"
        )
    whole, labels = stored.map_grid, stored.labels
    return drawn(whole, labels, graph.edits.borders, edits, graph.next_id)


def _refuse_absent(submaps: IntArray, wishes: Wishes) -> None:
    """Refuse to say something of submaps that are none."""
    known = sorted(set(submaps.tolist()) - {NO_SUBMAP})
    for id_ in wishes.submaps:
        if id_ not in known:
            there = ", ".join(str(each) for each in known)
            raise UsageError(
                f"there is no submap {id_} to name or to describe: choose from {there}"
            )


def _skipped(found: Drawn) -> list[str]:
    """What could not be made of the borders."""
    return [f"{number_of(place)}: {why}" for place, why in sorted(found.skipped.items())]


def _refuse_unapplied(unapplied: Sequence[str], found: Drawn, wishes: Wishes) -> None:
    """Refuse a wish that does not apply; what stands in edits.toml for longer may."""
    count = len(found.edits.changes)
    for place in range(count - len(wishes.changes), count):
        for line in unapplied:
            if line.startswith(f"{number_of(place)}: "):
                why = line.removeprefix(f"{number_of(place)}: ")
                raise UsageError(f"cannot {in_words(found.edits.changes[place])}: {why}")


def _relabelled(stored: StoredMap, found: Drawn, directory: Path) -> _Edited:
    """The map with its borders as they are."""
    bordered = replace(stored.topology, borders=found.borders, next_id=found.next_id)
    topology, unapplied = named(bordered, _regions(stored), found.edits, found.skipped)
    edits = written(found.edits, edits_text(stored.path, stored.limits))
    write_relabelled(directory, stored, topology, edits)
    return _Edited(topology, unapplied)


def _regions(stored: StoredMap) -> Regions | None:
    """The division of a map; None for one of a finished grid, which keeps none of the whole."""
    return stored.regions if (stored.path / filenames.LABELS).exists() else None


def _made_anew(
    stored: StoredMap, found: Drawn, config: Config | None, progress: Progress, directory: Path
) -> _Edited:
    """The map with other borders, made of its keyframes; what is thought of its layout stays."""
    clock, before = Stopwatch(), kept_of_stored(stored)
    config = settings_for(stored, {}) if config is None else config
    kept = replace(before, edits=found.edits)
    with stored.keyframes() as store:
        finished = divided_anew(
            store,
            kept,
            lambda _: quality_of_stored(stored),
            config,
            progress,
            clock,
            stored.counts,
            known_of(store, _lessons(stored, found, config), kept.starts, config),
        )
        overview = finished.overview(kept.logs)
        write_map(directory, finished.result(kept.logs, _run(stored, finished), overview), store)
    carry_over(stored.path, directory, filenames.OF_A_MAP - _OF_THE_LAYOUT)
    return _Edited(finished.topology, finished.unapplied)


def _lessons(stored: StoredMap, found: Drawn, config: Config) -> Lessons:
    """What the classifiers learned from that holds with other borders."""
    labels = stored.labels
    now, everything = replace(labels, submaps=found.submaps), np.arange(len(labels.stamps_ns))
    lessons = lessons_of_stored(stored, config)
    return lessons_left(lessons, labels, now, everything, config.grid.resolution_m)


def _run(stored: StoredMap, finished: FinishedMap) -> dict[str, Any]:
    """run.json of a map that was divided anew, by this version."""
    made = {"submaps": len(finished.topology.submaps), "edges": len(finished.topology.edges)}
    return {**stored.run, "versions": versions(), "counts": {**stored.counts, **made}}
