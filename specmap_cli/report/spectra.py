"""The tests that might have split a submap, as the page shows them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from specmap_cli.core.arrays import evenly
from specmap_cli.report.evidence import Evidence, SplitLook
from specmap_cli.report.frame import Frame

MOST_TESTS, MOST_NODES = 500, 90_000  # that a page keeps
_FINEST = 9  # steps of the strength of a node on either side


@dataclass(frozen=True, slots=True)
class Dot:
    """A test in the chart of all tests: seconds of recording and eigenvalue."""

    seconds: float
    eigenvalue: float
    split: bool


@dataclass(frozen=True, slots=True)
class Spectra:
    """The tests that are kept, of `known` in all, and what the page needs to draw each."""

    dots: tuple[Dot, ...]
    table: tuple[dict[str, Any], ...]
    threshold: float
    known: int
    thinned: bool


def spectra_of(evidence: Evidence, seconds: Sequence[float], frame: Frame) -> Spectra:
    """The tests, of each at most so many nodes; `seconds` of recording of each keyframe."""
    kept = _chosen(evidence.tests)
    most = MOST_NODES // max(len(kept), 1)
    return Spectra(
        dots=tuple(Dot(seconds[one.keyframe], one.eigenvalue, one.split) for one in kept),
        table=tuple(_row(one, seconds[one.keyframe], most, frame) for one in kept),
        threshold=evidence.threshold,
        known=len(evidence.tests),
        thinned=any(len(one.nodes) > most for one in kept),
    )


def _chosen(tests: Sequence[SplitLook]) -> list[SplitLook]:
    """All tests that split a submap, and others, evenly spread, up to so many."""
    splits = [k for k, one in enumerate(tests) if one.split]
    others = np.array([k for k, one in enumerate(tests) if not one.split], dtype=np.int64)
    some = evenly(np.array(splits, dtype=np.int64), MOST_TESTS)
    more = evenly(others, MOST_TESTS - len(some)) if len(some) < MOST_TESTS else others[:0]
    return [tests[k] for k in sorted([*some.tolist(), *more.tolist()])]


def _row(test: SplitLook, seconds: float, most: int, frame: Frame) -> dict[str, Any]:
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
