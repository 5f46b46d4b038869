"""How well views that the map never saw fit its walls: keyframes held out by stretches of the way.

The misfit of a scan is one less its score on a field of walls: the share of its returns, more or
less, that lie off them. What is usual for a laser and its building is learned from keyframes that
are matched with the rest of their submap, without what was seen a little before and after them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from specmap_cli.core.arrays import evenly
from specmap_cli.core.geometry import FloatArray, Pose2, travelled
from specmap_cli.core.records import PlanarScan
from specmap_cli.core.settings import LocalizationConfig
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.grids.matching import REFINE_SHIFT_M, refine
from specmap_cli.grids.score_field import ScoreField
from specmap_cli.recognition.learning.boosting import as_part

FIT_RANGE_M = 8.0  # returns matched with walls: farther ones are seen through doors
_HELD_OUT_M = 1.0  # path before and after a view that is held out with it
HELD_OUT_REACH_M = 1.5  # the rest of the map comes so near to a view held out, or it is a new place
_USUAL_MISFIT = 0.1  # mean share of returns off the walls, for a map that has none
_USUAL_MISFIT_VIEWS = 5  # weight of that mean, in views that the map held out
_MOST_VIEWS = 60  # held out: enough for a median, and quick
_MOST_OTHERS = 40  # keyframes that make the walls of a submap: half a metre apart in 20 m
_MOST_POINTS = 180  # of a scan, one every other degree: what a match costs grows with them
_DECIMALS = 4  # the last digits of a match differ from processor to processor


@as_part
@dataclass(frozen=True, slots=True)
class HeldOutMisfit:
    """The median misfit in [0, 1] of `views` scans that were held out of the walls they fit."""

    typical: Annotated[float, Field(ge=0.0, le=1.0)]
    views: Annotated[int, Field(ge=0, le=_MOST_VIEWS)]


def held_out_misfit(
    store: KeyframeStore,
    submaps: Mapping[int, Sequence[int]],
    poses: NDArray[Any],
) -> HeldOutMisfit:
    """The misfit of keyframes with the rest of their submaps; of no view where there is no rest.

    `submaps` lists the keyframes of each submap, ascending; `poses` (n, 3) are those of all.
    """
    way = travelled(poses)
    owner = {k: i for i, numbers in submaps.items() for k in numbers}
    found = []
    for k in evenly(np.array(sorted(owner), dtype=np.intp), _MOST_VIEWS).tolist():
        numbers = np.asarray(submaps[owner[k]], dtype=np.intp)
        others = numbers[np.abs(way[numbers] - way[k]) > _HELD_OUT_M]
        away = np.hypot(*(poses[others] - poses[k])[:, :2].T)
        if float(away.min(initial=math.inf)) >= HELD_OUT_REACH_M:  # it is no place of the map
            continue
        points = near_returns(store.scan(k), FIT_RANGE_M)
        if not len(points):
            found.append(1.0)
            continue
        map_from_laser = Pose2(*poses[k].tolist()) @ store.base_from_laser(k)
        reach = float(np.hypot(points[:, 0], points[:, 1]).max()) + REFINE_SHIFT_M
        walls = []  # that others saw, as far as the returns could meet them
        for other in evenly(others, _MOST_OTHERS).tolist():
            placed = Pose2(*poses[other].tolist()) @ store.base_from_laser(other)
            seen = placed.apply(store.scan(other).hits())
            away = seen - np.array([map_from_laser.x, map_from_laser.y])
            walls.append(seen[np.hypot(away[:, 0], away[:, 1]) <= reach])
        field = ScoreField.from_points(np.vstack(walls))
        found.append(1.0 - refine(field, points, map_from_laser).score)
    if not found:
        return HeldOutMisfit(0.0, 0)
    return HeldOutMisfit(round(float(np.median(found)), _DECIMALS), len(found))


def near_returns(scan: PlanarScan, near_m: float) -> FloatArray:
    """(N, 2) a choice of the scan's returns within `near_m`, or of the nearer half if that is more.

    Far ones are seen through doors, from where they hardly show again.
    """
    hits = scan.hits()
    ranges = np.hypot(hits[:, 0], hits[:, 1])
    reach = max(near_m, float(np.median(ranges))) if len(ranges) else near_m
    return np.asarray(evenly(hits[ranges <= reach], _MOST_POINTS))


def pooled(held_out: HeldOutMisfit | None, config: LocalizationConfig) -> float:
    """Mean misfit of known places: that of the map's own views, drawn to what is usual anywhere.

    The fewer views were held out, the nearer it is to `_USUAL_MISFIT`, which is wide. The mean is
    that of an exponential distribution with the median found.
    """
    views, typical = (held_out.views, held_out.typical) if held_out is not None else (0, 0.0)
    pseudo = _USUAL_MISFIT_VIEWS
    mean = (views * typical / math.log(2.0) + pseudo * _USUAL_MISFIT) / (views + pseudo)
    return max(config.least_misfit, mean)
