"""Several maps made one: whatever their order, the result is the same.

Every two maps are aligned. Those that meet are joined along the surest alignments, from the first
map on; what meets none of them stays apart. Maps are taken in the order of their recordings.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path

import numpy as np

from specmap_cli.core.arguments import instance_of, path_of
from specmap_cli.core.errors import InputError, UsageError
from specmap_cli.core.geometry import Pose2, nearest_motion
from specmap_cli.core.process import one_blas_thread
from specmap_cli.core.progress import Progress, Silent
from specmap_cli.core.records import Closure, IntArray
from specmap_cli.core.settings import Config
from specmap_cli.core.text import counted
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.layout.audit import Audit
from specmap_cli.layout.healing import Audited
from specmap_cli.maps.directory import OutputDirectory
from specmap_cli.maps.store import StoredMap, opened_map
from specmap_cli.maps.writing import write_map
from specmap_cli.pipelines.assessment import tell
from specmap_cli.pipelines.edited import drawn
from specmap_cli.pipelines.kept_map import KeptMap, Seen, seen_of_stored
from specmap_cli.pipelines.learning import Known, known_of, whole_grid
from specmap_cli.pipelines.localize import settings_for
from specmap_cli.pipelines.map_joining import Joined, beside, closures_between, join
from specmap_cli.pipelines.meetings import Meetings, Spread, meetings_of, parts_of, steps_of
from specmap_cli.pipelines.merge_report import MergeReport
from specmap_cli.pipelines.remaking import remade
from specmap_cli.pipelines.run_record import OF_THE_MAP, run_record
from specmap_cli.pipelines.stopwatch import Stopwatch
from specmap_cli.pipelines.stored_lessons import lessons_left, lessons_of_stored
from specmap_cli.recognition.features.sets import check_feature_sets
from specmap_cli.recognition.learning.lessons import Lessons
from specmap_cli.topology.regions import divide
from specmap_cli.topology.topological_map import fences_of


@one_blas_thread()
def merge_maps(
    maps: Sequence[StoredMap | Path | str],
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
    limits = None if config is None else config.limits
    given = [opened_map(one, "maps", limits) for one in maps]
    first = oldest(given)
    config = settings_for(first, {}) if config is None else instance_of(config, Config, "config")
    ordered = sorted(given, key=_age)
    check_feature_sets(config)
    clock = Stopwatch()
    with OutputDirectory(target, overwrite, progress) as partial, KeyframeStore() as store:
        seen = [seen_of_stored(stored) for stored in ordered]
        _refuse_twice(ordered)
        lessons = [lessons_of_stored(stored, config) for stored in ordered]
        progress.start("aligning", None)
        with clock.stage("alignment"):
            meetings = meetings_of(ordered, seen, config, spread)
        progress.start("layout", None)
        with clock.stage("layout"):
            merging = _merged(ordered, seen, meetings, store, config)
        counts = _counts(ordered)
        known = _known(ordered, lessons, merging, store, config)
        finished = remade(store, merging.joined, config, progress, clock, counts, known)
        overview = finished.overview(merging.joined.kept.logs)
        run = run_record([stored.path.resolve() for stored in ordered], None, config, finished)
        tell(finished.quality, progress)
        write_map(partial, finished.result(merging.joined.kept.logs, run, overview), store)
    names = _names(ordered)
    return MergeReport(
        out=target,
        run=run,
        quality=finished.quality,
        parts=tuple(
            tuple(names[k] for k in sorted(part)) for part in parts_of(len(seen), meetings)
        ),
        ids={
            names[k]: merging.ids_of(k, seen[k].kept, finished.labels.submaps)
            for k in range(len(seen))
        },
        unapplied=finished.unapplied,
    )


def oldest(maps: Sequence[StoredMap]) -> StoredMap:
    """The map whose frame, ids and settings the merged one has. UsageError for fewer than two."""
    if len(maps) < 2:
        raise UsageError(f"{counted(len(maps), 'map')} to merge: give two or more")
    return min(maps, key=_age)


def _age(stored: StoredMap) -> tuple[int, int, int, str]:
    """What orders maps whatever the order they are given in."""
    logs = stored.record.graph.logs
    start = min((log.start_ns for log in logs if log.start_ns is not None), default=0)
    end = max((log.end_ns for log in logs if log.end_ns is not None), default=0)
    return start, end, len(stored.labels.stamps_ns), stored.classifiers


def _names(maps: Sequence[StoredMap]) -> list[str]:
    """A name for each map: that of its directory, with its path where two are called the same."""
    short = [stored.path.resolve().name for stored in maps]
    return [
        name if short.count(name) == 1 else str(stored.path)
        for name, stored in zip(short, maps, strict=True)
    ]


def _refuse_twice(maps: Sequence[StoredMap]) -> None:
    """Refuse maps that hold the same recording: its walls would count twice."""
    for one, other in combinations(maps, 2):
        known = {(log.name, log.start_ns, log.scans) for log in one.record.graph.logs}
        for log in other.record.graph.logs:
            if (log.name, log.start_ns, log.scans) in known:
                raise InputError(
                    f"{other.path}: holds {log.name}, and so does {one.path}: leave out one of them"
                )


def _counts(maps: Sequence[StoredMap]) -> dict[str, int]:
    """What was counted of messages and scans while the maps were built."""
    totals: Counter[str] = Counter()
    for stored in maps:
        totals.update({n: count for n, count in stored.counts.items() if n not in OF_THE_MAP})
    return dict(totals)


@dataclass(frozen=True, slots=True)
class _Merging:
    """Maps joined so far; `firsts` are the first keyframe and the first stay of each, by number."""

    joined: Joined
    whole: GridMap
    firsts: Mapping[int, tuple[int, int]]

    def ids_of(self, number: int, kept: KeptMap, submaps: IntArray) -> dict[int, int]:
        """The submap of the result that most keyframes of each submap of one map are in.

        `submaps` (n,) are those of all keyframes in the result.
        """
        first, _ = self.firsts[number]
        own = kept.labels.submaps
        now = submaps[first : first + len(own)]
        return {
            int(id_): int(np.bincount(now[own == id_]).argmax()) for id_ in np.unique(own[own >= 0])
        }

    def pose_of(self, number: int, kept: KeptMap) -> Pose2:
        """The frame of one of the maps in the joint map, by the places of its keyframes."""
        first, _ = self.firsts[number]
        own = kept.labels.poses[:, :2]
        return nearest_motion(own, self.joined.kept.layout.poses[first : first + len(own), :2])


def _known(
    maps: Sequence[StoredMap],
    lessons: Sequence[Lessons],
    merging: _Merging,
    store: KeyframeStore,
    config: Config,
) -> Known:
    """What the maps keep of what their classifiers learned from, as it holds for all of them."""
    joint, cell_m = merging.joined.kept, config.grid.resolution_m
    parts = []
    for number, (stored, own) in enumerate(zip(maps, lessons, strict=True)):
        before, (first, _) = stored.labels, merging.firsts[number]
        everything = np.arange(len(before.stamps_ns))
        parts.append(lessons_left(own, before, joint.labels, everything, cell_m, first))
    return known_of(store, Lessons.joined(parts), joint.starts, config)


def _merged(
    maps: Sequence[StoredMap],
    seen: Sequence[Seen],
    meetings: Meetings,
    store: KeyframeStore,
    config: Config,
) -> _Merging:
    """All maps in one, their keyframes in `store` in the order of joining."""
    (_, first), *steps = steps_of(len(seen), meetings)
    _copy(maps[first], store)
    whole = seen[first].known.whole
    kept = _edited(seen[first].kept, whole)
    nothing = Audited(kept.layout, Audit(compared=0, disagreements=()))
    merging = _Merging(Joined(kept, nothing), whole, {first: (0, 0)})
    for parent, child in steps:
        _copy(maps[child], store)
        merging = _with(merging, parent, child, seen, meetings, store, config)
    return merging


def _edited(kept: KeptMap, whole: GridMap) -> KeptMap:
    """A map with the borders that its edits ask for; what cannot be made is told in the end."""
    found = drawn(whole, kept.labels, kept.borders, kept.edits, kept.next_id)
    labels = replace(kept.labels, submaps=found.submaps)
    return replace(
        kept, labels=labels, borders=found.borders, edits=found.edits, next_id=found.next_id
    )


def _copy(stored: StoredMap, store: KeyframeStore) -> None:
    with stored.keyframes() as own:
        store.extend(own)


def _with(
    merging: _Merging,
    parent: int | None,
    child: int,
    seen: Sequence[Seen],
    meetings: Meetings,
    store: KeyframeStore,
    config: Config,
) -> _Merging:
    """One map more, laid into `parent`, which is in already, or beside all."""
    joint, new = merging.joined.kept, seen[child]
    where = beside(merging.whole, new.known.whole)
    if parent is not None:
        where = merging.pose_of(parent, seen[parent].kept) @ _motion(meetings, parent, child)
    found = [
        replace(closure, old=closure.old + stay)
        for number, (_, stay) in merging.firsts.items()
        for closure in _closures(meetings, number, child, seen)
    ]
    firsts = {
        **merging.firsts,
        child: (len(joint.labels.stamps_ns), 1 + max(joint.stays, default=-1)),
    }
    regions = divide(merging.whole, joint.labels, fences_of(joint.borders))
    joined = join(store, joint, regions, new, where, found, config)
    whole = whole_grid(store, joined.kept.layout, config)[0]
    edited = replace(joined, kept=_edited(joined.kept, whole))
    return _Merging(edited, whole, firsts)


def _motion(meetings: Meetings, parent: int, child: int) -> Pose2:
    """Where one map lies in another that it meets."""
    alignment = meetings[min(parent, child), max(parent, child)]
    assert alignment.old_from_new is not None
    return alignment.old_from_new if parent < child else alignment.old_from_new.inverse()


def _closures(
    meetings: Meetings, number: int, child: int, seen: Sequence[Seen]
) -> tuple[Closure, ...]:
    """What the alignment of two maps says, `child` being the new one; nothing if they do not meet.

    Stays have the numbers of their own maps.
    """
    pair = min(number, child), max(number, child)
    if pair not in meetings:
        return ()
    found = closures_between(seen[pair[0]].kept, seen[pair[1]].kept, meetings[pair].joints)
    return found if number < child else tuple(_turned(closure) for closure in found)


def _turned(closure: Closure) -> Closure:
    """The same with old and new changed over."""
    motion = closure.old_from_new
    return replace(
        closure,
        old=closure.new,
        new=closure.old,
        old_from_new=None if motion is None else motion.inverse(),
    )
