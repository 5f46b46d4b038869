"""Maps against maps: is what changed in a building found, and does each map find its own building?

The sample office is recorded twice as it is and once with ten changes: doors closed, cabinets of
0.4 x 0.8 m moved, walls opened, a room added. How many are found, and what is told besides them.
Then pairs of maps: of one building by other tours and fields of view, of other buildings, and of
look-alikes (mirrored, bare for furnished, a row of equal offices): the transform against the true
one, or why it was refused.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np

from benchmarks.data import plan
from benchmarks.scoreboard.bench import Bench
from benchmarks.scoreboard.rows import Figure, Figures, Row
from specmap_cli.core.geometry import FloatArray, Pose2, nearest_motion, wrap_angle
from specmap_cli.grids.gridmap import FREE, OCCUPIED, GridMap
from specmap_cli.maps.store import read_map
from specmap_cli.maps.text_files import read_tum
from specmap_cli.pipelines.build import build_map
from specmap_cli.pipelines.compare import Comparison, compare_maps
from specmap_cli.pipelines.overlaps import stored_to_align
from specmap_cli.pipelines.simulate import simulate
from specmap_cli.recognition.closure.alignment import align
from specmap_cli.simulation.simulator import simulation_options
from specmap_cli.topology.differences import Crossing

Box = tuple[float, float, float, float]  # left, low, right, high; metres of the plan, y up

_FOUND_M = 0.6  # from a change to what is told of it: half a door, and its frame
_RATE_HZ = 5.0


@dataclass(frozen=True, slots=True)
class Change:
    """What is drawn into the plan before (`old`) and after (`new`), walls or, `free`, holes.

    `centre` is where to look for it; `kind` what is to be told.
    """

    kind: str
    old: Box | None = None
    new: Box | None = None
    free: bool = False


def door(box: Box) -> Change:
    """A door that is closed by a leaf."""
    return Change("door closed", new=box)


def cabinet(old: Box, new: Box) -> Change:
    """A cabinet that was moved."""
    return Change("cabinet moved", old=old, new=new)


def hole(box: Box) -> Change:
    """A wall that was opened."""
    return Change("wall opened", new=box, free=True)


def room(box: Box) -> Change:
    """A room that was walled up before."""
    return Change("room added", old=box)


def _flipped(change: Change, height: float) -> Change:
    """A change of a plan whose y runs down from its upper edge."""

    def turned(box: Box | None) -> Box | None:
        return None if box is None else (box[0], height - box[3], box[2], height - box[1])

    return Change(change.kind, turned(change.old), turned(change.new), change.free)


# Coordinates of sample_logs/draw_office.py: y runs down.
OFFICE = [
    door((8.8, 5.2, 9.7, 5.25)),
    door((11.7, 10.8, 11.75, 11.7)),
    door((15.2, 5.2, 16.1, 5.25)),
    cabinet((0.75, 2.6, 1.15, 3.4), (4.85, 2.0, 5.25, 2.8)),
    cabinet((17.85, 1.0, 18.25, 1.8), (12.0, 3.6, 12.8, 4.0)),
    cabinet((5.8, 9.9, 6.6, 10.3), (11.25, 7.6, 11.65, 8.4)),
    cabinet((13.55, 9.0, 13.95, 9.8), (17.0, 12.85, 17.8, 13.25)),
    hole((8.2, 2.4, 8.35, 3.5)),
    hole((14.2, 8.2, 15.4, 8.35)),
    room((0.75, 6.9, 3.0, 13.25)),
]
CHANGES = [_flipped(change, 14.0) for change in OFFICE]
# Plan, field of view, seed; those of one plan are one building.
MAPS: dict[str, tuple[str, float, int]] = {
    "fr079 270": ("Freiburg79_scan_furnitures", 270.0, 1),
    "fr079 180": ("Freiburg79_scan_furnitures", 180.0, 7),
    "office 270": ("office", 270.0, 1),
    "office 360": ("office", 360.0, 7),
    "lab_c 270": ("lab_c_scan_furnitures", 270.0, 1),
    "lab_c mirrored": ("mirrored lab_c_scan_furnitures", 270.0, 1),
    "lab_c bare": ("lab_c_scan", 360.0, 3),
    "row of offices": ("alike", 270.0, 1),
    "row again": ("alike", 270.0, 7),
}
SAME = (("fr079 270", "fr079 180"), ("office 270", "office 360"))
OTHERS = tuple(combinations(("fr079 270", "office 270", "lab_c 270", "row of offices"), 2))
ALIKE = (
    ("lab_c 270", "lab_c mirrored"),
    ("lab_c 270", "lab_c bare"),
    ("row of offices", "row again"),
)

ROWS = (
    Row("changes", "changes found, of 10", 10, 10, form=".0f"),
    Row("besides", "told besides the changes", 0, 0, "less", ".0f"),
    Row("same", "maps of one building: error of the transform", 0.05, None, "less", unit="m"),
    Row(
        "joined",
        "maps of other buildings and look-alikes that are joined, of 9",
        0,
        0,
        "less",
        ".0f",
    ),
)


def measure(bench: Bench) -> Figures:
    """Changes in the sample office, then pairs of maps."""
    with bench.scratch("comparison") as folder:
        found, besides = changes(folder)
        maps = {
            name: _mapped(folder, name, plan_of(of), view, seed)
            for name, (of, view, seed) in MAPS.items()
        }
        errors = [off for one, other in SAME if (off := _told(maps[one], maps[other])) is not None]
        joined = [
            pair for pair in (*OTHERS, *ALIKE) if _told(*(maps[name] for name in pair)) is not None
        ]
    same = (
        Figure(max(errors), note=f"{len(errors)} of {len(SAME)} aligned")
        if errors
        else Figure(None)
    )
    return {"changes": found, "besides": besides, "same": same, "joined": len(joined)}


def changes(folder: Path) -> tuple[int, int]:
    """How many of ten changes are found, and how much is told besides, also of no change at all."""
    before = _drawn(plan_of("office"), CHANGES, after=False)
    old = _mapped(folder, "before", before, 270.0, 1)
    again = _mapped(folder, "again", before, 360.0, 7)
    after = _mapped(folder, "after", _drawn(plan_of("office"), CHANGES, after=True), 270.0, 4)
    found = besides = 0
    for title, new, asked in (("changed", after, CHANGES), ("unchanged", again, [])):
        told = compare_maps(old, new)
        plan_from_old = _plan_from_map(old)
        missed = [change.kind for change in asked if not _is_told(change, told, plan_from_old)]
        more = _besides(told, asked, plan_from_old)
        found, besides = found + len(asked) - len(missed), besides + more
        words = f"{len(asked) - len(missed)} of {len(asked)} found, {more} told besides"
        print(f"office, {title}: {words}; missed: {', '.join(missed) or 'none'}", flush=True)
    return found, besides


def plan_of(name: str) -> GridMap:
    """A plan by name; `mirrored NAME`; `alike`: a row of equal offices."""
    if name == "alike":
        return row_of_equal_offices(8)
    kind, _, other = name.partition(" ")
    if kind == "mirrored":
        grid = plan_of(other)
        return GridMap(np.ascontiguousarray(grid.cells[:, ::-1]), grid.resolution)
    return plan(name)


def row_of_equal_offices(count: int) -> GridMap:
    """Offices of 3.5 m by 4.5 m that are all alike, above a corridor."""
    wide, deep, corridor, wall = 70, 90, 44, 4
    cells = np.full((2 * 6 + corridor + wall + deep, count * (wide + wall) + 12), OCCUPIED)
    cells = cells.astype(np.uint8)
    cells[6 : 6 + corridor, 6:-6] = FREE
    for left in range(6, 6 + count * (wide + wall), wide + wall):
        office = cells[6 + corridor + wall : 6 + corridor + wall + deep, left : left + wide]
        office[:] = FREE
        cells[6 + corridor : 6 + corridor + wall, left + 26 : left + 44] = FREE
        office[-16:, :30] = OCCUPIED
        office[26:56, -14:] = OCCUPIED
    return GridMap(cells, 0.05)


def _drawn(grid: GridMap, wanted: Sequence[Change], *, after: bool) -> GridMap:
    cells = grid.cells.copy()
    for change in wanted:
        box = change.new if after else change.old
        if box is not None:
            corners = np.round(np.array(box) / grid.resolution).astype(int)
            left, low, right, high = corners.tolist()
            cells[low:high, left:right] = FREE if change.free else OCCUPIED
    return GridMap(cells, grid.resolution, grid.origin)


def _mapped(folder: Path, name: str, grid: GridMap, view_deg: float, seed: int) -> Path:
    """The map of a tour of a plan; its true poses stand beside it."""
    out = folder / name.replace(" ", "_")
    if not out.exists():
        folder.mkdir(parents=True, exist_ok=True)
        beams = round(2 * view_deg) + (view_deg < 360.0)
        options = simulation_options(
            field_of_view_deg=view_deg, beams=beams, rate_hz=_RATE_HZ, seed=seed
        )
        log = out.with_suffix(".mcap")
        simulate(grid, options, log, out.with_suffix(".tum"))
        build_map([log], out)
        log.unlink()
    return out


def _plan_from_map(path: Path) -> Pose2:
    """Where a map lies in the plan that it was recorded in, by its true poses."""
    stored, truth = read_map(path).labels, read_tum(path.with_suffix(".tum"))
    rows = np.searchsorted(truth.stamps_ns, stored.stamps_ns - 1_000_000)
    true = truth.poses[np.minimum(rows, len(truth.poses) - 1), :2]
    return nearest_motion(stored.poses[:, :2], true)


def _told(old: Path, new: Path) -> float | None:
    """How many metres the transform between two maps is off; None where there is none."""
    found = align(stored_to_align(read_map(old)), stored_to_align(read_map(new)))
    off: float | None = None
    words = f"refused: {found.reason}"
    if found.old_from_new is not None:
        truth = _plan_from_map(old).inverse() @ _plan_from_map(new)
        error = truth.inverse() @ found.old_from_new
        off, degrees = error.distance, math.degrees(abs(wrap_angle(error.theta)))
        words = f"aligned: {off:.3f} m, {degrees:.2f} degrees off"
    print(f"  {old.name:<16} {new.name:<16} {words}", flush=True)
    return off


def _is_told(change: Change, told: Comparison, plan_from_old: Pose2) -> bool:
    """Whether a comparison tells of a change, by its kind and place."""
    found = told.differences
    closed, opened = (_ways(ways, plan_from_old) for ways in (found.closed, found.opened))
    appeared, vanished = (
        np.array([one.place for one in things]).reshape(-1, 2)
        for things in (found.appeared, found.vanished)
    )
    appeared, vanished = plan_from_old.apply(appeared), plan_from_old.apply(vanished)
    if change.kind == "door closed":
        return _near(change.new, np.concatenate([closed, appeared]))
    if change.kind == "cabinet moved":
        return _near(change.old, vanished) and _near(change.new, appeared)
    if change.kind == "wall opened":
        return _near(change.new, np.concatenate([opened, vanished]))
    return _is_added(change.old, told, plan_from_old)


def _is_added(box: Box | None, told: Comparison, plan_from_old: Pose2) -> bool:
    """Whether a new submap has its centre in a box of the plan."""
    added = [told.new.regions.outline(i).centroid for i in told.differences.identity.new]
    places = np.array([place for place in added if place is not None]).reshape(-1, 2)
    return _near(box, plan_from_old.apply(told.old_from_new.apply(places)))


def _ways(ways: Sequence[Crossing], plan_from_old: Pose2) -> FloatArray:
    """(n, 2) where some ways are in the plan."""
    places = np.array([way.place for way in ways]).reshape(-1, 2)
    return plan_from_old.apply(places)


def _near(box: Box | None, places: FloatArray) -> bool:
    """Whether one of the places (n, 2) lies in a box or near it."""
    return box is not None and bool(_distances(box, places).min(initial=np.inf) <= _FOUND_M)


def _distances(box: Box, places: FloatArray) -> FloatArray:
    """(n,) metres from places (n, 2) to a box."""
    low, high = np.array(box[:2]), np.array(box[2:])
    return np.asarray(np.hypot(*np.maximum(np.maximum(low - places, places - high), 0.0).T))


def _besides(told: Comparison, asked: Sequence[Change], plan_from_old: Pose2) -> int:
    """How much is told that no change explains."""
    found = told.differences
    places = [way.place for way in (*found.closed, *found.opened)]
    places += [one.place for one in (*found.appeared, *found.vanished)]
    boxes = [box for change in asked for box in (change.old, change.new) if box is not None]
    placed = plan_from_old.apply(np.array(places).reshape(-1, 2))
    return sum(not any(_near(box, place[None]) for box in boxes) for place in placed)
