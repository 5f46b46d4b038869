"""A map that can grow: its keyframes, what ties them, and how the map looks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from specmap_cli.core.errors import InputError, MapError
from specmap_cli.core.findings import Finding
from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.records import Closure, IntArray, Labels, Trajectory
from specmap_cli.core.settings import Config
from specmap_cli.core.text import counted
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.layout.carrying import rows_of
from specmap_cli.layout.g2o import read_g2o
from specmap_cli.layout.motion_edges import Bridge
from specmap_cli.layout.relaxation import Layout
from specmap_cli.maps import filenames
from specmap_cli.maps.edits import Edits, edits_text
from specmap_cli.maps.json_files import map_text
from specmap_cli.maps.store import StoredMap
from specmap_cli.maps.tum import read_trajectory
from specmap_cli.pipelines.assessment import evidence_of
from specmap_cli.pipelines.edited import edits_of_stored
from specmap_cli.pipelines.exploration import Explored
from specmap_cli.pipelines.finished_map import recording
from specmap_cli.pipelines.laying_out import LaidOut
from specmap_cli.pipelines.learning import divide, submap_grids, submaps_of, whole_grid
from specmap_cli.pipelines.localize import classifiers_of
from specmap_cli.quality.verdict import LAYOUT_CODES, of_recording
from specmap_cli.recognition.closure.known_map import KnownMap
from specmap_cli.topology.regions import Regions
from specmap_cli.topology.regions import divide as divide_cells
from specmap_cli.topology.topological_map import BorderEdit, LogInfo, TopologicalMap, starts_of

Stays = Mapping[int, tuple[int, ...]]


@dataclass(frozen=True, slots=True, kw_only=True)
class KeptMap:
    """A map with its keyframes: number i of the store is row i of `labels` and of the layout.

    `stays` are the keyframes of each piece in which the robot saw the map, by number, that of its
    frame first; `closures` name these. `breaks` are the keyframes at which tracking started afresh
    or another recording begins. `findings` are those about the recordings. `edits` are what a
    person decided, `edits_text` how it was written down, `borders` what of it the labels show, and
    `lost`, in words, what was decided about maps that are in this one and says nothing of it.
    `next_id` and what follows it are ids that no submap ever had.
    """

    layout: Layout
    labels: Labels
    trajectory: Trajectory
    stays: Stays
    closures: tuple[Closure, ...]
    breaks: Mapping[int, Bridge | None]
    logs: tuple[LogInfo, ...]
    findings: tuple[Finding, ...]
    next_id: int
    edits: Edits = field(default_factory=Edits)
    edits_text: str = ""
    lost: tuple[str, ...] = ()
    borders: tuple[BorderEdit, ...] = ()

    @property
    def starts(self) -> tuple[int, ...]:
        """The keyframes with which the recordings after the first one begin."""
        return starts_of(self.logs)

    @property
    def recordings(self) -> IntArray:
        """(n,) the recording, 0, 1, ..., of each keyframe."""
        number = np.arange(len(self.labels.stamps_ns))
        return np.searchsorted(np.array(self.starts, dtype=np.int64), number, side="right")

    @property
    def scan_starts(self) -> tuple[int, ...]:
        """The rows of the trajectory with which the recordings after the first one begin."""
        return tuple(np.cumsum([log.scans for log in self.logs])[:-1].tolist())


def thinned_of(logs: Sequence[LogInfo], recordings: IntArray) -> IntArray:
    """(n,) the recordings of keyframes, -1 for those of which a map keeps all."""
    whole = [log.path_m is None for log in logs if log.keyframes is not None]
    return np.where(np.array(whole)[recordings], -1, recordings)


@dataclass(frozen=True, slots=True)
class Seen:
    """A kept map as it looks: the division of its cells, and what aligns it with others."""

    kept: KeptMap
    regions: Regions
    known: KnownMap


def kept_of_stored(stored: StoredMap) -> KeptMap:
    """A map directory. Raises MapError when a file that it takes is missing or damaged."""
    topology, labels = stored.topology, stored.labels
    logs = stored.logs
    return KeptMap(
        layout=_layout(stored),
        labels=labels,
        trajectory=_trajectory(stored),
        stays={stay.number: stay.from_origin for stay in topology.stays},
        closures=topology.closures,
        breaks=_breaks(topology, logs),
        logs=logs,
        findings=_findings(stored),
        next_id=topology.next_id,
        edits=edits_of_stored(stored),
        edits_text=edits_text(stored.path, stored.limits),
        borders=topology.borders,
    )


def seen_of_stored(stored: StoredMap) -> Seen:
    """A map directory as it looks. Raises MapError as `kept_of_stored` does."""
    submaps = stored.topology.submaps
    known = KnownMap(
        whole=stored.map_grid,
        grids=stored.grids,
        frames={id_: submap.map_from_submap for id_, submap in submaps.items()},
        tracks=_tracks(stored.labels),
        classifiers=classifiers_of(stored),
    )
    return Seen(kept_of_stored(stored), stored.regions, known)


def seen_of_log(
    explored: Explored,
    laid: LaidOut,
    name: str,
    warnings: tuple[str, ...],
    store: KeyframeStore,
    config: Config,
) -> Seen:
    """A recording that was explored and laid out by itself; no classifier was trained for it.

    `name` is that of its file, `warnings` are those of reading and registration.
    """
    whole, beyond = whole_grid(store, laid.layout, config)
    submaps = divide(whole, laid.layout, explored.regions, laid.closures, config)
    labels = Labels(
        stamps_ns=np.array(store.stamps_ns, dtype=np.int64),
        poses=laid.layout.poses,
        submaps=submaps,
    )
    evidence = evidence_of(store, explored, laid, beyond, warnings)
    kept = KeptMap(
        layout=laid.layout,
        labels=labels,
        trajectory=laid.trajectory,
        stays=explored.regions,
        closures=laid.closures,
        breaks=explored.breaks,
        logs=(recording(name, laid.trajectory, len(submaps)),),
        findings=tuple(of_recording(evidence)),
        next_id=1 + int(submaps.max()),
    )
    keyframes = submaps_of(submaps)
    known = KnownMap(
        whole=whole,
        grids=submap_grids(store, keyframes, labels.poses, config),
        frames={id_: Pose2(*labels.poses[own[0]].tolist()) for id_, own in keyframes.items()},
        tracks=_tracks(labels),
    )
    return Seen(kept, divide_cells(whole, labels), known)


def _findings(stored: StoredMap) -> tuple[Finding, ...]:
    """What was found out about the recordings."""
    quality = stored.record.graph.quality
    found = [] if quality is None else quality.findings
    return tuple(one for one in found if one.code not in LAYOUT_CODES)


def _layout(stored: StoredMap) -> Layout:
    """The layout of a map directory, with the links that are more than the way between nodes."""
    path, labels = stored.path / filenames.POSE_GRAPH, stored.labels
    text = map_text(path, stored.limits)
    try:
        poses, links = read_g2o(text)
    except InputError as error:
        raise MapError(f"{path}: {error}: build the map again") from None
    nodes = np.array(sorted(poses), dtype=np.int64)
    ends = {end for link in links for end in (link.source, link.target)}
    if not ends <= poses.keys() <= set(range(len(labels.poses))):
        raise MapError(
            f"{path}: its vertices are not among the {counted(len(labels.poses), 'keyframe')} of "
            f"{filenames.LABELS}: build the map again"
        )
    after = dict(pairwise(nodes.tolist()))
    return Layout(
        poses=labels.poses,
        nodes=nodes,
        kept=tuple(link for link in links if after.get(link.source) != link.target),
    )


def _trajectory(stored: StoredMap) -> Trajectory:
    """The trajectory of a map directory, which leads through its keyframes."""
    path, labels = stored.path / filenames.TRAJECTORY, stored.labels
    trajectory = read_trajectory(path, stored.limits)
    found = rows_of(trajectory, labels.stamps_ns.tolist(), labels.poses)
    if len(found) != len(labels.stamps_ns) or len(trajectory.stamps_ns) != sum(
        log.scans for log in stored.logs
    ):
        raise MapError(
            f"{path}: is not the way through the keyframes of {filenames.LABELS} and the logs of "
            f"{filenames.TOPOLOGY}: build the map again"
        )
    return trajectory


def _breaks(topology: TopologicalMap, logs: Sequence[LogInfo]) -> dict[int, Bridge | None]:
    """Where tracking started afresh, and where recordings begin."""
    return {
        **dict.fromkeys(starts_of(logs)),
        **{
            each.keyframe: None
            if each.position_m is None or each.heading_rad is None
            else Bridge(each.position_m, each.heading_rad)
            for each in topology.breaks
        },
    }


def _tracks(labels: Labels) -> dict[int, FloatArray]:
    """Where the robot was in each submap, in the map."""
    return {id_: labels.poses[keyframes] for id_, keyframes in submaps_of(labels.submaps).items()}
