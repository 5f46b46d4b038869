"""Is a log from this map at all? Own rooms must be recognised, other buildings refused.

    OMP_NUM_THREADS=1 python -m benchmarks.unknown [--only tuned reported real] [--quick]
    python -m benchmarks.unknown --worlds row-1-20 row-2-20 office --views 180

Simulated maps at true poses: one room, two rooms, an office, whole floors, with lasers of 180, 270
and 360 degrees. In each of them: another tour of the same world by another way and start, the same
with a laser of twice the beams, a robot that stands still at several places (its scans differ by
noise alone), and the tours of all other worlds of the list. A column gives the share of scans that
were called known; those of the standing robot and of other buildings are the means over all places
and buildings, the worst beside it. `tuned` are the worlds that settings were chosen on, `reported`
others. `real`: the map of a whole real log, built by the program, with its own log and with those
of the other buildings whose laser sees enough. `--worlds` takes others than those of the lists.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.data import RESOLUTION_M, data_folder, plan, rooms_of
from benchmarks.recognition import localizer_of_tour, tour_of
from specmap_cli.core.config import load_config
from specmap_cli.core.errors import InputError
from specmap_cli.core.geometry import Pose2
from specmap_cli.core.labels import neighbours
from specmap_cli.core.progress import Silent
from specmap_cli.core.records import PosedScan
from specmap_cli.grids.gridmap import FREE, OCCUPIED, GridMap
from specmap_cli.grids.keyframes import KeyframeSelector, KeyframeStore
from specmap_cli.grids.map_server import read_grid
from specmap_cli.logs import open_log
from specmap_cli.logs.stream import SweepStream
from specmap_cli.pipelines.build import map_log
from specmap_cli.recognition.localization.localizer import Localizer
from specmap_cli.simulation.room_truth import RoomTruth, read_rooms

SAMPLE = Path(__file__).parent.parent / "sample_logs"
VIEWS_DEG = {"row-1": (180.0, 270.0, 360.0)}  # a floor is seen by one laser, the small by all
TUNED = ("row-1-0", "row-1-1", "row-1-2", "row-2-0", "Freiburg52_scan", "lab_c_scan_furnitures")
REPORTED = ("row-1-10", "row-1-11", "row-1-12", "row-2-10", "row-2-11", "row-4-10")
REPORTED_FLOORS = ("office", "Freiburg79_scan_furnitures")
REAL = {"fr079": "fr079.mcap", "mit_csail": "mit_csail.mcap", "turtlebot4": "turtlebot4_office"}
STANDING_SCANS, STANDING_PLACES = 40, 6
FOREIGN_S, RATE_HZ = 150.0, 4.0


@dataclass(frozen=True, slots=True)
class Known:
    """Shares of scans called known, one a log."""

    own: list[float]
    standing: list[float]
    foreign: list[float]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    sections: dict[str, Callable[[bool], None]] = {
        "tuned": lambda quick: simulated("tuned", TUNED, quick),
        "reported": lambda quick: simulated("reported", REPORTED + REPORTED_FLOORS, quick),
        "real": real,
    }
    parser.add_argument("--only", nargs="+", choices=sorted(sections), default=list(sections))
    parser.add_argument("--quick", action="store_true", help="three small worlds, one real log")
    parser.add_argument("--worlds", nargs="+", help="names of plans, row-COUNT-SEED, office")
    parser.add_argument("--views", nargs="+", type=float, default=[180.0], help="with --worlds")
    arguments = parser.parse_args()
    if arguments.worlds:
        measured("chosen", [(name, view) for name in arguments.worlds for view in arguments.views])
        return
    for name, run in sections.items():
        if name in arguments.only:
            run(arguments.quick)
            print()


def simulated(title: str, names: Sequence[str], quick: bool) -> None:
    chosen = [
        (name, view)
        for number, name in enumerate(names[:3] if quick else names)
        for view in VIEWS_DEG.get(name[:5], ((270.0, 360.0, 180.0)[number % 3],))
    ]
    measured(title, chosen)


def measured(title: str, chosen: Sequence[tuple[str, float]]) -> None:
    """A row for each world and field of view in degrees, and one for all of them."""
    print(f"{title:<26} view | own tour, twice the beams | standing, worst | foreign, worst")
    names, rows = list(dict.fromkeys(name for name, _ in chosen)), []
    for name, view in chosen:
        rows.append(_known(name, view, names))
        print(f"{name:<26} {view:4.0f} | {_text(rows[-1])}", flush=True)
    total = [[x for row in rows for x in part(row)] for part in (_own, _standing, _foreign)]
    print(f"{'all':<26}      | {_text(Known(*total))}")


def _own(row: Known) -> list[float]:
    return row.own


def _standing(row: Known) -> list[float]:
    return row.standing


def _foreign(row: Known) -> list[float]:
    return row.foreign


def _text(row: Known) -> str:
    own = " ".join(f"{x:.3f}" for x in row.own) if len(row.own) < 3 else f"{np.mean(row.own):.3f}"
    foreign = f"{np.mean(row.foreign):.3f} {max(row.foreign):.3f}" if row.foreign else "none"
    return f"{own:<13} | {np.mean(row.standing):.3f} {min(row.standing):.3f} | {foreign}"


def _known(name: str, view: float, names: Iterable[str]) -> Known:
    """How a map of one world takes logs of its own and of all others."""
    world, rooms = world_of(name)
    fresh = localizer_of_tour(tour_of(world, view, 1), rooms, load_config())
    again = tour_of(world, view, 7, spacing_m=2.6, rate_hz=RATE_HZ)
    finer = tour_of(world, view, 8, spacing_m=1.5, rate_hz=RATE_HZ, beams=int(2 * view))
    places = again[:: max(1, len(again) // STANDING_PLACES)]
    return Known(
        [_share(fresh(), tour) for tour in (again, finer)],
        [_share(fresh(), standing(scan, k)) for k, scan in enumerate(places)],
        [
            _share(fresh(), _foreign_tour(other, view))
            for other in names
            if other.partition("_")[0] != name.partition("_")[0]
        ],
    )


def _foreign_tour(name: str, view: float) -> list[PosedScan]:
    return tour_of(world_of(name)[0], view, 5, rate_hz=RATE_HZ, max_duration_s=FOREIGN_S)


def _share(localizer: Localizer, scans: Iterable[PosedScan]) -> float:
    """The share of scans whose filtered label is a submap."""
    return float(np.mean([localizer.update(s).filtered_submap is not None for s in scans]))


def standing(scan: PosedScan, seed: int) -> list[PosedScan]:
    """Scans of a robot that stands where one was taken: noise, and poses that tremble."""
    rng = np.random.default_rng(seed)
    made = []
    for k in range(STANDING_SCANS):
        ranges = scan.planar.ranges + rng.normal(0.0, 0.01, len(scan.planar.ranges))
        stamp_ns = scan.stamp_ns + k * 10**8
        pose = np.array(scan.map_from_base) + rng.normal(0.0, (0.002, 0.002, 0.001))
        made.append(
            replace(
                scan,
                index=k,
                stamp_ns=stamp_ns,
                map_from_base=Pose2(*pose.tolist()),
                planar=replace(scan.planar, stamp_ns=stamp_ns, ranges=ranges),
            )
        )
    return made


def world_of(name: str) -> tuple[GridMap, RoomTruth]:
    """A plan, the sample office, or `row-COUNT-SEED`: rooms in a row."""
    if name.startswith("row-"):
        count, seed = map(int, name.split("-")[1:])
        return row_of_rooms(count, seed)
    if name == "office":
        rooms = read_rooms(SAMPLE / "office_rooms.png", RESOLUTION_M)
        return read_grid(SAMPLE / "office.png", RESOLUTION_M), rooms
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


def real(quick: bool) -> None:
    print("real logs: share known, a row a map, a column a log")
    names = list(REAL)[-1:] if quick else list(REAL)
    built = {name: _real_map(name) for name in names}
    print(f"{'':<12}" + "".join(f"{name:>12}" for name in names))
    for name, (fresh, _) in built.items():
        shares = [_real_share(fresh, scans) for _, scans in built.values()]
        print(f"{name:<12}" + "".join(f"{text:>12}" for text in shares), flush=True)


def _real_share(fresh: Callable[[], Localizer], scans: Iterable[PosedScan]) -> str:
    try:
        return f"{_share(fresh(), scans):.3f}"
    except InputError:
        return "too narrow"


def _real_map(name: str) -> tuple[Callable[[], Localizer], list[PosedScan]]:
    """What makes localizers of the map of a whole log, and its scans as they were registered."""
    config, seen = load_config(), list[PosedScan]()
    selector = KeyframeSelector(config.keyframes)

    def accepts(scan: PosedScan) -> bool:
        seen.append(scan)
        return selector.accepts(scan)

    log_path = data_folder() / "logs" / REAL[name]
    with open_log(log_path, config.log) as log, KeyframeStore() as store:
        stream = SweepStream(log, config.log)
        made = map_log(stream, config, store, Silent(), accepts=accepts)
    adjacency = neighbours(made.classifiers.ids, made.topology.edges)
    submaps = made.topology.submaps
    grids = {i: submap.grid for i, submap in submaps.items()}
    frames = {i: submap.map_from_submap for i, submap in submaps.items()}
    kept = made.labels
    tracks = {i: kept.poses[kept.submaps == i] for i in made.classifiers.ids}
    settings = config.localization
    return lambda: Localizer(made.classifiers, adjacency, grids, settings, frames, tracks), seen


if __name__ == "__main__":
    main()
