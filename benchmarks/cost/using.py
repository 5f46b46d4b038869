"""What the other commands cost: a floor divided, scans localised, the start, and the size.

A floor of the COLD database at 0.02 m goes through `specmap segment`. Scans a second are those of
`specmap localize` with `--metric` on a simulated laser of 1,080 beams over 270 degrees, in
processor time, without the seconds that a log of a single scan takes: these are the start. The size
of an installation is that of the files of all packages that the program needs.
"""

from __future__ import annotations

import subprocess
import sys
import time
from importlib import metadata
from pathlib import Path
from statistics import median

from packaging.requirements import Requirement

from benchmarks.cost.pairs import told
from benchmarks.cost.processes import SPECMAP, Cost
from benchmarks.cost.processes import measure as measured
from benchmarks.data import data_folder, plan
from benchmarks.scoreboard.bench import Bench, build
from benchmarks.scoreboard.rows import Figure, Figures, Row
from specmap_cli.pipelines.simulate import simulate
from specmap_cli.simulation.simulator import SimulationOptions

FLOOR = "freiburg_seq2"
REPEATS, STARTS = 2, 5
MAP_S, LOG_S, RATE_HZ = 100.0, 60.0, 10.0
PROJECT = "specmap-cli"

ROWS = (
    Row("floor", "`segment` of a floor at 0.02 m", 3.0, 2.0, "less", ".1f", "s"),
    Row("floor_mb", "the same: memory", 400, 300, "less", ".0f", "MB"),
    Row("localized", "scans a second with filter and poses, 1,080 beams", 200, 400, form=".0f"),
    Row("first_label", "`localize`, until the first label", 0.5, 0.3, "less", ".2f", "s"),
    Row("help", "`specmap --help`", 0.3, 0.2, "less", ".2f", "s"),
    Row("import", "`import specmap_cli`", 0.1, 0.05, "less", ".3f", "s"),
    Row("installed", "size of an installation", 500, 300, "less", ".0f", "MB"),
)


def measure(bench: Bench) -> Figures:
    """One command after the other."""
    with bench.scratch("using") as folder:
        floor = [divided(folder) for _ in range(REPEATS)]
        rate, start = localizing(folder)
    return {
        "floor": Figure.of([cost.wall_s for cost in floor]),
        "floor_mb": Figure.of([cost.memory_mb for cost in floor]),
        "localized": rate,
        "first_label": start,
        "help": Figure.of([seconds([SPECMAP, "--help"]) for _ in range(STARTS)]),
        "import": Figure.of(
            [
                seconds([sys.executable, "-c", "import specmap_cli"])
                - seconds([sys.executable, "-c", "pass"])
                for _ in range(STARTS)
            ]
        ),
        "installed": installed_mb(),
    }


def divided(folder: Path) -> Cost:
    """One floor."""
    map_ = data_folder() / "cold" / FLOOR / "map.yaml"
    cost = measured([SPECMAP, "segment", str(map_), "-o", "rooms", "--overwrite", "-q"], folder)
    print(f"{FLOOR}: {told(cost)}", flush=True)
    return cost


def localizing(folder: Path) -> tuple[float, Figure]:
    """Scans a second of processor time, and wall seconds until the first label."""
    record(folder / "map.mcap", MAP_S, 1)
    scans = record(folder / "log.mcap", LOG_S, 2)
    record(folder / "one.mcap", 0.5 / RATE_HZ, 2)
    build(folder / "map.mcap", folder / "map")
    whole, *starts = (
        measured([SPECMAP, "localize", log, "--map", "map", "--metric", "-q"], folder)
        for log in ("log.mcap", *["one.mcap"] * STARTS)
    )
    print(f"localize: {scans} scans {told(whole)}; a scan", *map(told, starts), flush=True)
    started_s = median(one.processor_s for one in starts)
    rate = (scans - 1) / (whole.processor_s - started_s)
    return rate, Figure.of([one.wall_s for one in starts])


def record(out: Path, longest_s: float, seed: int) -> int:
    """Write a tour of the sample office; the number of its scans."""
    options = SimulationOptions(
        field_of_view_deg=270.0,
        beams=1080,
        rate_hz=RATE_HZ,
        max_duration_s=longest_s,
        seed=seed,
    )
    return simulate(plan("office"), options, out).scans


def seconds(command: list[str]) -> float:
    """Wall seconds of a short command."""
    start = time.perf_counter()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return time.perf_counter() - start


def installed_mb() -> float:
    """Megabytes of the program and of all that it needs, but for Python itself."""
    waiting, known, total = [PROJECT], set[str](), 0
    while waiting:
        name = waiting.pop().lower().replace("_", "-")
        if name in known:
            continue
        known.add(name)
        package = metadata.distribution(name)
        files = [Path(str(file.locate())) for file in package.files or ()]
        total += sum(path.stat().st_size for path in files if path.is_file())
        needed = [Requirement(line) for line in package.requires or ()]
        waiting += [
            one.name for one in needed if not one.marker or one.marker.evaluate({"extra": ""})
        ]
    return total / 1e6
