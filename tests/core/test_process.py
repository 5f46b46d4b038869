"""BLAS on one thread while specmap works, however many it has before and after."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

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
specmap_cli.build_map("tiny.mcap", "map", config, progress=looking)
assert looking.seen == {1}, looking.seen
"""


MISSING = """
import sys
sys.modules["threadpoolctl"] = None
from specmap_cli.cli import main
sys.exit(main(["--version"]))
"""


@pytest.mark.parametrize(
    "program",
    [PROGRAM, UNDER_WAY, MISSING],
    ids=["given back, also of what is loaded", "while a map is built", "a package is missing"],
)
def test_threads_in_a_program(program: str, tiny_log: Path, tmp_path: Path) -> None:
    """The last one tells the versions all the same."""
    (tmp_path / "tiny.mcap").symlink_to(tiny_log)
    names = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
    unset = {name: value for name, value in os.environ.items() if name not in names}
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, cwd=tmp_path, env=unset, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
