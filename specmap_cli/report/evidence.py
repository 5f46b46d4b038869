"""What a report tells of a map that stands in none of its files: it is found out from its scans."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from specmap_cli.core.geometry import FloatArray
from specmap_cli.grids.bent import BentMotion
from specmap_cli.maps.comparison import ComparisonRecord
from specmap_cli.maps.store import StoredMap


@dataclass(frozen=True, slots=True)
class Look:
    """A feature of a scan, and the share of a classifier's votes that hangs on it."""

    feature: str
    share: float


@dataclass(frozen=True, slots=True)
class Likeness:
    """A submap, and the share of the scans of another one that its classifier answers most to."""

    submap: int
    share: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Learned:
    """What the classifier of a submap looks at, and which submaps are like it.

    Of `scans` of its own that were asked, the share `right` is told correctly. `alike` falls.
    """

    looks: tuple[Look, ...] = ()
    scans: int = 0
    right: float = 0.0
    alike: tuple[Likeness, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class SplitLook:
    """A test that might have split a submap, made when `keyframe` came.

    `eigenvalues` fall; number `chosen`, from 0, divides the way (0: none does). `nodes` (n, 2) are
    in the map; `sides` (n,) the eigenvector there, -1 to 1, positive on the robot's side.
    """

    keyframe: int
    eigenvalues: FloatArray
    chosen: int
    split: bool
    nodes: FloatArray
    sides: FloatArray

    @property
    def eigenvalue(self) -> float:
        """What is held against the threshold; 0 when no eigenvector divides the way."""
        return float(self.eigenvalues[self.chosen]) if self.chosen else 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Evidence:
    """All of it. `notes` say what could not be found out, and why.

    `fit` (n,) is the share of the returns of each keyframe that lie on walls of the map, NaN for a
    scan without any. `threshold` is the eigenvalue above which a submap is split.
    """

    learned: Mapping[int, Learned] = field(default_factory=dict)
    fit: FloatArray | None = None
    tests: tuple[SplitLook, ...] = ()
    threshold: float = 1.0
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Changes:
    """What differs from an older map of the building, as a record and in words.

    `new_from_old` places the old map in the one that the report is about.
    """

    old: StoredMap
    record: ComparisonRecord
    lines: tuple[str, ...]
    new_from_old: BentMotion
