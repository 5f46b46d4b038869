"""Findings about the front end: scans that were lost, and where the tracking broke."""

from __future__ import annotations

from collections.abc import Iterator

from specmap_cli.core.arrays import runs
from specmap_cli.core.findings import Finding, Where
from specmap_cli.core.text import counted
from specmap_cli.quality.evidence import Evidence, graded, place_at

_LOST_SHARE = 0.02  # share of lost scans above which a map is doubtful
_LOST_SHARE_POOR = 0.2  # share of lost scans above which a map is poor
LOST, BREAK = "lost-scans", "tracking-break"


def lost_scans(evidence: Evidence) -> Iterator[Finding]:
    """Scans that could not be registered: their share, and where most of them are in a row."""
    trajectory = evidence.trajectory
    lost = trajectory.lost
    if lost is None or not lost.any():
        return
    share = float(lost.mean())
    stretches = [(start, end) for start, end in runs(lost) if lost[start]]
    start, end = max(stretches, key=lambda stretch: stretch[1] - stretch[0])
    severity, limit = graded(share, _LOST_SHARE, _LOST_SHARE_POOR)
    stamp_ns = int(trajectory.stamps_ns[start])
    measured = evidence.measured.any()
    yield Finding(
        code=LOST,
        severity=severity,
        message=f"{counted(int(lost.sum()), 'scan')} of {len(lost):,} ({share:.1%}) could not be "
        f"registered, {end - start:,} in a row from {stamp_ns * 1e-9:.3f} s on",
        advice=""
        if severity == "note"
        else "has the laser returns all the time, and is the odometry of this robot and this "
        "clock? See `specmap info --check`"
        if measured
        else "record odometry, or more scans a second",
        value=share,
        limit=limit,
        where=Where.of(stamp_ns, place_at(trajectory, start)),
    )


def breaks(evidence: Evidence) -> Iterator[Finding]:
    """Where tracking started afresh; what is not tied to the rest is told of by `loose`."""
    measured = evidence.measured.any()
    bridge = "odometry" if measured else "the motion before"
    for keyframe in evidence.breaks:
        if keyframe >= len(evidence.keyframes_ns):
            continue
        stamp_ns = evidence.keyframes_ns[keyframe]
        yield Finding(
            code=BREAK,
            severity="note",
            message=f"registration lost the robot before {stamp_ns * 1e-9:.3f} s and started "
            f"afresh, where {bridge} led",
            where=Where.of(stamp_ns, evidence.place_of(keyframe)),
        )
