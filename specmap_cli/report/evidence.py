"""What a report finds out from the scans of a map, and the way of the robot, thinned for the page.

The way is drawn as lines in colours, and is a table that a slider of time follows.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from specmap_cli.core.arrays import evenly, runs
from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import IntArray, Labels
from specmap_cli.drawing.sheet import strokes
from specmap_cli.report.html import STEPS, Frame, path_data, simplified

MOST_TESTS, MOST_NODES = 500, 90_000  # that a page keeps
_FINEST = 9  # steps of the strength of a node on either side


@dataclass(frozen=True, slots=True, kw_only=True)
class Learned:
    """What the classifier of a submap looks at, and which submaps are like it, with falling shares.

    That of features is of its votes; that of others of `scans` of the submap's own, of which the
    share `right` is told correctly.
    """

    features: tuple[tuple[str, float], ...] = ()
    scans: int = 0
    right: float = 0.0
    alike: tuple[tuple[int, float], ...] = ()


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


MOST_POINTS = 6000  # of the way: a screen shows no more
_STRAY_CM = 2.0  # how far the drawn line may lie off the way
FIT_STEPS = (0.5, 0.7, 0.85, 0.95)  # where the colours of the fit change
_NO_FIT = -1


@dataclass(frozen=True, slots=True)
class Track:
    """The keyframes that the page keeps, of `total` in all.

    `seconds` (n,) of recording, without the pauses between recordings; `poses` (n, 3) in the map;
    `submaps` (n,); `fit` (n,) or None; `starts` are the seconds at which recordings begin.
    """

    seconds: FloatArray
    poses: FloatArray
    submaps: IntArray
    fit: FloatArray | None
    starts: tuple[float, ...]
    total: int

    @classmethod
    def of(cls, labels: Labels, starts: Sequence[int], fit: FloatArray | None) -> Track:
        """The way by its keyframes; recordings after the first begin with keyframes `starts`."""
        seconds = running_seconds(labels.stamps_ns, starts)
        kept = evenly(np.arange(len(seconds)), MOST_POINTS)
        return cls(
            seconds=seconds[kept],
            poses=labels.poses[kept],
            submaps=labels.submaps[kept],
            fit=None if fit is None else fit[kept],
            starts=tuple(float(seconds[start]) for start in (0, *starts) if start < len(seconds)),
            total=len(seconds),
        )

    @property
    def duration_s(self) -> float:
        """Seconds of recording."""
        return float(self.seconds[-1]) if len(self.seconds) else 0.0

    def by_time(self, frame: Frame) -> list[tuple[int, str]]:
        """Path data by class of time, early to late."""
        classes = (self.seconds / max(self.duration_s, 1e-9) * STEPS).astype(np.int64)
        return self._lines(np.minimum(classes, STEPS - 1), frame)

    def by_fit(self, frame: Frame) -> list[tuple[int, str]]:
        """Path data by class of fit, from bad to good; nothing where it is not known."""
        if self.fit is None:
            return []
        classes = np.searchsorted(FIT_STEPS, self.fit, side="right")
        return self._lines(np.where(np.isnan(self.fit), _NO_FIT, classes), frame)

    def _lines(self, classes: IntArray, frame: Frame) -> list[tuple[int, str]]:
        places = self.poses[:, :2]
        found: dict[int, list[IntArray]] = {}
        for stroke in strokes(places, classes):
            line = frame.places(places[stroke.first : stroke.drawn_to])
            found.setdefault(int(classes[stroke.first]), []).append(simplified(line, _STRAY_CM))
        return [(of, path_data(lines)) for of, lines in sorted(found.items()) if of != _NO_FIT]

    def visits(self) -> list[tuple[float, float, int]]:
        """Stays in submaps: seconds of their start and their end, and the submap."""
        found = []
        for first, end in runs(self.submaps):
            until = self.seconds[min(end, len(self.seconds) - 1)]
            found.append((float(self.seconds[first]), float(until), int(self.submaps[first])))
        return found

    def table(self, frame: Frame) -> dict[str, Any]:
        """The same for the page: steps of tenths of a second, of centimetres, degrees, percent."""
        x, y = frame.places(self.poses[:, :2]).T
        fit = None if self.fit is None else np.rint(np.nan_to_num(self.fit, nan=-0.01) * 100.0)
        return {
            "t": _steps(np.rint(self.seconds * 10.0)),
            "x": _steps(x),
            "y": _steps(y),
            "a": np.rint(np.degrees(self.poses[:, 2])).astype(np.int64).tolist(),
            "s": [[int(self.submaps[first]), end - first] for first, end in runs(self.submaps)],
            "fit": None if fit is None else fit.astype(np.int64).tolist(),
            "starts": [round(start, 1) for start in self.starts],
        }


def running_seconds(stamps_ns: IntArray, starts: Sequence[int]) -> FloatArray:
    """(n,) seconds of recording at each keyframe; between recordings no time passes."""
    steps = np.diff(stamps_ns, prepend=stamps_ns[:1]) / 1e9
    steps[[start for start in starts if start < len(steps)]] = 0.0
    return np.asarray(np.cumsum(np.maximum(steps, 0.0)))


def _steps(values: Any) -> list[int]:
    """The first of some whole numbers, then what each is more than the one before."""
    whole = np.asarray(values).astype(np.int64)
    return np.diff(whole, prepend=0).tolist() if len(whole) else []
