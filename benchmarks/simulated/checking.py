"""Does `specmap check` find what is wrong with a map, by the right rule, and leave good ones alone?

Five small simulated buildings. Good: two tours of each by other seeds, fields of view and spacings;
the first is the golden map of the building and is checked by itself, the other against it: neither
may break a rule. Spoiled: ten kinds of maps that a fleet meets, from recordings that were spoiled,
from tours of buildings that were changed, and made from maps that do not belong together: each must
break the rule that says what is wrong. All rules are the defaults.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.making import spoiling as s
from benchmarks.making.recordings import simulated
from benchmarks.making.tours import world_of
from benchmarks.scoreboard.bench import Bench
from benchmarks.scoreboard.rows import Figures, Row
from specmap_cli.checking.rules import CheckRecord
from specmap_cli.core.config import load_config
from specmap_cli.grids.gridmap import FREE, OCCUPIED, GridMap
from specmap_cli.pipelines.build import build_map
from specmap_cli.pipelines.check import check_map
from specmap_cli.pipelines.update import update_map
from specmap_cli.simulation.simulator import SimulationOptions, simulated_tour, simulation_options

BUILDINGS = ("office", "row-4-10", "row-5-3", "row-5-12", "row-6-2")
TOURS = (1, 2)  # seeds; the first is that of the golden map
# Classifiers are of no interest here.
QUICK = load_config(
    None,
    None,
    {
        "recognition": {"rounds": 5},
        "localization": {"augmentation": 20, "track_samples": 20},
    },
)
DOOR_CELLS = 20  # a column of a row of rooms with no more free cells than this is in a door
Box = tuple[float, float, float, float]  # left, low, right, high; metres of the plan, y up


@dataclass(frozen=True, slots=True)
class Kind:
    """A way to spoil a map, and the `rules` of which at least one must be broken.

    A map that cannot be aligned with the golden one breaks all rules of the comparison: then none
    counts but `golden.aligned`, since the others say nothing.

    The `building` is recorded as `plan` changes it and the recording is spoiled; that of another
    building, `joined`, may be added to the map. `against` is the building of the golden map.
    """

    building: str
    rules: frozenset[str]
    plan: Callable[[GridMap], GridMap] | None = None
    spoil: s.Spoiling = iter
    joined: str = ""
    against: str = ""


def walled(box: Box) -> Callable[[GridMap], GridMap]:
    """The plan with a wall, a leaf of a door or goods in a box."""

    def draw(grid: GridMap) -> GridMap:
        cells = grid.cells.copy()
        left, low, right, high = np.round(np.array(box) / grid.resolution).astype(int).tolist()
        cells[low:high, left:right] = OCCUPIED
        return GridMap(cells, grid.resolution, grid.origin)

    return draw


def cut(share: float, beyond_m: float = 0.0) -> Callable[[GridMap], GridMap]:
    """The plan without what lies right of a door, the one nearest to a share of its width.

    So much of the room behind the door is left.
    """

    def draw(grid: GridMap) -> GridMap:
        cells = grid.cells.copy()
        free = (cells == FREE).sum(axis=0)
        doors = np.flatnonzero((free > 0) & (free <= DOOR_CELLS))
        door = doors[np.argmin(np.abs(doors - share * cells.shape[1]))]
        cells[:, door + round(beyond_m / grid.resolution) :] = OCCUPIED
        return GridMap(cells, grid.resolution, grid.origin)

    return draw


def bent(rise_m: float) -> Callable[[GridMap], GridMap]:
    """The plan as a map would have it that is bent along its length: its ends lie so far up."""

    def draw(grid: GridMap) -> GridMap:
        height, width = grid.cells.shape
        along = np.linspace(-1.0, 1.0, width)
        up = np.round(rise_m / grid.resolution * along**2).astype(int)
        cells = np.full((height + int(up.max()) + 1, width), OCCUPIED, dtype=np.uint8)
        for column, shift in enumerate(up.tolist()):
            cells[shift : shift + height, column] = grid.cells[:, column]
        return GridMap(cells, grid.resolution, grid.origin)

    return draw


SPOILED: Mapping[str, Kind] = {
    "lost scans": Kind(
        "office",
        frozenset({"lost_share", "findings.lost-scans"}),
        spoil=s.chained(s.first_scans_spoiled(150), s.without_odometry),
    ),
    "hole in the log": Kind(
        "row-5-3",
        frozenset({"findings.hole-in-log"}),
        spoil=s.chained(s.dropped(85.0, math.inf), s.kidnapped(40.0, 30.0)),
    ),
    "odometry of another robot": Kind(
        "row-4-10", frozenset({"findings.odometry-disagrees"}), spoil=s.foreign_odometry(-1.0)
    ),
    "doubled walls": Kind(
        "office",
        frozenset({"findings.walls-disagree", "findings.part-moved"}),
        spoil=s.stretched(1.15),
    ),
    "two logs that never met": Kind("row-4-10", frozenset({"parts"}), joined="row-5-3"),
    "a foreign log": Kind("row-5-3", frozenset({"golden.aligned"}), against="row-4-10"),
    "a wing missing": Kind("row-6-2", frozenset({"golden.unseen"}), cut(0.7), against="row-6-2"),
    "a door closed": Kind(
        "office", frozenset({"golden.closed"}), walled((8.8, 8.75, 9.7, 8.8)), against="office"
    ),
    "a bent layout": Kind("row-6-2", frozenset({"golden.off_m"}), bent(0.8), against="row-6-2"),
    "a hall full of goods": Kind(
        "row-5-12", frozenset({"golden.area_share"}), cut(0.8, 1.0), against="row-5-12"
    ),
}


ROWS = (
    Row("spoiled", "kinds of spoiled maps found by the right rule, of 10", 10, 10, form=".0f"),
    Row("good", "good maps that break a rule, of 10", 0, 0, "less", ".0f"),
)


def measure(bench: Bench) -> Figures:
    """Check every good and every spoiled map with the default rules."""
    with bench.scratch("checking") as folder:
        return {"good": good(folder), "spoiled": spoiled(folder)}


def good(folder: Path) -> int:
    """Every building by two tours; how many maps break a rule."""
    print(f"{'good map':<28} {'against':<12} broken rules")
    wrong = 0
    for building in BUILDINGS:
        for seed in TOURS:
            against = None if seed == TOURS[0] else golden_map(folder, building)
            broken = broken_rules(check_map(good_map(folder, building, seed), against=against))
            wrong += bool(broken)
            named = "-" if against is None else "golden"
            print(f"{building}, tour {seed}".ljust(28), named.ljust(12), told(broken), flush=True)
    return wrong


def spoiled(folder: Path) -> int:
    """Ten kinds of spoiled maps; how many break the rules that they must break."""
    print(f"{'spoiled map':<28} {'found':<6} {'by the rule':<32} broken besides")
    found = 0
    for name, kind in SPOILED.items():
        golden = golden_map(folder, kind.against) if kind.against else None
        broken = broken_rules(check_map(spoiled_map(folder, name, kind), against=golden))
        right = [rule for rule in saying(broken) if rule in kind.rules]
        found += bool(right)
        besides = told([rule for rule in broken if rule not in kind.rules])
        print(
            f"{name:<28} {'yes' if right else 'MISSED':<6} {told(right):<32} {besides}", flush=True
        )
    return found


def broken_rules(record: CheckRecord) -> list[str]:
    """The rules that a map breaks."""
    return [outcome.rule for outcome in record.rules if not outcome.passed]


def saying(broken: list[str]) -> list[str]:
    """The broken rules that say something: without alignment, no other rule of a comparison."""
    if "golden.aligned" not in broken:
        return broken
    return [rule for rule in broken if rule == "golden.aligned" or not rule.startswith("golden.")]


def told(rules: list[str]) -> str:
    """Rules in a cell of a table."""
    return ", ".join(rules) or "none"


def golden_map(folder: Path, building: str) -> Path:
    """The map that the others of a building are held against."""
    return good_map(folder, building, TOURS[0])


def good_map(folder: Path, building: str, seed: int) -> Path:
    """The map of a tour of a building as it is."""
    return made(folder, f"{building}-{seed}", world_of(building)[0], seed, iter)


def spoiled_map(folder: Path, name: str, kind: Kind) -> Path:
    """The map that is spoiled in one way: of a tour of its own."""
    grid = world_of(kind.building)[0]
    drawn = grid if kind.plan is None else kind.plan(grid)
    map_ = made(folder, name.replace(" ", "-"), drawn, 5, kind.spoil)
    if not kind.joined:
        return map_
    joined = map_.with_name(f"{map_.name}-joined")
    if not joined.exists():
        good_map(folder, kind.joined, TOURS[0])
        log = folder / f"{kind.joined}-{TOURS[0]}.mcap"
        update_map(map_, log, joined, allow_apart=True)
    return joined


def made(folder: Path, name: str, grid: GridMap, seed: int, spoil: s.Spoiling) -> Path:
    """The map of a tour, unless it is there; its recording stays beside it."""
    out, log = folder / name, folder / f"{name}.mcap"
    if not out.exists():
        simulated(simulated_tour(grid, options_of(seed)), spoil, log)
        build_map(log, out, QUICK)
    return out


def options_of(seed: int) -> SimulationOptions:
    """A quick tour; the seed also chooses the laser and how close the path comes to every place."""
    view_deg = (270.0, 360.0, 180.0)[seed % 3]
    return simulation_options(
        field_of_view_deg=view_deg,
        beams=round(view_deg) + (view_deg < 360.0),
        rate_hz=5.0,
        speed_mps=0.8,
        spacing_m=(2.5, 1.8, 2.2)[seed % 3],
        seed=seed,
    )
