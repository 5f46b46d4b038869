"""The picture of two maps against each other: old in blue, new in orange, common walls dark."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import BentMotion, FloatArray
from specmap_cli.core.text import counted
from specmap_cli.drawing.canvas import Canvas, Image
from specmap_cli.drawing.palette import INK, PAPER, QUIET, WRONG, Colour, paler
from specmap_cli.drawing.sheet import Sheet, extent_of
from specmap_cli.drawing.symbols import Legend, Symbol
from specmap_cli.grids.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap
from specmap_cli.topology.differences import Differences, walls_in_common
from specmap_cli.topology.regions import NOBODY, Regions

OLD: Colour = (196, 110, 30)
NEW: Colour = (0, 120, 240)
OPENED: Colour = (90, 150, 40)
_BOTH, _OLD_ONLY, _NEW_ONLY = 0, 1, 2
_FLOOR: Colour = (244, 244, 244)
_PALE = 0.78
_BOX, _HALO = 4, 9  # pixels: of a box round a thing, and of the paper under it
_BOX_MARGIN_M = 0.12  # between a thing and its box
_DISC, _BAR = 15.0, 9.0  # pixels: of the sign of a way
_ID_LETTERS = 17.0


def render_comparison(
    old: Regions, new: Regions, old_from_new: BentMotion, found: Differences, names: tuple[str, str]
) -> Image:
    """What differs between two maps, in the frame of the old one; BGR (H, W, 3)."""
    both = _laid_over(old, new, old_from_new, found)
    signs: dict[str, tuple[object, Symbol]] = {
        "vanished": (found.vanished, _frame(OLD)),
        "appeared": (found.appeared, _frame(NEW)),
        "way closed": (found.closed, lambda canvas, at: _sign(canvas, at, WRONG)),
        "way opened": (found.opened, lambda canvas, at: _sign(canvas, at, OPENED)),
    }
    legend: Legend = (
        ("wall in both", _bar(INK)),
        ("only in the old map", _bar(OLD)),
        ("only in the new map", _bar(NEW)),
        *((words, symbol) for words, (any_, symbol) in signs.items() if any_),
    )
    sheet = Sheet(*extent_of(both), legend)
    fills = {_BOTH: _FLOOR, _OLD_ONLY: paler(OLD, _PALE), _NEW_ONLY: paler(NEW, _PALE)}
    sheet.floor(both, fills)
    _draw_walls(sheet, both.grid, old.grid, new.grid, old_from_new)
    ids = [(outline.centroid, str(id_), QUIET) for id_, outline in sorted(old.outlines.items())]
    for id_ in found.identity.new:
        centroid = new.outline(id_).centroid
        moved = None if centroid is None else old_from_new.apply(centroid[None])[0]
        ids.append((moved, f"new {id_}", NEW))  # the old map may have that number, too
    for place, words, colour in ids:
        if place is not None:
            x, y = sheet.pixels(place[None])[0]
            sheet.canvas.text(x, y, words, _ID_LETTERS, colour, "centre", bold=True)
    for things, colour in ((found.vanished, OLD), (found.appeared, NEW)):
        for one in things:  # in a box that leaves their walls to be seen
            away = one.corners - one.place
            length = np.maximum(np.hypot(*away.T), _BOX_MARGIN_M)[:, None]
            corners = one.place + away * (1.0 + 1.5 * _BOX_MARGIN_M / length)
            _box(sheet.canvas, sheet.pixels(corners), colour)
    for ways, colour in ((found.closed, WRONG), (found.opened, OPENED)):
        for way in ways:
            _sign(sheet.canvas, sheet.pixels(way.place[None])[0], colour)
    sheet.title(f"{names[1]} against {names[0]}", _figures(found))
    return sheet.canvas.image


def _laid_over(old: Regions, new: Regions, old_from_new: BentMotion, found: Differences) -> Regions:
    """Both maps on one grid in the frame of the old one; who saw each free cell is its owner.

    Under a thing that map has the cells which shows the thing: the floor there is in the other one.
    """
    cell_m = old.grid.resolution
    reach = np.concatenate([_corners(old.grid), old_from_new.rigid.apply(_corners(new.grid))])
    low = np.floor((reach.min(axis=0) - old.grid.origin) / cell_m) * cell_m + old.grid.origin
    width, height = np.ceil((reach.max(axis=0) - low) / cell_m).astype(int).tolist()
    empty = np.full((height, width), UNKNOWN, dtype=np.uint8)
    canvas = GridMap(empty, cell_m, (float(low[0]), float(low[1])))
    places = canvas.centres_of(np.argwhere(empty == UNKNOWN))
    one = old.grid.values_at(places).reshape(empty.shape)
    other = new.grid.values_at(old_from_new.rigid.inverse().apply(places)).reshape(empty.shape)
    free_old, free_new = one == FREE, other == FREE
    owner = np.full(empty.shape, NOBODY, dtype=np.int64)
    owner[free_old | free_new] = _BOTH
    owner[free_old & (other == UNKNOWN)] = _OLD_ONLY
    owner[free_new & (one == UNKNOWN)] = _NEW_ONLY
    for things, floor, thing in (
        (found.vanished, _NEW_ONLY, _OLD_ONLY),
        (found.appeared, _OLD_ONLY, _NEW_ONLY),
    ):
        for each in things:
            under = np.zeros(owner.shape, dtype=np.uint8)
            ring = canvas.cells_of(each.corners)[:, ::-1].astype(np.int32)
            cv2.fillConvexPoly(under, ring, (1.0,))
            owner[(under > 0) & (owner == floor)] = thing
    cells = np.where(owner != NOBODY, FREE, np.where((one | other) == UNKNOWN, UNKNOWN, OCCUPIED))
    return Regions(GridMap(cells.astype(np.uint8), cell_m, canvas.origin), owner, {})


def _corners(grid: GridMap) -> FloatArray:
    """(4, 2) the corners of a grid, metres."""
    height, width = grid.cells.shape
    cells = np.array([[x, y] for x in (0.0, width) for y in (0.0, height)])
    return np.asarray(cells * grid.resolution + grid.origin)


def _draw_walls(
    sheet: Sheet, canvas: GridMap, old: GridMap, new: GridMap, old_from_new: BentMotion
) -> None:
    """Walls of one map in its colour, those of both dark."""
    common = walls_in_common(old, new, old_from_new.inverse())
    sheet.walls(old, common, INK)
    sheet.walls(old, old.occupied & ~common, OLD)
    alone = new.occupied & ~walls_in_common(new, old, old_from_new)
    places = old_from_new.apply(new.centres_of(np.argwhere(alone)))
    cells = canvas.cells_of(places)
    rows, columns = cells[canvas.inside(cells)].T
    picture = np.zeros(canvas.cells.shape, dtype=np.bool_)
    picture[rows, columns] = True
    sheet.walls(canvas, picture, NEW)


def _box(canvas: Canvas, corners: NDArray[np.float64], colour: Colour) -> None:
    ring = np.concatenate([corners, corners[:1]])
    canvas.line(ring, PAPER, _HALO)
    canvas.line(ring, colour, _BOX)


def _sign(canvas: Canvas, centre: FloatArray, colour: Colour) -> None:
    """A disc with a bar, which stands upright where the way is open."""
    canvas.disc(centre, _DISC, colour, PAPER)
    along = np.array([0.0, _BAR]) if colour == OPENED else np.array([_BAR, 0.0])
    canvas.line(np.array([centre - along, centre + along]), PAPER, 5)


def _figures(found: Differences) -> str:
    parts = [
        f"{len(ways)} {what}"
        for ways, what in ((found.closed, "closed"), (found.opened, "opened"))
        if ways
    ]
    ways = [f"ways: {' and '.join(parts)}"] if parts else []
    things = [
        f"{counted(len(things), 'thing')} {what}"
        for things, what in ((found.appeared, "appeared"), (found.vanished, "vanished"))
        if things
    ]
    return ",  ".join([*ways, *things]) or "no change found"


def _bar(colour: Colour) -> Symbol:
    floor, wall = np.array([20, 10]), np.array([20, 3])

    def draw(canvas: Canvas, at: FloatArray) -> None:
        canvas.box(at - floor, at + floor, paler(colour, _PALE))
        canvas.box(at - wall, at + wall, colour)

    return draw


def _frame(colour: Colour) -> Symbol:
    corners = np.array([[-16, -9], [16, -9], [16, 9], [-16, 9]])
    return lambda canvas, at: _box(canvas, at + corners, colour)
