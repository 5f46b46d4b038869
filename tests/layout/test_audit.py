from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from specmap_cli.core.geometry import FloatArray, Pose2, compose
from specmap_cli.core.records import PlanarScan
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.layout.audit import _PASS_M, _WALL_M, Audit, Disagreement, audit, passes_of
from tests.layout.driving import stored

Drive = tuple[FloatArray, list[PlanarScan]]
SECOND_LAP = 480


@pytest.fixture(scope="module")
def truth(drive: Drive) -> Iterator[tuple[KeyframeStore, FloatArray]]:
    poses, scans = drive
    with stored(poses, scans) as store:
        yield store, poses


def second_lap_moved(poses: FloatArray, motion: Pose2) -> FloatArray:
    """The poses, those of the second lap as a whole moved by a motion of the map."""
    moved = np.array(poses)
    moved[SECOND_LAP:] = compose(np.array(motion), poses[SECOND_LAP:])
    return moved


def test_a_right_layout_has_no_disagreement(truth: tuple[KeyframeStore, FloatArray]) -> None:
    store, poses = truth
    found = audit(store, poses, [])
    assert found.compared >= 5
    assert found.disagreements == ()


def test_noise_of_centimetres_is_none(truth: tuple[KeyframeStore, FloatArray]) -> None:
    store, poses = truth
    found = audit(store, second_lap_moved(poses, Pose2(0.05, -0.05, 0.005)), [])
    assert found.disagreements == ()


@pytest.mark.parametrize("away", [(0.4, 0.0), (0.0, -0.4), (1.0, 0.7), (-2.0, 0.3)])
def test_walls_drawn_twice_are_found_with_their_distance(
    truth: tuple[KeyframeStore, FloatArray], away: tuple[float, float]
) -> None:
    store, poses = truth
    found = audit(store, second_lap_moved(poses, Pose2(*away, 0.0)), [])
    assert found.disagreements
    known = [one for one in found.disagreements if one.offset is not None]
    assert known
    for one in known:
        assert one.offset is not None
        assert one.earlier < SECOND_LAP <= one.later
        assert one.apart_m == pytest.approx(float(np.hypot(*away)), abs=0.12)
        assert (one.offset.x, one.offset.y) == pytest.approx((-away[0], -away[1]), abs=0.3)


def test_the_offset_leads_back(truth: tuple[KeyframeStore, FloatArray]) -> None:
    store, poses = truth
    bent = second_lap_moved(poses, Pose2(0.5, 0.3, 0.04))
    worst = max(
        (one for one in audit(store, bent, []).disagreements if one.offset is not None),
        key=lambda one: one.walls_m,
    )
    assert worst.offset is not None
    back = compose(np.array(worst.offset), bent[worst.later])
    assert np.hypot(*(back - poses[worst.later])[:2]) < 0.15


def test_what_is_folded_over_another_place_fits_nowhere(
    truth: tuple[KeyframeStore, FloatArray],
) -> None:
    """Another part of the building drawn over this one: no small motion mends that."""
    store, poses = truth
    turned = second_lap_moved(poses, Pose2(9.0, -2.0, np.pi / 2))
    found = audit(store, turned, [])
    assert found.disagreements
    assert all(one.walls_m >= _WALL_M for one in found.disagreements)


def test_a_chair_is_no_disagreement(drive: Drive) -> None:
    """Something of half a metre that stands there at the second visit only."""
    poses, scans = drive
    middle = np.array([4.0, 2.5 + 0.7])
    seen = []
    for number, (pose, scan) in enumerate(zip(poses, scans, strict=True)):
        if number >= SECOND_LAP:
            away = Pose2(*pose.tolist()).inverse().apply(middle[None])[0]
            bearing, distance = np.arctan2(away[1], away[0]), float(np.hypot(*away))
            near = np.abs(scan.bearings - bearing) * distance < 0.25
            ranges = np.where(near, np.minimum(scan.ranges, distance), scan.ranges)
            scan = replace(scan, ranges=ranges)
        seen.append(scan)
    with stored(poses, seen) as store:
        assert audit(store, poses, []).disagreements == ()


def test_passes_cut_the_whole_path_and_end_at_breaks(
    truth: tuple[KeyframeStore, FloatArray],
) -> None:
    store, poses = truth
    passes = passes_of(store, poses, [SECOND_LAP])
    assert [one.first for one in passes][1:] == [one.last + 1 for one in passes][:-1]
    assert passes[0].first == 0
    assert passes[-1].last == len(poses) - 1
    assert SECOND_LAP in [one.first for one in passes]
    ways = np.diff([one.way_m for one in passes])
    assert (ways <= _PASS_M + 0.2).all()


def test_no_keyframes_no_audit() -> None:
    with KeyframeStore() as store:
        assert audit(store, np.zeros((0, 3)), []) == Audit()


def test_distance_is_that_at_the_place_of_the_walls() -> None:
    one = Disagreement(
        earlier=0,
        later=9,
        place=(10.0, 0.0),
        walls_m=3.0,
        share=0.5,
        offset=Pose2(0.0, 0.0, 0.1),
    )
    assert one.apart_m == pytest.approx(2 * 10.0 * np.sin(0.05))
    assert replace(one, offset=None).apart_m is None
