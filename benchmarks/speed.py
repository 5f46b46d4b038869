"""`specmap build` against `kiss_icp_pipeline` on the same scans, whole processes, in one run.

python -m benchmarks.speed [--repeats 2]

KISS-ICP gets the scans as PointCloud2, with the same range and voxel size. Absolute times wander on
shared machines, so that the figures to read are the ratio of the fastest runs, the peak memory, and
the peak memory on the same log played twice.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.data import log_file
from specmap_cli.core.geometry import Pose2
from specmap_cli.core.settings import Config
from specmap_cli.logs import open_log
from specmap_cli.logs.stream import SweepStream
from specmap_cli.logs.writer import LogWriter

_SAMPLED_EVERY_S = 0.05
SCRIPTS = Path(sys.executable).parent


class Cost(NamedTuple):
    """What a command took: wall and processor seconds, and megabytes at the peak.

    `memory_mb` is the resident memory of its largest process; `together_mb` the memory of all its
    processes at once, pages they share counted once.
    """

    wall_s: float
    processor_s: float
    memory_mb: float
    together_mb: float


def measure(command: list[str], folder: Path, **settings: str) -> Cost:
    """Run a process to its end; it must succeed."""
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", **settings}
    start = time.perf_counter()
    with open(os.devnull, "wb") as null:
        process = subprocess.Popen(
            command, cwd=folder, env=environment, stdout=null, stderr=subprocess.STDOUT
        )
        ended, together = 0, 0.0
        while not ended:
            together = max(together, proportional_mb(process.pid))
            time.sleep(_SAMPLED_EVERY_S)
            ended, status, usage = os.wait4(process.pid, os.WNOHANG)
    seconds = time.perf_counter() - start
    if status != 0:
        raise SystemExit(f"failed with status {status}: {' '.join(command)}")
    return Cost(seconds, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024.0, together)


def proportional_mb(pid: int) -> float:
    """Memory of a process and its children now, pages they share counted once."""
    total = 0.0
    try:
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text(encoding="ascii").split()
        for process in (str(pid), *children):
            lines = Path(f"/proc/{process}/smaps_rollup").read_text(encoding="ascii").splitlines()
            total += sum(int(line.split()[1]) for line in lines if line.startswith("Pss:"))
    except (FileNotFoundError, ProcessLookupError):  # one has just ended
        return 0.0
    return total / 1024.0


def write_clouds(log: Path, out: Path, max_range: float) -> int:
    """The returns of every planar scan as PointCloud2 messages."""
    count = 0
    with open_log([log]) as source, LogWriter(out) as writer:
        for sweep in SweepStream(source, Config().log):
            hits = sweep.planar.hits(max_range)
            points = np.column_stack([hits, np.zeros(len(hits))]).astype(np.float32)
            writer.cloud("/points", "laser", sweep.stamp_ns, points)
            count += 1
    return count


def write_twice(log: Path, out: Path) -> None:
    """The same log played twice, the stamps of the second time shifted behind the first."""
    with open_log([log]) as source, LogWriter(out) as writer:
        start = source.contents.start_ns
        mounting = Pose2.from_matrix(SweepStream(source, Config().log).selection.base_from_laser)
        writer.static_transform(
            "base_link",
            "laser",
            (mounting.x, mounting.y, 0.0),
            (0.0, 0.0, float(np.sin(mounting.theta / 2)), float(np.cos(mounting.theta / 2))),
            0,
        )
        shift, last = 0, 0
        for _ in range(2):
            for sweep in SweepStream(source, Config().log):
                stamp, planar = sweep.stamp_ns + shift, sweep.planar
                writer.scan(
                    "/scan",
                    "laser",
                    stamp,
                    float(planar.bearings[0]),
                    float(planar.bearings[1] - planar.bearings[0]),
                    planar.ranges,
                    range_max=planar.range_max,
                )
                if sweep.odom_from_base is not None:
                    writer.odometry("/odom", "odom", "base_link", stamp, sweep.odom_from_base)
                last = sweep.stamp_ns
            shift = last + 10**9 - start


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=2)
    repeats = parser.parse_args().repeats
    log = log_file("fr079")
    registration = Config().registration
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        clouds, twice = folder / "points.mcap", folder / "twice.mcap"
        scans = write_clouds(log, clouds, registration.max_range_m)
        write_twice(log, twice)
        same = {
            "kiss_icp_out_dir": str(folder / "kiss"),
            "kiss_icp_data": json.dumps(
                {"max_range": registration.max_range_m, "min_range": 0.0, "deskew": False}
            ),
            "kiss_icp_mapping": json.dumps({"voxel_size": registration.voxel_m}),
        }
        build = [str(SCRIPTS / "specmap"), "build", str(log.resolve()), "--overwrite", "-o"]
        kiss = [str(SCRIPTS / "kiss_icp_pipeline"), str(clouds), "--dataloader", "rosbag"]
        kiss += ["--topic", "/points"]
        ours = [measure([*build, str(folder / "map")], folder) for _ in range(repeats)]
        theirs = [measure(kiss, folder, **same) for _ in range(repeats)]
        double = measure(
            [str(SCRIPTS / "specmap"), "build", str(twice), "-o", str(folder / "map2")], folder
        )
    mine, other = min(ours), min(theirs)
    print(f"fr079, {scans:,} scans, whole process, fastest of {repeats}")
    print(f"{'':20} {'wall s':>8} {'cpu s':>8} {'peak MB':>8} {'together':>8}")
    for name, cost in (
        ("specmap build", mine),
        ("kiss_icp_pipeline", other),
        ("build, log twice", double),
    ):
        print(
            f"{name:20} {cost.wall_s:8.1f} {cost.processor_s:8.1f} "
            f"{cost.memory_mb:8.0f} {cost.together_mb:8.0f}"
        )
    print(
        f"build / KISS-ICP: wall {mine.wall_s / other.wall_s:.2f}, "
        f"cpu {mine.processor_s / other.processor_s:.2f}; "
        f"memory twice / once {double.together_mb / mine.together_mb:.2f}"
    )


if __name__ == "__main__":
    main()
