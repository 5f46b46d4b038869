"""Maps against maps: is what changed in a building found, and does each map find its own building?

    OMP_NUM_THREADS=1 python -m benchmarks.comparison [--only changes alignment] [--keep DIR]

`changes`: two plans, each recorded twice as it is and once with ten changes: doors closed, cabinets
of 0.4 x 0.8 m moved, walls opened, a room added. How many are found, and what is told besides them.
`alignment`: maps of one building by other tours, fields of view and furniture, maps of other
buildings, and look-alikes: the transform against the true one, or why it was refused. `--keep`
keeps the maps in a directory and takes those that are there.
"""

from __future__ import annotations

import argparse
import math
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np

from benchmarks.data import plan
from benchmarks.unknown import world_of
from specmap_cli.core.geometry import FloatArray, Pose2, nearest_motion, wrap_angle
from specmap_cli.core.settings import Config
from specmap_cli.evaluation.trajectories import read_tum
from specmap_cli.grids.gridmap import FREE, OCCUPIED, GridMap
from specmap_cli.maps.store import read_map
from specmap_cli.pipelines.build import build_map
from specmap_cli.pipelines.compare import Comparison, compare_maps
from specmap_cli.pipelines.known_maps import align_maps
from specmap_cli.pipelines.simulate import simulate
from specmap_cli.simulation.simulator import simulation_options
from specmap_cli.topology.blocked import Crossing

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
LAB = [
    door((14.2, 18.15, 15.6, 18.2)),
    door((8.1, 12.8, 9.4, 12.85)),
    door((12.4, 13.5, 12.45, 14.9)),
    cabinet((10.6, 6.0, 11.0, 6.8), (7.5, 10.3, 8.3, 10.7)),
    cabinet((22.8, 18.0, 23.2, 18.8), (26.5, 21.4, 27.3, 21.8)),
    cabinet((28.2, 8.0, 28.6, 8.8), (25.0, 7.0, 25.4, 7.8)),
    cabinet((15.5, 17.7, 16.3, 18.1), (13.0, 16.0, 13.4, 16.8)),
    hole((13.85, 7.0, 14.25, 8.4)),
    hole((16.85, 8.0, 17.2, 9.3)),
    room((22.55, 5.3, 24.95, 10.9)),
]
CHANGES: dict[str, Sequence[Change]] = {
    "office": [_flipped(change, 14.0) for change in OFFICE],
    "lab_c_scan_furnitures": LAB,
}
# Plan, field of view, seed; those of one plan are one building.
MAPS: dict[str, tuple[str, float, int]] = {
    "lab_c 270": ("lab_c_scan_furnitures", 270.0, 1),
    "lab_c 180": ("lab_c_scan_furnitures", 180.0, 7),
    "fr079 270": ("Freiburg79_scan_furnitures", 270.0, 1),
    "fr079 180": ("Freiburg79_scan_furnitures", 180.0, 7),
    "fr052 270": ("Freiburg52_scan_furnitures", 270.0, 1),
    "fr052 180": ("Freiburg52_scan_furnitures", 180.0, 7),
    "office 270": ("office", 270.0, 1),
    "office 360": ("office", 360.0, 7),
    "four rooms": ("row-4-10", 270.0, 1),
    "four again": ("row-4-10", 270.0, 6),
    "two rooms": ("row-2-0", 270.0, 1),
    "one room": ("row-1-0", 270.0, 1),
}
# the maps of other buildings that are compared, each with each: 21 pairs
OTHERS = (
    "lab_c 270", "fr079 270", "fr052 270", "office 270", "four rooms", "two rooms", "one room",
)  # fmt: skip
ALIKE: dict[str, tuple[str, float, int]] = {
    "lab_c mirrored": ("mirrored lab_c_scan_furnitures", 270.0, 1),
    "lab_c bare": ("lab_c_scan", 360.0, 3),
    "lab_c other wing": ("wing lab_c_scan_furnitures", 270.0, 2),
    "row of offices": ("alike", 270.0, 1),
    "row again": ("alike", 270.0, 7),
}
ALIKE_PAIRS = [
    ("lab_c 270", "lab_c mirrored"),
    ("lab_c 270", "lab_c bare"),
    ("lab_c 270", "lab_c other wing"),
    ("row of offices", "row again"),
]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    sections: dict[str, Callable[[Path], None]] = {"changes": changes, "alignment": alignment}
    parser.add_argument("--only", nargs="+", choices=sorted(sections), default=list(sections))
    parser.add_argument("--keep", type=Path, help="directory of the maps")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        for name in arguments.only:
            sections[name](arguments.keep or Path(folder))
            print()


def changes(folder: Path) -> None:
    """What is found of ten changes a plan, and what is told of a plan without any."""
    print(f"{'plan':<24} {'changes found':<14} {'told besides':<13} missed")
    for name, wanted in CHANGES.items():
        before = _drawn(plan_of(name), wanted, after=False)
        old = _mapped(folder, f"{name} before", before, 270.0, 1)
        again = _mapped(folder, f"{name} again", before, 360.0, 7)
        after = _mapped(
            folder, f"{name} after", _drawn(plan_of(name), wanted, after=True), 270.0, 4
        )
        for title, new, asked in ((f"{name}", after, wanted), (" unchanged", again, ())):
            told = compare_maps(old, new)
            plan_from_old = _plan_from_map(old)
            missed = [change for change in asked if not _is_told(change, told, plan_from_old)]
            besides = _besides(told, asked, plan_from_old)
            found = f"{len(asked) - len(missed)} of {len(asked)}"
            words = ", ".join(change.kind for change in missed) or "none"
            print(f"{title:<24} {found:<14} {besides:<13} {words}", flush=True)


def alignment(folder: Path) -> None:
    """Pairs of maps of one building, of others, and of look-alikes."""
    made = {name: _mapped(folder, name, plan_of(spec[0]), *spec[1:]) for name, spec in MAPS.items()}
    same = [(a, b) for a, b in combinations(MAPS, 2) if MAPS[a][0] == MAPS[b][0]]
    print("one building")
    for a, b in same:
        print(f"  {a:<12} {b:<12} {_verdict(made[a], made[b])}", flush=True)
    print("other buildings")
    for a, b in combinations(OTHERS, 2):
        print(f"  {a:<12} {b:<12} {_verdict(made[a], made[b])}", flush=True)
    print("look-alikes")
    made |= {
        name: _mapped(folder, name, plan_of(spec[0]), *spec[1:]) for name, spec in ALIKE.items()
    }
    for a, b in ALIKE_PAIRS:
        print(f"  {a:<14} {b:<18} {_verdict(made[a], made[b])}", flush=True)


def plan_of(name: str) -> GridMap:
    """A plan by name; `mirrored NAME`, `wing NAME`: its right third is another plan; `alike`."""
    if name == "alike":
        return row_of_equal_offices(8)
    kind, _, other = name.partition(" ")
    if kind == "mirrored":
        grid = plan_of(other)
        return GridMap(np.ascontiguousarray(grid.cells[:, ::-1]), grid.resolution)
    if kind == "wing":
        return _with_another_wing(plan_of(other))
    return world_of(name)[0] if name == "office" or name.startswith("row-") else plan(name)


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


def _with_another_wing(grid: GridMap) -> GridMap:
    """The plan with its right third turned upside down."""
    cells = grid.cells.copy()
    known = np.flatnonzero((cells == FREE).any(axis=0))
    rows = np.flatnonzero((cells == FREE).any(axis=1))
    left = int(known[0] + 2 * (known[-1] - known[0]) // 3)
    wing = cells[rows[0] : rows[-1] + 1, left:]
    cells[rows[0] : rows[-1] + 1, left:] = wing[::-1].copy()
    return GridMap(cells, grid.resolution, grid.origin)


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


def _verdict(old: Path, new: Path) -> str:
    found = align_maps(read_map(old), read_map(new), Config())
    if found.old_from_new is None:
        return f"refused: {found.reason}"
    truth = _plan_from_map(old).inverse() @ _plan_from_map(new)
    error = truth.inverse() @ found.old_from_new
    degrees = math.degrees(abs(wrap_angle(error.theta)))
    return f"aligned: {error.distance:.3f} m, {degrees:.2f} degrees off; {found.reason}"


def _is_told(change: Change, told: Comparison, plan_from_old: Pose2) -> bool:
    """Whether a comparison tells of a change, by its kind and place."""
    found = told.differences
    closed, opened = (_ways(ways, plan_from_old) for ways in (found.closed, found.opened))
    appeared, vanished = (
        np.array([one.thing.centre for one in things]).reshape(-1, 2)
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
    added = [told.new.regions.outline(i).centroid for i in told.differences.identity.added]
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
    places += [one.thing.centre for one in (*found.appeared, *found.vanished)]
    boxes = [box for change in asked for box in (change.old, change.new) if box is not None]
    placed = plan_from_old.apply(np.array(places).reshape(-1, 2))
    return sum(not any(_near(box, place[None]) for box in boxes) for place in placed)


if __name__ == "__main__":
    main()
