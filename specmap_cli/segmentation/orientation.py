"""One window and one orientation for every copy of a map, wherever it lies and however it turns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray
from specmap_cli.grids.gridmap import BoolArray


@dataclass(frozen=True, slots=True)
class Orientation:
    """The `window` of a grid that is looked at, and how many quarter turns it is turned by."""

    window: tuple[slice, slice]
    turns: int

    def apply(self, picture: NDArray[Any]) -> NDArray[Any]:
        """The window (h, w) of a picture (H, W), turned."""
        return np.rot90(picture[self.window], self.turns)

    def undo(self, turned: NDArray[Any], picture: NDArray[Any]) -> NDArray[Any]:
        """A copy of `picture` (H, W) with `turned` (h, w) put back into the window."""
        whole = picture.copy()
        whole[self.window] = np.rot90(turned, -self.turns)
        return whole

    def cells_in_grid(self, cells: NDArray[Any], shape: tuple[int, ...]) -> FloatArray:
        """Rows and columns (n, 2) in the grid of cells in the turned window of `shape` (h, w)."""
        for _ in range(self.turns):
            height, width = shape
            cells = np.column_stack([cells[:, 1], height - 1 - cells[:, 0]])
            shape = (width, height)
        return np.asarray(cells + [side.start for side in self.window], dtype=np.float64)


def canonical(free: BoolArray) -> Orientation:
    """The window of the free cells (H, W), in the turn whose picture is smallest as bytes."""
    rows, columns = np.flatnonzero(free.any(axis=1)), np.flatnonzero(free.any(axis=0))
    if not len(rows):
        return Orientation((slice(0, 0), slice(0, 0)), 0)
    window = slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)
    turned = [np.rot90(free[window], turns) for turns in range(4)]
    least = min(range(4), key=lambda turns: (turned[turns].shape, turned[turns].tobytes()))
    return Orientation(window, least)
