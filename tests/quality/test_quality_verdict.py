import re
import tracemalloc
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from specmap_cli.core.findings import Finding, Quality, Severity, Where, summary
from specmap_cli.core.geometry import IDENTITY, FloatArray, Pose2, compose, invert
from specmap_cli.layout.audit import Agreement
from specmap_cli.layout.path_graph import step_information
from specmap_cli.layout.pose_graph import Link
from specmap_cli.layout.result import Layout, PartMove
from specmap_cli.quality.evidence import Evidence, Rival, Stretch, stretches_of
from specmap_cli.quality.findings import (
    is_of_recording,
    maybe_back,
    narrow_links,
    rival_places,
)
from tests.layout.driving import link
from tests.quality.evidence import evidence_of, judged

SCANS = 100  # a metre apart along x, one a second; every one a keyframe


def evidence(
    lost: tuple[int, ...] = (), breaks: tuple[int, ...] = (), *, odometry: bool = True
) -> Evidence:
    """A straight drive in which nothing is wrong but what is asked for."""
    poses = np.column_stack([np.arange(float(SCANS)), np.zeros((SCANS, 2))])
    measured = poses if odometry else np.full((SCANS, 3), np.nan)
    return evidence_of(poses, odometry=measured, lost=lost, breaks=breaks)


def travelled(base: Evidence, **fields: Any) -> Evidence:
    """The drive with a trajectory of which something else is known."""
    return replace(base, trajectory=replace(base.trajectory, **fields))


def only(found: Evidence) -> Finding:
    (finding,) = judged(found).findings
    return finding


def laid(base: Evidence | None = None, **fields: Any) -> Evidence:
    """The drive, or another one, with a layout of which something else is known."""
    base = base or evidence()
    return replace(base, layout=replace(base.layout, **fields))


@pytest.mark.parametrize(
    ("count", "severity", "limit"),
    [
        (1, "note", 0.02),
        (2, "note", 0.02),
        (3, "doubtful", 0.02),
        (20, "doubtful", 0.02),
        (21, "poor", 0.2),
    ],
)
def test_lost_scans_weigh_by_their_share(count: int, severity: Severity, limit: float) -> None:
    finding = only(evidence(lost=tuple(range(30, 30 + count))))
    assert (finding.code, finding.severity, finding.limit) == ("lost-scans", severity, limit)
    assert finding.value == pytest.approx(count / SCANS)
    assert finding.where == Where(30 * 10**9, 30.0, 0.0)


def test_lost_scans_are_told_at_the_longest_run() -> None:
    finding = only(evidence(lost=(3, 50, 51, 52, 80, 81)))
    said = "6 scans of 100 (6.0%) could not be registered, 3 in a row from 50.000 s on"
    assert finding.message == said
    assert finding.advice.startswith("has the laser returns all the time, and is the odometry of")
    alone = only(evidence(lost=(50, 51, 52), odometry=False))
    assert alone.advice == "record odometry, or more scans a second"


def test_each_break_is_told_with_what_bridged_it() -> None:
    found = judged(evidence(breaks=(40, 70)))
    assert [one.code for one in found.findings] == ["tracking-break"] * 2
    assert found.verdict == "good"
    assert found.findings[0].message == (
        "registration lost the robot before 40.000 s and started afresh, where odometry led"
    )
    blind = judged(evidence(breaks=(40,), odometry=False))
    assert blind.findings[0].message.endswith("where the motion before led")


@pytest.mark.parametrize(
    ("breaks", "way_m", "severity"),
    [((95,), 4, "doubtful"), ((60,), 39, "poor"), ((20, 25), 4, "doubtful")],
)
def test_what_a_guess_places_weighs_by_its_way_up_to_the_next_break(
    breaks: tuple[int, ...], way_m: int, severity: Severity
) -> None:
    found = judged(laid(loose=breaks[:1], base=evidence(breaks=breaks)))
    loose = found.findings[0]
    assert (loose.code, loose.severity, found.verdict) == ("loose-part", severity, severity)
    assert loose.value == pytest.approx(way_m / (SCANS - 1))
    assert loose.message == (
        f"a guess alone places the {way_m} m that follow {breaks[0]}.000 s: "
        "nothing there was recognised"
    )


def test_a_recording_that_meets_no_other_is_doubtful_however_long_it_is() -> None:
    found = judged(laid(loose=(60,), base=replace(evidence(breaks=(60,)), starts=(60,))))
    loose = found.findings[0]
    assert (loose.code, loose.severity, found.verdict) == ("loose-part", "doubtful", "doubtful")
    assert loose.message == (
        "nothing ties the 39 m recorded from 60.000 s on to the other recordings: where they lie "
        "beside these is arbitrary"
    )


@pytest.mark.parametrize(("share", "severity"), [(0.02, "doubtful"), (0.2, "poor")])
def test_walls_that_contradict_weigh_by_their_share(share: float, severity: Severity) -> None:
    wrong = round(10_000 * share)
    agreement = Agreement(agree=10_000 - wrong, contradict=wrong, worst=(5, 6, 60, 4))
    found = judged(laid(agreement=agreement, nodes=np.arange(SCANS), choice="relaxed")).findings
    assert [(one.code, one.severity) for one in found] == [("walls-disagree", severity)] * 2
    assert [one.place for one in found] == [(5.0, 0.0), (60.0, 0.0)], "6 and 4 are the same place"
    assert [one.value for one in found] == pytest.approx([share, share])


def test_the_gravest_come_first_and_of_all_but_the_input_the_worst_is_told() -> None:
    base = evidence(lost=(1,), breaks=(20, 40))
    found = judged(replace(base, beyond=1, warnings=("cut off", "laser tilted"))).findings
    codes = ["beyond-grid", "lost-scans", *["tracking-break"] * 2, *["input"] * 2]
    assert [one.code for one in found] == codes
    told = summary(found)
    assert told[-2:] == ["cut off", "laser tilted"]
    (broken,) = (line for line in told if line.startswith("registration lost the robot"))
    assert broken.endswith(" (and 1 more like it)")


@pytest.mark.parametrize(
    ("off_m", "verdict"), [(0.25, "good"), (0.5, "doubtful"), (1.1, "poor"), (9.0, "poor")]
)
def test_a_stretch_that_may_be_longer_is_told_by_how_much(off_m: float, verdict: str) -> None:
    base = evidence(odometry=False)
    short = Stretch(keyframe=80, way_m=2.0, off_m=0.1)
    stretches = (short, Stretch(keyframe=50, way_m=14.2, off_m=off_m))
    found = judged(replace(base, stretches=stretches))
    assert found.verdict == verdict
    if verdict == "good":
        assert found.findings == ()
        return
    (finding,) = found.findings
    assert (finding.code, finding.value) == ("unmeasured-way", off_m)
    assert finding.where == base.at_keyframe(50)
    assert finding.message == (
        f"the way at 50.000 s, 14 m, may be {off_m:.1f} m longer or shorter: walls do not show "
        "how far the robot came"
    )


def corridor_of(loop: bool) -> Layout:
    """Eleven nodes a metre apart, of which the way from 2 to 8 was guessed."""
    poses = np.column_stack([np.arange(11.0), np.zeros(11), np.zeros(11)])
    guesses = np.zeros((10, 2))
    guesses[2:8, 0] = 0.1
    fisher = np.repeat(1e6 * np.eye(3)[None], 10, axis=0)
    slacks = np.full((10, 3), np.inf)
    information = step_information([Pose2(1.0, 0.0, 0.0)] * 10, fisher, slacks, guesses)
    odometry = tuple(link(k, k + 1, [1.0, 0.0, 0.0], "odometry", information[k]) for k in range(10))
    kept = (link(1, 9, [8.0, 0.0, 0.0], "nearby", np.eye(3) / 0.05**2),) if loop else ()
    return Layout(poses=poses, nodes=np.arange(11), odometry=odometry, kept=kept)


def test_what_was_guessed_in_a_row_adds_up_and_what_ties_its_ends_takes_it_away() -> None:
    guessed = np.zeros((11, 2))
    guessed[:, 0] = np.clip(np.arange(11) - 2, 0, 6) * 0.1
    (alone,) = stretches_of(guessed, corridor_of(loop=False))
    assert alone.keyframe == 5
    assert alone.way_m == pytest.approx(6.0)
    assert alone.off_m == pytest.approx(2 * 0.6)
    (tied,) = stretches_of(guessed, corridor_of(loop=True))
    assert 0.1 < tied.off_m < 0.25
    (untied,) = stretches_of(guessed, Layout(poses=corridor_of(loop=False).poses))
    assert untied == alone, "a layout without a graph"
    assert stretches_of(np.zeros((11, 2)), corridor_of(loop=True)) == ()


@pytest.mark.parametrize(
    ("times", "by", "advice"),
    [
        (0.95, 0, ""),
        (0.68, 32, "of this robot"),
        (1.9, 90, "1.9 times as far as the map: is it in metres"),
        (1e3, 99_900, "in metres"),
        (1e-3, 100, "in metres"),
        (0.0, 100, "stands still"),
    ],
)
def test_odometry_of_another_robot_makes_a_map_doubtful(times: float, by: int, advice: str) -> None:
    base = evidence()
    found = judged(travelled(base, odometry=base.trajectory.poses * (times, 1.0, 1.0)))
    assert found.verdict == ("doubtful" if by else "good")
    messages = [f"odometry and the map disagree by {by}% of the way nearly everywhere"]
    assert [one.message for one in found.findings] == messages[: by > 0]
    assert [one.value for one in found.findings] == pytest.approx([abs(1.0 - times)][: by > 0])
    assert all(advice in one.advice for one in found.findings)


@pytest.mark.parametrize(("times", "severity"), [(1.25, "doubtful"), (0.85, "note")])
def test_odometry_that_goes_farther_by_one_ratio_is_told(times: float, severity: Severity) -> None:
    """Of wheels that slip on half of the way it is not."""
    base = evidence()
    odometry = np.array(base.trajectory.poses)
    finding = only(travelled(base, odometry=odometry * (times, 1.0, 1.0)))
    assert (finding.code, finding.severity) == ("odometry-disagrees", severity)
    assert f"{times} times as far" in finding.message
    odometry[:, 0] += (times - 1.0) * np.minimum(odometry[:, 0], SCANS // 2)
    assert judged(travelled(base, odometry=odometry)).findings == ()


def test_odometry_is_compared_where_there_is_some_and_a_slip_of_wheels_is_a_note() -> None:
    base = evidence()
    gapped, slipped = np.array([base.trajectory.poses] * 2)
    gapped[20:70] = np.nan
    assert judged(travelled(base, odometry=gapped)).findings == ()
    slipped[50:, 0] += 4.0
    finding = only(travelled(base, odometry=slipped))
    assert (finding.code, finding.severity) == ("odometry-disagrees", "note")
    assert finding.message.endswith("elsewhere by 0%")
    assert finding.place is not None
    assert 44.0 <= finding.place[0] <= 50.0


def wandering(away: Pose2 = IDENTITY, late: int = 0, turn: float = 1.0, **told: Any) -> Quality:
    """A drive whose map has the base `away` from that of odometry, which comes `late`."""
    rng = np.random.default_rng(0)
    angles = np.repeat(rng.uniform(-1.0, 1.0, 60), 8).cumsum() * 0.1
    steps = np.append(np.stack([np.cos(angles), np.sin(angles)]) * 0.1, [angles], axis=0).T
    wheels = np.append(steps[:, :2].cumsum(axis=0), angles[:, None], axis=1)
    odometry = np.roll(wheels, late, axis=0) * (1.0, 1.0, turn)
    noise = rng.normal(0.0, 0.01, wheels.shape) * (1.0, 1.0, 0.1)
    poses = compose(wheels, np.array(away)) + noise
    return judged(evidence_of(poses, 10**8, odometry=odometry, **told))


@pytest.mark.parametrize(
    ("away", "said"),
    [
        (Pose2(1.0, 0.2, 0.0), (1.2, 0.2, 0, 1.02, 0)),
        (Pose2(0.0, 0.0, -0.2), (0.196, -0.04, -11, 0, 11)),
        (Pose2(0.0, 0.2, 3.1), (-0.2, 0.21, 178, 0.2, 178)),
    ],
)
def test_odometry_and_map_tell_where_the_laser_is(away: Pose2, said: tuple[float, ...]) -> None:
    """The base is away from the right one as the log has the laser away from where it is."""
    (finding,) = wandering(away, mounting=Pose2(0.2, 0.0, 0.0)).findings
    assert (finding.code, finding.severity) == ("laser-misplaced", "doubtful")
    found = [float(number) for number in re.findall(r"-?\d+(?:\.\d+)?", finding.message)]
    assert found == pytest.approx(said, abs=0.02)
    (unknown,) = wandering(away).findings
    assert unknown.severity == "note"


def test_late_or_foreign_odometry_and_a_drive_without_turns_put_no_laser_elsewhere() -> None:
    near = wandering(Pose2(0.2, 0, 0.05))
    assert "upside down" in wandering(turn=-1.0).findings[0].message
    for found in (wandering(), wandering(late=5), near):
        assert "laser-misplaced" not in [one.code for one in found.findings]
    base = evidence()
    moved = compose(base.trajectory.poses, np.array((1.0, 0.0, 0.0)))
    assert judged(travelled(base, poses=moved)).findings == ()


@pytest.mark.parametrize(("end", "said"), [(70, "in all for 61% of"), (90, "stands still")])
def test_wheels_that_stand_say_nothing_of_odometry_elsewhere(end: int, said: str) -> None:
    """A robot that is carried for most of a drive; one whose wheels hardly turn at all."""
    base = evidence()
    carried = np.array(base.trajectory.poses)
    carried[10:end] = carried[10]
    carried[end:] -= carried[end] - carried[10]
    (found,) = judged(travelled(base, odometry=carried)).findings
    assert found.severity == ("note" if end == 70 else "doubtful")
    assert said in found.advice


@pytest.mark.parametrize(("votes", "severity"), [(1, "doubtful"), (2, "doubtful"), (3, "note")])
def test_a_piece_that_was_moved_far_is_told_of(votes: int, severity: Severity) -> None:
    moves = (
        PartMove(first=30, moved_m=0.5, votes=1),
        PartMove(first=60, moved_m=4.2, votes=votes),
        PartMove(first=80, moved_m=9.0, votes=0),  # loose, which is told elsewhere
    )
    finding = only(laid(parts=moves))
    assert (finding.code, finding.severity) == ("part-moved", severity)
    assert finding.message == (
        "the layout moved what follows 60.000 s by 4.2 m, to where closures and passes "
        f"({votes}) put it"
    )
    assert finding.value == pytest.approx(4.2)


TIES = tuple(link(1, 9, (0.0, 0.0, 0.0), kind) for kind in ("closure", "closure", "nearby"))


@pytest.mark.parametrize(
    ("found", "told"),
    [
        (
            laid(dropped=TIES),
            "note closures-refuted: 2 loop closures contradict the rest: left out",
        ),
        (
            laid(
                agreement=Agreement(agree=1000, contradict=100, worst=(0,)),
                nodes=np.array([7]),
                choice="relaxed",
            ),
            "doubtful walls-disagree: walls seen around 7.000 s contradict what was seen when the "
            "robot was there before (9.1% of what was seen twice in the map)",
        ),
        (
            laid(nodes=np.arange(3)),
            "doubtful layout-refused: with the matches found, more walls contradict each other "
            "than without: the poses are those of the tracking",
        ),
        (
            replace(evidence(), beyond=3),
            "doubtful beyond-grid: 3 keyframes beyond the largest grid allowed, left out of the "
            "map",
        ),
    ],
)
def test_what_is_told_of_a_layout(found: Evidence, told: str) -> None:
    finding = only(found)
    assert f"{finding.severity} {finding.code}: {finding.message}" == told


BREAK = 30
POSES: FloatArray = np.array([(k % BREAK, k // BREAK, 0.0) for k in range(60)], dtype=np.float64)
ELSEWHERE = Pose2(20.0, -3.0, 0.5)  # a motion of the map
NEARLY = Pose2(0.2, 0.1, 0.02)


def claim(older: int, newer: int, motion: Pose2) -> Link:
    """A refuted closure by which a motion of the map takes keyframe `newer` to its place."""
    a, b = (Pose2(*POSES[k].tolist()) for k in (older, newer))
    return link(older, newer, a.inverse() @ motion @ b, kind="closure")


def test_another_place_of_what_nothing_measured_the_way_to_is_told() -> None:
    base = replace(evidence_of(POSES, breaks=(BREAK,)), rivals=(Rival(BREAK, 17.94),))
    (told,) = rival_places(base)
    assert (told.severity, told.code, told.value) == ("doubtful", "rival-place", 17.94)
    assert told.message.startswith("the walls of what follows 30.000 s fit 17.9 m elsewhere, too")
    assert is_of_recording(told), "it stays when another recording is added"


def maybe(found: Sequence[Link], sigma_m: float = 2.0, **changed: Any) -> list[Finding]:
    """What is told of links refuted for being alone, on a path whose steps are off by so much."""
    alone = tuple(replace(one, kind="nearby") for one in found)
    steps = compose(invert(POSES[:-1]), POSES[1:]).tolist()
    way = [Link.closure(k, k + 1, Pose2(*step), sigma_m, 0.1) for k, step in enumerate(steps)]
    known = {"why": {(one.source, one.target): "alone" for one in alone}, "dropped": alone}
    layout = {"nodes": np.arange(len(POSES)), "odometry": tuple(way), **known, **changed}
    return list(maybe_back(laid(evidence_of(POSES), **layout)))


@pytest.mark.parametrize(
    "found",
    [
        [claim(3, 40, ELSEWHERE)],
        [claim(3, 40, ELSEWHERE), claim(8, 50, Pose2(-9.0, 4.0, 2.0))],
        [claim(3, 40, ELSEWHERE), claim(3, 50, ELSEWHERE)],  # one view, two matches with it
        [claim(3, 40, NEARLY), claim(8, 50, NEARLY)],  # nearly where it is
    ],
)
def test_what_does_not_agree_on_another_place_is_not_told(found: list[Link]) -> None:
    assert maybe([claim(3, 40, ELSEWHERE), claim(8, 50, ELSEWHERE @ NEARLY)])
    assert maybe(found) == []


def test_walls_found_elsewhere_too_few_times_to_go_by_are_told() -> None:
    found = [claim(k, k + 30, ELSEWHERE) for k in (10, 12, 14)]
    (told,) = maybe(found)
    away = (ELSEWHERE @ Pose2(*POSES[40].tolist())).matrix() - Pose2(*POSES[40].tolist()).matrix()
    distance_m = np.hypot(*away[:2, 3])
    assert (told.severity, told.code, told.value) == ("doubtful", "rival-place", 3.0)
    assert told.message.startswith("walls seen around 40.000 s and 2 times more look like those ")
    assert f" {distance_m:.1f} m from there before" in told.message
    assert not maybe(found[:1])
    assert not maybe(found, why={(one.source, one.target): "outvoted" for one in found})
    assert not maybe(found, sigma_m=0.2), "the path says that it is another place that looks alike"
    ties = [claim(k, k + 30, Pose2(0.0, 0.0, 0.0)) for k in (10, 12, 14)]
    assert not maybe(found, kept=tuple(ties)), "and so do places that were recognised"


def test_the_memory_does_not_grow_with_the_square_of_the_refuted_links() -> None:
    found = [claim(k % BREAK, BREAK + k % BREAK, ELSEWHERE) for k in range(1000)]
    tracemalloc.start()
    try:
        (told,) = maybe(found)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert told.value == 30.0
    assert not is_of_recording(told), "it is found anew"
    assert peak < 5e6, "one motion a pair of them is 24 MB"


def test_links_without_a_way_are_told_with_the_radius_that_fits() -> None:
    assert not list(narrow_links(4, {}, 0.25))
    (some,) = narrow_links(4, {(0, 1): 0.118, (2, 7): None}, 0.25)
    assert (some.severity, some.value, some.limit) == ("note", 0.5, 0.5)
    assert some.message.startswith("2 of the 4 links that the robot drove along have no way")
    assert some.message.endswith("0.25 m radius: 0-1 (0.12 m fits), 2-7 (shut)")
    assert "robot_radius_m" in some.advice
    (shut,) = narrow_links(9, dict.fromkeys([(0, other) for other in range(1, 8)]), 0.25)
    assert shut.severity == "doubtful"
    assert shut.message.endswith("0-5 (shut), ...")
    assert shut.advice == "look what stands there now"
