"""BLAS on one thread while specmap works, however many it has before and after."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from specmap_cli.grids.gridmap import GridMap
from specmap_cli.pipelines.simulate import simulate
from specmap_cli.simulation.simulator import SimulationOptions

PROGRAM = """
import numpy, threadpoolctl
from specmap_cli.core.process import one_blas_thread

def threads():
    pools = threadpoolctl.threadpool_info()
    return {pool["filepath"]: pool["num_threads"] for pool in pools if pool["user_api"] == "blas"}

@one_blas_thread()
def work():
    import scipy.linalg
    with one_blas_thread():
        inner = threads()
    assert inner == threads(), "an inner call gave the threads back"
    return inner

threadpoolctl.ThreadpoolController().limit(limits=3)
before, during, after = threads(), work(), threads()
assert before and set(before.values()) == {3}, before
assert len(during) > len(before) and set(during.values()) == {1}, during
assert after == dict.fromkeys(during, 3), after
"""

UNDER_WAY = """
import threadpoolctl
import specmap_cli
from specmap_cli.core.progress import Silent

class Looking(Silent):
    seen = set()
    def advance(self, steps=1):
        self.seen.update(pool["num_threads"] for pool in threadpoolctl.threadpool_info()
                         if pool["user_api"] == "blas")

looking = Looking()
threadpoolctl.ThreadpoolController().limit(limits=3)
little = {"recognition": {"rounds": 4}, "localization": {"augmentation": 20}}
config = specmap_cli.load_config(overrides=little)
specmap_cli.build_map("flat.mcap", "map", config, progress=looking)
assert looking.seen == {1}, looking.seen
"""


def run(program: str, folder: Path) -> None:
    names = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
    unset = {name: value for name, value in os.environ.items() if name not in names}
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=folder, env=unset, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr


def test_threads_are_taken_and_given_back_also_of_what_is_loaded_meanwhile(tmp_path: Path) -> None:
    run(PROGRAM, tmp_path)


def test_the_versions_are_told_though_one_of_the_packages_is_missing(tmp_path: Path) -> None:
    run(
        "import sys; sys.modules['threadpoolctl'] = None\n"
        "from specmap_cli.cli import main; sys.exit(main(['--version']))",
        tmp_path,
    )


def test_a_program_that_builds_a_map_has_one_thread_meanwhile(
    tmp_path: Path, flat: GridMap
) -> None:
    simulate(
        flat, SimulationOptions(beams=120, rate_hz=3, max_duration_s=8), tmp_path / "flat.mcap"
    )
    run(UNDER_WAY, tmp_path)
