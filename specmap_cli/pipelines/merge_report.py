"""What `merge` tells of the map that it made."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from specmap_cli.core.findings import Quality
from specmap_cli.core.text import counted
from specmap_cli.pipelines.run_record import told


@dataclass(frozen=True, slots=True, kw_only=True)
class MergeReport:
    """What `merge` did: the map directory and its run.json.

    `parts` are the names of the maps that hang together, a list a part. `ids` tells, map by map,
    which submap of the result each submap became, `unapplied` which of a person's edits do not
    apply.
    """

    out: Path
    run: Mapping[str, Any]
    quality: Quality
    parts: tuple[tuple[str, ...], ...]
    ids: Mapping[str, Mapping[int, int]]
    unapplied: tuple[str, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """The same for a machine."""
        return {
            "out": str(self.out),
            **self.run["counts"],
            "parts": [list(part) for part in self.parts],
            "ids": {
                name: {str(old): new for old, new in own.items()} for name, own in self.ids.items()
            },
            "unapplied": list(self.unapplied),
            "quality": self.run["quality"],
            "warnings": self.run["warnings"],
        }

    def lines(self) -> list[str]:
        """A summary: what makes the map doubtful or poor comes first."""
        counts = self.run["counts"]
        parts = "; ".join(", ".join(part) for part in self.parts)
        apart = f"{self.out}: {len(self.parts)} parts that do not meet: {parts}"
        made = (
            f"{self.out}: {counted(len(self.ids), 'map')} merged: "
            f"{counted(counts['submaps'], 'submap')}, {counted(counts['scans'], 'scan')} over "
            f"{counts['path_m']:.0f} m"
        )
        return told(self.out, self.quality, *([apart] if len(self.parts) > 1 else []), made)
