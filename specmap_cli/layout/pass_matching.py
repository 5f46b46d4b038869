"""Two passes through one place, matched by the walls that they may have seen from the same side."""

from __future__ import annotations

from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.layout.wall_matching import LOOP_SCORE, WallFit, match_walls
from specmap_cli.layout.wall_sides import from_behind
from specmap_cli.layout.walls import Walls

Stretch = tuple[int, int]  # a row, and how many rows on either side of it
_FEW = 0.05  # share of points that cannot move a match by much


def match_passes(
    walls: Walls,
    poses: FloatArray,
    newer: Stretch,
    older: Stretch,
    guess: Pose2,
    drift_m: float,
) -> WallFit | None:
    """The pose of the newer row in the frame of the older one, if the walls around them fit.

    `poses` (M, 3) place the rows around each; `guess` may be wrong by `drift_m`. A wall that the
    older pass saw from its other side only does not fit, however near it lies.
    """
    source, target = (walls.around(*rows, poses) for rows in (newer, older))
    fit = match_walls(source, target, guess, drift_m)
    if fit is None:
        return None
    sides, others = (walls.sides_around(*rows, poses) for rows in (newer, older))
    behind = from_behind(sides, others, guess, drift_m)
    share = float(behind.mean())
    if share < _FEW:
        return fit
    asked = LOOP_SCORE / max(1.0 - share, LOOP_SCORE)
    return match_walls(source[~behind], target, guess, drift_m, asked)
