"""Two maps in one: the new one laid into the old one, whose submaps keep their ids.

So is what a person decided about them. What was said of the older map counts first. The merges,
splits and forbidden doors of the newer one are said again, in their order, of what its submaps
became.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.findings import Finding
from specmap_cli.core.geometry import FloatArray, Pose2, compose, nearest_motion
from specmap_cli.core.records import Closure, IntArray, Labels, Trajectory
from specmap_cli.core.settings import Config
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.layout.joining import join_layouts, placed
from specmap_cli.maps.edits import (
    Change,
    Edits,
    ForbidEdit,
    MergeEdit,
    SplitEdit,
    SubmapEdit,
    in_words,
)
from specmap_cli.pipelines.laying_out import constraints_of, refute
from specmap_cli.pipelines.map_in_making import LaidOut, gaps_in
from specmap_cli.pipelines.session import Session
from specmap_cli.recognition.closure.alignment import Joint
from specmap_cli.topology.graph import inherited
from specmap_cli.topology.identity import undone

_JOINED = "the maps were joined here"
_APART_M = 20.0  # between maps that have nothing in common: walls within it are never matched
_FEW = 0.1  # share of the keyframes of a submap that may have got elsewhere
_DECIMALS = 3  # of metres: a person's finger is no finer

Place = tuple[float, float]


def join(
    session: Session, old: LaidOut, new: LaidOut, old_from_new: Pose2, found: Sequence[Closure]
) -> LaidOut:
    """The old map with the new one laid into it; the store holds the keyframes of both, in order.

    `found` are closures between the two: `old` is the number of a stay of the old map, `new` that
    of one of the new map. Every submap of the old map keeps its keyframes and its id. The borders
    that a person moved in the new map are edits of the joint one, which are still to be made. It is
    still to be drawn.
    """
    store, first, stay = session.store, len(old), 1 + max(old.stays, default=-1)
    later = _renumbered(new, old_from_new, first, stay)
    stays = {**old.stays, **later.stays}
    logs = (*old.logs, *later.logs)
    found = tuple(replace(closure, new=closure.new + stay) for closure in found)
    breaks = {**old.breaks, first: None, **later.breaks}
    constraints = constraints_of(found, stays, store, np.arange(len(store)))
    cuts = {**gaps_in(store.poses, logs), **breaks}
    layout = join_layouts(store, old.layout, later.layout, tuple(constraints.values()), cuts)
    # in the frame in which the old keyframes lie nearest to their places in the old map
    layout = placed(layout, nearest_motion(layout.poses[:first, :2], old.layout.poses[:, :2]))
    starts = {*old.starts, first, *later.starts}  # no guess of tracking joined the recordings
    parts = tuple(move for move in layout.parts if move.first not in starts)
    layout = replace(layout, parts=parts)
    plain = new
    if new.borders:  # divided as it was before a person moved its borders
        before = undone(new.whole, new.labels, new.borders)
        plain = replace(new, labels=replace(new.labels, submaps=before), borders=())
    submaps = inherit(old, plain, layout.poses, old_from_new, session.config)
    joint = LaidOut(
        layout=layout,
        labels=Labels(stamps_ns=store.stamps_ns, poses=layout.poses, submaps=submaps),
        trajectory=_trajectory(old, new, layout.poses),
        stays=stays,
        closures=(*old.closures, *later.closures, *refute(found, constraints, layout)),
        breaks=breaks,
        logs=logs,
        findings=(*old.findings, *later.findings),
        next_id=max(old.next_id, 1 + int(submaps.max(initial=-1))),
        edits=old.edits,
        edits_text=old.edits_text,
        lost=old.lost,
        borders=old.borders,
    )
    return with_edits_of(joint, plain, old_from_new)


def place_apart(old: GridMap, new: GridMap) -> Pose2:
    """A place for a map that fits nowhere: to the right of the old map, with a gap between them."""
    (left, low), (x, y) = old.origin, new.origin
    right = left + old.cells.shape[1] * old.resolution
    return Pose2(right + _APART_M - x, low - y, 0.0)


def _renumbered(laid: LaidOut, old_from_new: Pose2, first: int, first_stay: int) -> LaidOut:
    """The map in another one's frame, its keyframes and stays numbered behind those of that."""
    return replace(
        laid,
        layout=placed(laid.layout, old_from_new, first),
        stays={
            number + first_stay: tuple(keyframe + first for keyframe in own)
            for number, own in laid.stays.items()
        },
        closures=tuple(
            replace(closure, new=closure.new + first_stay, old=closure.old + first_stay)
            for closure in laid.closures
        ),
        breaks={number + first: bridge for number, bridge in laid.breaks.items() if number},
        findings=tuple(moved_finding(finding, old_from_new) for finding in laid.findings),
        logs=tuple(
            replace(log, keyframes=(log.keyframes[0] + first, log.keyframes[1] + first))
            if log.keyframes is not None
            else log
            for log in laid.logs
        ),
    )


def moved_finding(finding: Finding, old_from_new: Pose2) -> Finding:
    """A finding at its place in another map."""
    if finding.where is None or finding.place is None:
        return finding
    x, y = old_from_new.apply(np.array([finding.place]))[0].tolist()
    return replace(finding, where=replace(finding.where, x=x, y=y))


def closures_between(old: LaidOut, new: LaidOut, joints: Sequence[Joint]) -> tuple[Closure, ...]:
    """What the joints of an alignment say, as closures between the longest stays in the submaps.

    Each names the stays by the numbers that they have in their own maps.
    """
    found = []
    for joint in joints:
        one, other = _longest_stay(old, joint.old), _longest_stay(new, joint.new)
        if one is None or other is None:
            continue
        frames = [
            Pose2(*laid.layout.poses[laid.stays[number][0]].tolist())
            for laid, number in ((old, one), (new, other))
        ]
        found.append(
            Closure(
                new=other,
                old=one,
                xi=np.nan,
                claims_new_by_old=np.nan,
                claims_old_by_new=np.nan,
                verified=True,
                merged=True,
                score=joint.score,
                reason=_JOINED,
                old_from_new=frames[0].inverse() @ joint.map_from_map @ frames[1],
            )
        )
    return tuple(found)


def _longest_stay(laid: LaidOut, submap: int) -> int | None:
    """The stay with the most keyframes of a submap, the first of equals; None without any."""
    counts = {
        number: int(np.count_nonzero(laid.labels.submaps[list(keyframes)] == submap))
        for number, keyframes in laid.stays.items()
    }
    best = max(counts, key=lambda number: (counts[number], -number), default=None)
    return best if best is not None and counts[best] else None


def inherit(
    old: LaidOut, new: LaidOut, poses: FloatArray, old_from_new: Pose2, config: Config
) -> IntArray:
    """The submap (m,) of each keyframe of both maps, which lie at `poses` (m, 3).

    Old ones stay in their submaps, new ones get into these.
    """
    there = compose(np.array(old_from_new.inverse()), old.labels.poses)
    divided = np.concatenate([new.regions.owners(there), new.labels.submaps])
    least_m = config.segmentation.region_min_m
    return inherited(old.labels, old.regions, old.next_id, poses, divided, least_m)


def _trajectory(old: LaidOut, new: LaidOut, poses: FloatArray) -> Trajectory:
    """All scans of both maps, moved with the keyframes, which lie at `poses` now."""
    ways = old.trajectory, new.trajectory
    carried = old.way_through(poses[: len(old)]), new.way_through(poses[len(old) :])
    lengths = [len(way.poses) for way in ways]
    return Trajectory(
        stamps_ns=np.concatenate([way.stamps_ns for way in ways]),
        poses=np.concatenate(carried),
        tilt=_both([way.tilt for way in ways], [np.zeros((n, 3)) for n in lengths]),
        lost=_both([way.lost for way in ways], [np.zeros(n, dtype=np.bool_) for n in lengths]),
    )


def _both(
    parts: Sequence[NDArray[Any] | None], blanks: Sequence[NDArray[Any]]
) -> NDArray[Any] | None:
    """Columns of both trajectories, blank where one has none; None where neither has any."""
    if all(part is None for part in parts):
        return None
    both = zip(parts, blanks, strict=True)
    return np.concatenate([blank if part is None else part for part, blank in both])


def with_edits_of(joint: LaidOut, new: LaidOut, old_from_new: Pose2) -> LaidOut:
    """The joint map with the edits of the `new` one, beside those of the old one that it has.

    The new map, whose keyframes are the last of the joint one, is divided as before a person moved
    its borders. What says nothing of the joint map is added to what is `lost`.
    """
    submaps = joint.labels.submaps[len(joint) - len(new) :]
    retelling = _Retelling(new, submaps, old_from_new, joint.next_id)
    changes: list[Change] = list(joint.edits.changes)
    lost = []
    for change in new.edits.changes:
        told = retelling.told(change)
        if isinstance(told, str):
            lost.append(f"{in_words(change)}: {told}")
        else:
            changes += told
    said = dict(joint.edits.submaps)
    for id_, edit in sorted(new.edits.submaps.items()):
        if id_ not in retelling.became:
            lost.append(f"submaps.{id_}: there is no submap {id_}")
            continue
        heir = retelling.became[id_][0]
        first = said.get(heir, SubmapEdit())
        said[heir] = SubmapEdit(  # where the two differ the first counts
            name=first.name or edit.name,
            kind=first.kind or edit.kind,
            properties={**edit.properties, **first.properties},
        )
        if edit.name and said[heir].name != edit.name:
            lost.append(f"submaps.{id_}: {edit.name!r} is {first.name!r} in an earlier map")
    where = f"in the map of {new.logs[0].name}: "
    return replace(
        joint,
        edits=Edits(submaps=said, changes=tuple(changes)),
        next_id=retelling.next_id,
        lost=(*joint.lost, *(where + line for line in lost)),
    )


class _Retelling:
    """Says the changes of a map again, of what its submaps `became`, by id: the largest first."""

    def __init__(self, new: LaidOut, submaps: IntArray, old_from_new: Pose2, next_id: int) -> None:
        own = new.labels.submaps
        self.became: dict[int, list[int]] = {}
        for id_ in np.unique(own[own >= 0]).tolist():
            found, counts = np.unique(submaps[own == id_], return_counts=True)
            first, *others = np.argsort(-counts, kind="stable")
            kept = [first, *(k for k in others if counts[k] >= _FEW * counts.sum())]
            self.became[id_] = [int(found[k]) for k in kept]
        self.next_id = next_id
        self._submaps, self._places = submaps.copy(), new.labels.poses[:, :2]
        self._old_from_new = old_from_new

    def told(self, change: Change) -> list[Change] | str:
        """A change said again, which may take several or none; or why it cannot be."""
        ids: tuple[int, ...]
        if isinstance(change, SplitEdit):
            ids = (change.split,)
        else:
            ids = change.merge if isinstance(change, MergeEdit) else change.forbid
        for id_ in ids:
            if id_ not in self.became:
                return f"there is no submap {id_}"
        if isinstance(change, MergeEdit):
            return self._merge(*ids)
        if isinstance(change, SplitEdit):
            return self._split(change)
        # forbidden between all that the two became
        at = None if change.at is None else self._moved(change.at)
        ends = [self.became[end] for end in ids]
        pairs = [(one, other) for one in ends[0] for other in ends[1] if one != other]
        return [ForbidEdit(forbid=pair, at=at) for pair in pairs]

    def _merge(self, kept: int, gone: int) -> list[Change]:
        """Two submaps made one; nothing is to be done where they are one already."""
        one, other = self.became[kept][0], self.became[gone][0]
        self.became[kept] += self.became.pop(gone)
        self._submaps[self._submaps == other] = one
        self.became = {
            id_: list(dict.fromkeys(one if each == other else each for each in own))
            for id_, own in self.became.items()
        }
        return [] if one == other else [MergeEdit(merge=(one, other))]

    def _split(self, change: SplitEdit) -> list[Change]:
        """The submap cut that the robot was in nearest to the middle of the line."""
        there = np.flatnonzero(np.isin(self._submaps, self.became[change.split]))
        away = self._places[there] - np.mean(change.line, axis=0)
        cut = self.became[change.split][0]
        if len(there):
            cut = int(self._submaps[there[np.argmin((away**2).sum(axis=1))]])
        new, self.next_id = self.next_id, self.next_id + 1
        if change.new is not None:
            self.became[change.new] = [new]
        one, other = map(self._moved, change.line)
        return [SplitEdit(split=cut, line=(one, other), new=new)]

    def _moved(self, place: Place) -> Place:
        """A place of the new map in the old one's frame."""
        x, y = np.round(self._old_from_new.apply(np.array([place]))[0], _DECIMALS).tolist()
        return x, y
