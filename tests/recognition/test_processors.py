"""The same bytes on every processor: a build under several kernels of the linear algebra."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from specmap_cli.grids.gridmap import GridMap
from specmap_cli.pipelines.simulate import simulate
from specmap_cli.simulation.simulator import SimulationOptions

pytest.importorskip("threadpoolctl", reason="tells which kernel is in use")

KERNELS = ("Haswell", "Prescott")  # sums in four lanes with fused products, and in two without
WIDEST = "SkylakeX"  # in eight lanes, and small products by loops of their own
# Those two run on every processor; a wide kernel that is forced on a narrower one ends the program.
CPUINFO = Path("/proc/cpuinfo")
if CPUINFO.exists() and {"avx512f", "avx512bw", "avx512vl"} <= set(CPUINFO.read_text().split()):
    RUNNABLE: tuple[str, ...] = (*KERNELS, WIDEST)
else:
    RUNNABLE = KERNELS
FIXED = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}

# With an older NumPy the last digits of poses depend on the kernel; nothing that is decided does.
OLDER_NUMPY = np.lib.NumpyVersion(np.__version__) < "2.4.0"
TRAJECTORIES = {"trajectory.g2o", "trajectory.tum"}

KERNEL_IN_USE = """
import threadpoolctl, numpy, scipy.linalg
pools = threadpoolctl.threadpool_info()
print(sorted({pool["architecture"] for pool in pools if pool["internal_api"] == "openblas"}))
"""


# What is made in many steps from sums, cosines and roots: features, matches and their spread.
DIGESTS = """
import hashlib, numpy as np
from specmap_cli.core.geometry import Pose2
from specmap_cli.core.records import PlanarScan
from specmap_cli.grids.matching import ScoreField, covariance, refine
from specmap_cli.recognition.features.sets import scans_features
rng = np.random.default_rng(0)
bearings = np.linspace(-2.0, 2.0, 181)
for k in range(20):
    ranges = 2.0 + k / 7 + 0.3 * rng.random(181).cumsum() / 9
    scan = PlanarScan(0, bearings, ranges, range_max=20.0, full_circle=False)
    points = scan.hits(20.0)
    field = ScoreField.from_points(points)
    found = refine(field, points, Pose2(0.07, -0.05, 0.02))
    spread = covariance(field, points[::4], found.pose)
    made = scans_features([scan], "full")[0], np.array(found.pose), spread
    print(hashlib.sha256(b"".join(part.tobytes() for part in made)).hexdigest())
"""

# Loops of NumPy for AVX-512 that this processor has, by the names of this NumPy.
WIDE_LOOPS = """
from numpy.__config__ import show
found = show(mode="dicts").get("SIMD Extensions", {}).get("found", [])
print(" ".join(name for name in found if "AVX512" in name or name == "X86_V4"))
"""


def run_under(kernel: str, *arguments: str, **more: str) -> str:
    """What Python prints when the linear algebra uses this kernel; `more` variables are set."""
    environment = {**os.environ, **FIXED, "OPENBLAS_CORETYPE": kernel, **more}
    command = [sys.executable, *arguments]
    run = subprocess.run(command, env=environment, check=True, capture_output=True, text=True)
    return run.stdout


@pytest.fixture(scope="module")
def _chosen() -> None:
    """Skips where not the kernels are loaded that are asked for."""
    if len({run_under(kernel, "-c", KERNEL_IN_USE) for kernel in KERNELS}) < len(KERNELS):
        pytest.skip("NumPy is not on OpenBLAS here, or the processor lets no kernel be chosen")


@pytest.mark.usefixtures("_chosen")
def test_features_and_matches_are_the_same_under_every_kernel() -> None:
    made = {run_under(kernel, "-c", DIGESTS) for kernel in RUNNABLE}
    assert [len(digests.split()) for digests in made] == [20]


def test_features_and_matches_are_the_same_without_avx_512() -> None:
    wide = run_under("", "-c", WIDE_LOOPS).strip()
    if not wide:
        pytest.skip("this processor, or this NumPy on it, has no loops for AVX-512 to switch off")
    with_loops = run_under("", "-c", DIGESTS)
    without = run_under("", "-c", DIGESTS, NPY_DISABLE_CPU_FEATURES=wide)
    if run_under("", "-c", WIDE_LOOPS, NPY_DISABLE_CPU_FEATURES=wide).strip():
        pytest.skip("this NumPy does not let its loops be switched off")
    assert len(with_loops.split()) == 20
    assert with_loops == without


@pytest.mark.usefixtures("_chosen")
def test_a_build_gives_the_same_bytes_under_every_kernel(flat: GridMap, tmp_path: Path) -> None:
    log, written = tmp_path / "flat.mcap", []
    robot = {"field_of_view_deg": 360, "beams": 120, "rate_hz": 2, "speed_mps": 0.9}
    simulate(flat, SimulationOptions.model_validate({**robot, "max_duration_s": 30}), log)
    for kernel in RUNNABLE:
        out = tmp_path / kernel
        settings = ("recognition.rounds=6", "localization.augmentation=20")
        sets = [part for setting in settings for part in ("--set", setting)]
        run_under(kernel, "-m", "specmap_cli", "build", str(log), "-o", str(out), "-q", *sets)
        # seconds are of the clock, and the rest of run.json is not computed
        files = [path for path in out.rglob("*") if path.is_file() and path.name != "run.json"]
        written.append({str(path.relative_to(out)): path.read_bytes() for path in files})
    one, *others = written
    assert one.keys() >= {"classifiers.json", "topology.json", "labels.csv"}
    assert all(other.keys() == one.keys() for other in others)
    different = {name for other in others for name in one if one[name] != other[name]}
    assert different - (TRAJECTORIES if OLDER_NUMPY else set()) == set()
