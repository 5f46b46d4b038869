"""What a batch costs beside the maps: the constants of docs/scale.md.

python -m benchmarks.batch_costs [--jobs 2000]

Jobs that do nothing go through workers of this machine; their results go into the summaries. One
real job of the sample log is done, and found complete again.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from specmap_cli.batch import cluster, crew
from specmap_cli.batch.batch import sizes_of
from specmap_cli.batch.cluster import Place
from specmap_cli.batch.crew import DaskCrew, Terms
from specmap_cli.batch.dispatch import Finished, Turn, worked_off
from specmap_cli.batch.ledger import Ledger
from specmap_cli.batch.outputs import write_summaries
from specmap_cli.batch.records import Job, JobResult, Step
from specmap_cli.batch.running import failure, run_job

SAMPLE_LOG = Path("sample_logs/office.mcap").absolute()
_STEPS = (Step("build"), Step("report"))


def nothing(turn: Turn, terms: Terms, version: str) -> JobResult:
    """In the place of `crew.on_worker`: no work at all."""
    return failure(turn.job, "log", f"nothing was done by {version}", limits=terms.limits)


def seconds(work: Callable[[], object]) -> float:
    """How long something takes."""
    began = time.perf_counter()
    work()
    return time.perf_counter() - began


def dispatch(count: int) -> tuple[float, Ledger]:
    """Seconds a job between a client, a scheduler and two workers of this machine."""
    jobs = [Job(f"job-{k:06}", (str(SAMPLE_LOG),), _STEPS) for k in range(count)]
    ledger = Ledger(jobs, dict.fromkeys((job.name for job in jobs), 1))
    crew.on_worker = nothing
    with cluster.opened(Place(workers=2)) as client, DaskCrew(client, Terms("")) as workers:
        began = time.perf_counter()
        for happening in worked_off(jobs, workers, 0):
            if isinstance(happening, Finished):
                ledger.heard(happening)
        return (time.perf_counter() - began) / count, ledger


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--jobs", type=int, default=2000)
    count = parser.parse_args().jobs
    handed_s, ledger = dispatch(count)
    print(f"handing a job out and hearing of it       {1e3 * handed_s:8.2f} ms")
    with tempfile.TemporaryDirectory() as name:
        out = Path(name)
        summed_s = seconds(lambda: write_summaries(name, ledger))
        size = sum(path.stat().st_size for path in out.iterdir())
        print(f"summaries, a job                          {1e3 * summed_s / count:8.2f} ms")
        print(f"summaries, a job                          {size / count / 1e3:8.2f} kB")
        asked_s = seconds(lambda: sizes_of(ledger.jobs))
        print(f"asking for the size of a log, on a disk   {1e3 * asked_s / count:8.2f} ms")
        job = Job("office", (str(SAMPLE_LOG),), _STEPS)
        done_s = seconds(lambda: run_job(job, name))
        found_s = seconds(lambda: run_job(job, name))
        size = sum(path.stat().st_size for path in (out / "office").rglob("*") if path.is_file())
        files = sum(path.is_file() for path in (out / "office").rglob("*"))
        print(f"a map of the sample log with its report   {done_s:8.1f} s")
        print(f"finding it complete                       {1e3 * found_s:8.2f} ms")
        print(f"its result                                {size / 1e6:8.2f} MB, {files} files")
    started_s = seconds(
        lambda: subprocess.run([sys.executable, "-m", "specmap_cli", "config"], capture_output=True)
    )
    print(f"the start of a step                       {started_s:8.2f} s")


if __name__ == "__main__":
    main()
