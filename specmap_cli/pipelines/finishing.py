"""The tail of every pipeline: from a map that is laid out to a map directory.

The borders that a person asked for are made, classifiers learn the submaps, the submaps are linked,
ways lead through their doors, and a person's names hold. Then all of it is written.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from specmap_cli.core.findings import Quality, summary
from specmap_cli.core.process import give_memory_back
from specmap_cli.core.text import legible
from specmap_cli.core.worker import ahead
from specmap_cli.drawing.overview import render_overview
from specmap_cli.logs.selection import Selection
from specmap_cli.maps import filenames
from specmap_cli.maps.edits import written
from specmap_cli.maps.writing import MapResult, write_map, write_scans
from specmap_cli.pipelines.edits import drawn, named
from specmap_cli.pipelines.learning import Prior, learn
from specmap_cli.pipelines.map_in_making import FinishedMap, LaidOut
from specmap_cli.pipelines.reports import run_record
from specmap_cli.pipelines.session import Session
from specmap_cli.quality.findings import NARROW, narrow_links
from specmap_cli.topology.graph import build_topology, stays_of
from specmap_cli.topology.navigation import with_ways
from specmap_cli.topology.topological_map import Break


def finish(
    session: Session, laid: LaidOut, prior: Prior, quality: Quality | None = None
) -> FinishedMap:
    """Make the edits of a map hold, learn, find the ways, judge.

    `prior` is what there is to learn from, `quality` what is thought of the map, where that is
    known from before.
    """
    laid, skipped = with_borders(laid)
    labels, starts = laid.labels, laid.starts
    learned = learn(session, labels, prior, starts)
    give_memory_back()
    with session.clock.stage("ways"):
        linked = build_topology(
            labels=labels,
            breaks=[
                Break(keyframe, *((bridge.position_m, bridge.heading_rad) if bridge else ()))
                for keyframe, bridge in sorted(laid.breaks.items())
                if keyframe < len(laid)  # none came after the last of them
                and keyframe not in starts
            ],
            closures=laid.closures,
            stays=stays_of(laid.stays, labels),
            grids=learned.grids,
            starts=starts,
        )
        linked = replace(linked, borders=laid.borders, next_id=laid.next_id)
        linked = with_ways(linked, laid.regions, session.config.ways, labels.poses)
    topology, unapplied = named(linked, laid.regions, laid.edits, skipped)
    driven = {pair: edge for pair, edge in topology.edges.items() if edge.kind == "traversed"}
    fits_m = {pair: edge.clearance_m for pair, edge in driven.items() if edge.path is None}
    narrow = narrow_links(len(driven), fits_m, session.config.ways.robot_radius_m)
    before = (laid.quality if quality is None else quality).findings
    return FinishedMap(
        laid=laid,
        topology=topology,
        classifiers=learned.classifiers,
        features=learned.features,
        quality=Quality.of([*(one for one in before if one.code != NARROW), *narrow]),
        unapplied=(*unapplied, *laid.lost),
    )


def with_borders(laid: LaidOut) -> tuple[LaidOut, Mapping[int, str]]:
    """A map with the borders that its edits ask for.

    Also why a change could not be made, by its place in the list.
    """
    if not laid.borders and not laid.edits.changes:
        return laid, {}
    found = drawn(laid.whole, laid.labels, laid.borders, laid.edits, laid.next_id, laid.rooms)
    bordered = replace(
        laid,
        labels=replace(laid.labels, submaps=found.submaps),
        borders=found.borders,
        edits=found.edits,
        next_id=found.next_id,
    )
    return bordered, found.skipped


def write_made(
    session: Session,
    directory: Path,
    finished: FinishedMap,
    inputs: Sequence[Path],
    selection: Selection | None = None,
    **made_by: Any,
) -> Mapping[str, Any]:
    """Write a map that was made of `inputs` into an empty directory; returns its run.json.

    Before it is told which edits do not apply, what is grave, and what is worth knowing of it, but
    for what was told of the `selection` when the log was opened. What follows `inputs` is as in
    `run_record`.
    """
    for line in finished.unapplied:
        session.progress.note(f"{filenames.EDITS}: not applied: {line}")
    told = set() if selection is None else {legible(line) for line in selection.warnings}
    for warning in summary(finished.quality.warnings):
        if warning not in told:
            session.progress.warn(warning)
    for note in summary(finished.quality.notes):
        session.progress.note(note)
    return write_finished(
        session,
        directory,
        finished,
        lambda: run_record(session, finished, inputs, selection, **made_by),
    )


def write_finished(
    session: Session,
    directory: Path,
    finished: FinishedMap,
    run_of: Callable[[], Mapping[str, Any]],
) -> Mapping[str, Any]:
    """Write a map into an empty directory; returns its run.json, which `run_of` makes.

    The picture is drawn before that is asked: it takes memory, which run.json counts.
    """
    laid = finished.laid
    with ahead(lambda: _scans(session, directory, laid)) as scans:
        overview = render_overview(
            finished.topology,
            laid.regions,
            laid.trajectory,
            laid.labels,
            laid.logs,
            finished.quality,
        )
        run = run_of()
        result = MapResult(
            topology=finished.topology,
            regions=laid.regions,
            trajectory=laid.trajectory,
            labels=laid.labels,
            classifiers=finished.classifiers.to_json(),
            features=finished.features,
            logs=laid.logs,
            run=run,
            quality=finished.quality,
            pose_graph=laid.layout.g2o(),
            edits=written(laid.edits, laid.edits_text),
            overview=overview,
        )
        give_memory_back()
        write_map(directory, result, lambda: scans.result)
    return run


def _scans(session: Session, directory: Path, laid: LaidOut) -> Generator[None, None, None]:
    """Write the scans of the keyframes; nothing is told on the way."""
    yield from ()
    write_scans(directory, session.store, laid.labels)
