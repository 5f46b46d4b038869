"""Whether a result is believed: what the walls say of it, and whether it agrees with the motion."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from specmap_cli.core.geometry import IDENTITY, FloatArray, Pose2
from specmap_cli.core.records import PosedScan, Sweep
from specmap_cli.core.settings import RegistrationConfig
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.registration import FrontEnd
from specmap_cli.registration.local_map import Fit, Support
from specmap_cli.registration.trust import Founding, Judgement, Located, judge, looked_through
from tests.casting import keyframe
from tests.registration.drives import circle, expecting, guess_of, path, sweeps, with_ranges, worst

GUESS = Pose2(2.0, 1.0, 0.5)


def judged(
    score: float = 0.9,
    support: Support | None = None,
    away: Pose2 = IDENTITY,
    *,
    measured: bool = True,
    **found: Any,
) -> Judgement:
    """What is thought of a result so far from its guess; by default all of it could be seen."""
    located = Located(
        fit=Fit(pose=(GUESS @ away).matrix(), score=score, refused=2),
        support=support or Support(score=score, share=1.0, count=100),
        **{"searched": False, "wide_searched": False, "agrees": True, **found},
    )
    return judge(located, guess_of(GUESS, expecting(measured=measured)), RegistrationConfig())


@pytest.mark.parametrize(
    ("least", "found"),
    [
        (0.5, {"agrees": False}),
        (0.5, {"agrees": False, "measured": False}),
        (0.7, {"agrees": False, "searched": True}),
        (0.6, {"agrees": False, "searched": True, "measured": False}),
        (0.7, {"agrees": False, "searched": True, "wide_searched": True, "measured": False}),
        (0.15, {}),
        (0.15, {"measured": False}),
    ],
)
def test_agreement_may_score_worse_than_contradiction(least: float, found: dict[str, Any]) -> None:
    for score, lost in ((least - 0.001, True), (least, False)):
        judgement = judged(score, **found)
        assert (judgement.agrees, judgement.lost) == (found.get("agrees", True), lost)


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


@pytest.mark.parametrize(
    ("share", "measured", "lost"), [(0.6, False, False), (0.6, True, True), (0.4, False, True)]
)
def test_without_odometry_new_space_may_be_seen(share: float, measured: bool, lost: bool) -> None:
    support = Support(score=0.65, share=share, count=round(100 * share))
    assert judged(0.4, support, agrees=False, searched=True, measured=measured).lost == lost


def test_a_lost_sweep_is_put_back_on_its_guess() -> None:
    away = Pose2(0.6, 0.2, 0.3)
    lost = judged(0.3, away=away, agrees=False)
    assert lost.lost
    assert lost.fit.planar == GUESS
    assert (lost.fit.score, lost.fit.refused) == (0.3, 2)
    assert np.allclose(judged(0.8, away=away, agrees=False).fit.planar, GUESS @ away)


@pytest.mark.parametrize(
    ("score", "share", "unaligned", "said"),
    [
        (0.76, 1.0, False, {"certain", "founds"}),
        (0.75, 1.0, False, {"founds"}),
        (0.86, 0.5, False, {"certain", "proven", "founds"}),
        (0.86, 0.49, False, {"founds"}),  # too little was seen to prove it
        (0.95, 1.0, True, {"founds"}),  # odometry must not be its own witness
        (0.6, 0.2, False, {"founds"}),
        (0.59, 0.2, False, {"refutes"}),
        (0.59, 0.19, False, set()),  # too little was seen for either
        (0.9, 0.19, False, set()),
    ],
)
def test_what_walls_alone_prove_and_what_founds_a_map_or_refutes_one(
    score: float, share: float, unaligned: bool, said: set[str]
) -> None:
    found = judged(0.6, Support(score=score, share=share, count=50), unaligned=unaligned)
    names = ("certain", "proven", "founds", "refutes")
    assert {name for name in names if getattr(found, name)} == said
    lost = judged(0.1)
    assert (lost.founds, lost.refutes) == (False, True)


@given(st.floats(-3.1, 3.1), st.floats(-1.2, 1.2), st.floats(-1.2, 1.2), st.floats(0.0, 1.0))
def test_levelling_undoes_tilt_alone(yaw: float, pitch: float, roll: float, share: float) -> None:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
    pose[:3, 3] = 1.0, -2.0, 0.3
    level = Judgement(fit=Fit(pose=pose, score=0.8), agrees=False).levelled(share)
    assert (level.fit.score, level.agrees) == (0.8, False)
    assert np.array_equal(level.fit.pose[:, 3], pose[:, 3])
    angles = Rotation.from_matrix(level.fit.pose[:3, :3]).as_euler("ZYX")
    assert angles == pytest.approx([yaw, (1 - share) * pitch, (1 - share) * roll], abs=1e-6)
    assert np.array_equal(pose[:3, 3], [1.0, -2.0, 0.3])  # the first one is as it was


def scan(index: int, *, lost: bool = False, restarted: bool = False) -> PosedScan:
    made = keyframe(circle(index, np.ones(4)).planar, IDENTITY, number=index)
    return dataclasses.replace(made, lost=lost, restarted=restarted)


def told(scans: tuple[PosedScan, ...]) -> list[tuple[int, bool, bool]]:
    return [(each.index, each.lost, each.restarted) for each in scans]


def test_scans_wait_until_the_map_is_founded() -> None:
    founding = Founding(5)
    assert founding.handed_on(scan(0), founded=False) == ()
    assert founding.handed_on(scan(1, lost=True), founded=False) == ()
    settled = founding.handed_on(scan(2), founded=True)
    assert told(settled) == [(0, False, False), (1, True, False), (2, False, False)]
    assert told(founding.handed_on(scan(3), founded=True)) == [(3, False, False)]
    assert founding.rest() == ()


def test_scans_of_a_map_that_is_given_up_are_lost_and_the_next_one_restarts() -> None:
    founding = Founding(5)
    founding.handed_on(scan(7, restarted=True), founded=False)
    founding.handed_on(scan(8, lost=True), founded=False)
    assert founding.refute() == 1
    assert told(founding.handed_on(scan(9), founded=False)) == [(7, True, False), (8, True, False)]
    found = told(founding.handed_on(scan(10), founded=True))
    assert found == [(9, False, True), (10, False, False)]


def test_no_more_wait_than_allowed_and_the_end_of_a_log_settles_all() -> None:
    founding = Founding(3)
    handed = [founding.handed_on(scan(k), founded=False) for k in range(5)]
    assert [len(each) for each in handed] == [0, 0, 3, 0, 0]
    assert told(founding.rest()) == [(3, False, False), (4, False, False)]


def spoiled(items: list[Sweep], count: int) -> list[Sweep]:
    """The first sweeps hold ranges at random."""
    rng = np.random.default_rng(4)
    for k in range(count):
        items[k] = with_ranges(items[k], rng.uniform(0.3, 3.0, len(items[k].planar.ranges)))
    return items


@pytest.mark.parametrize("odometry", [True, False])
@pytest.mark.parametrize("count", [0, 1, 2, 5, 8])
def test_spoiled_first_scans_cost_no_other(world: GridMap, count: int, odometry: bool) -> None:
    truth = path()[:24]
    front_end = FrontEnd(RegistrationConfig())
    scans: list[PosedScan] = []
    for sweep in spoiled(sweeps(world, truth, odometry=odometry), count):
        scans += front_end.take(sweep)
    scans += front_end.rest()
    assert [each.index for each in scans] == list(range(24))
    assert [each.index for each in scans if each.lost] == list(range(count))
    assert not any(each.restarted for each in scans)
    assert worst(scans[count:], truth[count:])[0] < 0.08
    assert front_end.counts["lost"] == count
    assert front_end.counts["registered"] == 24 - count
    assert front_end.counts["breaks"] == 0


def ring(radius_m: float, first: float = -3.0, last: float = 3.0) -> FloatArray:
    angles = np.linspace(first, last, 200)
    return radius_m * np.column_stack([np.cos(angles), np.sin(angles)])


@pytest.mark.parametrize(
    ("walls", "share"),
    [
        (ring(2.0), 1.0),
        (ring(3.8), 0.0),  # as near the ends of the beams as noise brings them
        (ring(6.0), 0.0),
        (np.concatenate([ring(2.0), ring(4.0)]), 0.5),
    ],
)
@pytest.mark.parametrize("laser", [IDENTITY, Pose2(3.0, -1.0, 2.0)])
def test_a_look_through_walls_refutes_them(walls: FloatArray, share: float, laser: Pose2) -> None:
    scan = circle(0, np.full(90, 4.0)).planar
    assert looked_through(laser.apply(walls), scan, laser) == pytest.approx(share)


def test_walls_out_of_view_and_beams_without_return_say_nothing() -> None:
    full = circle(0, np.full(90, 4.0)).planar
    ahead = dataclasses.replace(full, bearings=np.linspace(-0.8, 0.8, 90), full_circle=False)
    assert looked_through(ring(2.0, 1.0, 3.0), ahead, IDENTITY) == 0.0
    assert looked_through(ring(2.0, -0.7, 0.7), ahead, IDENTITY) == 1.0
    blank = dataclasses.replace(full, ranges=np.full(90, np.inf))
    assert looked_through(ring(2.0), blank, IDENTITY) == 0.0
    assert looked_through(np.zeros((0, 2)), full, IDENTITY) == 0.0


@pytest.mark.parametrize("count", [1, 4, 5, 6, 7])
def test_a_spoiled_scan_amid_a_hall_is_no_keyframe_of_its_map(count: int) -> None:
    """What the first good scan sees lies where the spoiled ones did not look."""
    items = spoiled([circle(k, np.full(90, 6.0), IDENTITY) for k in range(12)], count)
    front_end = FrontEnd(RegistrationConfig())
    scans = [each for sweep in items for each in front_end.take(sweep)] + [*front_end.rest()]
    assert [each.index for each in scans if each.lost] == list(range(count))
