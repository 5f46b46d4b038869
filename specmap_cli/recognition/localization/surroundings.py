"""The walls round each submap: its own, and those of its neighbours where it saw nothing.

At a border a scan sees walls of two submaps. Against the grid of one alone it fits badly there, and
a match has too little to hold on to.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np

from specmap_cli.core.geometry import Pose2
from specmap_cli.grids.gridmap import OCCUPIED, UNKNOWN, CellArray, GridMap
from specmap_cli.grids.score_field import ScoreField


class Surroundings:
    """Score fields of submaps, each in its own frame; made when asked for.

    `frames` are the frames of the grids in the layout. A submap without one stands alone.
    """

    def __init__(
        self,
        grids: Mapping[int, GridMap],
        adjacency: Mapping[int, Collection[int]],
        frames: Mapping[int, Pose2],
    ) -> None:
        self.grids = grids
        self.adjacency = adjacency
        self.frames = frames
        self._fields: dict[int, ScoreField] = {}

    def field(self, submap: int) -> ScoreField:
        """The walls in and around a submap, as far as its grid reaches."""
        if submap not in self._fields:
            self._fields[submap] = ScoreField.from_grid(self._completed(submap))
        return self._fields[submap]

    def _completed(self, submap: int) -> GridMap:
        """The grid of a submap with the walls of its neighbours in the cells that it never saw."""
        own = self.grids[submap]
        cells = own.cells.copy()
        for other in sorted(self.adjacency.get(submap, ())):
            if other != submap and {submap, other} <= self.frames.keys():
                own_from_other = self.frames[submap].inverse() @ self.frames[other]
                _draw(cells, own, self.grids[other], own_from_other)
        return GridMap(cells, own.resolution, own.origin)


def _draw(cells: CellArray, own: GridMap, other: GridMap, own_from_other: Pose2) -> None:
    """Draw the walls of another grid into the unknown cells (H, W) of one's own."""
    walls = own_from_other.apply(other.centres_of(np.argwhere(other.occupied)))
    places = own.cells_of(walls)
    rows, columns = places[own.inside(places)].T
    unseen = cells[rows, columns] == UNKNOWN
    cells[rows[unseen], columns[unseen]] = OCCUPIED
