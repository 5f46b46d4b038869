"""Batches: nothing lost, nothing half-written, nothing done twice, whoever is killed; and speed.

python -m benchmarks.batch [--logs 200] [--kills 20] [--scheduler] [--bucket] [--work DIR]

Makes short logs (see `benchmarks.batch_logs`), one in ten of them damaged or in want of memory, and
does them on two workers. Then every fifth log on one worker and on two, for the wall times. Then
all of them again while somebody is killed at random, and started again until it is whole: the
client, a worker, and with --scheduler the scheduler, which then is in a process of its own as the
workers are. --bucket does them once more with results in a bucket of moto's server. Exit code 1
when anything is not as it must be. --work keeps logs and results. Times are worth something only
where two processors are free.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import psutil

from benchmarks.batch_crew import WORKERS, Crew, bucket, fetched
from benchmarks.batch_logs import make_logs

MEMORY_MB = 420  # what the short logs need, and not what the hungry ones need, even twice
MOST_SHARE = 0.6  # of one worker's wall time
STEPS = ("--step", "build", "--step", "report")
_PROGRAM = (sys.executable, "-m", "specmap_cli", "batch")
_NOT_OF_THE_RESULT = {"run.json"}  # times and memory of a map


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
        raise SystemExit(f"batch ended with {process.returncode}: {said.decode()}")
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


def tormented(
    logs: Path, out: Path, kills: int, pace_s: float, crew: Crew | None, seed: int = 1
) -> Counter[str]:
    """Run a batch, killing somebody now and then; whoever was killed starts again."""
    chance, killed = random.Random(seed), Counter[str]()
    victims = ["client", "worker", *(["scheduler"] if crew else [])]
    where = ("--scheduler", crew.address) if crew else ("--workers", str(WORKERS))
    process = None
    while process is None or process.returncode not in (0, 5):
        if crew is not None:
            crew.keep()
        process = batch(logs, out, *where, "--retries", "50")
        while process.poll() is None and sum(killed.values()) < kills:
            until = time.monotonic() + chance.uniform(0.4, 1.6) * pace_s
            while process.poll() is None and time.monotonic() < until:
                time.sleep(0.2)
            victim = victims[sum(killed.values()) % len(victims)]
            if process.poll() is None and _killed(victim, process, crew, chance):
                killed[victim] += 1
            if crew is not None:
                crew.keep()
        while process.poll() is None:  # nobody is killed any more, but what died stands up
            time.sleep(0.5)
            if crew is not None:
                crew.keep()
        if process.returncode not in (0, 4, 5, -signal.SIGKILL):
            raise SystemExit(f"batch ended with {process.returncode}: {_said(process)}")
    return killed


def twice(out: Path) -> list[str]:
    """Jobs that were finished more than once without being interrupted: there must be none."""
    done: Counter[str] = Counter()
    for line in (out / "events.jsonl").read_text(encoding="utf-8").splitlines():
        event = json.loads(line)
        if event["event"] in ("done", "failed"):
            done[event["job"]] += 1
    return sorted(name for name, times in done.items() if times > 1)


def _killed(
    victim: str, process: subprocess.Popen[bytes], crew: Crew | None, chance: random.Random
) -> bool:
    if victim == "client":
        process.kill()  # its workers and their steps must end by themselves
        process.wait()
        return True
    if crew is not None:
        return crew.kill(victim, chance)
    children = psutil.Process(process.pid).children()
    workers = [child for child in children if "spawn_main" in " ".join(child.cmdline())]
    if not workers:
        return False
    chance.choice(workers).kill()
    return True


def _hash(folder: Path) -> str:
    found = hashlib.sha256()
    for path in sorted(folder.rglob("*")):
        if path.is_file() and path.name not in _NOT_OF_THE_RESULT:
            found.update(f"{path.relative_to(folder)}\n".encode() + path.read_bytes())
    return found.hexdigest()


def _said(process: subprocess.Popen[bytes]) -> str:
    return "" if process.stderr is None else process.stderr.read().decode()


class Report:
    """Prints figures, and remembers whether something was wrong."""

    def __init__(self) -> None:
        self.wrong = 0

    def tell(self, what: str, figures: str, wrong: list[str]) -> None:
        self.wrong += len(wrong)
        print(f"{what:30} {figures}{'  WRONG' if wrong else ''}", flush=True)
        for line in wrong[:20]:
            print(f"    {line}")


def run(folder: Path, count: int, kills: int, *, scheduler: bool, in_bucket: bool) -> int:
    report, logs, out = Report(), folder / "logs", folder / "maps"
    bad = make_logs(logs, count)
    wall = whole(logs, out, "--workers", str(WORKERS))
    expected = results(out)
    failed = sum(bool(reason) for _, reason in expected.values())
    figures = f"{len(expected) - failed} maps, {failed} reasons, {wall:.0f} s"
    report.tell(f"{count} logs, {WORKERS} workers", figures, judge(out, bad, count))
    _compare_workers(report, sorted(logs.iterdir())[::5], folder)
    pace_s = wall / max(1, kills)
    modes = [
        (None, "killed"),
        *([(Crew(folder), "scheduler elsewhere, killed")] if scheduler else []),
    ]
    for crew, what in modes:
        if not kills:
            break
        again = folder / f"again-{'far' if crew else 'here'}"
        try:
            killed = tormented(logs, again, kills, pace_s, crew)
        finally:
            if crew is not None:
                crew.close()
        wrong = judge(again, bad, count) + [f"done twice: {name}" for name in twice(again)]
        wrong += [
            f"differs: {name}" for name in expected if results(again).get(name) != expected[name]
        ]
        report.tell(what, ", ".join(f"{name} {killed[name]}" for name in sorted(killed)), wrong)
    if in_bucket:
        with bucket() as url:
            wall = whole(logs, url, "--workers", str(WORKERS))
            found = fetched(url, folder / "bucket")
        wrong = judge(found, bad, count)
        wrong += [
            f"differs: {name}" for name in expected if results(found).get(name) != expected[name]
        ]
        report.tell("results in a bucket", f"{wall:.0f} s", wrong)
    return report.wrong


def _compare_workers(report: Report, part: list[Path], folder: Path) -> None:
    """Wall times of one worker and of two, in the same run."""
    one = whole(part, folder / "one", "--workers", "1")
    two = whole(part, folder / "two", "--workers", str(WORKERS))
    share = two / one
    wrong = [] if share <= MOST_SHARE else [f"more than {MOST_SHARE} of one worker's time"]
    figures = f"1 worker {one:.0f} s, {WORKERS} workers {two:.0f} s: {share:.2f}"
    report.tell(f"{len(part)} of the logs", figures, wrong)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--logs", type=int, default=200)
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--scheduler", action="store_true")
    parser.add_argument("--bucket", action="store_true")
    parser.add_argument("--work", type=Path, help="a new directory, which is kept")
    arguments = parser.parse_args()
    folder = arguments.work or Path(tempfile.mkdtemp(prefix="specmap-batch-"))
    try:
        wrong = run(
            folder.absolute(),
            arguments.logs,
            arguments.kills,
            scheduler=arguments.scheduler,
            in_bucket=arguments.bucket,
        )
    finally:
        if arguments.work is None:
            shutil.rmtree(folder, ignore_errors=True)
    raise SystemExit(wrong > 0)


if __name__ == "__main__":
    main()
