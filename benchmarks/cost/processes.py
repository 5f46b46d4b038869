"""What a command costs: wall time, processor time and memory of a process and its children."""

from __future__ import annotations

import math
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

SCRIPTS = Path(sys.executable).parent
SPECMAP = str(SCRIPTS / "specmap")
_SAMPLED_EVERY_S = 0.05


class Cost(NamedTuple):
    """What a command took: wall and processor seconds, and megabytes at the peak.

    `memory_mb` is the resident memory of its largest process; `together_mb` the memory of all its
    processes at once, pages they share counted once. Both are looked at every 50 ms: the system's
    own account, `ru_maxrss`, also counts the peak of the program that measures.
    """

    wall_s: float
    processor_s: float
    memory_mb: float
    together_mb: float


def measure(
    command: list[str], folder: Path, *, limit_s: float = math.inf, **settings: str
) -> Cost:
    """Run a process to its end; raises RuntimeError with its last words when it fails.

    With a limit it may fail, and is stopped after so many seconds: the cost is then that so far.
    """
    own = {name: value for name, value in os.environ.items() if name[:8] != "SPECMAP_"}
    own.pop("PYTHONDONTWRITEBYTECODE", None)  # an installation keeps its modules compiled
    start = time.perf_counter()
    with tempfile.TemporaryFile() as output:
        process = subprocess.Popen(
            command,
            cwd=folder,
            env=own | settings,
            stdout=output,
            stderr=subprocess.STDOUT,
            start_new_session=limit_s < math.inf,
        )
        ended, largest, together = 0, 0.0, 0.0
        while not ended:
            largest = max(largest, *memory_mb(process.pid, "status", "VmHWM:"))
            together = max(together, sum(memory_mb(process.pid, "smaps_rollup", "Pss:")))
            time.sleep(_SAMPLED_EVERY_S)
            if time.perf_counter() - start > limit_s:
                os.killpg(process.pid, signal.SIGKILL)
            ended, status, usage = os.wait4(process.pid, os.WNOHANG)
        seconds = time.perf_counter() - start
        output.seek(0)
        told = output.read().decode("utf-8", "replace").strip().splitlines()
    if status != 0 and limit_s == math.inf:
        last = told[-1] if told else "nothing"
        raise RuntimeError(f"{' '.join(command)} ended with status {status}: {last}")
    return Cost(seconds, usage.ru_utime + usage.ru_stime, largest, together)


def memory_mb(pid: int, file: str, field: str) -> list[float]:
    """What the system tells of a process and of each of its children now; [0.0] when one ends."""
    found = [0.0]
    try:
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text(encoding="ascii").split()
        for process in (str(pid), *children):
            lines = Path(f"/proc/{process}/{file}").read_text(encoding="ascii").splitlines()
            found += [int(line.split()[1]) / 1024.0 for line in lines if line.startswith(field)]
    except (FileNotFoundError, ProcessLookupError):  # one has just ended
        return [0.0]
    return found
