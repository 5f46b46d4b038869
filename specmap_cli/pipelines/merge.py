"""Several maps made one: whatever their order, the result is the same.

Every two maps are aligned. Those that meet are joined along the surest alignments, from the first
map on; what meets none of them stays apart. Maps are taken in the order of their recordings.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np

from specmap_cli.core.errors import InputError, UsageError, path_of
from specmap_cli.core.geometry import nearest_motion
from specmap_cli.core.process import one_blas_thread
from specmap_cli.core.progress import Progress, Silent
from specmap_cli.core.records import Closure, IntArray
from specmap_cli.core.settings import Config
from specmap_cli.core.text import counted
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.maps.directory import OutputDirectory
from specmap_cli.maps.store import Map, opened_map
from specmap_cli.pipelines.finishing import finish, with_borders, write_made
from specmap_cli.pipelines.joining import closures_between, join, place_apart
from specmap_cli.pipelines.laying_out import with_grid
from specmap_cli.pipelines.learning import Prior, training_data_of_stored, valid_training_data
from specmap_cli.pipelines.localizer import settings_for
from specmap_cli.pipelines.map_in_making import LaidOut, laid_out_of_stored
from specmap_cli.pipelines.overlaps import (
    Overlaps,
    Spread,
    overlaps_of,
    parts_of,
    steps_of,
    stored_to_align,
)
from specmap_cli.pipelines.reports import MergeReport
from specmap_cli.pipelines.session import Session
from specmap_cli.recognition.features.sets import check_feature_sets
from specmap_cli.recognition.learning.sampling import TrainingData


@one_blas_thread()
def merge_maps(
    maps: Sequence[Map | Path | str],
    out: Path | str,
    config: Config | None = None,
    *,
    overwrite: bool = False,
    progress: Progress | None = None,
    spread: Spread | None = None,
) -> MergeReport:
    """Make one map of several, in any order, and write it to the directory `out`.

    The frame and the ids are those of the map with the earliest recording. Without `config` the
    settings are that map's. `spread` aligns many pairs of maps at once, elsewhere, with the same
    result. Raises UsageError for fewer than two maps, InputError where two hold
    the same recording, MapError as `read_map` does.
    """
    target, progress = path_of(out, "out"), progress or Silent()
    given = [opened_map(one, "maps", config) for one in maps]
    first = oldest(given)
    config = config or settings_for(first, {})
    ordered = sorted(given, key=_age)
    check_feature_sets(config)
    made = OutputDirectory(target, overwrite, progress, made_of=given)
    with made as partial, KeyframeStore() as store:
        session = Session(config, store, progress)
        parts = [laid_out_of_stored(stored) for stored in ordered]
        to_align = [stored_to_align(stored) for stored in ordered]
        _refuse_twice(ordered)
        kept = [training_data_of_stored(stored, config) for stored in ordered]
        progress.start("aligning", None)
        with session.clock.stage("alignment"):
            overlaps = overlaps_of(ordered, to_align, config, spread)
        progress.start("layout", None)
        with session.clock.stage("layout"):
            merging = _Merging(session, ordered, parts, overlaps)
        counts: Counter[str] = Counter()  # of messages and scans, while the maps were built
        for stored in ordered:
            counts.update(stored.counts)
        laid = replace(merging.joint, counts=dict(counts))
        prior = Prior.of(session, merging.training_data(kept))
        finished = finish(session, laid, prior)
        paths = [stored.path.resolve() for stored in ordered]
        run = write_made(session, partial, finished, paths)
    short = [path.name for path in paths]  # a path where two are called the same
    names = [
        name if short.count(name) == 1 else str(stored.path)
        for name, stored in zip(short, ordered, strict=True)
    ]
    return MergeReport(
        out=target,
        run=run,
        quality=finished.quality,
        parts=tuple(
            tuple(names[k] for k in sorted(part)) for part in parts_of(len(names), overlaps)
        ),
        ids={name: merging.ids_of(k, finished.laid.labels.submaps) for k, name in enumerate(names)},
        unapplied=finished.unapplied,
    )


def oldest(maps: Sequence[Map]) -> Map:
    """The map whose frame, ids and settings the merged one has. UsageError for fewer than two."""
    if len(maps) < 2:
        raise UsageError(f"{counted(len(maps), 'map')} to merge", "give two or more")
    return min(maps, key=_age)


def _age(stored: Map) -> tuple[int, int, int, str]:
    """What orders maps whatever the order they are given in."""
    logs = stored.record.graph.logs
    start = min((log.start_ns for log in logs if log.start_ns is not None), default=0)
    end = max((log.end_ns for log in logs if log.end_ns is not None), default=0)
    return start, end, len(stored.labels.stamps_ns), stored.classifiers


def _refuse_twice(maps: Sequence[Map]) -> None:
    """Refuse maps that hold the same recording: its walls would count twice."""
    for one, other in combinations(maps, 2):
        known = {(log.name, log.start_ns, log.scans) for log in one.record.graph.logs}
        for log in other.record.graph.logs:
            if (log.name, log.start_ns, log.scans) in known:
                raise InputError(
                    f"holds {log.name}, and so does {one.path}",
                    "leave out one of them",
                    where=other.path,
                )


class _Merging:
    """Maps joined along their alignments, in the order of the store; the `joint` one in the end."""

    def __init__(
        self, session: Session, maps: Sequence[Map], parts: Sequence[LaidOut], overlaps: Overlaps
    ) -> None:
        self.session, self.maps, self.parts, self.overlaps = session, maps, parts, overlaps
        self._firsts: dict[int, tuple[int, int]] = {}  # first keyframe and stay of each map
        for parent, child in steps_of(len(parts), overlaps):
            with maps[child].scans() as own:
                session.store.extend(own)
            if self._firsts:
                joint = with_grid(session, self._joined(parent, child))
            else:
                joint, self._firsts[child] = parts[child], (0, 0)
            # what of its edits cannot be made is told in the end
            self.joint = with_borders(joint)[0]

    def ids_of(self, number: int, submaps: IntArray) -> dict[int, int]:
        """The submap that most keyframes of each one of a map are in now, by `submaps` (n,)."""
        first, _ = self._firsts[number]
        own = self.parts[number].labels.submaps
        now = submaps[first : first + len(own)]
        return {
            int(id_): int(np.bincount(now[own == id_]).argmax()) for id_ in np.unique(own[own >= 0])
        }

    def training_data(self, of_maps: Sequence[TrainingData]) -> TrainingData:
        """What the classifiers of the maps learned from, as it holds for all of them."""
        cell_m, now = self.session.config.grid.resolution_m, self.joint.labels
        found = []
        for number, (part, own) in enumerate(zip(self.parts, of_maps, strict=True)):
            first, _ = self._firsts[number]
            found.append(
                valid_training_data(own, part.labels, now, np.arange(len(part)), cell_m, first)
            )
        return TrainingData.joined(found)

    def _joined(self, parent: int | None, child: int) -> LaidOut:
        """One map more, laid into `parent`, which is in already, or beside all."""
        joint, new = self.joint, self.parts[child]
        if parent is None:
            where = place_apart(joint.whole, new.whole)
        else:
            motion = self.overlaps[min(parent, child), max(parent, child)].old_from_new
            assert motion is not None
            first, own = self._firsts[parent][0], self.parts[parent].labels.poses[:, :2]
            there = nearest_motion(own, joint.layout.poses[first : first + len(own), :2])
            where = there @ (motion if parent < child else motion.inverse())
        found = [
            replace(closure, old=closure.old + stay)
            for number, (_, stay) in self._firsts.items()
            for closure in self._closures(number, child)
        ]
        self._firsts[child] = len(joint), 1 + max(joint.stays, default=-1)
        return join(self.session, joint, new, where, found)

    def _closures(self, number: int, child: int) -> tuple[Closure, ...]:
        """What the alignment with the new map `child` says, by the numbers of their own stays."""
        one, other = min(number, child), max(number, child)
        if (one, other) not in self.overlaps:
            return ()
        joints = self.overlaps[one, other].joints
        found = closures_between(self.parts[one], self.parts[other], joints)
        if number < child:
            return found
        return tuple(
            replace(
                closure,
                old=closure.new,
                new=closure.old,
                old_from_new=closure.old_from_new and closure.old_from_new.inverse(),
            )
            for closure in found
        )
