"""What a report tells of a map that stands in none of its files: it is found out from its scans.

The tests that might have split a submap are thinned here for the page.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from specmap_cli.core.geometry import FloatArray, evenly
from specmap_cli.report.svg import Frame

MOST_TESTS, MOST_NODES = 500, 90_000  # that a page keeps
_FINEST = 9  # steps of the strength of a node on either side


@dataclass(frozen=True, slots=True)
class FeatureShare:
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

    features: tuple[FeatureShare, ...] = ()
    scans: int = 0
    right: float = 0.0
    alike: tuple[Likeness, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class SplitTrial:
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
    tests: tuple[SplitTrial, ...] = ()
    threshold: float = 1.0
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Spectra:
    """The tests that are kept, of `total` in all, and what the page needs to draw each.

    `dots` are the tests in the chart, each with the seconds of recording at which it was made.
    """

    dots: tuple[tuple[float, SplitTrial], ...]
    table: tuple[dict[str, Any], ...]
    threshold: float
    total: int
    thinned: bool


def spectra_of(evidence: Evidence, seconds: Sequence[float], frame: Frame) -> Spectra:
    """The tests, of each at most so many nodes; `seconds` of recording of each keyframe."""
    # all that split a submap, and others, evenly spread
    splits, others = (
        np.array([k for k, one in enumerate(evidence.tests) if one.split == split], dtype=np.int64)
        for split in (True, False)
    )
    some = evenly(splits, MOST_TESTS)
    more = evenly(others, MOST_TESTS - len(some)) if len(some) < MOST_TESTS else others[:0]
    kept = [evidence.tests[k] for k in sorted([*some.tolist(), *more.tolist()])]
    most = MOST_NODES // max(len(kept), 1)
    return Spectra(
        dots=tuple((seconds[one.keyframe], one) for one in kept),
        table=tuple(_row(one, seconds[one.keyframe], most, frame) for one in kept),
        threshold=evidence.threshold,
        total=len(evidence.tests),
        thinned=any(len(one.nodes) > most for one in kept),
    )


def _row(test: SplitTrial, seconds: float, most: int, frame: Frame) -> dict[str, Any]:
    """A test for the page: `nodes` are x, y and strength in a row."""
    kept = evenly(np.arange(len(test.nodes)), most)
    strength = np.rint(test.sides[kept] * _FINEST).astype(np.int64)
    nodes = np.column_stack([frame.places(test.nodes[kept]), strength])
    return {
        "t": round(seconds, 1),
        "values": np.round(test.eigenvalues, 3).tolist(),
        "chosen": test.chosen,
        "split": test.split,
        "nodes": nodes.reshape(-1).tolist(),
    }
