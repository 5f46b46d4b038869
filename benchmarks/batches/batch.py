"""Batches: nothing lost, nothing half-written, nothing done twice, though it is killed; and speed.

Makes short logs (logs.py), one in ten of them damaged or in want of memory, and does them on two
workers. Then every fourth log on one worker and on two, for the wall times. Then all of them again
in a batch that is killed time and again at random, and started again until it is whole.
"""

from __future__ import annotations

import hashlib
import json
import random
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

from benchmarks.batches.logs import make_logs
from benchmarks.scoreboard.bench import Bench
from benchmarks.scoreboard.rows import Figures, Row

MEMORY_MB = 420  # what the short logs need, and not what the hungry ones need, even twice
LOGS, KILLS, WORKERS = 40, 8, 2
STEPS = ("--step", "build", "--step", "report")
_PROGRAM = (sys.executable, "-m", "specmap_cli", "batch")
_NOT_OF_THE_RESULT = {"run.json"}  # times and memory of a map

ROWS = (
    Row("wrong", "short logs of 40 that end wrongly", 0, 0, "less", ".0f"),
    Row("two_workers", "wall time of two workers, times one", 0.6, None, "less", ".2f"),
    Row(
        "killed_wrong",
        "of the 40 after 8 kills: results that are wrong or differ",
        0,
        0,
        "less",
        ".0f",
    ),
    Row("twice", "jobs that were done twice", 0, 0, "less", ".0f"),
)


def measure(bench: Bench) -> Figures:
    """The same logs in peace, by one worker and by two, and by a batch that is killed at times."""
    with bench.scratch("batches") as folder:
        logs, out, again = folder / "logs", folder / "maps", folder / "again"
        bad = make_logs(logs, LOGS)
        wall = whole(logs, out, "--workers", str(WORKERS))
        expected, wrong = results(out), judge(out, bad, LOGS)
        some = sorted(logs.iterdir())[::4]
        one, two = (whole(some, folder / f"by-{n}", "--workers", str(n)) for n in (1, WORKERS))
        tormented(logs, again, wall / (2 * KILLS))
        after, found = judge(again, bad, LOGS), results(again)
        after += [f"differs: {name}" for name in expected if found.get(name) != expected[name]]
        again_done = twice(again)
    print(f"{LOGS} logs in {wall:.0f} s; one worker {one:.0f} s, two {two:.0f} s")
    print("\n".join([*wrong, *after, *again_done]))
    return {
        "wrong": len(wrong),
        "two_workers": two / one,
        "killed_wrong": len(after),
        "twice": len(again_done),
    }


def batch(logs: list[Path] | Path, out: str | Path, *options: str) -> subprocess.Popen[bytes]:
    """A batch that was started."""
    given = [str(log) for log in (logs if isinstance(logs, list) else [logs])]
    command = [*_PROGRAM, *given, "-o", str(out), *STEPS, "--memory-limit", str(MEMORY_MB)]
    return subprocess.Popen(
        [*command, *options, "--quiet"], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
    )


def whole(logs: list[Path] | Path, out: str | Path, *options: str) -> float:
    """Run a batch to its end; seconds that it took."""
    began = time.monotonic()
    process = batch(logs, out, *options)
    _, said = process.communicate()
    if process.returncode not in (0, 5):
        raise RuntimeError(f"batch ended with {process.returncode}: {said.decode()}")
    return time.monotonic() - began


def results(out: Path) -> dict[str, tuple[str, str]]:
    """Kind of failure, or a hash of the map but for its times, of each job; with its reason."""
    found = {}
    for record in sorted(out.glob("*/job.json")):
        told = json.loads(record.read_text(encoding="utf-8"))
        state = told["kind"] or _hash(record.parent / "map")
        found[told["name"]] = (state, told["reason"] or "")
    return found


def judge(out: Path, bad: dict[str, str], count: int) -> list[str]:
    """What is wrong with the results of a batch."""
    found, wrong = results(out), []
    if len(found) != count:
        wrong.append(f"{len(found)} results of {count}")
    for name, (state, reason) in found.items():
        kind = state if reason else None
        if kind != bad.get(name):
            wrong.append(f"{name}: {kind or 'done'}, expected {bad.get(name, 'done')}: {reason}")
    left = sorted(path.name for path in out.iterdir() if ".partial" in path.name)
    return [*wrong, *(f"left behind: {name}" for name in left)]


def tormented(logs: Path, out: Path, pace_s: float, seed: int = 1) -> None:
    """Run a batch that is killed `KILLS` times, with its workers, and started again."""
    chance = random.Random(seed)
    for _ in range(KILLS):
        process = batch(logs, out, "--workers", str(WORKERS))
        try:
            process.wait(chance.uniform(0.4, 1.6) * pace_s)
        except subprocess.TimeoutExpired:
            process.kill()  # its steps must end by themselves
            process.wait()
        else:
            raise RuntimeError("the batch ended before it was killed often enough")
    whole(logs, out, "--workers", str(WORKERS))


def twice(out: Path) -> list[str]:
    """Jobs that were finished more than once without being interrupted: there must be none."""
    done: Counter[str] = Counter()
    for line in (out / "events.jsonl").read_text(encoding="utf-8").splitlines():
        event = json.loads(line)
        if event["event"] in ("done", "failed"):
            done[event["job"]] += 1
    return sorted(name for name, times in done.items() if times > 1)


def _hash(folder: Path) -> str:
    found = hashlib.sha256()
    for path in sorted(folder.rglob("*")):
        if path.is_file() and path.name not in _NOT_OF_THE_RESULT:
            found.update(f"{path.relative_to(folder)}\n".encode() + path.read_bytes())
    return found.hexdigest()
