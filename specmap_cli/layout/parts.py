"""Parts: pieces of the path between breaks of the tracking, each rigid to begin with.

A part hangs on the one before by a guess. Constraints between parts, from closures or matches,
say where it really is; before the pose graph is solved the part is moved there as a whole, since a
robust optimisation takes what is metres off for an outlier.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from specmap_cli.core.geometry import FloatArray, compose, invert, wrap_angles
from specmap_cli.core.records import IntArray
from specmap_cli.layout.pose_graph import Link

_SAME_M, _SAME_RAD = 0.5, 0.15  # constraints this close to each other say the same


def corrections(
    links: Sequence[Link], part: int, parts: IntArray, row: dict[int, int], poses: FloatArray
) -> FloatArray:
    """Motions (L, 3) of the map that would satisfy each link between `part` and an older part.

    Each is to be composed from the left with the poses of the part.
    """
    found = []
    for link in links:
        i, j, z = row[link.source], row[link.target], np.array(link.source_from_target)
        if parts[i] > parts[j]:
            i, j, z = j, i, invert(z)
        if parts[j] == part and parts[i] < part:
            found.append(compose(compose(poses[i], z), invert(poses[j])))
    return np.array(found).reshape(-1, 3)


def agreed(motions: FloatArray, centre: FloatArray) -> tuple[FloatArray, int] | None:
    """The motion most others agree with, and how many do, itself included; None without any.

    `centre` (2,) is where the motions are compared: a turn far from the origin moves much.
    """
    if not len(motions):
        return None
    placed = compose(motions, np.array([centre[0], centre[1], 0.0]))
    apart = np.hypot(*(placed[:, None, :2] - placed[None, :, :2]).transpose(2, 0, 1))
    turned = np.abs(wrap_angles(placed[:, None, 2] - placed[None, :, 2]))
    votes = ((apart <= _SAME_M) & (turned <= _SAME_RAD)).sum(axis=1)
    best = int(votes.argmax())
    return motions[best], int(votes[best])


def moved(poses: FloatArray, parts: IntArray, part: int, motion: FloatArray) -> FloatArray:
    """Poses (M, 3) with `part` and the later ones, which hang on it, moved as a whole."""
    result = np.array(poses)
    later = parts >= part
    result[later] = compose(motion, poses[later])
    return result
