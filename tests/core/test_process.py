"""The memory of the process: what is not held any more goes back to the system."""

from __future__ import annotations

import platform
from pathlib import Path

import numpy as np
import pytest

from specmap_cli.core.process import give_memory_back

BLOCKS, EVERY = 1000, 100


def resident_kb() -> int:
    """What the process holds now."""
    status = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    return next(int(line.split()[1]) for line in status if line.startswith("VmRSS:"))


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="another C library keeps no holes")
def test_holes_between_what_is_held_go_back() -> None:
    blocks = [np.ones(12_000) for _ in range(BLOCKS)]  # 96 kB each: too small to be mapped alone
    held = blocks[EVERY - 1 :: EVERY]  # the last among them: what lies before are holes
    full = resident_kb()
    del blocks
    give_memory_back()
    assert full - resident_kb() > 0.9 * BLOCKS * 12_000 * 8 / 1024
    assert sum(float(each.sum()) for each in held) == 12_000.0 * BLOCKS / EVERY
