"""Rival places: refuted closures that agree with each other on where a piece of the way lies.

Where nothing measured the way over a hole or a break, closures and passes alone say where the robot
was afterwards. In a building whose wings look alike many of them may agree and be wrong. Then the
few that lead to the right place were refuted; but they agree, too, which chance hardly makes.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from specmap_cli.core.findings import Finding, Where
from specmap_cli.core.geometry import IDENTITY, Pose2
from specmap_cli.core.text import counted
from specmap_cli.layout.pose_graph import Link
from specmap_cli.quality.evidence import Evidence
from specmap_cli.quality.holes import STILL_RAD
from specmap_cli.quality.placed import MOVED_M

RIVAL = "rival-place"
_LEAST = 2  # that agree to a metre and a few degrees: of wrong ones no two do by chance


def rival_places(evidence: Evidence) -> Iterator[Finding]:
    """Pieces after an unmeasured hole or break that several refuted closures put elsewhere."""
    poses = [Pose2(*pose) for pose in evidence.layout.poses.tolist()]
    for start in _unmeasured(evidence):
        across = [link for link in evidence.layout.dropped if _spans(link, start)]
        votes, correction = _largest_agreement(across, poses)
        if votes < _LEAST:
            continue
        here = poses[start]
        away_m = (here.inverse() @ correction @ here).distance
        stamp_ns = evidence.keyframes_ns[start]
        yield Finding(
            code=RIVAL,
            severity="doubtful",
            message=f"{counted(votes, 'refuted loop closure')} agree that what follows "
            f"{stamp_ns * 1e-9:.3f} s lies {away_m:.1f} m elsewhere, and nothing measured the way "
            "there: parts of the building look alike",
            advice="record odometry, and without holes",
            value=float(votes),
            limit=float(_LEAST),
            where=Where.of(stamp_ns, evidence.place_of(start)),
        )


def _unmeasured(evidence: Evidence) -> list[int]:
    """The keyframes before which nothing measured the way."""
    starts = {hole.keyframe for hole in evidence.holes if hole.measured is None}
    if not evidence.measured.any():
        starts |= set(evidence.breaks)
    return sorted(start for start in starts if start < len(evidence.keyframes_ns))


def _spans(link: Link, start: int) -> bool:
    return link.kind == "closure" and (link.source < start) != (link.target < start)


def _largest_agreement(links: Sequence[Link], poses: Sequence[Pose2]) -> tuple[int, Pose2]:
    """How many links agree on one motion of the newer piece in the map, and that motion.

    What moves it no farther than `MOVED_M` is no other place. Links of one keyframe count once.
    """
    best, motion = 0, IDENTITY
    for one in links:
        correction = _correction(one, poses)
        newer = poses[max(one.source, one.target)]
        if (newer.inverse() @ correction @ newer).distance <= MOVED_M:
            continue
        agreeing = [other for other in links if _agrees(other, correction, poses)]
        votes = min(
            len({min(link.source, link.target) for link in agreeing}),
            len({max(link.source, link.target) for link in agreeing}),
        )
        if votes > best:
            best, motion = votes, correction
    return best, motion


def _correction(link: Link, poses: Sequence[Pose2]) -> Pose2:
    """The motion in the map frame that takes the newer end of a link to where it says."""
    claimed = link.source_from_target
    if link.source < link.target:
        return poses[link.source] @ claimed @ poses[link.target].inverse()
    return poses[link.target] @ claimed.inverse() @ poses[link.source].inverse()


def _agrees(link: Link, correction: Pose2, poses: Sequence[Pose2]) -> bool:
    """Whether a link puts its newer end where a motion takes it."""
    newer = poses[max(link.source, link.target)]
    apart = (correction @ newer).inverse() @ (_correction(link, poses) @ newer)
    return bool(apart.distance <= MOVED_M and abs(apart.theta) <= STILL_RAD)
