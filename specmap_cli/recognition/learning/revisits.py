"""Scans of a recording that is added to a map, told by the classifiers that the map had before.

These never saw the recording: no piece of the way need be held out to learn how sure they are. But
they cannot tell what they never saw. So only those scans count that were taken where the robot had
been in the submap before, facing the same way.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from specmap_cli.core.arrays import evenly
from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import IntArray
from specmap_cli.grids.keyframes import DIRECTION_RAD
from specmap_cli.recognition.learning.calibration import MOST_VIEWS, HeldOutMargins
from specmap_cli.recognition.learning.classifiers import ClassifierSet, Recogniser
from specmap_cli.recognition.learning.holding_out import Samples

_CHORD = 2.0 * np.sin(0.5 * DIRECTION_RAD)  # of the unit circle


@dataclass(frozen=True, slots=True)
class Revisits:
    """The `classifiers` of a map before the recording whose keyframes begin at number `first`.

    The keyframes of both lie at `poses` (n, 3), in `submaps` (n,). A place is known that lies
    within `reach_m` of one where the robot was in the submap, less far the more it faced another
    way, unless the laser looks all round.
    """

    classifiers: ClassifierSet
    first: int
    poses: FloatArray
    submaps: IntArray
    reach_m: float

    def told(self, samples: Mapping[int, Samples], by: Recogniser) -> HeldOutMargins:
        """The margins of samples of the recording; `by` is one of the classifiers before it."""
        column = {id_: k for k, id_ in enumerate(by.ids)}
        found = [(column[i], self._known(i, samples[i])) for i in sorted(samples) if i in column]
        features = [own.features for _, own in found if len(own.features)]
        if not features:
            return HeldOutMargins(np.zeros((0, len(column))), np.zeros(0, dtype=np.intp))
        true = np.repeat([k for k, _ in found], [len(own.features) for _, own in found])
        rows = evenly(np.arange(len(true)), MOST_VIEWS)
        return HeldOutMargins(by.margins(np.vstack(features)[rows]), true[rows].astype(np.intp))

    def _known(self, submap: int, samples: Samples) -> Samples:
        """Those of the recording at places of the submap that were known before."""
        before = np.flatnonzero(self.submaps[: self.first] == submap)
        own = samples.rows(samples.keyframes >= self.first)
        if not len(before) or not len(own.keyframes):
            return own.rows(np.zeros(len(own.keyframes), dtype=bool))
        near = cKDTree(self._views(before)).query(self._views(own.keyframes))[0] < 1.0
        return own.rows(np.asarray(near))

    def _views(self, keyframes: NDArray[np.intp]) -> FloatArray:
        """Where keyframes (k,) look from, and where to: farther apart than one is another view."""
        x, y, heading = self.poses[keyframes].T
        places = np.column_stack([x, y]) / self.reach_m
        if self.classifiers.sensor.full_circle:
            return places
        facing = np.column_stack([np.cos(heading), np.sin(heading)]) / _CHORD
        return np.hstack([places, facing])
