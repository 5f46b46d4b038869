"""Simulated tours at their true poses, and small worlds for them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.data import RESOLUTION_M, plan, rooms_of
from specmap_cli.core.records import PosedScan
from specmap_cli.grids.gridmap import FREE, OCCUPIED, GridMap
from specmap_cli.simulation.simulator import SimulationOptions, simulated_tour
from specmap_cli.simulation.worlds import RoomTruth


def tour_options(view: float, seed: int, **more: Any) -> SimulationOptions:
    """A tour with a laser that sees `view` degrees; a beam a degree if nothing else is said."""
    usual = {"field_of_view_deg": view, "beams": int(view), "rate_hz": 5.0, "seed": seed}
    return SimulationOptions(**(usual | more))


def tour_of(world: GridMap, view: float, seed: int, **more: Any) -> list[PosedScan]:
    """The scans of a tour at their true poses."""
    options = tour_options(view, seed, **more)
    return [
        PosedScan(
            index=s.index,
            stamp_ns=s.stamp_ns,
            map_from_base=pose,
            planar=s.planar,
            base_from_laser=s.base_from_laser,
        )
        for s, pose in simulated_tour(world, options).scans()
    ]


def world_of(name: str) -> tuple[GridMap, RoomTruth]:
    """A plan, the sample office, or `row-COUNT-SEED`: rooms in a row."""
    if name.startswith("row-"):
        count, seed = map(int, name.split("-")[1:])
        return row_of_rooms(count, seed)
    return plan(name), rooms_of(name)


def row_of_rooms(count: int, seed: int) -> tuple[GridMap, RoomTruth]:
    """Rooms of 3 to 8.5 m by 3 to 7.5 m in a row, with doors of 0.9 m and things at the walls."""
    rng = np.random.default_rng(1000 * count + seed)  # no two rows begin with the same room
    sizes = [(int(rng.integers(60, 170)), int(rng.integers(60, 150))) for _ in range(count)]
    shape = max(h for _, h in sizes) + 20, sum(w for w, _ in sizes) + 6 * count + 10
    cells, labels = np.full(shape, OCCUPIED, dtype=np.uint8), np.zeros(shape, dtype=np.int32)
    left, shared = 6, (0, shape[0])
    for number, (width, height) in enumerate(sizes, start=1):
        below = 6 + int(rng.integers(0, max(1, shape[0] - 12 - height)))
        cells[below : below + height, left : left + width] = FREE
        labels[below : below + height, left : left + width] = number
        for _ in range(int(rng.integers(1, 4))):
            _furnish(cells[below : below + height, left : left + width], rng)
        low, high = max(below, shared[0]) + 2, min(below + height, shared[1]) - 20
        if number > 1:
            door = low + int(rng.integers(0, max(1, high - low)))
            cells[door : door + 18, left - 14 : left + 8] = FREE
        left, shared = left + width + 6, (below, below + height)
    return GridMap(cells, RESOLUTION_M), RoomTruth(labels, RESOLUTION_M)


def _furnish(room: NDArray[np.uint8], rng: np.random.Generator) -> None:
    """A box at one wall of a room's cells (H, W), if it is small beside the room."""
    size = np.array([rng.integers(6, 20), rng.integers(6, 30)])
    if (2 * size >= room.shape).any():
        return
    corner = rng.integers(0, np.array(room.shape) - size)
    axis, far = int(rng.integers(2)), bool(rng.integers(2))
    corner[axis] = room.shape[axis] - size[axis] if far else 0
    room[corner[0] : corner[0] + size[0], corner[1] : corner[1] + size[1]] = OCCUPIED
