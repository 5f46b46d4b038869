"""What odometry says of a map: where the laser sits, which way it went, and how far."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from specmap_cli.core.findings import Finding
from specmap_cli.core.geometry import (
    IDENTITY,
    FloatArray,
    Pose2,
    compose,
    invert,
    step_lengths,
    travelled,
    wrap_angles,
)
from specmap_cli.core.records import Trajectory
from specmap_cli.core.text import counted
from specmap_cli.quality.evidence import (
    ODOMETRY_SHARE,
    ODOMETRY_SLIP_SHARE,
    ODOMETRY_WINDOW_M,
    Evidence,
    graded,
    told,
)

ODOMETRY, MISPLACED = "odometry-disagrees", "laser-misplaced"

_OTHER_UNIT = 1.5  # times the way of the map: no wheels slip so, a unit or a gear is wrong
_STANDS = 1e-4  # times the way of the map: below any unit, the driver writes no motion
# By which a laser may sit elsewhere than the log says, and look elsewhere, before it is told.
_MISPLACED_M, _MISPLACED_RAD = 0.3, 0.05
_PIECE_M, _PIECE_RAD = 1.0, 0.5  # way and turn of a piece that tells where the laser is
_PIECES = 20  # fewer of them tell nothing
_LEAST_TURNS = 10  # pieces that turn: of fewer the noise may be the other way round
_SLOW = 0.5  # share of a piece below which it is the noise of a robot that stands
_ALIKE_RAD = 0.1  # turns of map and odometry, in most pieces that turn: late odometry has others
_HUBER, _MEDIAN_OFF = 1.345, 1.177  # standard deviations: where doubt begins; of half of all
_LEAST_OFF_M = 1e-3  # by which pieces differ at least: the last digit of a log
# Share by which a way may be longer by odometry than in the map: before a word, and in a right map.
_SCALED_NOTED, _SCALED = 0.1, 0.2
_FEWEST = 8  # pieces of the way that tell of a scale
_ROUNDS = 20  # of weighting the pieces anew: later ones change nothing


def laser_misplaced(evidence: Evidence) -> Iterator[Finding]:
    """A laser that is not where the log says: the way of the map is not that of the base."""
    by_map, by_odometry = (motions[:, 2] for motions in _pieces(evidence.trajectory))
    turning = np.abs(by_map) > _ALIKE_RAD
    mirrored = np.abs(wrap_angles(by_map + by_odometry)) <= _ALIKE_RAD
    otherwise, turns = int((mirrored & turning).sum()), int(turning.sum())
    if turns >= _LEAST_TURNS and 2 * otherwise > turns:
        yield Finding(
            code=MISPLACED,
            severity="doubtful",
            message=f"{otherwise} of {turns} turns of the map are the other way round by odometry: "
            "the laser hangs upside down and the map is a mirror image, or odometry is wrong",
            advice="give the transform from the base to the laser a roll of 180 degrees",
            value=otherwise / turns,
            limit=0.5,
        )
    base = base_by_odometry(evidence.trajectory)
    if base == IDENTITY:
        return
    laser, turn_rad = base.inverse() @ evidence.mounting, abs(base.theta)
    away = base.distance > _MISPLACED_M
    yield Finding(
        code=MISPLACED,
        # without a mounting in the log, the laser is the base, and the map is right of it
        severity="note" if evidence.mounting == IDENTITY else "doubtful",
        message=f"by odometry the laser sits on the base at x {laser.x:.2f} m, y {laser.y:.2f} m, "
        f"turned by {_degrees(laser.theta)}: {base.distance:.2f} m and {_degrees(turn_rad)} from "
        "where the log has it",
        advice="correct the transform from the base to the laser",
        value=base.distance if away else turn_rad,
        limit=_MISPLACED_M if away else _MISPLACED_RAD,
    )


def _degrees(angle: float) -> str:
    return counted(round(math.degrees(angle)), "degree")


def odometry_disagrees(evidence: Evidence) -> Iterator[Finding]:
    """Odometry that tells another way than the map: everywhere, or in single places.

    Everywhere that wheels turn: the laser is not where the log says, or the odometry is of another
    robot or clock. In a single place wheels slip, or the robot is carried, which is no fault of the
    map. Where it tells the same way, but longer or shorter all along, wheels or ranges err.
    """
    poses, odometry = evidence.trajectory.poses, evidence.trajectory.odometry
    if odometry is None or not evidence.measured.any():
        return
    poses = compose(poses, np.array(base_by_odometry(evidence.trajectory)))  # that of the wheels
    way = travelled(poses)
    starts = np.searchsorted(
        way, np.arange(0.0, way[-1] - ODOMETRY_WINDOW_M, 0.5 * ODOMETRY_WINDOW_M)
    )
    ends = np.searchsorted(way, way[starts] + ODOMETRY_WINDOW_M)
    known = ends < len(way)
    known[known] &= np.isfinite(odometry[starts[known], 0] + odometry[ends[known], 0])
    starts, ends = starts[known], ends[known]
    if not len(starts):
        return
    by_map, by_odometry = (compose(invert(p[starts]), p[ends]) for p in (poses, odometry))
    off = compose(invert(by_map), by_odometry)
    apart = np.hypot(off[:, 0], off[:, 1]) / ODOMETRY_WINDOW_M
    # wheels that stand while the map moves tell of a robot that is carried, unless they mostly do
    turned = np.nancumsum(step_lengths(odometry))
    times = (turned[ends - 1] - turned[starts]) / ODOMETRY_WINDOW_M
    driven = times > ODOMETRY_SHARE
    gone_m, driven_m = (np.hypot(*motions[:, :2].T) for motions in (by_map, by_odometry))
    straight = gone_m > 0.5 * ODOMETRY_WINDOW_M
    ratios = driven_m / np.where(straight, gone_m, np.inf)
    usual = float(np.median(apart[driven] if driven.mean() > ODOMETRY_SHARE else apart))
    worst = int(apart.argmax())
    everywhere = usual > ODOMETRY_SHARE
    if not everywhere:
        yield from _scaled(ratios[straight & driven])
    share = usual if everywhere else float(apart[worst])
    limit = ODOMETRY_SHARE if everywhere else ODOMETRY_SLIP_SHARE
    if share <= limit:
        return
    where = evidence.at_scan(int(starts[worst]))
    place = "nearly everywhere" if everywhere else f"at {told(where)}, elsewhere by {usual:.0%}"
    stands = times < _STANDS
    advice = ""
    if everywhere:
        advice = _unlike(float(np.median(ratios[straight] if straight.any() else times)))
    elif stands[worst]:
        advice = (
            f"by odometry the robot stands there, in all for {stands.mean():.0%} of the way: if "
            "nobody carried it, its odometry hung: build with --no-odometry"
        )
    yield Finding(
        code=ODOMETRY,
        severity="doubtful" if everywhere else "note",
        message=f"odometry and the map disagree by {share:.0%} of the way {place}",
        advice=advice,
        value=share,
        limit=limit,
        where=where,
    )


def _unlike(times: float) -> str:
    """What to do about odometry that goes so many times as far as the map, but another way."""
    if times < _STANDS:
        return "by odometry the robot stands still: build with --no-odometry"
    if 1.0 / _OTHER_UNIT < times < _OTHER_UNIT:
        return "is the odometry of this robot and this clock?"
    as_far = f"{float(f'{times:.2g}'):,g} times as far as the map"
    return f"odometry goes {as_far}: is it in metres, of these wheels and this gear?"


def _scaled(ratios: FloatArray) -> Iterator[Finding]:
    """Odometry that goes farther than the map, or less far, by one of these ratios (n,) all along.

    They are those of straight pieces of the way.
    """
    if len(ratios) < _FEWEST:
        return
    low, times, high = np.percentile(ratios, (25, 50, 75)).tolist()
    # what three quarters of the pieces are off by: wheels that slip do so in some
    off = max(low - 1.0, 1.0 - high)
    if off > _SCALED_NOTED:
        severity, limit = graded(off, _SCALED, math.inf)
        yield Finding(
            code=ODOMETRY,
            severity=severity,
            message=f"by odometry the robot goes {times:.2f} times as far as in the map all the "
            "way: wheels or ranges have a wrong scale",
            advice="measure one way in the building: the map has the scale of the ranges",
            value=off,
            limit=limit,
        )


def _pieces(trajectory: Trajectory) -> tuple[FloatArray, FloatArray]:
    """The motions (n, 3) of pieces of the way by the map, and by odometry; none without it."""
    if trajectory.odometry is None:
        return np.zeros((0, 3)), np.zeros((0, 3))
    known = np.isfinite(trajectory.odometry[:, 0])
    if trajectory.lost is not None:
        known &= ~trajectory.lost
    poses, odometry = trajectory.poses[known], trajectory.odometry[known]
    turned = np.append(0.0, np.abs(wrap_angles(np.diff(poses[:, 2])))).cumsum()[: len(poses)]
    pieces = travelled(poses) / _PIECE_M + turned / _PIECE_RAD
    cuts = np.flatnonzero(np.diff(pieces // 1.0))
    by_map, by_odometry = (compose(invert(p[cuts[:-1]]), p[cuts[1:]]) for p in (poses, odometry))
    return by_map, by_odometry


def base_by_odometry(trajectory: Trajectory) -> Pose2:
    """The base that odometry moves, seen from that of the map.

    Where the laser is not where the log says, the base of the map goes in a circle round the right
    one when the robot turns. In complex numbers a piece of the way that the map has as m, turned by
    a, is q = s (m + (exp(ia) - 1) p) by odometry: p is the place of the right base, s has its
    heading and the scale of the wheels (Censi et al., "Simultaneous Calibration of Odometry and
    Sensor Parameters for Mobile Robots", T-RO 2013). They follow by least squares with Huber's
    weights. IDENTITY where too little of the way tells of them, or where they are no more than
    `_MISPLACED_M` and `_MISPLACED_RAD` and two standard deviations off.
    """
    by_map, by_odometry = _pieces(trajectory)
    alike = np.abs(wrap_angles(by_map[:, 2] - by_odometry[:, 2])) <= _ALIKE_RAD
    turning = np.abs(by_map[:, 2]) > _ALIKE_RAD
    driven = np.hypot(*by_map[:, :2].T) / _PIECE_M + np.abs(by_map[:, 2]) / _PIECE_RAD > _SLOW
    used = alike & driven
    if used.sum() < _PIECES or 2 * (alike & turning).sum() < turning.sum():
        return IDENTITY
    m, q = (motions[used, 0] + 1j * motions[used, 1] for motions in (by_map, by_odometry))
    c, weights = np.exp(1j * by_map[used, 2]) - 1.0, np.ones(len(m))
    for _ in range(_ROUNDS):
        mm, cc = (weights * abs(m) ** 2).sum(), (weights * abs(c) ** 2).sum()
        mc, mq, cq = ((weights * a.conj() * b).sum() for a, b in ((m, c), (m, q), (c, q)))
        free = mm * cc - abs(mc) ** 2
        if not free > 0.0:  # it never turned, or drove one circle
            return IDENTITY
        s, sp = (cc * mq - mc * cq) / free, (mm * cq - mc.conj() * mq) / free
        off = abs(q - s * m - sp * c)
        usual = max(float(np.median(off)) / _MEDIAN_OFF, _LEAST_OFF_M)
        weights = _HUBER * usual / np.maximum(off, _HUBER * usual)
    if not abs(s) > 0.0:  # by the wheels it stood still
        return IDENTITY
    place, turn = sp / s, -float(np.angle(s))
    sure_m, sure_rad = 2.0 * usual / abs(s) * np.sqrt(np.array([mm, cc]) / free)
    elsewhere = abs(place) - sure_m > _MISPLACED_M or abs(turn) - sure_rad > _MISPLACED_RAD
    if sure_rad > _MISPLACED_RAD or not elsewhere:
        return IDENTITY
    return Pose2(float(place.real), float(place.imag), turn)
