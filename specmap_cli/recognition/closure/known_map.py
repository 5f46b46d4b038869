"""What the alignment of two maps needs of each: grids, frames, tracks and classifiers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.recognition.closure.prepared import PreparedGrid, PreparedGrids
from specmap_cli.recognition.learning.classifiers import ClassifierSet

_PREPARED = 64  # grids at a time: each takes up to a megabyte


@dataclass(frozen=True, slots=True, kw_only=True)
class KnownMap:
    """A finished map: its `whole` grid, and the grids of its submaps by id.

    `frames` are those of the submaps in the map, `tracks` (k, 2 or more) where the robot was in
    each, in the map; a map that was cut from a finished grid has none, nor `classifiers`.
    """

    whole: GridMap
    grids: Mapping[int, GridMap]
    frames: Mapping[int, Pose2]
    tracks: Mapping[int, FloatArray]
    classifiers: ClassifierSet | None = None

    @property
    def ids(self) -> list[int]:
        """Submap ids, ascending."""
        return sorted(self.frames)


class Pieces:
    """The submaps of a map prepared for matching, those last asked for kept."""

    def __init__(self, known: KnownMap) -> None:
        self.known = known
        self._grids = PreparedGrids(_PREPARED)

    def of(self, submap: int) -> PreparedGrid | None:
        """One submap's grid in its own frame; None when it shows too little of a wall."""
        return self._grids.of(submap, self.known.grids[submap])
