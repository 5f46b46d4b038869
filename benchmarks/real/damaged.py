"""Every damaged input of the data folder: exit code, peak memory and what is said.

Logs go to `specmap info` and `specmap build`, pictures to `specmap segment`, map directories to
`specmap localize --metric` with scans of the sample log's laser. It is wrong when the exit code is
1, an error is longer than a line, or memory is above 600 MB. `beams.mcap` is a row of the costs.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from benchmarks.data import data_folder
from benchmarks.scoreboard.bench import Bench
from benchmarks.scoreboard.rows import Figure, Figures, Row

MOST_MB = 600.0
NESTED = ("multi", "bombs", "third")
TIMED = ("beams.mcap",)
_SPECMAP = [sys.executable, "-m", "specmap_cli"]

ROWS = (
    Row("wrong", "commands on damaged inputs that end wrongly", 0, 0, "less", ".0f"),
    Row("memory", "the largest memory of these", 600, 400, "less", ".0f", "MB"),
)


def commands(path: Path, out: Path) -> Iterator[list[str]]:
    """What a user would do with the input."""
    if path.name.startswith("map-"):
        scans = ["localize", "sample_logs/office_again.mcap", "--map", str(path), "--metric"]
        yield [*scans, "-o", str(out / "labels.csv"), "--plot", str(out / "plot.png")]
    elif path.suffix == ".png":
        yield ["segment", str(path), "--resolution", "0.05", "-o", str(out / "rooms")]
    else:
        yield ["info", str(path)]
        yield ["build", str(path), "-o", str(out / "map")]


def run(arguments: list[str]) -> tuple[int, float, list[str]]:
    """Exit code, megabytes at the peak, and the lines on stderr."""
    with tempfile.TemporaryFile() as errors, open(os.devnull, "wb") as null:
        process = subprocess.Popen([*_SPECMAP, *arguments], stdout=null, stderr=errors)
        _, status, usage = os.wait4(process.pid, 0)
        errors.seek(0)
        said = errors.read().decode("utf-8", "replace").splitlines()
    process.returncode = os.waitstatus_to_exitcode(status)
    return process.returncode, usage.ru_maxrss / 1024.0, said


def measure(_: Bench) -> Figures:
    """Try every input."""
    folder = data_folder() / "damaged"
    inputs = [path for path in sorted(folder.iterdir()) if path.name not in NESTED]
    inputs += [path for name in NESTED for path in sorted((folder / name).iterdir())]
    wrong, most, tried = 0, 0.0, 0
    for path in inputs:
        if path.name.startswith("README") or path.name in TIMED:
            continue
        with tempfile.TemporaryDirectory() as name:
            for arguments in commands(path, Path(name)):
                code, peak_mb, said = run(arguments)
                errors = [line for line in said if line.startswith("specmap: error:")]
                bad = code not in (0, 2, 3, 4) or peak_mb > MOST_MB or len(errors) > 1
                bad |= bool(code) != bool(errors) or any("Traceback" in line for line in said)
                wrong, most, tried = wrong + bad, max(most, peak_mb), tried + 1
                last = said[-1].replace(str(folder), "") if said else ""
                figures = f"{code} {peak_mb:5.0f} MB{' WRONG' if bad else ''}"
                print(f"{path.name:28} {arguments[0]:9} {figures} {last:.110}", flush=True)
    return {"wrong": Figure(wrong, note=f"of {tried}"), "memory": most}
