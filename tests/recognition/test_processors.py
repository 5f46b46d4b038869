"""The same bytes on every processor: a build under several kernels of the linear algebra."""

from __future__ import annotations

import os
import subprocess
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from specmap_cli.grids.gridmap import GridMap
from specmap_cli.pipelines.simulate import simulate
from specmap_cli.simulation.simulator import SimulationOptions

pytest.importorskip("threadpoolctl", reason="tells which kernel is in use")

KERNELS = ("Haswell", "Prescott")  # sums in four lanes with fused products, and in two without
FIXED = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}

# With an older NumPy the last digits of poses depend on the kernel; nothing that is decided does.
OLDER_NUMPY = np.lib.NumpyVersion(np.__version__) < "2.4.0"
TRAJECTORIES = {"trajectory.g2o", "trajectory.tum"}

KERNEL_IN_USE = """
import threadpoolctl, numpy, scipy.linalg
pools = threadpoolctl.threadpool_info()
print(sorted({pool["architecture"] for pool in pools if pool["internal_api"] == "openblas"}))
"""


def run_under(kernel: str, *arguments: str) -> str:
    """What Python prints when the linear algebra uses this kernel."""
    environment = {**os.environ, **FIXED, "OPENBLAS_CORETYPE": kernel}
    command = [sys.executable, *arguments]
    return subprocess.run(
        command, env=environment, check=True, capture_output=True, text=True
    ).stdout


@cache
def kernels_in_use() -> tuple[str, ...]:
    """The kernels that were loaded when each of `KERNELS` was asked for."""
    return tuple(run_under(kernel, "-c", KERNEL_IN_USE) for kernel in KERNELS)


def test_a_build_gives_the_same_bytes_under_every_kernel(flat: GridMap, tmp_path: Path) -> None:
    if len(set(kernels_in_use())) < len(KERNELS):
        pytest.skip("this processor or this OpenBLAS does not let its kernel be chosen")
    log, written = tmp_path / "flat.mcap", []
    simulate(flat, SimulationOptions(field_of_view_deg=360, beams=120, rate_hz=3, seed=3), log)
    for kernel in KERNELS:
        out = tmp_path / kernel
        settings = ("recognition.rounds=8", "localization.augmentation=40")
        sets = [part for setting in settings for part in ("--set", setting)]
        run_under(kernel, "-m", "specmap_cli", "build", str(log), "-o", str(out), "-q", *sets)
        files = sorted(path for path in out.rglob("*") if path.is_file())
        # seconds are of the clock, and the rest of run.json is not computed
        written.append(
            {str(p.relative_to(out)): p.read_bytes() for p in files if p.name != "run.json"}
        )
    one, other = written
    assert one.keys() == other.keys() >= {"classifiers.json", "topology.json", "labels.csv"}
    different = {name for name in one if one[name] != other[name]}
    assert different - (TRAJECTORIES if OLDER_NUMPY else set()) == set()
