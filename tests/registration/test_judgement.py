"""Whether a result is believed: its score, and whether it agrees with the motion expected."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from specmap_cli.core.geometry import IDENTITY, Pose2
from specmap_cli.core.settings import RegistrationConfig
from specmap_cli.registration.expected_motion import ExpectedMotion
from specmap_cli.registration.judgement import Verdict, judge, needed_score
from specmap_cli.registration.locating import Located
from specmap_cli.registration.scene import Fit

GUESS = Pose2(2.0, 1.0, 0.5)


def judged(
    away: Pose2 = IDENTITY,
    score: float = 0.9,
    motion: Pose2 = IDENTITY,
    *,
    searched: bool = False,
    measured: bool = True,
    **settings: float,
) -> Verdict:
    """The verdict on a result so far `away` from its guess."""
    expected = ExpectedMotion(
        motion=motion,
        carried=motion,
        during=motion,
        interval_s=0.1,
        measured=measured,
        jumped=False,
        shortened=False,
    )
    fit = Fit(pose=(GUESS @ away).matrix(), score=score, refused=2)
    located = Located(fit=fit, searched=searched, wide_searched=False)
    config = RegistrationConfig.model_validate(settings)
    return judge(located, GUESS.matrix(), expected, config)


@pytest.mark.parametrize(
    ("away", "motion", "measured", "agrees"),
    [
        # at rest odometry may err by 5 cm and 0.03 rad
        (Pose2(0.049, 0.0, 0.0), IDENTITY, True, True),
        (Pose2(0.0, -0.051, 0.0), IDENTITY, True, False),
        (Pose2(0.0, 0.0, -0.029), IDENTITY, True, True),
        (Pose2(0.0, 0.0, 0.031), IDENTITY, True, False),
        # and by a share of what it measured
        (Pose2(0.129, 0.0, 0.0), Pose2(0.4, 0.0, 0.0), True, True),
        (Pose2(0.131, 0.0, 0.0), Pose2(0.4, 0.0, 0.0), True, False),
        (Pose2(0.0, 0.0, 0.149), Pose2(0.0, 0.0, -0.4), True, True),
        (Pose2(0.0, 0.0, 0.151), Pose2(0.0, 0.0, -0.4), True, False),
        # a motion carried on errs by how a robot speeds up
        (Pose2(0.099, 0.0, 0.119), IDENTITY, False, True),
        (Pose2(0.101, 0.0, 0.0), IDENTITY, False, False),
        (Pose2(0.0, 0.0, 0.121), IDENTITY, False, False),
        # a long motion proves nothing
        (IDENTITY, Pose2(0.499, 0.0, 0.499), True, True),
        (IDENTITY, Pose2(0.3, 0.4, 0.0), True, False),
        (IDENTITY, Pose2(0.0, 0.0, -0.5), True, False),
    ],
)
def test_a_result_agrees_when_it_is_as_near_as_the_motion_can_have_been(
    away: Pose2, motion: Pose2, measured: bool, agrees: bool
) -> None:
    assert judged(away, motion=motion, measured=measured).agrees == agrees


@pytest.mark.parametrize(
    ("searched", "measured", "needed"),
    [(False, True, 0.5), (False, False, 0.5), (True, True, 0.7), (True, False, 0.6)],
)
def test_a_contradiction_must_score_well(searched: bool, measured: bool, needed: float) -> None:
    far = Pose2(0.4, 0.0, 0.0)
    for score, lost in ((needed - 0.01, True), (needed, False)):
        verdict = judged(far, score, searched=searched, measured=measured)
        assert (verdict.agrees, verdict.lost) == (False, lost)
    config = RegistrationConfig()
    assert needed_score(config, searched=searched, measured=measured) == needed


def test_needed_scores_are_settings() -> None:
    config = RegistrationConfig(poor_score=0.1, sure_score=0.2, fair_score=0.3)
    flags = list(itertools.product((False, True), repeat=2))
    found = [needed_score(config, searched=s, measured=m) for s, m in flags]
    assert found == [0.1, 0.1, 0.3, 0.2]


def test_agreement_helps_all_but_the_hopeless() -> None:
    assert not judged(score=0.15).lost
    assert judged(score=0.149).lost
    assert judged(score=0.149).agrees


def test_a_lost_sweep_is_put_back_on_its_guess() -> None:
    lost = judged(Pose2(0.6, 0.2, 0.3), 0.3)
    assert lost.lost
    assert lost.fit.planar == GUESS
    assert (lost.fit.score, lost.fit.refused) == (0.3, 2)
    kept = judged(Pose2(0.6, 0.2, 0.3), 0.8)
    assert np.allclose(kept.fit.planar, GUESS @ Pose2(0.6, 0.2, 0.3))


@pytest.mark.parametrize(
    ("away", "score", "measured", "told"),
    [
        (IDENTITY, 0.4, True, True),
        (IDENTITY, 0.9, True, False),  # not lost
        (IDENTITY, 0.1, True, False),  # lost anyhow
        (Pose2(2.0, 0.0, 0.0), 0.4, True, False),  # against odometry
        (IDENTITY, 0.4, False, False),  # odometry said nothing
    ],
)
def test_what_is_lost_for_the_length_of_the_step_alone_is_told(
    away: Pose2, score: float, measured: bool, told: bool
) -> None:
    motion = Pose2(0.7, 0.0, 0.0)
    verdict = judged(away, score, motion, measured=measured)
    assert verdict.long
    assert verdict.lost_by_length == told
    if told:
        believed = judged(away, score, motion, believed_step_m=0.8)
        assert not believed.long
        assert not believed.lost


def test_believed_turns_are_a_setting() -> None:
    turn = Pose2(0.0, 0.0, 0.7)
    assert judged(score=0.4, motion=turn).lost_by_length
    assert not judged(score=0.4, motion=turn, believed_step_rad=0.8).lost


@given(st.floats(-3.1, 3.1), st.floats(-1.2, 1.2), st.floats(-1.2, 1.2), st.floats(0.0, 1.0))
def test_levelling_takes_back_tilt_and_nothing_else(
    yaw: float, pitch: float, roll: float, share: float
) -> None:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
    pose[:3, 3] = 1.0, -2.0, 0.3
    level = Verdict(fit=Fit(pose=pose, score=0.8), agrees=False).levelled(share)
    assert (level.fit.score, level.agrees) == (0.8, False)
    assert np.array_equal(level.fit.pose[:, 3], pose[:, 3])
    angles = Rotation.from_matrix(level.fit.pose[:3, :3]).as_euler("ZYX")
    assert angles == pytest.approx([yaw, (1 - share) * pitch, (1 - share) * roll], abs=1e-6)
    assert np.array_equal(pose[:3, 3], [1.0, -2.0, 0.3])  # the first verdict is as it was
