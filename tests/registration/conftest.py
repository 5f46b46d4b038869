"""The world that the simulated drives of this room go through."""

import numpy as np
import pytest

from specmap_cli.grids.gridmap import FREE, OCCUPIED, GridMap


@pytest.fixture(scope="session")
def world() -> GridMap:
    """Two rooms of 5 m x 4 m that differ, joined by a door, and a third one far away."""
    cells = np.full((120, 700), OCCUPIED, dtype=np.uint8)
    cells[10:90, 10:110] = FREE
    cells[10:90, 114:214] = FREE
    cells[40:58, 108:116] = FREE
    cells[10:30, 60:80] = OCCUPIED
    cells[70:90, 150:190] = OCCUPIED
    cells[10:25, 200:214] = OCCUPIED
    cells[10:110, 500:650] = FREE
    cells[60:110, 560:580] = OCCUPIED
    return GridMap(cells, 0.05)
