from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from specmap_cli.core.findings import Where
from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.records import PlanarScan, Trajectory
from specmap_cli.grids.gridmap import FREE, OCCUPIED, GridMap
from specmap_cli.layout.result import Layout
from specmap_cli.quality.evidence import Evidence, Hole, holes_of
from specmap_cli.quality.holes import noted, unwatched
from tests.layout.driving import link, scans_of, stored
from tests.quality.evidence import evidence_of

STILL = Pose2(0.0, 0.0, 0.0)
SCANS = 200  # half a metre apart along x, two a second; every one a keyframe


def rooms() -> GridMap:
    """A room of 6 m by 4 m, and one of 4 m by 3 m elsewhere."""
    cells = np.full((160, 300), OCCUPIED, dtype=np.uint8)
    cells[20:100, 20:140] = FREE
    cells[40:100, 190:270] = FREE
    return GridMap(cells, 0.05)


def drive(
    places: Sequence[float] | FloatArray, times_s: Sequence[float] | FloatArray
) -> tuple[list[PlanarScan], FloatArray]:
    """Scans at places along x, 3 m up, and the true poses."""
    poses = np.array([(x, 3.0, 0.0) for x in places])
    scans = scans_of(rooms(), poses)
    stamps = [int(time * 1e9) for time in times_s]
    return [replace(s, stamp_ns=t) for s, t in zip(scans, stamps, strict=True)], poses


def found(
    scans: Sequence[PlanarScan],
    poses: FloatArray,
    odometry: FloatArray | None = None,
    lost: Sequence[int] = (),
    breaks: Sequence[int] = (),
) -> tuple[Hole, ...]:
    """The holes of a log whose scans are keyframes, those that were lost excepted."""
    marks = np.zeros(len(scans), dtype=np.bool_)
    marks[list(lost)] = True
    stamps = np.array([scan.stamp_ns for scan in scans])
    way, rows = Trajectory(stamps, poses, odometry=odometry, lost=marks), np.flatnonzero(~marks)
    with stored(poses[rows], [scans[row] for row in rows.tolist()]) as store:
        return holes_of(store, rows, way, Layout(poses=poses[rows]), breaks)


def evidence(*holes: Hole, ties: Sequence[tuple[int, int]] = ()) -> Evidence:
    poses = np.column_stack([0.5 * np.arange(SCANS), np.zeros((SCANS, 2))])
    kept = tuple(link(a, b, (0.0, 0.0, 0.0)) for a, b in ties)
    return evidence_of(poses, 5 * 10**8, layout={"kept": kept}, holes=holes)


def hole(measured: Pose2 | None, apart: Pose2, alike: float = 0.9) -> Hole:
    return Hole(row=100, keyframe=100, seconds=30.0, measured=measured, apart=apart, alike=alike)


TIES = [(10, 130), (20, 145), (30, 160)]  # 15, 22.5 and 30 m after the hole
CARRIED = hole(STILL, Pose2(1.4, 0.0, 0.0))
STUCK = replace(hole(Pose2(6.0, 0.0, 0.0), Pose2(6.0, 0.0, 0.0)), kind="rest")


def told(seen: Hole) -> list[str]:
    """The messages about a hole that was found, after which nothing known was seen."""
    found_in = evidence(replace(seen, keyframe=100, row=100))
    return [finding.message for finding in unwatched(found_in)]


@pytest.mark.parametrize(("on_m", "said"), [(1.2, False), (0.0, False), (0.6, True), (2.0, True)])
def test_a_robot_that_went_on_is_found_there_without_odometry(on_m: float, said: bool) -> None:
    """Six seconds without scans, at two decimetres a second."""
    places = np.concatenate([np.arange(1.5, 2.8, 0.1), 2.7 + on_m + np.arange(0.0, 0.3, 0.1)])
    times = np.concatenate([0.5 * np.arange(13), 12.0 + 0.5 * np.arange(3)])
    (seen,) = found(*drive(places, times))
    assert seen.measured is None
    assert bool(told(seen)) == said


@pytest.mark.parametrize(("on_m", "said"), [(1.5, False), (0.0, True), (0.6, True)])
def test_a_robot_drives_on_in_a_short_hole_without_odometry(on_m: float, said: bool) -> None:
    """Three seconds at half a metre a second: odometry would tell of them."""
    places = np.concatenate([np.arange(1.5, 3.6, 0.1), 3.5 + on_m + np.arange(0.0, 0.3, 0.1)])
    scans, poses = drive(places, np.cumsum([0.0, *[0.2] * 20, 3.0, 0.2, 0.2]))
    (seen,) = found(scans, poses)
    assert bool(told(seen)) == said
    assert not list(noted(evidence(replace(seen, keyframe=100, row=100))))
    assert found(scans, poses, poses) == ()
    afresh = poses - (np.arange(len(poses)) > 20)[:, None] * poses[21]
    assert [bool(told(seen)) for seen in found(scans, poses, afresh)] == [True]


def test_scans_lost_behind_a_hole_do_not_say_where_the_robot_is() -> None:
    """The wheels turn a little there, and the first scan that is registered lies elsewhere."""
    scans, poses = drive([2.0, 2.1, 2.2, 2.2, 2.3, 2.4], [0.0, 0.2, 0.4, 30.4, 30.6, 30.8])
    believed = poses.copy()
    believed[5, 0] += 1.3
    (seen,) = found(scans, believed, poses, lost=(3, 4))
    assert seen.measured == pytest.approx((0.0, 0.0, 0.0))
    assert seen.apart.distance == pytest.approx(1.3)
    assert told(seen)


@pytest.mark.parametrize(("elsewhere_m", "count"), [(0.0, 0), (8.8, 1)])
def test_a_robot_carried_with_its_laser_on(elsewhere_m: float, count: int) -> None:
    """Tracking breaks though the wheels stand still, and other walls follow, or the same ones."""
    places = np.array([2.0, 2.1, 2.2, 2.2, 2.2, 2.2, 2.3])
    scans, poses = drive(places, 0.2 * np.arange(7.0))
    there, _ = drive(places + elsewhere_m, 0.2 * np.arange(7.0))
    scans[5:] = there[5:]
    (seen,) = found(scans, poses, poses, lost=(3, 4), breaks=(3,))
    assert (seen.row, seen.keyframe, seen.kind) == (5, 3, "lost")
    assert seen.seconds == pytest.approx(0.6)
    messages = told(seen)
    assert len(messages) == count
    if messages:
        assert messages[0].startswith(
            "no scan could be registered for 1 s before 50.000 s, and the walls changed though"
        )


@pytest.mark.parametrize(("off_m", "count"), [(0.0, 0), (2.0, 1)])
def test_a_break_is_doubted_where_odometry_tells_another_motion(off_m: float, count: int) -> None:
    scans, poses = drive([2.0, 2.1, 2.2, 2.4, 2.6, 2.8], 0.2 * np.arange(6.0))
    wheels = poses + np.outer(np.arange(6) > 4, (0.0, off_m, 0.0))
    (seen,) = found(scans, poses, wheels, lost=(3, 4), breaks=(3,))
    assert (seen.kind, len(told(seen))) == ("lost", count)
    assert found(scans, poses, lost=(3, 4), breaks=(3,)) == found(scans[:1], poses[:1]) == ()


def hung(odometry_x: FloatArray) -> tuple[Hole, ...]:
    """A laser that shows the same for ten scans while odometry goes along x."""
    scans, poses = drive(np.array([2.0, 2.1, *[2.2] * 10, 2.4, 2.6]), 0.2 * np.arange(14.0))
    odometry = poses.copy()
    odometry[:, 0] = odometry_x
    return found(scans, poses, odometry)


def test_a_laser_that_hangs_leaves_a_hole() -> None:
    (seen,) = hung(np.linspace(2.0, 6.0, 14))
    assert (seen.kind, seen.row) == ("rest", 12)
    assert seen.measured is not None
    assert seen.measured.distance == pytest.approx(10 * 4.0 / 13)
    (message,) = told(seen)
    assert message == (
        "the scans show the robot at rest for 2 s before 50.000 s, and odometry tells another "
        "motion than the map: where the robot was afterwards is a guess"
    )


@pytest.mark.parametrize(
    "odometry_x",
    [
        np.linspace(2.0, 4.4, 14),  # wheels slip
        np.array([2.0] * 6 + [12.0] * 8),  # odometry was reset
        np.full(14, np.nan),
    ],
)
def test_what_odometry_may_tell_of_a_robot_at_rest(odometry_x: FloatArray) -> None:
    assert hung(odometry_x) == ()


def test_two_holes_while_the_robot_stands_are_both_looked_at() -> None:
    """It was carried in the first one and stood still in the second."""
    places = [*np.linspace(2.0, 4.0, 41), 4.0, 4.0, 4.1]
    scans, poses = drive(places, np.cumsum([0.0, *[0.2] * 40, 30.0, 30.0, 0.2]))
    believed = poses.copy()
    believed[41:, 1] += 1.3
    seen = found(scans, believed, poses)
    assert [one.apart.distance for one in seen] == pytest.approx([1.3, 0.0])
    at_one_place = (replace(one, keyframe=100, row=100) for one in seen)
    assert not list(unwatched(evidence(*at_one_place, ties=TIES)))


@pytest.mark.parametrize(
    ("usual_s", "intervals_s", "count"),
    [
        (0.2, (0.2, 0.2, 2.9, 0.2), 0),  # nobody is so quick, and the robot drives no metre
        (0.2, (0.2, 0.2, 4.9, 0.2), 1),
        (0.2, (0.2, 0.2, 5.1, 0.2), 1),
        (3.0, (3.0, 2.0, 14.0, 3.0), 0),  # a log of few scans, some of them far apart
        (0.2, (0.0, 0.0, 0.0, 0.0), 0),  # stamps that say nothing
        (0.2, (0.2, 0.2, 0.2, 30.0), 0),  # standing at the end: no keyframe follows
    ],
)
def test_what_is_a_hole_depends_on_the_usual_interval(
    usual_s: float, intervals_s: Sequence[float], count: int
) -> None:
    times = np.cumsum([0.0, *[usual_s] * 40, *intervals_s])
    scans, poses = drive(np.linspace(2.0, 5.0, len(times)), times)
    lost = (len(scans) - 1,) if intervals_s[-1] == 30.0 else ()
    assert len(found(scans, poses, lost=lost)) == count


ANOTHER = "odometry tells another motion than the map"
CARRIED_AWAY = "the wheels did not turn though the map has the robot 1.4 m and 20 degrees away"


@pytest.mark.parametrize(
    ("measured", "apart", "alike", "reason"),
    [
        (STILL, STILL, 0.9, None),
        (None, STILL, 0.9, None),
        (STILL, STILL, 0.3, "the walls changed though the wheels did not turn"),
        (None, STILL, 0.3, "no odometry tells of it"),
        (Pose2(8.0, 0.0, 1.2), Pose2(2.0, 1.0, 0.4), 0.0, None),  # it drove on, as measured
        (None, Pose2(9.0, 0.0, 1.0), 1.0, "no odometry tells of it"),
        (STILL, Pose2(1.3, 0.4, -0.35), 1.0, CARRIED_AWAY),
        (Pose2(8.0, 0.0, 0.0), Pose2(3.0, 0.0, 0.0), 1.0, ANOTHER),
        (Pose2(8.0, 0.0, 0.0), Pose2(0.0, 0.0, 0.3), 1.0, ANOTHER),
    ],
)
def test_odometry_or_the_same_walls_must_tell_where_the_robot_was(
    measured: Pose2 | None, apart: Pose2, alike: float, reason: str | None
) -> None:
    found_there = list(unwatched(evidence(hole(measured, apart, alike))))
    if reason is None:
        assert found_there == []
        return
    (finding,) = found_there
    assert (finding.code, finding.severity, finding.value) == ("hole-in-log", "doubtful", 30.0)
    assert finding.advice == "record without holes, or drive on through places seen before"
    assert finding.message == (
        f"there are no scans for 30 s before 50.000 s, and {reason}: where the robot was "
        "afterwards is a guess"
    )
    assert finding.where == Where(50 * 10**9, 50.0, 0.0)
    known = replace(evidence(hole(measured, apart, alike)), fitting={100})
    assert list(unwatched(known)) == [], "all that follows fits there, and nowhere else"


@pytest.mark.parametrize(
    ("seen", "ties", "doubted"),
    [
        (CARRIED, TIES, False),
        (CARRIED, TIES[:2], True),  # in too few places
        (CARRIED, [(10, 130), (11, 131), (12, 132)], True),  # three times in one place
        (CARRIED, [(10, 101), (20, 110), (30, 118)], True),  # within 10 m: the room mistaken
        (CARRIED, [(10, 30), (20, 45), (30, 60)], True),  # all of them before the hole
        (replace(STUCK, alike=0.7), TIES, False),  # the same walls speak for wheels that spun
        (replace(STUCK, alike=0.5), TIES, True),  # odometry and walls are not outvoted
    ],
)
def test_places_known_from_before_confirm_what_follows_a_hole(
    seen: Hole, ties: Sequence[tuple[int, int]], doubted: bool
) -> None:
    assert bool(list(unwatched(evidence(seen, ties=ties)))) == doubted


@pytest.mark.parametrize(("seconds", "told"), [(30.0, 0), (3500.0, 0), (9000.0, 1)])
def test_a_hole_of_hours_is_another_session(seconds: float, told: int) -> None:
    stood = replace(hole(Pose2(0.0, 0.0, 0.0), Pose2(0.0, 0.0, 0.0), 1.0), seconds=seconds)
    assert not list(unwatched(evidence(stood)))
    found = [one for one in noted(evidence(stood)) if "another session" in one.message]
    assert len(found) == told
    for finding in found:
        assert (finding.code, finding.severity) == ("hole-in-log", "note")
        assert finding.message.startswith("no scan for 2.5 h before ")
        assert "specmap update" in finding.advice
    assert not list(noted(evidence(replace(stood, kind="rest"))))


@pytest.mark.parametrize(
    ("seen", "told"),
    [
        (hole(None, STILL), True),
        (hole(STILL, STILL), True),
        (hole(Pose2(2.0, 0.0, 0.0), STILL), False),  # odometry measured the way over it
        (CARRIED, False),  # that is doubtful
        (STUCK, False),
    ],
)
def test_that_walls_alone_say_where_a_robot_stood_is_a_note(seen: Hole, told: bool) -> None:
    """Carried to a twin of its room it seems to have stood there."""
    notes = list(noted(evidence(seen)))
    assert [(note.code, note.severity) for note in notes] == [("hole-in-log", "note")] * told
    for note in notes:
        assert "there are no scans for 30 s before 50.000 s: the walls alone show" in note.message
