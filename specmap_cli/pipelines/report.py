"""The report on a map: a page for people, made of a map directory alone."""

from __future__ import annotations

from pathlib import Path

from specmap_cli.core.process import one_blas_thread
from specmap_cli.core.progress import Progress, Silent
from specmap_cli.core.settings import LimitsConfig
from specmap_cli.maps.store import StoredMap, opened_map
from specmap_cli.pipelines.compare import Comparison, compare_maps
from specmap_cli.pipelines.comparison_report import lines_of
from specmap_cli.pipelines.map_evidence import evidence_of
from specmap_cli.report.evidence import Changes
from specmap_cli.report.page import render


@one_blas_thread()
def report_map(
    map_: StoredMap | Path | str,
    compare: StoredMap | Path | str | None = None,
    limits: LimitsConfig | None = None,
    progress: Progress | None = None,
) -> str:
    """The report on a map directory, or on one that was read, as the text of one HTML page.

    `compare` is an older map of the same building. `limits` bound the files that are read. Raises
    MapError for a damaged map, NoResultError when the two maps cannot be aligned.
    """
    progress = progress or Silent()
    stored = opened_map(map_, "map_", limits)
    if stored.note:
        progress.note(stored.note)
    changes = None
    if compare is not None:
        older = opened_map(compare, "compare", limits)
        changes = _changes(compare_maps(older, stored, progress=progress))
    return render(stored, evidence_of(stored, progress), changes)


def _changes(found: Comparison) -> Changes:
    """A comparison as the report draws it: on the new map, both named without their folders."""
    record = found.record
    named = {
        which: getattr(record, which).model_copy(update={"map": stored.path.resolve().name})
        for which, stored in (("old", found.old), ("new", found.new))
    }
    return Changes(
        old=found.old,
        record=record,
        lines=tuple(lines_of(record.model_copy(update=named))),
        new_from_old=found.old_from_new.inverse(),
    )
