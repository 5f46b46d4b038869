"""The way of the robot: as lines in colours, and as a table that a slider of time follows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from specmap_cli.core.geometry import FloatArray, evenly, runs
from specmap_cli.core.records import IntArray, Labels
from specmap_cli.drawing.sheet import strokes
from specmap_cli.report.svg import STEPS, Frame, path_data, simplified

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
