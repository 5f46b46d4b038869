"""Findings about what nothing measured, and about odometry that tells something else."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from specmap_cli.core.arrays import runs
from specmap_cli.core.findings import Finding, Where
from specmap_cli.core.geometry import FloatArray, compose, invert, step_lengths, travelled
from specmap_cli.core.records import IntArray
from specmap_cli.quality.evidence import Evidence, place_at

_UNMEASURED_M = 2.0  # longest way that nothing measured; a quarter of it may be wrong
ODOMETRY_WINDOW_M = 5.0  # way over which odometry is compared with the map
ODOMETRY_SHARE = 0.3  # share of the way by which both may differ in the median: wheels err less
# Share of the way in a single place, where wheels slip, before it is noted.
ODOMETRY_SLIP_SHARE = 0.5
UNMEASURED, ODOMETRY = "unmeasured-way", "odometry-disagrees"
_PACE_PERCENTILE = 75.0  # of the steps of a robot that moves: it slows down in turns and at doors


def unmeasured_way(evidence: Evidence) -> Iterator[Finding]:
    """Stretches whose length is a guess: bare corridors that no odometry measures.

    Registration cannot tell there how far the robot came. As long as the scans lasted, the robot
    is taken to have gone on as fast as elsewhere.
    """
    trajectory = evidence.trajectory
    if trajectory.blind is None or not trajectory.blind.any():
        return
    steps = step_lengths(trajectory.poses)
    seen = ~(trajectory.blind[1:] | trajectory.blind[:-1])
    pace_m = float(np.percentile(steps[seen], _PACE_PERCENTILE)) if seen.any() else 0.0
    for start, end in runs(trajectory.blind):
        way_m = pace_m * (end - start)
        if not trajectory.blind[start] or way_m <= _UNMEASURED_M:
            continue
        stamp_ns = int(trajectory.stamps_ns[start])
        yield Finding(
            code=UNMEASURED,
            severity="doubtful",
            message=f"from {stamp_ns * 1e-9:.3f} s on, for {end - start:,} scans, the walls do not "
            f"show how far the robot came, and no odometry does: about {way_m:.0f} m are a guess",
            advice="record odometry",
            value=way_m,
            limit=_UNMEASURED_M,
            where=Where.of(stamp_ns, place_at(trajectory, start)),
        )


def odometry_disagrees(evidence: Evidence) -> Iterator[Finding]:
    """Odometry that tells another way than the map: everywhere, or in single places.

    Everywhere: it is of another robot or clock, or the laser is not where the log says. In a single
    place wheels slip, which is no fault of the map.
    """
    trajectory = evidence.trajectory
    if trajectory.odometry is None or not evidence.measured.any():
        return
    rows, apart = _deviations(trajectory.poses, trajectory.odometry, ODOMETRY_WINDOW_M)
    if not len(rows):
        return
    usual, worst = float(np.median(apart)), int(apart.argmax())
    everywhere = usual > ODOMETRY_SHARE
    if not everywhere and apart[worst] <= ODOMETRY_SLIP_SHARE:
        return
    row = int(rows[worst])
    stamp_ns = int(trajectory.stamps_ns[row])
    yield Finding(
        code=ODOMETRY,
        severity="doubtful" if everywhere else "note",
        message=f"odometry and the map disagree by {usual:.0%} of the way nearly everywhere"
        if everywhere
        else f"odometry and the map disagree by {apart[worst]:.0%} of the way at "
        f"{stamp_ns * 1e-9:.3f} s, elsewhere by {usual:.0%}",
        advice="is the odometry of this robot and this clock, is the laser where the log says?"
        if everywhere
        else "",
        value=usual if everywhere else float(apart[worst]),
        limit=ODOMETRY_SHARE if everywhere else ODOMETRY_SLIP_SHARE,
        where=Where.of(stamp_ns, place_at(trajectory, row)),
    )


def _deviations(
    poses: FloatArray, odometry: FloatArray, window_m: float
) -> tuple[IntArray, FloatArray]:
    """Rows at which windows of the way begin, and how far both differ over each, as its share."""
    way = travelled(poses)
    starts = np.searchsorted(way, np.arange(0.0, way[-1] - window_m, 0.5 * window_m))
    ends = np.searchsorted(way, way[starts] + window_m)
    known = ends < len(way)
    known[known] &= np.isfinite(odometry[starts[known], 0] + odometry[ends[known], 0])
    starts, ends = starts[known], ends[known]
    by_map = compose(invert(poses[starts]), poses[ends])
    by_odometry = compose(invert(odometry[starts]), odometry[ends])
    apart = compose(invert(by_map), by_odometry)
    return starts.astype(np.int64), np.hypot(apart[:, 0], apart[:, 1]) / window_m
