"""The layout of what was explored: relaxed and turned; and the closures that it refutes.

Then the map is drawn in it and divided: the regions of the finished map say where submaps end.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from specmap_cli.core.arrays import Packed
from specmap_cli.core.errors import NoResultError
from specmap_cli.core.geometry import FloatArray, Pose2, compose, invert, wrap_angles
from specmap_cli.core.process import give_memory_back
from specmap_cli.core.records import Closure, IntArray, Labels
from specmap_cli.core.settings import Config
from specmap_cli.core.text import legible
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.grids.keyframes import KeyframeStore, integrate_keyframes
from specmap_cli.layout.passes import METRES_A_RADIAN
from specmap_cli.layout.path_graph import chosen_nodes
from specmap_cli.layout.pose_graph import Link
from specmap_cli.layout.relaxation import relax
from specmap_cli.layout.result import Layout, along_walls, corrected, rows_of
from specmap_cli.pipelines.exploration import Regions, in_own_frame, online_labels
from specmap_cli.pipelines.map_in_making import Explored, LaidOut
from specmap_cli.pipelines.pieces import Pieces, pieces_placed
from specmap_cli.pipelines.session import Session
from specmap_cli.pipelines.tracking import Tracking
from specmap_cli.quality.evidence import Evidence, holes_of, stretches_of
from specmap_cli.quality.findings import of_recording
from specmap_cli.segmentation.division import regions_of, segment
from specmap_cli.topology.graph import by_appearance
from specmap_cli.topology.topological_map import LogInfo

_CLOSURE_SIGMA_M = 0.04  # spread of matched grids' transforms about the truth, x and y
_CLOSURE_SIGMA_RAD = 0.0087  # spread of their heading

Pair = tuple[int, int]

REFUTED = "contradicts the layout"
_WHY = {
    "impossible": "the path cannot be so wrong",
    "outvoted": "closures that agree say otherwise",
    "alone": "no other agrees",
    "outlier": "the others cannot be solved with it",
    "walls": "walls would be drawn twice",
}


def lay_out(session: Session, explored: Explored, tracking: Tracking, name: str) -> LaidOut:
    """The map of what was explored in the recording of a file `name`: laid out, drawn and divided.

    Raises NoResultError when no keyframe fits into the largest grid allowed.
    """
    store, config = session.store, session.config
    session.progress.start("layout", None)
    give_memory_back()
    with session.clock.stage("layout"):
        nodes = chosen_nodes(store.poses, explored.breaks)
        constraints = constraints_of(explored.closures, explored.regions, store, nodes)
        links = tuple(constraints.values())
        layout = relax(store, links, explored.breaks, config.relaxation, explored.passes)
        pieces = pieces_placed(session, Pieces(layout, links, explored.breaks), explored.trajectory)
        layout = along_walls(pieces.layout, store, config.relaxation)
        trajectory = corrected(explored.trajectory, store, layout.poses)
    closures = refute(explored.closures, constraints, layout)
    whole, beyond, division = _drawn(session, layout)
    if division is None:
        submaps = online_labels(explored.regions, closures, len(layout.poses))
    else:
        least_m = config.segmentation.region_min_m
        submaps = regions_of(whole, division.array, layout.poses, least_m)
    submaps = by_appearance(submaps)
    with session.clock.stage("audit"):
        rows = rows_of(explored.trajectory, store.stamps_ns, store.poses)
        evidence = Evidence(
            trajectory=trajectory,
            keyframes_ns=store.stamps_ns,
            breaks=tuple(explored.breaks),
            layout=layout,
            beyond=beyond,
            warnings=tracking.warnings,
            holes=holes_of(store, rows, trajectory, layout, explored.breaks),
            stretches=stretches_of(store.guessed_m, layout),
            fitting=pieces.fitting,
            rivals=pieces.rivals,
            mounting=store.base_from_laser(0),
        )
        findings = tuple(of_recording(evidence))
    return LaidOut(
        layout=layout,
        labels=Labels(stamps_ns=store.stamps_ns, poses=layout.poses, submaps=submaps),
        trajectory=trajectory,
        stays=explored.regions,
        closures=closures,
        breaks=pieces.breaks,
        logs=(_told_of(name, trajectory.stamps_ns, len(submaps)),),
        findings=findings,
        next_id=1 + int(submaps.max()),
        drawn=whole,
        division=division,
        beyond=beyond,
        counts=tracking.counts,
    )


def _told_of(name: str, stamps_ns: IntArray, keyframes: int) -> LogInfo:
    """The recording of a file whose scans have these stamps (n,), alone in its map."""
    return LogInfo(
        name=legible(Path(name).name),
        start_ns=int(stamps_ns.min()),
        end_ns=int(stamps_ns.max()),
        scans=len(stamps_ns),
        keyframes=(0, keyframes - 1),
    )


def with_grid(session: Session, laid: LaidOut) -> LaidOut:
    """A map with the grid of all keyframes, which the session's store has. Raises as `lay_out`."""
    whole, beyond, division = _drawn(session, laid.layout, laid.starts)
    return replace(laid, drawn=whole, beyond=beyond, division=division)


def _drawn(
    session: Session, layout: Layout, starts: Collection[int] = ()
) -> tuple[GridMap, int, Packed | None]:
    """The grid of all keyframes as laid out, how many lay beyond its limits, its `division_of`."""
    store, config = session.store, session.config
    with session.clock.stage("grids"):
        everything = range(len(store))
        counts = integrate_keyframes(store, everything, layout.poses, config.grid, starts)
        whole, beyond = counts.snapshot(), counts.refused
        del counts  # of a large building they are most of the memory
        give_memory_back()
    if not whole.cells.size:
        raise NoResultError(
            "no scan fits into the largest grid allowed: nothing to map",
            "raise grid.max_extent_m or grid.max_area_m2, or lower grid.max_range_m",
            mark=";",
        )
    session.progress.start("segmentation", None)
    with session.clock.stage("segmentation"):
        division = division_of(whole, layout, config, starts)
    give_memory_back()
    return whole, beyond, division


def division_of(
    whole: GridMap, layout: Layout, config: Config, starts: Collection[int] = ()
) -> Packed | None:
    """The region (H, W) of each cell of the map, -1 for none.

    None where the finished map does not say where submaps end: one place of the building may be
    two of the layout, or the settings leave it to the way. Recordings that begin at `starts` and
    meet no other lie apart: their walls are drawn over no others.
    """
    guessed = set(layout.loose) - set(starts)
    if guessed or not (config.relaxation.enabled and config.segmentation.final_regions):
        return None
    return Packed.of(segment(whole, config.segmentation).labels)


def constraints_of(
    closures: Sequence[Closure], regions: Regions, store: KeyframeStore, nodes: IntArray
) -> dict[Pair, Link]:
    """For each pair of merged regions, (old, new): where a keyframe lies, seen from another.

    These two saw most alike: by the match of the grids they are the nearest to each other, turned
    as little as may be; or they are the `nodes` (M,) of the layout before these, as tracked.

    Grids that match while the robot's tracks do not overlap are no evidence for the layout: that is
    what look-alike rooms do, too.
    """
    found = {}
    for closure in closures:
        if not closure.merged or closure.old_from_new is None:
            continue
        old, new = regions[closure.old], regions[closure.new]
        old_track = in_own_frame(store, old)
        new_track = compose(np.array(closure.old_from_new), in_own_frame(store, new))
        i, j = nearest_pair(old_track, new_track)
        ends = old[i], new[j]
        source, target = nodes[np.searchsorted(nodes, ends, side="right") - 1].tolist()
        seen = Pose2(*compose(invert(old_track[i]), new_track[j]).tolist())
        before = store.pose(source).inverse() @ store.pose(old[i])
        back = store.pose(new[j]).inverse() @ store.pose(target)
        found[closure.old, closure.new] = Link.closure(
            source, target, before @ seen @ back, _CLOSURE_SIGMA_M, _CLOSURE_SIGMA_RAD
        )
    return found


def refute(
    closures: Sequence[Closure], constraints: Mapping[Pair, Link], layout: Layout
) -> tuple[Closure, ...]:
    """The closures, without the merges whose constraint the layout dropped."""
    dropped = {(link.source, link.target) for link in layout.dropped if link.kind == "closure"}
    reasons = {
        pair: f"{REFUTED}: {_WHY[layout.why[ends]]}" if ends in layout.why else REFUTED
        for pair, ends in ((pair, (one.source, one.target)) for pair, one in constraints.items())
        if ends in dropped
    }
    return tuple(
        replace(closure, merged=False, verified=False, reason=reason, old_from_new=None)
        if (reason := reasons.get((closure.old, closure.new)))
        else closure
        for closure in closures
    )


def nearest_pair(old: FloatArray, new: FloatArray) -> Pair:
    """Which poses of two tracks (n, 3) and (m, 3) are nearest: a turn is as bad as a way.

    Only those are turned that are no farther apart than that, which are few of the n times m.
    """
    away = np.hypot(old[:, 0, None] - new[:, 0], old[:, 1, None] - new[:, 1])

    def apart(i: IntArray, j: IntArray) -> FloatArray:
        turns = np.abs(wrap_angles(old[i, 2] - new[j, 2]))
        return np.asarray(away[i, j] + METRES_A_RADIAN * turns)

    first = np.array([np.unravel_index(int(away.argmin()), away.shape)]).T
    i, j = np.nonzero(away <= apart(*first))
    best = int(apart(i, j).argmin())
    return int(i[best]), int(j[best])
