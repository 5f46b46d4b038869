"""specmap: topological maps from laser logs (Brunskill, Kollar and Roy, IROS 2007)."""

from __future__ import annotations

__version__ = "0.1.0"
