"""`make test`, as a person or a CI runs it, with all that it needs installed before."""

from __future__ import annotations

import re
import subprocess
import time

from benchmarks.scoreboard.bench import Bench
from benchmarks.scoreboard.digest import ROOT
from benchmarks.scoreboard.rows import Figures, Row

_PASSED = re.compile(r"(\d+) passed")

ROWS = (
    Row("seconds", "`make test`", 240, None, "less", ".0f", "s"),
    Row("tests", "tests that passed", better="none", form=",.0f"),
)


def measure(_: Bench) -> Figures:
    """Run it once; raises RuntimeError when it fails."""
    start = time.perf_counter()
    done = subprocess.run(["make", "test"], cwd=ROOT, capture_output=True, text=True)
    seconds = time.perf_counter() - start
    lines = done.stdout.strip().splitlines()
    print("\n".join(lines[-3:]))
    found = _PASSED.search(done.stdout)
    if done.returncode or found is None:
        last = (done.stderr.strip().splitlines() or lines or ["no word"])[-1]
        raise RuntimeError(f"make test ended with {done.returncode}: {last}")
    return {"seconds": seconds, "tests": int(found[1])}
