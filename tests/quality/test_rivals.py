"""Refuted closures that agree on another place."""

from __future__ import annotations

import tracemalloc
from collections.abc import Sequence

import numpy as np
import pytest

from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.layout.pose_graph import Link
from specmap_cli.quality.findings import rival_places
from tests.layout.driving import link
from tests.quality.evidence import evidence_of

SCANS, BREAK = 60, 30
POSES: FloatArray = np.array([(k % BREAK, k // BREAK, 0.0) for k in range(SCANS)], dtype=np.float64)
ELSEWHERE = Pose2(20.0, -3.0, 0.5)  # a motion of the map
NEARLY = Pose2(0.2, 0.1, 0.02)


def claim(older: int, newer: int, motion: Pose2) -> Link:
    """A refuted closure by which a motion of the map takes keyframe `newer` to its place."""
    a, b = (Pose2(*POSES[k].tolist()) for k in (older, newer))
    return link(older, newer, a.inverse() @ motion @ b, kind="closure")


def backwards(one: Link) -> Link:
    """The same claim, from the newer keyframe to the older."""
    return link(one.target, one.source, one.source_from_target.inverse(), kind="closure")


def found(refuted: Sequence[Link], *, odometry: bool = False) -> list[str]:
    measured = POSES if odometry else np.full((SCANS, 3), np.nan)
    left_out = {"dropped": tuple(refuted)}
    evidence = evidence_of(POSES, odometry=measured, layout=left_out, breaks=(BREAK,))
    return [finding.message for finding in rival_places(evidence)]


def test_refuted_closures_that_agree_on_another_place_are_told() -> None:
    agreeing = [claim(3, 40, ELSEWHERE), claim(8, 50, ELSEWHERE @ NEARLY)]
    (message,) = found([*agreeing, claim(5, 45, Pose2(-9.0, 4.0, 2.0))])
    assert message.startswith("2 refuted loop closures agree that what follows 30.000 s lies ")
    at_start = Pose2(*POSES[BREAK].tolist())
    away = (at_start.inverse() @ ELSEWHERE @ at_start).distance
    assert f"lies {away:.1f} m elsewhere" in message
    assert found([backwards(one) for one in agreeing]) == [message]
    assert found(agreeing, odometry=True) == [], "where odometry measured the way"


@pytest.mark.parametrize(
    "refuted",
    [
        [claim(3, 40, ELSEWHERE)],
        [claim(3, 40, ELSEWHERE), claim(8, 50, Pose2(-9.0, 4.0, 2.0))],
        [claim(3, 40, ELSEWHERE), claim(3, 50, ELSEWHERE)],  # one view, two matches with it
        [claim(3, 40, NEARLY), claim(8, 50, NEARLY)],  # nearly where it is
        [claim(3, 10, ELSEWHERE), claim(8, 20, ELSEWHERE)],  # on one side of the break
    ],
)
def test_what_does_not_agree_on_another_place_is_not_told(refuted: list[Link]) -> None:
    assert found(refuted) == []


def test_the_memory_does_not_grow_with_the_square_of_the_refuted_closures() -> None:
    refuted = [claim(k % BREAK, BREAK + k % (SCANS - BREAK), ELSEWHERE) for k in range(1000)]
    tracemalloc.start()
    try:
        (message,) = found(refuted)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert message.startswith("30 refuted loop closures agree")
    assert peak < 5e6, "one motion a pair of them is 24 MB"
