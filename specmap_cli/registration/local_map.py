"""The local map: what the last keyframes saw, to register the next sweep against.

The registration method holds their points in its own form. Beside it stands the score field of the
same walls in the plane, which scores results and serves the correlative search.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.settings import RegistrationConfig
from specmap_cli.grids.score_field import PointCells, ScoreField
from specmap_cli.registration.aligner import (
    REBUILD_KEYFRAMES,
    WINDOW_KEYFRAMES,
    Aligner,
    SensorKind,
)
from specmap_cli.registration.seen_space import SeenSpace
from specmap_cli.registration.sweep_view import SweepView

_FIELD_RANGES = 2.0  # side of the score field, in ranges; walls beyond score 0

# Of the score field, in spacings of the walls' points: cells that leave no gap between them, and a
# sigma of one voxel. Finer fields cost time and tell right from wrong results no better.
_CELL_SPACINGS, _SIGMA_SPACINGS = 1.5, 2.0
_SEEN_SPACINGS = 4.0  # cells of the space looked at: two voxels, as wide as a wall scores at all


class LocalMap:
    """The last `WINDOW_KEYFRAMES` keyframes, in the map frame.

    The score field forgets older ones when the registration method rebuilds its voxels; until then
    new walls are drawn into it.
    """

    def __init__(self, aligner: Aligner, sensor: SensorKind, config: RegistrationConfig) -> None:
        self.aligner, self.sensor = aligner, sensor
        self._spacing_m = config.voxel_m / 2
        self._sigma_m = _SIGMA_SPACINGS * self._spacing_m
        self._inserted = 0
        self._side_m = _FIELD_RANGES * sensor.range_m
        self._walls: deque[FloatArray] = deque(maxlen=WINDOW_KEYFRAMES)
        self._outlines: deque[FloatArray] = deque(maxlen=WINDOW_KEYFRAMES)
        self._cells: deque[PointCells] = deque(maxlen=WINDOW_KEYFRAMES)  # of the walls
        self._field: ScoreField | None = None
        self._seen: SeenSpace | None = None

    def __len__(self) -> int:
        return len(self._walls)

    def clear(self) -> None:
        """Forget everything."""
        self.aligner.clear()
        self._walls.clear()
        self._cells.clear()
        self._outlines.clear()
        self._field = self._seen = None
        self._inserted = 0

    def insert(self, view: SweepView, map_from_base: FloatArray) -> None:
        """Add a keyframe seen from a pose (4, 4)."""
        points = view.cloud if view.dense is None else view.dense
        self.aligner.insert(points, map_from_base)
        planar = Pose2.from_matrix(map_from_base)
        walls = planar.apply(view.walls)
        self._walls.appendleft(walls)
        cells = PointCells.of(walls, _CELL_SPACINGS * self._spacing_m)
        self._cells.appendleft(cells)
        self._outlines.appendleft(planar.apply(view.outline()))
        rebuilt = self._inserted % REBUILD_KEYFRAMES == 0
        field = None if rebuilt else self._field
        self._field = None if field is None else field.with_cells(cells, self._sigma_m)
        self._seen = None
        self._inserted += 1

    @property
    def walls(self) -> FloatArray:
        """The walls (N, 2) of all keyframes, those of the last one first."""
        return np.concatenate(self._walls)

    @property
    def field(self) -> ScoreField:
        """The score field of the walls, built when first asked for.

        Walls too far from the last keyframe for a field of `_FIELD_RANGES` are left out.
        """
        if self._field is None:
            x, y = self._outlines[0][0].tolist()  # the last laser
            self._field = ScoreField.from_cells(self._cells, self._sigma_m, self._side_m, (x, y))
        return self._field

    @property
    def seen(self) -> SeenSpace:
        """The space that the keyframes have looked at, made when first asked for."""
        if self._seen is None:
            cell_m = _SEEN_SPACINGS * self._spacing_m
            self._seen = SeenSpace.of(self._outlines, cell_m, self._side_m / 2)
        return self._seen
