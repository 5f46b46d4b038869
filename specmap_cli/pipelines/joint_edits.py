"""What a person decided about two maps, made to hold in the one that they become.

What was said of the older map counts first. The merges, splits and forbidden doors of the newer one
are said again, in their order, of what its submaps became.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from specmap_cli.core.geometry import Pose2
from specmap_cli.core.records import IntArray
from specmap_cli.maps.edits import (
    Change,
    Edits,
    ForbidEdit,
    MergeEdit,
    SplitEdit,
    SubmapEdit,
    in_words,
)
from specmap_cli.pipelines.kept_map import KeptMap, Seen
from specmap_cli.topology.redrawing import undone
from specmap_cli.topology.regions import divide

_FEW = 0.1  # share of the keyframes of a submap that may have got elsewhere
_DECIMALS = 3  # of metres: a person's finger is no finer

Place = tuple[float, float]


@dataclass(frozen=True, slots=True)
class JointEdits:
    """The edits of both maps; `next_id` and what follows are ids that neither they nor a map has.

    `lost` are those that say nothing of the joint map, in words.
    """

    edits: Edits
    next_id: int
    lost: tuple[str, ...] = ()


def without_borders(seen: Seen) -> Seen:
    """A map divided as it was before a person moved its borders."""
    kept = seen.kept
    if not kept.borders:
        return seen
    submaps = undone(kept.labels.submaps, kept.labels.poses, kept.borders)
    labels = replace(kept.labels, submaps=submaps)
    regions = divide(seen.known.whole, labels)
    return replace(seen, kept=replace(kept, labels=labels, borders=()), regions=regions)


def edits_of_both(
    old: KeptMap, new: KeptMap, submaps: IntArray, old_from_new: Pose2, next_id: int
) -> JointEdits:
    """The edits of two maps; the `new` one is divided as before a person moved its borders.

    `submaps` (n,) are those of the joint map that the keyframes of the new one are in; `next_id`
    and what follows are ids that no submap has.
    """
    retelling = _Retelling(new, submaps, old_from_new, next_id)
    changes: list[Change] = list(old.edits.changes)
    lost = []
    for change in new.edits.changes:
        told = retelling.told(change)
        if isinstance(told, str):
            lost.append(f"{in_words(change)}: {told}")
        else:
            changes += told
    said = dict(old.edits.submaps)
    for id_, edit in sorted(new.edits.submaps.items()):
        if id_ not in retelling.became:
            lost.append(f"submaps.{id_}: there is no submap {id_}")
            continue
        heir = retelling.became[id_][0]
        first = said.get(heir, SubmapEdit())
        said[heir] = _both(first, edit)
        if edit.name and said[heir].name != edit.name:
            lost.append(f"submaps.{id_}: {edit.name!r} is {first.name!r} in an earlier map")
    where = f"in the map of {new.logs[0].name}: "
    return JointEdits(
        Edits(submaps=said, changes=tuple(changes)),
        retelling.next_id,
        tuple(where + line for line in lost),
    )


def _both(first: SubmapEdit, second: SubmapEdit) -> SubmapEdit:
    """What is said of one submap twice: where the two differ the first counts."""
    return SubmapEdit(
        name=first.name or second.name,
        kind=first.kind or second.kind,
        properties={**second.properties, **first.properties},
    )


class _Retelling:
    """Says the changes of one map, in order, of the submaps of another that its own became.

    `became` are these by id, the one with the most keyframes first.
    """

    def __init__(self, new: KeptMap, submaps: IntArray, old_from_new: Pose2, next_id: int) -> None:
        own = new.labels.submaps
        ids = np.unique(own[own >= 0]).tolist()
        self.became = {id_: _commonest(submaps[own == id_]) for id_ in ids}
        self.next_id = next_id
        self._submaps, self._places = submaps.copy(), new.labels.poses[:, :2]
        self._old_from_new = old_from_new

    def told(self, change: Change) -> list[Change] | str:
        """A change said again, which may take several or none; or why it cannot be."""
        ids = _named_in(change)
        for id_ in ids:
            if id_ not in self.became:
                return f"there is no submap {id_}"
        if isinstance(change, MergeEdit):
            return self._merge(*ids)
        if isinstance(change, SplitEdit):
            return self._split(change)
        return self._forbid(change)

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

    def _forbid(self, change: ForbidEdit) -> list[Change]:
        """The way forbidden between all that the two became."""
        ends = [self.became[end] for end in change.forbid]
        at = None if change.at is None else self._moved(change.at)
        pairs = [(one, other) for one in ends[0] for other in ends[1] if one != other]
        return [ForbidEdit(forbid=pair, at=at) for pair in pairs]

    def _moved(self, place: Place) -> Place:
        """A place of the new map in the old one's frame."""
        x, y = np.round(self._old_from_new.apply(np.array([place]))[0], _DECIMALS).tolist()
        return x, y


def _named_in(change: Change) -> tuple[int, ...]:
    """The submaps that a change is about."""
    if isinstance(change, MergeEdit):
        return change.merge
    return (change.split,) if isinstance(change, SplitEdit) else change.forbid


def _commonest(submaps: IntArray) -> list[int]:
    """The submaps that keyframes (n,) are in, the commonest first, the others if not of a few."""
    found, counts = np.unique(submaps, return_counts=True)
    first, *others = np.argsort(-counts, kind="stable")
    kept = [first, *(k for k in others if counts[k] >= _FEW * len(submaps))]
    return [int(found[k]) for k in kept]
