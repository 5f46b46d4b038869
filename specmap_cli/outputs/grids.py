"""Occupancy grids as files: a trinary PNG and a YAML beside it, in the map_server convention.

0 is occupied, 254 free and 205 unknown; the first row of the image is the highest y. `mapfiles`
reads them back.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from specmap_cli.geometry import FloatArray, Pose2
from specmap_cli.gridmap import FREE, OCCUPIED, UNKNOWN, CellArray, GridMap
from specmap_cli.mapfiles import FREE_THRESHOLD, OCCUPIED_THRESHOLD
from specmap_cli.outputs.files import write_bytes
from specmap_cli.topomap import Submap

# Cells by which corners may be off for their sums not being exact.
_SLACK = 1e-6
_GREY = np.zeros(256, dtype=np.uint8)
_GREY[[FREE, OCCUPIED, UNKNOWN]] = (254, 0, 205)
_PNG_OPTIONS = [cv2.IMWRITE_PNG_COMPRESSION, 6, cv2.IMWRITE_PNG_STRATEGY, 0]


def write_png(path: Path, image: NDArray[Any]) -> None:
    """Write an image, 8 or 16 bit, grey (H, W) or BGR (H, W, 3): the same bytes every time.

    The file appears complete or not at all. UsageError when it cannot be written.
    """
    _, encoded = cv2.imencode(".png", image, _PNG_OPTIONS)
    write_bytes(path, encoded.tobytes())


def write_grid(stem: Path, grid: GridMap) -> None:
    """Write `stem`.png and `stem`.yaml."""
    image = stem.with_name(stem.name + ".png")
    cells = grid.cells if grid.cells.size else np.full((1, 1), UNKNOWN, dtype=np.uint8)
    write_png(image, _GREY[cells[::-1]])
    lines = [
        f"image: {image.name}",
        "mode: trinary",
        f"resolution: {_number(grid.resolution)}",
        f"origin: [{_number(grid.origin[0])}, {_number(grid.origin[1])}, 0.0]",
        "negate: 0",
        f"occupied_thresh: {OCCUPIED_THRESHOLD}",
        f"free_thresh: {FREE_THRESHOLD}",
    ]
    text = "\n".join(lines) + "\n"
    stem.with_name(stem.name + ".yaml").write_text(text, encoding="utf-8")


def _number(value: float) -> str:
    """Six decimals at the most, and a point, without which YAML reads an integer."""
    return repr(round(float(value), 6) + 0.0)


def lay_out(submaps: Iterable[Submap]) -> GridMap:
    """All submaps' grids in the map frame: occupied wins over free, free over unknown.

    Each cell of the result looks up the nearest cell of each submap, so that turned grids leave no
    holes.
    """
    members = [submap for submap in submaps if submap.grid.cells.size]
    if not members:
        return GridMap(np.full((1, 1), UNKNOWN, dtype=np.uint8), 0.05)
    resolution = members[0].grid.resolution
    corners = [grid_corners(m.grid, m.map_from_submap) for m in members]
    low = np.floor(np.min([c.min(axis=0) for c in corners], axis=0) / resolution + _SLACK)
    high = np.ceil(np.max([c.max(axis=0) for c in corners], axis=0) / resolution - _SLACK)
    width, height = (high - low).astype(int).tolist()
    origin = (float(low[0] * resolution), float(low[1] * resolution))
    canvas = GridMap(np.full((height, width), UNKNOWN, dtype=np.uint8), resolution, origin)
    for submap in members:
        _paste(canvas, submap.grid, submap.map_from_submap)
    return canvas


def grid_corners(grid: GridMap, map_from_grid: Pose2) -> FloatArray:
    """(4, 2) the corners of a grid in the map."""
    height, width = grid.cells.shape
    ends = np.array([(0, 0), (width, 0), (width, height), (0, height)], dtype=np.float64)
    return map_from_grid.apply(ends * grid.resolution + grid.origin)


def warp(
    cells: CellArray, grid: GridMap, map_from_grid: Pose2, canvas: GridMap, outside: int
) -> tuple[tuple[slice, slice], CellArray]:
    """`cells`, an image on `grid`, sampled at the cells of `canvas` that the grid may reach.

    Returns the window (rows, columns) of the canvas and the samples there, `outside` where the grid
    has none.
    """
    corners = (grid_corners(grid, map_from_grid) - canvas.origin) / canvas.resolution
    height, width = canvas.cells.shape
    low = np.clip(np.floor(corners.min(axis=0)).astype(int) - 1, 0, (width, height))
    high = np.clip(np.ceil(corners.max(axis=0)).astype(int) + 1, 0, (width, height))
    grid_from_map = map_from_grid.inverse()
    # column and row of the source as a function of those of the canvas: p' = A p + b, at centres
    step = grid_from_map.rotation() * (canvas.resolution / grid.resolution)
    first = (low + 0.5) * canvas.resolution + canvas.origin
    start = (grid_from_map.apply(first[None])[0] - grid.origin) / grid.resolution
    columns = np.arange(high[0] - low[0])
    rows = np.arange(high[1] - low[1])
    u = start[0] + step[0, 0] * columns[None, :] + step[0, 1] * rows[:, None]
    v = start[1] + step[1, 0] * columns[None, :] + step[1, 1] * rows[:, None]
    column, row = np.floor(u).astype(np.intp), np.floor(v).astype(np.intp)
    inside = (column >= 0) & (row >= 0) & (column < cells.shape[1]) & (row < cells.shape[0])
    samples = np.full(inside.shape, outside, dtype=cells.dtype)
    samples[inside] = cells[row[inside], column[inside]]
    return (slice(int(low[1]), int(high[1])), slice(int(low[0]), int(high[0]))), samples


def _paste(canvas: GridMap, grid: GridMap, map_from_grid: Pose2) -> None:
    window, samples = warp(grid.cells, grid, map_from_grid, canvas, UNKNOWN)
    below = canvas.cells[window]
    below[(samples == FREE) & (below == UNKNOWN)] = FREE
    below[samples == OCCUPIED] = OCCUPIED
