from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from specmap_cli.core.findings import Finding, Severity, Where
from specmap_cli.core.geometry import Pose2
from specmap_cli.core.records import Trajectory
from specmap_cli.layout.audit import Audit, Disagreement
from specmap_cli.layout.contradictions import Agreement
from specmap_cli.layout.pose_graph import Link
from specmap_cli.layout.result import Layout, PartMove, Repair
from specmap_cli.quality.evidence import Evidence, graded
from specmap_cli.quality.verdict import judged

SCANS = 100  # a metre apart along x, one a second; every one a keyframe


def evidence(
    lost: tuple[int, ...] = (), breaks: tuple[int, ...] = (), *, odometry: bool = True
) -> Evidence:
    """A straight drive in which nothing is wrong but what is asked for."""
    poses = np.column_stack([np.arange(SCANS), np.zeros(SCANS), np.zeros(SCANS)]).astype(float)
    marks = np.zeros(SCANS, dtype=np.bool_)
    marks[list(lost)] = True
    stamps = np.arange(SCANS) * 10**9
    way = Trajectory(
        stamps, poses, lost=marks, odometry=poses if odometry else np.full((SCANS, 3), np.nan)
    )
    return Evidence(
        trajectory=way,
        keyframes_ns=tuple(stamps.tolist()),
        breaks=breaks,
        layout=Layout(poses=poses),
        audit=Audit(compared=20),
        beyond=0,
        warnings=(),
    )


def only(found: Evidence) -> Finding:
    (finding,) = judged(found).findings
    return finding


def disagreement(place: tuple[float, float], walls_m: float = 3.0) -> Disagreement:
    return Disagreement(
        earlier=10, later=60, place=place, walls_m=walls_m, share=0.4, offset=Pose2(0.0, 0.5, 0.0)
    )


def closure(kind: str) -> Link:
    return Link(
        source=1,
        target=9,
        source_from_target=Pose2(0.0, 0.0, 0.0),
        information=np.eye(3),
        kind=kind,  # type: ignore[arg-type]
    )


def test_nothing_wrong_is_good() -> None:
    quality = judged(evidence())
    assert (quality.verdict, quality.findings) == ("good", ())


@pytest.mark.parametrize(
    ("count", "severity"),
    [(1, "note"), (2, "note"), (3, "doubtful"), (20, "doubtful"), (21, "poor")],
)
def test_lost_scans_weigh_by_their_share(count: int, severity: Severity) -> None:
    finding = only(evidence(lost=tuple(range(30, 30 + count))))
    assert (finding.code, finding.severity) == ("lost-scans", severity)
    assert finding.value == pytest.approx(count / SCANS)
    assert finding.where == Where(30 * 10**9, 30.0, 0.0)


def test_lost_scans_are_told_at_the_longest_run() -> None:
    finding = only(evidence(lost=(3, 50, 51, 52, 80, 81)))
    assert finding.message == (
        "6 scans of 100 (6.0%) could not be registered, 3 in a row from 50.000 s on"
    )
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


@pytest.mark.parametrize(("start", "severity"), [(95, "doubtful"), (60, "poor")])
def test_what_a_guess_places_weighs_by_its_way(start: int, severity: Severity) -> None:
    base = evidence(breaks=(start,))
    found = judged(replace(base, layout=replace(base.layout, loose=(start,))))
    loose = found.findings[0]
    assert (loose.code, loose.severity, found.verdict) == ("loose-part", severity, severity)
    assert loose.message == (
        f"a guess alone places the {SCANS - 1 - start} m that follow {start}.000 s: "
        "nothing there was recognised"
    )


def test_a_loose_part_ends_at_the_next_break() -> None:
    base = evidence(breaks=(20, 25))
    found = judged(replace(base, layout=replace(base.layout, loose=(20,))))
    (loose,) = (one for one in found.findings if one.code == "loose-part")
    assert loose.value == pytest.approx(4 / 99)


@pytest.mark.parametrize(("count", "severity"), [(1, "doubtful"), (2, "doubtful"), (3, "poor")])
def test_disagreeing_walls_weigh_by_their_share(count: int, severity: Severity) -> None:
    places = [(100.0 * k, 0.0) for k in range(count)]
    audit = Audit(compared=20, disagreements=tuple(map(disagreement, places)))
    found = judged(replace(evidence(), audit=audit)).findings
    assert [(one.code, one.severity) for one in found] == [("walls-disagree", severity)] * count
    assert [one.place for one in found] == places


def test_disagreements_at_one_place_are_one_finding_with_the_longest_walls() -> None:
    audit = Audit(
        compared=100, disagreements=(disagreement((1.0, 0.0)), disagreement((3.0, 1.0), 5.0))
    )
    finding = only(replace(evidence(), audit=audit))
    assert finding.message == (
        "near (3.0, 1.0) the walls seen at 10.000 s and 60.000 s are 0.50 m apart (over 5.0 m)"
    )
    unknown = tuple(replace(one, offset=None) for one in audit.disagreements)
    other = only(replace(evidence(), audit=replace(audit, disagreements=unknown)))
    assert "contradict each other" in other.message


def test_refused_closures_are_a_note() -> None:
    base = evidence()
    dropped = (closure("closure"), closure("closure"), closure("nearby"))
    finding = only(replace(base, layout=replace(base.layout, dropped=dropped)))
    assert (finding.code, finding.severity) == ("closures-refuted", "note")
    assert finding.message == "2 loop closures contradict the rest: left out"


def test_what_is_beyond_the_grid_makes_a_map_doubtful() -> None:
    finding = only(replace(evidence(), beyond=3))
    assert (finding.code, finding.severity) == ("beyond-grid", "doubtful")
    assert finding.message == "3 keyframes beyond the largest grid allowed, left out of the map"


def test_the_gravest_come_first_and_the_input_is_told() -> None:
    found = replace(evidence(lost=(1,)), beyond=1, warnings=("scans without any return: 2",))
    codes = [one.code for one in judged(found).findings]
    assert codes == ["beyond-grid", "lost-scans", "input"]


def test_grades_at_their_limits() -> None:
    assert graded(0.1, 0.1, 0.2) == ("note", 0.1)
    assert graded(0.2, 0.1, 0.2) == ("doubtful", 0.1)
    assert graded(0.21, 0.1, 0.2) == ("poor", 0.2)


def test_a_stretch_that_nothing_measures_makes_a_map_doubtful() -> None:
    base = evidence(odometry=False)
    blind = np.zeros(SCANS, dtype=np.bool_)
    blind[10:12], blind[40:60] = True, True
    poses = np.array(base.trajectory.poses)
    poses[40:] -= (20.0, 0.0, 0.0)  # the robot seemed to stand still there
    poses[40:60, 0] = poses[39, 0]
    way = replace(base.trajectory, poses=poses, blind=blind)
    finding = only(replace(base, trajectory=way))
    assert (finding.code, finding.severity) == ("unmeasured-way", "doubtful")
    assert finding.value == pytest.approx(20.0)
    assert finding.message == (
        "from 40.000 s on, for 20 scans, the walls do not show how far the robot came, and no "
        "odometry does: about 20 m are a guess"
    )


def turned_odometry(share: float) -> np.ndarray:
    """Odometry that tells a shorter way."""
    poses = np.array(evidence().trajectory.poses)
    poses[:, 0] *= 1.0 - share
    return poses


@pytest.mark.parametrize(("share", "said"), [(0.25, False), (0.35, True)])
def test_odometry_of_another_robot_makes_a_map_doubtful(share: float, said: bool) -> None:
    base = evidence()
    way = replace(base.trajectory, odometry=turned_odometry(share))
    found = judged(replace(base, trajectory=way))
    assert found.verdict == ("doubtful" if said else "good")
    if said:
        (finding,) = found.findings
        assert finding.message == (
            "odometry and the map disagree by 35% of the way nearly everywhere"
        )
        assert finding.value == pytest.approx(0.35)


def test_wheels_that_slip_once_are_a_note() -> None:
    base = evidence()
    odometry = np.array(base.trajectory.poses)
    odometry[50:, 0] += 4.0
    finding = only(replace(base, trajectory=replace(base.trajectory, odometry=odometry)))
    assert (finding.code, finding.severity) == ("odometry-disagrees", "note")
    assert finding.message.endswith("elsewhere by 0%")
    assert finding.place is not None
    assert 44.0 <= finding.place[0] <= 50.0


def test_odometry_with_holes_is_compared_where_there_is_some() -> None:
    base = evidence()
    odometry = np.array(base.trajectory.poses)
    odometry[20:70] = np.nan
    way = replace(base.trajectory, odometry=odometry)
    assert judged(replace(base, trajectory=way)).findings == ()


@pytest.mark.parametrize(("votes", "severity"), [(1, "doubtful"), (2, "doubtful"), (3, "note")])
def test_a_piece_that_was_moved_far_is_told_of(votes: int, severity: Severity) -> None:
    moves = (
        PartMove(first=30, moved_m=0.5, votes=1),
        PartMove(first=60, moved_m=4.2, votes=votes),
        PartMove(first=80, moved_m=9.0, votes=0),  # loose, which is told elsewhere
    )
    base = evidence()
    finding = only(replace(base, layout=replace(base.layout, parts=moves)))
    assert (finding.code, finding.severity) == ("part-moved", severity)
    assert finding.message == (
        "the layout moved what follows 60.000 s by 4.2 m, to where closures and passes "
        f"({votes}) put it"
    )
    assert finding.value == pytest.approx(4.2)


def test_walls_that_were_mended_are_a_note() -> None:
    base = evidence()
    repair = Repair(links=(closure("nearby"),), walls_m=4.2, moved_m=0.25)
    finding = only(replace(base, layout=replace(base.layout, repair=repair)))
    assert (finding.code, finding.severity, finding.value) == ("walls-mended", "note", 0.25)
    assert finding.message == (
        "4.2 m of wall were drawn twice: matched again in 1 place, the map moved by up to 0.25 m"
    )


def test_contradictions_all_over_the_map_make_it_doubtful() -> None:
    base = evidence()
    many, few = Agreement(agree=1000, contradict=100), Agreement(agree=10000, contradict=60)
    finding = only(replace(base, layout=replace(base.layout, agreement=many)))
    assert finding.message == "9.1% of the walls that two passes saw contradict each other"
    assert finding.severity == "doubtful"
    assert judged(replace(base, layout=replace(base.layout, agreement=few))).findings == ()


def test_a_layout_that_was_not_taken_makes_a_map_doubtful() -> None:
    base = evidence()
    nodes = np.arange(3)
    finding = only(replace(base, layout=replace(base.layout, nodes=nodes)))
    assert (finding.code, finding.severity) == ("layout-refused", "doubtful")
