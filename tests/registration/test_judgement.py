"""Whether a result is believed: what the walls say of it, and whether it agrees with the motion."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from specmap_cli.core.geometry import IDENTITY, Pose2
from specmap_cli.core.settings import RegistrationConfig
from specmap_cli.registration.guess import MotionGuess
from specmap_cli.registration.judgement import Judgement, judge
from specmap_cli.registration.local_map import Fit, Support
from specmap_cli.registration.locating import Located
from specmap_cli.registration.motion import ExpectedMotion

GUESS = Pose2(2.0, 1.0, 0.5)


def judged(
    score: float = 0.9,
    support: Support | None = None,
    away: Pose2 = IDENTITY,
    *,
    agrees: bool = True,
    searched: bool = False,
    wide_searched: bool = False,
    measured: bool = True,
    unaligned: bool = False,
) -> Judgement:
    """What is thought of a result so far from its guess; by default all of it could be seen."""
    located = Located(
        fit=Fit(pose=(GUESS @ away).matrix(), score=score, refused=2),
        searched=searched,
        wide_searched=wide_searched,
        agrees=agrees,
        support=support or Support(score=score, share=1.0, count=100),
        unaligned=unaligned,
    )
    expected = ExpectedMotion(
        motion=IDENTITY,
        carried=IDENTITY,
        during=IDENTITY,
        interval_s=0.1,
        measured=measured,
        jumped=False,
        shortened=False,
    )
    guess = MotionGuess(
        pose=GUESS.matrix(), before=GUESS.matrix(), expected=expected, by_motion=GUESS
    )
    return judge(located, guess, RegistrationConfig())


@pytest.mark.parametrize(
    ("searched", "wide", "measured", "needed"),
    [
        (False, False, True, 0.5),
        (False, False, False, 0.5),
        (True, False, True, 0.7),
        (True, False, False, 0.6),
        (True, True, False, 0.7),
    ],
)
def test_a_contradiction_must_score_well(
    searched: bool, wide: bool, measured: bool, needed: float
) -> None:
    for score, lost in ((needed - 0.01, True), (needed, False)):
        found = judged(
            score, agrees=False, searched=searched, wide_searched=wide, measured=measured
        )
        assert (found.agrees, found.lost) == (False, lost)


@pytest.mark.parametrize("measured", [True, False])
def test_agreement_helps_all_but_the_hopeless(measured: bool) -> None:
    assert not judged(0.15, measured=measured).lost
    assert judged(0.149, measured=measured).lost
    assert judged(0.149, measured=measured).agrees


@pytest.mark.parametrize(
    ("support", "lost"),
    [
        (Support(score=0.9, share=0.3, count=30), False),  # the rest of the walls is new
        (Support(score=0.1, share=0.3, count=30), True),  # what could be seen is not there
        (Support(score=0.1, share=0.05, count=5), False),  # five points say nothing
        (Support(score=0.0, share=0.0, count=0), False),
    ],
)
def test_only_walls_that_could_be_seen_speak_against_odometry(support: Support, lost: bool) -> None:
    assert judged(0.05, support).lost == lost
    assert judged(0.05, support, measured=False).lost  # a motion carried on is no witness


def test_without_odometry_a_contradiction_may_see_new_space_too() -> None:
    half_new = Support(score=0.65, share=0.6, count=60)
    mostly_new = Support(score=0.65, share=0.4, count=40)
    for support, measured, lost in (
        (half_new, False, False),
        (half_new, True, True),
        (mostly_new, False, True),
    ):
        found = judged(0.4, support, agrees=False, searched=True, measured=measured)
        assert found.lost == lost


def test_a_lost_sweep_is_put_back_on_its_guess() -> None:
    away = Pose2(0.6, 0.2, 0.3)
    lost = judged(0.3, away=away, agrees=False)
    assert lost.lost
    assert lost.fit.planar == GUESS
    assert (lost.fit.score, lost.fit.refused) == (0.3, 2)
    kept = judged(0.8, away=away, agrees=False)
    assert np.allclose(kept.fit.planar, GUESS @ away)


@pytest.mark.parametrize(
    ("score", "share", "unaligned", "certain", "proven"),
    [
        (0.76, 1.0, False, True, False),
        (0.75, 1.0, False, False, False),
        (0.86, 0.5, False, True, True),
        (0.86, 0.49, False, False, False),  # too little was seen
        (0.95, 1.0, True, False, False),  # odometry must not be its own witness
    ],
)
def test_walls_alone_prove_a_result_that_fits_well(
    score: float, share: float, unaligned: bool, certain: bool, proven: bool
) -> None:
    support = Support(score=score, share=share, count=60)
    found = judged(0.6, support, unaligned=unaligned)
    assert (found.certain, found.proven) == (certain, proven)


@pytest.mark.parametrize(
    ("score", "share", "founds", "refutes"),
    [
        (0.6, 0.2, True, False),
        (0.59, 0.2, False, True),
        (0.59, 0.19, False, False),  # too little was seen for either
        (0.9, 0.19, False, False),
    ],
)
def test_what_founds_a_map_and_what_refutes_one(
    score: float, share: float, founds: bool, refutes: bool
) -> None:
    found = judged(0.6, Support(score=score, share=share, count=40))
    assert (found.founds, found.refutes) == (founds, refutes)
    lost = judged(0.1)
    assert (lost.founds, lost.refutes) == (False, True)


@given(st.floats(-3.1, 3.1), st.floats(-1.2, 1.2), st.floats(-1.2, 1.2), st.floats(0.0, 1.0))
def test_levelling_takes_back_tilt_and_nothing_else(
    yaw: float, pitch: float, roll: float, share: float
) -> None:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
    pose[:3, 3] = 1.0, -2.0, 0.3
    level = Judgement(fit=Fit(pose=pose, score=0.8), agrees=False).levelled(share)
    assert (level.fit.score, level.agrees) == (0.8, False)
    assert np.array_equal(level.fit.pose[:, 3], pose[:, 3])
    angles = Rotation.from_matrix(level.fit.pose[:3, :3]).as_euler("ZYX")
    assert angles == pytest.approx([yaw, (1 - share) * pitch, (1 - share) * roll], abs=1e-6)
    assert np.array_equal(pose[:3, 3], [1.0, -2.0, 0.3])  # the first one is as it was
