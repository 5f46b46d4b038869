"""A map in the making: explored while the log lasts, laid out, finished.

`Explored` is what Algorithm 1 found on the way. `LaidOut` has one pose and one submap a keyframe:
so begins the rest of every pipeline, and a map directory is read as one. `FinishedMap` has what was
learned of the submaps, and how they are linked: all that a map directory is written from.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from specmap_cli.core.arrays import Packed, windows_of
from specmap_cli.core.errors import InputError, MapError
from specmap_cli.core.findings import UNDOUBTED, Finding, Quality
from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import NO_SUBMAP, Closure, IntArray, Labels, Trajectory
from specmap_cli.core.text import counted
from specmap_cli.grids.gridmap import GridMap, Piece
from specmap_cli.layout.joining import gaps_of
from specmap_cli.layout.passes import PassesOnTheWay
from specmap_cli.layout.path_graph import Bridge
from specmap_cli.layout.pose_graph import read_g2o
from specmap_cli.layout.result import Layout, propagated, rows_of
from specmap_cli.maps import filenames
from specmap_cli.maps.edits import Edits, edits_text
from specmap_cli.maps.features_file import Arrays
from specmap_cli.maps.store import Map
from specmap_cli.maps.text_files import map_text
from specmap_cli.pipelines.edits import edits_of_stored
from specmap_cli.quality.evidence import Evidence
from specmap_cli.quality.findings import is_of_recording, of_layout
from specmap_cli.recognition.features.sets import KeyframeFeatures
from specmap_cli.recognition.learning.classifiers import ClassifierSet
from specmap_cli.segmentation.division import driven, regions_of
from specmap_cli.topology.regions import NOBODY, Regions, divide
from specmap_cli.topology.topological_map import (
    BorderEdit,
    LogInfo,
    TopologicalMap,
    driven_m,
    fences_of,
    starts_of,
)

_MOST = 0.5  # share of a region that makes it a part of what was there

Breaks = Mapping[int, Bridge | None]


@dataclass(frozen=True, slots=True, kw_only=True)
class Explored:
    """What Algorithm 1 found.

    `regions` holds the keyframes of each region that was left, that of its frame first. `closures`
    are all pairs of regions that were considered, in order. `breaks` are the keyframes at which
    tracking started afresh, and how well odometry bridges each. `features` are those of the
    keyframes, each computed once. `passes` is the search for nearby passes as far as it has come.
    """

    trajectory: Trajectory
    regions: Mapping[int, tuple[int, ...]]
    closures: tuple[Closure, ...]
    breaks: Breaks
    features: KeyframeFeatures
    passes: PassesOnTheWay | None


@dataclass(frozen=True, kw_only=True)
class LaidOut:
    """A map with its keyframes: number i of the store is row i of `labels` and of the layout.

    `stays` are the keyframes of each piece in which the robot saw the map, by number, that of its
    frame first; `closures` name these. `breaks` are the keyframes at which tracking started afresh
    or another recording begins. `findings` are those about the recordings. `next_id` and what
    follows it are ids that no submap ever had.

    `drawn` is the grid of all keyframes, None until it is drawn; `beyond` of them did not fit into
    it. `division` has the region of each of its cells (H, W), or -1; None where keyframes alone say
    which submap a cell is in. `counts` are of messages and scans.

    `edits` are what a person decided, `edits_text` how it was written down, `borders` what of it
    the labels show, and `lost`, in words, what was decided about maps that are in this one and says
    nothing of it.
    """

    layout: Layout
    labels: Labels
    trajectory: Trajectory
    stays: Mapping[int, tuple[int, ...]]
    closures: tuple[Closure, ...]
    breaks: Breaks
    logs: tuple[LogInfo, ...]
    findings: tuple[Finding, ...]
    next_id: int
    drawn: GridMap | None = None
    division: Packed | None = None
    beyond: int = 0
    counts: Mapping[str, int] = field(default_factory=dict)
    edits: Edits = field(default_factory=Edits)
    edits_text: str = ""
    lost: tuple[str, ...] = ()
    borders: tuple[BorderEdit, ...] = ()

    def __len__(self) -> int:
        """How many keyframes it has."""
        return len(self.labels.stamps_ns)

    @property
    def whole(self) -> GridMap:
        """The grid of all keyframes, which was drawn."""
        assert self.drawn is not None
        return self.drawn

    @property
    def rooms(self) -> list[Piece] | None:
        """The regions that the robot entered; None if nobody knows."""
        if self.division is None:
            return None
        return driven(self.whole, self.division.array, self.labels.poses)

    @cached_property
    def regions(self) -> Regions:
        """The division of the cells of the whole grid among the submaps."""
        return divide(self.whole, self.labels, fences_of(self.borders), self.rooms)

    def keeping(self, known: Regions) -> LaidOut:
        """The map whose submaps keep the floor that they had in `known`.

        A region without a keyframe, of which most was theirs, counts as entered: it becomes one
        with the region of the first keyframe.
        """
        if self.division is None:
            return self
        division = self.division.array.copy()
        entered = regions_of(self.whole, division, self.labels.poses, 0.0)
        for region, window in windows_of(division).items():
            if region not in entered:
                mine = division[window] == region
                cells = np.argwhere(mine) + [part.start for part in window]
                owner = known.grid.under(self.whole.centres_of(cells), known.owner, NOBODY)
                if np.mean(owner != NOBODY) > _MOST:
                    division[window][mine] = entered[0]
        return replace(self, division=Packed.of(division))

    def way_through(self, poses: FloatArray) -> FloatArray:
        """Poses (s, 3) of all scans, moved with the keyframes, which lie at `poses` (n, 3) now."""
        way, labels = self.trajectory, self.labels
        rows = rows_of(way, labels.stamps_ns, labels.poses)
        return propagated(way.poses, rows, poses[: len(rows)])

    @property
    def starts(self) -> tuple[int, ...]:
        """The keyframes with which the recordings after the first one begin."""
        return starts_of(self.logs)

    @property
    def quality(self) -> Quality:
        """What is thought of the map."""
        evidence = Evidence(
            trajectory=self.trajectory,
            keyframes_ns=self.labels.stamps_ns,
            breaks=tuple(self.breaks),
            layout=self.layout,
            beyond=self.beyond,
            warnings=(),
            starts=self.starts,
        )
        return Quality.of([*self.findings, *of_layout(evidence)])


@dataclass(frozen=True, slots=True, kw_only=True)
class FinishedMap:
    """A map ready to be written.

    `features` are what the classifiers learned from, as the map's file has them; `unapplied` tells
    what a person decided and does not apply.
    """

    laid: LaidOut
    topology: TopologicalMap
    classifiers: ClassifierSet
    features: Arrays
    quality: Quality
    unapplied: tuple[str, ...] = ()

    @property
    def counts(self) -> dict[str, int | float]:
        """What was read for the map, and what it is: whatever was counted of it before is past."""
        laid, topology = self.laid, self.topology
        return {
            **laid.counts,
            "scans": len(laid.trajectory.stamps_ns),
            "keyframes": len(laid),
            "submaps": len(topology.submaps),
            "edges": len(topology.edges),
            "doors": len(topology.doors),
            "merges": sum(closure.merged for closure in topology.closures),
            "path_m": round(driven_m(laid.logs, laid.labels), 3),
        }


def gaps_in(poses: FloatArray, logs: Sequence[LogInfo]) -> dict[int, Bridge]:
    """Where keyframes of recordings at `poses` (n, 3) were let go, and what bridges each gap."""
    whole = [log.path_m is None for log in logs if log.keyframes is not None]
    recordings = np.searchsorted(starts_of(logs), np.arange(len(poses)), side="right")
    return gaps_of(poses, np.where(np.array(whole)[recordings], -1, recordings))


def laid_out_of_stored(stored: Map) -> LaidOut:
    """A map directory. Raises MapError when a file that it takes is missing or damaged."""
    topology, labels = stored.topology, stored.labels
    if not topology.stays:
        raise MapError("keeps no stays of the robot", "build the map again", where=stored.path)
    nowhere = np.flatnonzero(labels.submaps == NO_SUBMAP)
    if len(nowhere):  # may be read, and is never so after a recording was divided into stays
        what = f"keyframe {nowhere[0]} is in no submap"
        raise MapError.damaged(what, stored.path / filenames.LABELS)
    return LaidOut(
        layout=_layout(stored),
        labels=labels,
        trajectory=way_of_stored(stored)[0],
        stays={  # that of its frame first, though the robot came back and earlier ones were added
            stay.number: (stay.origin, *(k for k in stay.keyframes if k != stay.origin))
            for stay in topology.stays
        },
        closures=topology.closures,
        breaks={
            **dict.fromkeys(starts_of(stored.logs)),
            **{
                each.keyframe: None
                if each.position_m is None or each.heading_rad is None
                else Bridge(each.position_m, each.heading_rad)
                for each in topology.breaks
            },
        },
        logs=stored.logs,
        findings=tuple(filter(is_of_recording, quality_of_stored(stored).findings)),
        next_id=topology.next_id,
        drawn=stored.map_grid,
        division=Packed.of(stored.regions.owner),
        counts=stored.counts,
        edits=edits_of_stored(stored),
        edits_text=edits_text(stored.path, stored.limits),
        borders=topology.borders,
    )


def quality_of_stored(stored: Map) -> Quality:
    """What was thought of a map when it was made."""
    quality = stored.quality
    return UNDOUBTED if quality is None else Quality.of(quality.findings)


def _layout(stored: Map) -> Layout:
    """The layout of a map directory, with the links that are more than the way between nodes."""
    path, labels = stored.path / filenames.POSE_GRAPH, stored.labels
    text = map_text(path, stored.limits)
    try:
        poses, links = read_g2o(text)
    except InputError as error:
        raise MapError(error, "build the map again", where=path) from None
    ends = {end for link in links for end in (link.source, link.target)}
    if not ends <= poses.keys() <= set(range(len(labels.poses))):
        raise MapError(
            f"its vertices are not among the {counted(len(labels.poses), 'keyframe')} "
            f"of {filenames.LABELS}",
            "build the map again",
            where=path,
        )
    nodes = stored.checked(np.array(sorted(poses), dtype=np.int64), path.name)
    after = dict(pairwise(nodes.tolist()))
    return Layout(
        poses=labels.poses,
        nodes=nodes,
        kept=tuple(link for link in links if after.get(link.source) != link.target),
    )


def way_of_stored(stored: Map) -> tuple[Trajectory, IntArray]:
    """The trajectory of a map directory, and its rows (n,) that are the keyframes.

    Raises MapError when it does not lead through them.
    """
    path, labels = stored.path / filenames.TRAJECTORY, stored.labels
    trajectory = stored.trajectory
    found = rows_of(trajectory, labels.stamps_ns, labels.poses)
    if len(found) != len(labels.stamps_ns) or len(trajectory.stamps_ns) != sum(
        log.scans for log in stored.logs
    ):
        raise MapError(
            f"is not the way through the keyframes of {filenames.LABELS} and the logs "
            f"of {filenames.TOPOLOGY}",
            "build the map again",
            where=path,
        )
    return trajectory, found
