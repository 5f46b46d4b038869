"""Scans of one laser made to look like those of another."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.errors import InputError
from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import PlanarScan
from specmap_cli.recognition.learning.sensor import Sensor

_VIEW_SLACK_RAD = 0.0873  # a laser is refused that sees by more than this less
_RANGE_SHARE = 0.5  # a laser is refused that sees less far than this share of the map's laser


class BeamSampler:
    """Makes scans of the laser `seen` look like those of `known`, which the classifiers know.

    Raises InputError when the laser seen sees less than that of the map did.
    """

    def __init__(self, seen: Sensor, known: Sensor) -> None:
        self.known = known
        self.same = seen.sees_as(known)
        self.note = (
            "" if self.same else f"the log's laser ({seen}) is resampled to the map's ({known})"
        )
        narrower = seen.field_of_view < known.field_of_view - _VIEW_SLACK_RAD
        if narrower or seen.range_max < _RANGE_SHARE * known.range_max:
            raise InputError(
                f"the log's laser ({seen}) sees less than the laser of the map ({known}); "
                "build the map again with this laser"
            )

    def apply(self, scan: PlanarScan) -> PlanarScan:
        """The scan at the known laser's bearings, cut to its range."""
        if self.same or not len(scan.bearings):
            return scan
        wanted = self.known.bearings()
        ranges = scan.ranges[_nearest(scan.bearings, wanted)]
        with np.errstate(invalid="ignore"):
            ranges = np.where(ranges >= self.known.range_max, np.inf, ranges)
        return PlanarScan(
            stamp_ns=scan.stamp_ns,
            bearings=wanted,
            ranges=ranges,
            range_max=self.known.range_max,
            full_circle=self.known.full_circle,
        )


def _nearest(bearings: FloatArray, wanted: FloatArray) -> NDArray[np.intp]:
    """(W,) index of the bearing (B,) ascending nearest to each wanted one, around the circle."""
    turn = 2.0 * math.pi
    around = np.concatenate([bearings - turn, bearings, bearings + turn])
    right = np.clip(np.searchsorted(around, wanted), 1, len(around) - 1)
    left_is_nearer = wanted - around[right - 1] < around[right] - wanted
    return np.asarray((right - left_is_nearer) % len(bearings), dtype=np.intp)
