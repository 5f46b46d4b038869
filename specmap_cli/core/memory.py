"""How much memory this process needed."""

from __future__ import annotations

import re
from pathlib import Path

# Not `ru_maxrss`: there the peak of the process that started this one counts as well.
_STATUS = Path("/proc/self/status")
_PEAK = re.compile(r"^VmHWM:\s*(\d+) kB$", re.MULTILINE)
_KB_PER_MB = 1000.0 / 1.024  # the kernel means 1,024 bytes


def peak_memory_mb() -> float | None:
    """The most megabytes that this process has held so far; None where the system does not tell."""
    try:
        found = _PEAK.search(_STATUS.read_text(encoding="ascii"))
    except OSError:
        return None
    return None if found is None else round(int(found[1]) / _KB_PER_MB, 1)
