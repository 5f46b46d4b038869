"""Where submaps end, once the whole map is known.

The online test (section II-C) sees a room only as far as the robot had come, and the robot may come
back by another door. When the layout is consistent, the same clustering on the finished map says
better which keyframes were taken in one region, and finds duplicates that recognition left over.
"""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from specmap_cli.core.geometry import FloatArray, step_lengths
from specmap_cli.core.records import IntArray
from specmap_cli.core.settings import SegmentationConfig
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.segmentation.division import segment


def regions_of(grid: GridMap, poses: FloatArray, config: SegmentationConfig) -> IntArray:
    """The region (n,) of `grid` that each keyframe at `poses` (n, 3) was taken in.

    Regions the robot only grazed, on less than `region_min_m` of way in all, go to the region that
    it came from.
    """
    found = segment(grid, config).labels
    if (found < 0).all():
        return np.zeros(len(poses), dtype=np.int64)
    rows, columns = np.clip(grid.cells_of(poses[:, :2]), 0, np.array(found.shape) - 1).T
    if (found[rows, columns] < 0).any():
        nearest = ndimage.distance_transform_edt(
            found < 0, return_distances=False, return_indices=True
        )
        rows, columns = nearest[:, rows, columns]
    labels = found[rows, columns].astype(np.int64)
    return _without_grazed(labels, poses, config.region_min_m)


def _without_grazed(labels: IntArray, poses: FloatArray, way_m: float) -> IntArray:
    """Labels without those driven less than `way_m`, each keyframe in the last label that stays."""
    way = np.bincount(labels[1:], weights=step_lengths(poses), minlength=int(labels.max()) + 1)
    stays = way[labels] >= way_m
    if not stays.any():
        return np.full_like(labels, np.bincount(labels).argmax())
    first = int(np.argmax(stays))
    source = np.where(stays, np.arange(len(labels)), first)
    return np.asarray(labels[np.maximum.accumulate(source)], dtype=np.int64)
