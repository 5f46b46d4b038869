"""What a person decided about a map: names, kinds, properties, merges, splits, forbidden doors.

Names, kinds, properties and forbidden doors are written into a map at once. Where borders change,
it is made anew from its keyframes: grids, classifiers, regions and links; its layout stays.
"""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import networkx as nx
import numpy as np

from specmap_cli.core.errors import MapError, UsageError, is_of_the_place, path_of
from specmap_cli.core.findings import summary
from specmap_cli.core.process import one_blas_thread, versions
from specmap_cli.core.progress import Progress, Silent
from specmap_cli.core.records import NO_SUBMAP
from specmap_cli.drawing.overview import render_overview, render_segmentation
from specmap_cli.grids.map_server import write_png
from specmap_cli.maps import filenames
from specmap_cli.maps.directory import OutputDirectory
from specmap_cli.maps.edits import Edits, borders_in, edits_text, in_words, written
from specmap_cli.maps.schema import EditsRecord, TopologyRecord, placed
from specmap_cli.maps.store import Map, opened_map
from specmap_cli.pipelines.edits import (
    Drawn,
    RequestedEdits,
    drawn,
    edits_of_stored,
    named,
    number_of,
    with_requested,
)
from specmap_cli.pipelines.finishing import finish, write_finished
from specmap_cli.pipelines.laying_out import with_grid
from specmap_cli.pipelines.learning import Prior, training_data_of_stored, valid_training_data
from specmap_cli.pipelines.localizer import settings_for
from specmap_cli.pipelines.map_in_making import laid_out_of_stored, quality_of_stored
from specmap_cli.pipelines.reports import EditReport
from specmap_cli.pipelines.session import Session
from specmap_cli.segmentation.division import driven
from specmap_cli.topology.navigation import parts
from specmap_cli.topology.regions import Regions, kind_of
from specmap_cli.topology.topological_map import TopologicalMap, default_name

# What no border changes: copied, so that nothing is rounded again.
_OF_THE_LAYOUT = frozenset({filenames.KEYFRAMES, filenames.TRAJECTORY, filenames.POSE_GRAPH})
_REWRITTEN = (filenames.TOPOLOGY, filenames.OVERVIEW, filenames.EDITS)

Edited = tuple[TopologicalMap, tuple[str, ...]]  # as it was written, and what does not apply to it


@one_blas_thread()
def edit_map(
    map_: Map | Path | str,
    requested: RequestedEdits | None = None,
    out: Path | str | None = None,
    *,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> EditReport:
    """Make edits hold in a map: those of its edits.toml, and what is requested beside them.

    Without `out` the map itself is replaced, complete or not at all. Where it must be made anew, it
    is with the settings that it was built with. Raises UsageError for a request that does not
    apply; MapError for a damaged map or edits.toml, and for a merge or a split in a map without
    keyframes.
    """
    progress, requested = progress or Silent(), requested or RequestedEdits()
    stored = opened_map(map_, "map_")
    if stored.note:
        progress.note(stored.note)
    target = stored.path if out is None else path_of(out, "out")
    in_place = os.path.realpath(target) == os.path.realpath(stored.path)
    # once the map is held nobody changes its edits.toml unseen
    with OutputDirectory(target, overwrite or in_place, progress, made_of=[stored]) as partial:
        before = edits_of_stored(stored)
        found = _drawn(stored, with_requested(before, requested))
        known = sorted(set(found.submaps.tolist()) - {NO_SUBMAP})
        for id_ in sorted({*requested.submaps, *set(requested.forget).difference(before.submaps)}):
            if id_ not in known:
                there = ", ".join(str(each) for each in known)
                raise UsageError(
                    f"there is no submap {id_} to name, describe or forget", f"choose from {there}"
                )
        skipped = [f"{number_of(place)}: {why}" for place, why in sorted(found.skipped.items())]
        _refuse_unapplied(skipped, found, requested)
        anew = found.borders != stored.record.graph.edits.borders
        if anew:
            topology, unapplied = _made_anew(stored, found, progress, partial)
        else:
            topology, unapplied = _relabelled(stored, found, partial)
        _refuse_unapplied(unapplied, found, requested)
    for line in unapplied:
        progress.note(f"{filenames.EDITS}: not applied: {line}")
    for line in (*_torn(stored.record, requested), *_surprises(stored.record, topology)):
        progress.warn(line)
    submaps, edges = topology.submaps, topology.edges
    return EditReport(
        out=target,
        edits=found.edits,
        unapplied=unapplied,
        names={id_: submap.name or default_name(id_) for id_, submap in submaps.items()},
        forbidden=tuple(pair for pair, edge in sorted(edges.items()) if edge.forbidden),
        remade=anew,
    )


def _torn(before: TopologyRecord, requested: RequestedEdits) -> Iterator[str]:
    """The merges asked for of submaps between which there is no link: one room of two pieces."""
    graph = nx.Graph([(edge.source, edge.target) for edge in before.edges])
    graph.add_nodes_from(node.id for node in before.nodes)
    for change in requested.changes:
        one, other = change.get("merge", (None, None))
        if one in graph and other in graph:
            if not graph.has_edge(one, other):
                yield f"submaps {one} and {other} were merged, though no link is between them"
            graph = nx.contracted_nodes(graph, one, other, self_loops=False)


def _surprises(before: TopologyRecord, after: TopologicalMap) -> Iterator[str]:
    """What a person may not have meant, where it is new: rooms cut off, one name given twice."""
    edges, were = after.edges.values(), parts([node.id for node in before.nodes], before.edges)
    apart = {id_ for part in were[1:] for id_ in part}
    allowed = parts(after.submaps, [replace(edge, forbidden=False) for edge in edges])
    shut = [part for part in parts(after.submaps, edges)[1:] if part not in allowed]
    reasons = ("no way there is wide enough for the robot", "every way there is forbidden")
    for found, why in zip((allowed[1:], shut), reasons, strict=True):
        cut = [part for part in found if not apart.issuperset(part)]
        if cut:
            noun = "submap" if sum(map(len, cut)) == 1 else "submaps"
            which = "; ".join(", ".join(map(str, part)) for part in cut)
            yield f"no route leads to {noun} {which} any more: {why}"
    names = {id_: submap.name or default_name(id_) for id_, submap in after.submaps.items()}
    was = {node.id: node.name for node in before.nodes}
    for name in dict.fromkeys(names[id_] for id_ in sorted(names) if names[id_] != was.get(id_)):
        of = [id_ for id_ in sorted(names) if names[id_] == name]
        if len(of) > 1:
            yield f"{len(of)} submaps are called {name!r}: {', '.join(map(str, of))}"


def _drawn(stored: Map, edits: Edits) -> Drawn:
    """The keyframes with the borders of the edits; a finished grid has none that could be moved."""
    graph = stored.record.graph
    if not borders_in(edits) and not graph.edits.borders:
        return Drawn(np.array(stored.ids, dtype=np.int64), (), graph.next_id, edits=edits)
    if not (stored.path / filenames.KEYFRAMES).exists():
        raise MapError(
            f"has no {filenames.KEYFRAMES}: merges and splits need the scans of a map "
            "that this version of `specmap build` made of a recording",
            where=stored.path,
        )
    if not graph.stays:
        raise MapError("keeps no stays: its borders are fixed", "build it again", where=stored.path)
    whole, labels = stored.map_grid, stored.labels
    rooms = driven(whole, stored.regions.owner, labels.poses)
    return drawn(whole, labels, graph.edits.borders, edits, graph.next_id, rooms)


def _refuse_unapplied(unapplied: Sequence[str], found: Drawn, requested: RequestedEdits) -> None:
    """Refuse a request that does not apply; what stands in edits.toml for longer may."""
    count = len(found.edits.changes)
    for place in range(count - len(requested.changes), count):
        for line in unapplied:
            number, _, why = line.partition(": ")
            if number == number_of(place):
                raise UsageError(f"cannot {in_words(found.edits.changes[place])}: {why}")


def _relabelled(stored: Map, found: Drawn, directory: Path) -> Edited:
    """The map with its borders as they are."""
    bordered = replace(stored.topology, borders=found.borders, next_id=found.next_id)
    regions = stored.regions
    topology, unapplied = named(bordered, regions, found.edits, found.skipped)
    edits = written(found.edits, edits_text(stored.path, stored.limits))
    _carry_over(stored.path, directory, _REWRITTEN)
    record = _record_with(stored.record, topology, regions)
    (directory / filenames.TOPOLOGY).write_text(record.text(), encoding="utf-8")
    logs = stored.record.graph.logs
    if not stored.of_recording:
        picture = render_segmentation(topology, regions, logs[0], stored.frame)
    else:
        way, quality = stored.trajectory, quality_of_stored(stored)
        labels = stored.labels
        picture = render_overview(topology, regions, way, labels, logs, quality, stored.frame)
    write_png(directory / filenames.OVERVIEW, picture)
    if edits:
        (directory / filenames.EDITS).write_text(edits, encoding="utf-8")
    return topology, unapplied


def _made_anew(stored: Map, asked: Drawn, progress: Progress, directory: Path) -> Edited:
    """The map with other borders, made of its keyframes; what is thought of its layout stays."""
    config = settings_for(stored, {})
    laid, labels = laid_out_of_stored(stored), stored.labels
    kept = valid_training_data(
        training_data_of_stored(stored, config),
        labels,
        replace(labels, submaps=asked.submaps),
        np.arange(len(laid)),
        config.grid.resolution_m,
    )
    with stored.scans() as store:
        session = Session(config, store, progress)
        laid = with_grid(session, replace(laid, edits=asked.edits)).keeping(stored.regions)
        prior = Prior.of(session, kept)
        before = quality_of_stored(stored)
        finished = finish(session, laid, prior, before)
        known, quality = {*summary(before.warnings), *summary(before.notes)}, finished.quality
        for tell, found in ((progress.warn, quality.warnings), (progress.note, quality.notes)):
            for line in summary(found):
                if line not in known:
                    tell(line)
        made = {"counts": finished.counts, "quality": quality.as_dict()}
        run = {**stored.run, "versions": versions(), **made}
        _carry_over(stored.path, directory, filenames.OF_A_MAP - _OF_THE_LAYOUT)
        write_finished(session, directory, finished, lambda: run)
    return finished.topology, finished.unapplied


def _record_with(
    record: TopologyRecord, topology: TopologicalMap, regions: Regions
) -> TopologyRecord:
    """The contents of topology.json with the names and the like of an edited map."""
    nodes = []
    for node in record.nodes:
        submap = topology.submaps[node.id]
        shape = np.array(node.polygon, dtype=np.float64).reshape(-1, 2)
        said = {
            "name": submap.name or default_name(node.id),
            "kind": submap.kind or kind_of(shape),
            "properties": dict(submap.properties),
        }
        nodes.append(node.model_copy(update=said))
    shown = {
        "edits": EditsRecord(submaps=topology.said, borders=topology.borders),
        "next_id": topology.next_id,
        "doors": topology.doors,
        "seen": regions.seen,
    }
    graph, edges = record.graph.model_copy(update=shown), placed(topology, nodes)
    return record.model_copy(update={"graph": graph, "nodes": tuple(nodes), "edges": edges})


def _carry_over(source: Path, target: Path, without: Collection[str]) -> None:
    """Copy what a directory holds, but for some names. Raises MapError for what cannot be read."""
    try:
        for path in sorted(source.iterdir()):
            if path.name in without:
                continue
            if path.is_dir():
                shutil.copytree(path, target / path.name)
            elif path.is_file():
                shutil.copyfile(path, target / path.name)
    except OSError as error:
        if is_of_the_place(error) and error.errno != errno.EIO:  # it is the output that is full
            raise OSError(error.errno, error.strerror, str(target)) from None
        raise MapError.of_system(error, "cannot be copied", where=source) from None
