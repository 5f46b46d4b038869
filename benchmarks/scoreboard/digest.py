"""What tree a page was made of."""

from __future__ import annotations

import hashlib
from pathlib import Path

ROOT = Path(__file__).parents[2]
_SOURCES = ("specmap_cli", "benchmarks")
_KINDS = {".py", ".toml", ".json", ".html", ".css", ".js"}
_FILES = ("constraints.txt",)


def digest() -> str:
    """Twelve hexadecimal digits of the program, the benchmarks and the versions they run with."""
    total = hashlib.sha256()
    for path in sorted(_paths()):
        total.update(path.relative_to(ROOT).as_posix().encode() + b"\0")
        total.update(hashlib.sha256(path.read_bytes()).digest())
    return total.hexdigest()[:12]


def _paths() -> list[Path]:
    found = [ROOT / name for name in _FILES]
    for folder in _SOURCES:
        found += [path for path in (ROOT / folder).rglob("*") if path.suffix in _KINDS]
    return [path for path in found if path.name != "scoreboard.json"]
