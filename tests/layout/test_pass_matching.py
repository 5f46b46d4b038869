"""Passes on either side of a wall: its two sides are not laid on one another."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.grids.gridmap import FREE, OCCUPIED, GridMap
from specmap_cli.layout.motion_edges import MATCH_RANGE_M
from specmap_cli.layout.pass_matching import match_passes
from specmap_cli.layout.wall_matching import match_walls
from specmap_cli.layout.walls import Walls
from tests.layout.driving import between, graph_by_hand, scans_of, stored
from tests.turning import turned

LAX = 0.2  # the rooms have little else in common
REACH = 4
FIRST, SECOND, AGAIN = 4, 13, 22  # rows: in the lower room, in the upper one, in the lower one
Drive = tuple[FloatArray, Walls]


def two_rooms() -> GridMap:
    """Two rooms, 6 m x 3 m, with a wall of 0.25 m between them."""
    cells = np.full((140, 140), OCCUPIED, dtype=np.uint8)
    cells[10:70, 10:130] = FREE
    cells[75:135, 10:130] = FREE
    return GridMap(cells, 0.05)


@pytest.fixture(scope="module")
def drive() -> Iterator[Drive]:
    """True poses along the wall: below it, above it, and below it again; and the walls seen."""
    x = np.linspace(2.5, 4.5, 9)
    stretches = [np.column_stack([x, np.full(9, y), np.zeros(9)]) for y in (2.2, 5.0, 1.5)]
    truth = np.concatenate(stretches)
    with stored(truth, scans_of(two_rooms(), truth)) as store:
        yield truth, Walls(store, graph_by_hand(truth), MATCH_RANGE_M)


def test_the_other_side_of_a_wall_is_no_match(drive: Drive) -> None:
    poses, walls = drive
    guess = between(poses, FIRST, SECOND)
    newer, older = (SECOND, REACH), (FIRST, REACH)
    source, target = (walls.around(*rows, poses) for rows in (newer, older))
    mistaken = match_walls(source, target, guess, 0.3, LAX)
    assert mistaken is not None
    assert (guess.inverse() @ mistaken.target_from_source).distance > 0.2, "a wall's thickness off"
    with turned("layout.wall_matching", LOOP_SCORE=LAX):
        assert match_passes(walls, poses, newer, older, guess, 0.3) is None


@pytest.mark.parametrize("off_m", [0.0, 0.2, -0.2])
def test_the_same_side_is_one(drive: Drive, off_m: float) -> None:
    poses, walls = drive
    truth = between(poses, FIRST, AGAIN)
    guess = truth @ Pose2(0.0, off_m, 0.0)
    fit = match_passes(walls, poses, (AGAIN, REACH), (FIRST, REACH), guess, 0.3)
    assert fit is not None
    assert (truth.inverse() @ fit.target_from_source).distance < 0.03


def test_what_fits_nowhere_is_none(drive: Drive) -> None:
    poses, walls = drive
    away = Pose2(0.0, 20.0, 0.0)
    assert match_passes(walls, poses, (AGAIN, REACH), (FIRST, REACH), away, 0.3) is None
