"""What grows with a recording: its length, its area, its beams.

fr079 played four times over; 1.5 km of corridors in a building of 140 by 100 m; corridors around
260 by 220 m; `ual`, 530 m outdoors; a hostile log of 25 kB with scans of 99,999 beams. Times are
per scan and against one play of fr079 in the same run, the median of three. Memory is that of all
processes together.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from statistics import median

from benchmarks.cost.pairs import told
from benchmarks.cost.processes import SPECMAP, Cost
from benchmarks.cost.processes import measure as measured
from benchmarks.data import data_folder, recording
from benchmarks.making.recordings import simulated
from benchmarks.making.replays import write_plays
from benchmarks.making.worlds import Place, corridors, drive_along
from benchmarks.scoreboard.bench import Bench, build
from benchmarks.scoreboard.rows import Figure, Figures, Row
from specmap_cli.simulation.simulator import OdometryErrors

PLAYS, REPEATS = 4, 3
LIMIT_S = 30.0  # of a log that should take 10 s
TWO_PERCENT = OdometryErrors(distance_scale=0.02, turn_scale=0.02)
ROUND = (
    (0, 0), (2, 0), (2, 2), (0, 2), (0, 0), (1, 0), (1, 1), (2, 1), (2, 2), (1, 2), (1, 1), (0, 1),
    (0, 2), (1, 2), (1, 1), (2, 1), (2, 0), (1, 0), (1, 1), (0, 1), (0, 0),
)  # fmt: skip
SHORT = ((0, 0), (2, 0), (2, 2), (0, 2), (0, 0), (1, 0), (1, 1), (2, 1))

ROWS = (
    Row("plays_cpu", "four plays: processor time, times one", 3.6, 3.6, "less", ".2f"),
    Row("plays_largest", "four plays: largest process, times one", 1.1, 1.1, "less", ".2f"),
    Row("plays_together", "four plays: all processes, times one", 1.15, 1.15, "less", ".2f"),
    Row(
        "corridors",
        "1.5 km of corridors: processor time a scan, times fr079",
        1.3,
        1.1,
        "less",
        ".2f",
    ),
    Row("corridors_mb", "the same: memory", 300, 300, "less", ".0f", "MB"),
    Row("large_mb", "260 x 220 m, simulated: memory", 500, 500, "less", ".0f", "MB"),
    Row("ual", "ual: wall time a scan, times fr079", 2.0, 1.5, "less", ".1f"),
    Row("ual_mb", "ual: memory", 400, 400, "less", ".0f", "MB"),
    Row("beams", "61 scans of 99,999 beams, wall time", 10, 10, "less", ".0f", "s"),
    Row("beams_mb", "the same: memory", 500, 500, "less", ".0f", "MB"),
)


def measure(bench: Bench) -> Figures:
    """One recording after the other."""
    with bench.scratch("growth") as folder:
        one, four = folder / "one.mcap", folder / "four.mcap"
        write_plays(recording("fr079"), one, 1)
        write_plays(recording("fr079"), four, PLAYS)
        long_building(folder / "long.mcap", (0.0, 60.0, 140.0), (0.0, 50.0, 100.0), ROUND, 1.0)
        firsts, longs = list[Cost](), list[Cost]()
        for _ in range(REPEATS):  # in turn: the machine is not as quick all the time
            firsts.append(_built("fr079", one, folder))
            scans = _scans(folder)
            longs.append(_built("1.5 km of corridors", folder / "long.mcap", folder))
            long_scans = _scans(folder)
        first_s = median(cost.processor_s for cost in firsts)
        plays = _built("four plays", four, folder)
        long_building(folder / "large.mcap", (0.0, 120.0, 260.0), (0.0, 100.0, 220.0), SHORT, 2.0)
        large = _built("260 x 220 m", folder / "large.mcap", folder)
        ual = _built("ual", recording("ual"), folder)
        ual_scans = _scans(folder)
        bench.adopt("ual", folder / "map")
        beams = hostile(data_folder() / "damaged" / "third" / "beams.mcap", folder)
    note = "stopped there" if beams.wall_s > LIMIT_S else ""
    return {
        "plays_cpu": plays.processor_s / first_s,
        "plays_largest": plays.memory_mb / median(cost.memory_mb for cost in firsts),
        "plays_together": plays.together_mb / median(cost.together_mb for cost in firsts),
        "corridors": Figure.of(
            [
                long.processor_s / long_scans / (first.processor_s / scans)
                for long, first in zip(longs, firsts, strict=True)
            ]
        ),
        "corridors_mb": Figure.of([cost.together_mb for cost in longs]),
        "large_mb": large.together_mb,
        "ual": ual.wall_s / ual_scans / (median(cost.wall_s for cost in firsts) / scans),
        "ual_mb": ual.together_mb,
        "beams": Figure(beams.wall_s, note=note),
        "beams_mb": Figure(beams.together_mb, note=note),
    }


def _built(name: str, log: Path, folder: Path) -> Cost:
    cost = build(log, folder / "map")
    print(f"{name}: {told(cost)}", flush=True)
    return cost


def _scans(folder: Path) -> int:
    """How many scans the last map was built of."""
    run = json.loads((folder / "map" / "run.json").read_text(encoding="utf-8"))
    return int(run["counts"]["scans"])


def long_building(
    path: Path,
    columns: Sequence[float],
    rows: Sequence[float],
    places: Sequence[tuple[int, int]],
    speed_mps: float,
) -> None:
    """A drive through corridors with niches at so many metres, by their crossings."""
    ways: list[tuple[Place, Place]] = [((columns[0], y), (columns[-1], y)) for y in rows]
    ways += [((x, rows[0]), (x, rows[-1])) for x in columns]
    tour = drive_along(
        corridors(ways, 2.4, 5.0),
        [(columns[x], rows[y]) for x, y in places],
        range_max_m=20.0,
        rate_hz=5.0,
        speed_mps=speed_mps,
        errors=TWO_PERCENT,
        field_of_view_deg=180.0,
        beams=181,
    )
    simulated(tour, iter, path)


def hostile(log: Path, folder: Path) -> Cost:
    """What a log costs that is made to cost much, until the limit; it may be refused."""
    command = [SPECMAP, "build", str(log), "-o", str(folder / "hostile"), "-q"]
    cost = measured(command, folder, limit_s=LIMIT_S)
    print(f"{log.name}: {told(cost)}", flush=True)
    return cost
