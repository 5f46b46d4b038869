"""The frame of a map: its axes lie along the walls of the building.

The frame in which a robot is tracked begins with the robot's first pose, so that its axes are those
of nothing. In a frame that follows the walls every recording of a building is drawn alike, walls
run along the rows and columns of the grids, and what is measured in cells hangs less on chance.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from specmap_cli.core.geometry import FloatArray, compose, evenly
from specmap_cli.core.settings import RelaxationConfig
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.layout.path_graph import MATCH_RANGE_M
from specmap_cli.layout.result import Layout

_QUARTER = math.pi / 2.0  # walls meet at right angles: a direction counts but for quarter turns
_MOST = 400  # keyframes asked, evenly spread: what they say of the directions hardly differs
_APART = (4, 8)  # beams from one end of a piece of wall to the other
_LENGTHS_M = (0.2, 1.5)  # of a piece: longer than the noise of a reading, shorter than most walls
_BENT_M = 0.03  # a piece is straight when its middle lies this near to the line of its ends
_BINS = 360  # of a quarter turn
_SPREAD_RAD = math.radians(3.0)  # of the curve that the bins are smoothed by: a layout is bent some
_NEAR_RAD = (0.1, 0.05)  # pieces this near to the direction say what it is exactly, in two rounds
# Of evenly spread directions a ninth is that near to any; a building has one of which are twice as
# many, or it has none.
_CLEAR = 2.0 * 2.0 * _NEAR_RAD[0] / _QUARTER
_STEP_RAD = 1e-4  # what the turn is rounded to: a centimetre over a hundred metres


def along_walls(layout: Layout, store: KeyframeStore, config: RelaxationConfig) -> Layout:
    """The layout turned about the map's origin so that most walls are parallel to an axis.

    Of the four such turns it is the smallest, so none is above 45 degrees. A building of which no
    direction stands out stays as it is. Deterministic.
    """
    if not config.follow_walls:
        return layout
    turn = -wall_direction(*_pieces(store, layout.poses))
    if turn == 0.0:
        return layout
    return replace(layout, poses=compose(np.array([0.0, 0.0, turn]), layout.poses))


def wall_direction(directions: FloatArray, lengths: FloatArray) -> float:
    """The direction, in [-pi/4, pi/4], of most metres of wall, or of walls at right angles to them.

    `directions` (n,) are those of pieces of wall, `lengths` (n,) their metres. 0 when no direction
    stands out.
    """
    if not len(lengths):
        return 0.0
    # the direction round which there are most metres of wall
    bins = np.floor(np.mod(directions, _QUARTER) * (_BINS / _QUARTER)).astype(np.intp) % _BINS
    metres = np.bincount(bins, weights=lengths, minlength=_BINS)
    around = np.arange(-_BINS // 2, _BINS // 2)
    curve = np.exp(-0.5 * (around * (_QUARTER / _BINS) / _SPREAD_RAD) ** 2)
    rows = (np.arange(_BINS)[:, None] + around) % _BINS
    peak = int((metres[rows] * curve).sum(axis=1).argmax())
    direction = (peak + 0.5) * (_QUARTER / _BINS)
    for near in _NEAR_RAD:
        # seen from it, in [-pi/4, pi/4), whatever quarter they are in
        off = np.mod(directions - direction + 0.5 * _QUARTER, _QUARTER) - 0.5 * _QUARTER
        taken = np.abs(off) < near
        if lengths[taken].sum() < _CLEAR * (near / _NEAR_RAD[0]) * lengths.sum():
            return 0.0
        direction += float((lengths * off)[taken].sum() / lengths[taken].sum())
    nearest = float(np.mod(direction + 0.5 * _QUARTER, _QUARTER)) - 0.5 * _QUARTER
    return round(nearest / _STEP_RAD) * _STEP_RAD


def _pieces(store: KeyframeStore, poses: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Directions (n,) in the map and lengths (n,) of straight pieces of wall in some keyframes."""
    found = [np.zeros((2, 0))]
    shortest, longest = _LENGTHS_M
    for number in evenly(np.arange(len(store)), _MOST).tolist():
        heading = poses[number, 2] + store.base_from_laser(number).theta
        scan = store.scan(number)
        ranges = np.where(scan.ranges <= MATCH_RANGE_M, scan.ranges, np.nan)
        angles = heading + scan.bearings
        points = np.stack([ranges * np.cos(angles), ranges * np.sin(angles)])
        for apart in _APART:
            start, end, half = points[:, :-apart], points[:, apart:], apart // 2
            along, sag = end - start, 0.5 * (start + end) - points[:, half:-half]
            length = np.hypot(along[0], along[1])
            wall = (length > shortest) & (length < longest) & (np.hypot(sag[0], sag[1]) < _BENT_M)
            found.append(np.stack([np.arctan2(along[1], along[0])[wall], length[wall]]))
    directions, lengths = np.concatenate(found, axis=1)
    return directions, lengths
