"""Keyframes: which scans are one, their store on disk, and which a map can do without."""

import math
import os
import tracemalloc
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.geometry import FloatArray, Pose2, wrap_angle
from specmap_cli.core.odometry import UNMEASURED, Slack
from specmap_cli.core.records import IntArray, PlanarScan, PosedScan
from specmap_cli.core.settings import GridConfig, KeyframeConfig
from specmap_cli.grids import keyframes
from specmap_cli.grids.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap
from specmap_cli.grids.keyframes import KeyframeSelector, KeyframeStore, integrate_keyframes
from specmap_cli.grids.occupancy import OccupancyGrid
from tests.casting import keyframe, store_of
from tests.strategies import planar_scans, poses
from tests.turning import turn

CONFIG = KeyframeConfig(distance_m=0.1, angle_rad=0.05)
NOTHING = PlanarScan(0, np.array([0.0]), np.array([np.inf]), 10.0, False)
ENOUGH = 4


def at(x: float, planar: PlanarScan = NOTHING) -> PosedScan:
    return keyframe(planar, Pose2(x, 0.0, 0.0))


def scan_of(number: int) -> PlanarScan:
    """Nine beams of one length."""
    return PlanarScan(number, np.linspace(-1, 1, 9), np.full(9, float(number)), 10.0, False)


@given(st.lists(st.tuples(planar_scans(beams=16), poses, poses), min_size=1, max_size=5))
def test_what_is_stored_is_read_back(taken: list[tuple[PlanarScan, Pose2, Pose2]]) -> None:
    with KeyframeStore() as store:
        for index, (scan, pose, mounting) in enumerate(taken):
            assert store.append(keyframe(scan, pose, mounting, index)) == index
        assert len(store) == len(taken)
        np.testing.assert_array_equal(store.poses, np.array([pose for _, pose, _ in taken]))
        np.testing.assert_array_equal(store.poses_of([0, len(taken) - 1]), store.poses[[0, -1]])
        assert store.stamps_ns.tolist() == [scan.stamp_ns for scan, _, _ in taken]
        for number in reversed(range(len(taken))):
            scan, pose, mounting = taken[number]
            found = store.scan(number)
            np.testing.assert_array_equal(found.ranges, scan.ranges.astype(np.float32))
            np.testing.assert_allclose(found.bearings, scan.bearings, atol=1e-6)
            assert (found.stamp_ns, found.range_max) == (scan.stamp_ns, scan.range_max)
            assert found.full_circle == scan.full_circle
            assert store.pose(number) == pose
            assert store.base_from_laser(number) == mounting
            hits = mounting.apply(scan.hits(3.0))
            np.testing.assert_allclose(store.points(number, 3.0), hits, atol=1e-4)


def test_what_registration_was_unsure_of_is_kept() -> None:
    scans = [
        replace(
            at(float(k)), guessed_m=(0.1 * k, -0.2 * k), odometry_slacks=Slack(0.5, 1.0, float(k))
        )
        for k in range(3)
    ]
    with KeyframeStore() as store, KeyframeStore() as other:
        for scan in scans:
            store.append(scan)
        store.append(at(3.0))
        store.keep(np.array([0, 2, 3]), store.poses_of([0, 2, 3]))
        other.extend(store)
        assert other.guessed_m.tolist() == [[0.0, 0.0], [0.2, -0.4], [0.0, 0.0]]
        assert other.odometry_slacks.tolist() == [[0.5, 1.0, 0.0], [0.5, 1.0, 2.0], [*UNMEASURED]]


def test_a_store_is_read_while_it_grows() -> None:
    """Scans without a beam are among them."""
    with KeyframeStore() as store:
        assert store.poses.shape == store.poses_of([]).shape == (0, 3)
        for number in range(5):
            ranges = np.full(2 * number, float(number))
            scan = PlanarScan(number, np.linspace(-1, 1, 2 * number), ranges, 10.0, False)
            store.append(at(number, scan))
            for earlier in range(number + 1):
                assert store.scan(earlier).ranges.tolist() == [earlier] * 2 * earlier
        assert store.points(0).shape == (0, 2)


def test_scans_do_not_stay_in_memory() -> None:
    beams, scans = 2000, 1000
    scan = PlanarScan(0, np.linspace(-3, 3, beams), np.full(beams, 5.0), 10.0, False)
    tracemalloc.start()
    with KeyframeStore() as store:
        for number in range(scans):
            store.append(at(number, scan))
        for number in range(scans):
            store.scan(number)
        held, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert held < scans * 500  # of the 16,000 bytes a scan
    assert peak < scans * 500 + 10 * scan.ranges.nbytes


@given(st.lists(st.tuples(planar_scans(beams=24), poses, poses), min_size=1, max_size=3))
def test_a_keyframe_grid_is_that_of_its_scans(taken: list[tuple[PlanarScan, Pose2, Pose2]]) -> None:
    config = GridConfig(resolution_m=0.1, footprint_m=0.3)
    direct = OccupancyGrid(config)
    with store_of(keyframe(*each) for each in taken) as store:
        numbers = list(range(len(taken)))[::-1]
        for number in numbers:
            pose = store.pose(number)
            laser = pose @ store.base_from_laser(number)
            direct.integrate([store.scan(number)], np.array([laser]), np.array([pose]))
        expected = direct.snapshot()
        for at_once in (32, 2):
            turn("grids.keyframes", at_once=at_once)
            found = integrate_keyframes(store, numbers, store.poses_of(numbers), config).snapshot()
            np.testing.assert_array_equal(found.cells, expected.cells)
            assert found.origin == expected.origin


def by_hand(way: list[PosedScan], config: KeyframeConfig) -> list[bool]:
    """The rule of the settings, written out."""
    accepted, last = [], None
    for scan in way:
        x, y, theta = scan.map_from_base
        if scan.lost:
            accepted.append(False)
            continue
        far = last is None or scan.restarted
        if last is not None:
            far |= math.hypot(x - last[0], y - last[1]) >= config.distance_m
            far |= abs(wrap_angle(theta - last[2])) >= config.angle_rad
        accepted.append(far)
        last = (x, y, theta) if far else last
    return accepted


@given(st.integers(0, 10_000))
def test_keyframes_are_chosen_by_the_rule_of_the_settings(seed: int) -> None:
    rng = np.random.default_rng(seed)
    places = np.cumsum(rng.normal(0.0, (0.07, 0.07, 0.04), (60, 3)), axis=0)
    way = [
        replace(
            keyframe(NOTHING, Pose2(x, y, wrap_angle(theta + math.pi))),
            lost=bool(rng.random() < 0.1),
            restarted=bool(rng.random() < 0.05),
        )
        for x, y, theta in places.tolist()
    ]
    selector = KeyframeSelector(CONFIG)
    assert [selector.accepts(scan) for scan in way] == by_hand(way, CONFIG)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="only where processes are forked")
@pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")
def test_a_forked_process_reads_without_moving_the_place_at_which_is_written() -> None:
    with store_of(at(number, scan_of(number)) for number in range(4)) as store:
        child = os.fork()
        if not child:
            right = all(store.scan(k).ranges.tolist() == [float(k)] * 9 for k in (2, 0, 3))
            os._exit(0 if right else 1)
        store.append(at(4, scan_of(4)))
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
        store.append(at(5, scan_of(5)))
        for number in range(6):
            assert store.scan(number).ranges.tolist() == [float(number)] * 9


def test_the_store_is_closed_after_an_error_too() -> None:
    store = KeyframeStore()
    with pytest.raises(IndexError), store:
        store.scan(0)
    with pytest.raises(ValueError, match="closed"):
        store.append(at(0.0))


def test_a_grid_says_how_many_keyframes_it_had_to_refuse() -> None:
    config = GridConfig(resolution_m=0.1, max_extent_m=50.0)
    places = enumerate((0.0, 5.0, 900.0, 10.0, 901.0), start=1)
    with store_of(at(x, scan_of(number)) for number, x in places) as store:
        for numbers, refused in (([0, 1, 2, 3, 4], 2), ([0, 1, 3], 0)):
            grid = integrate_keyframes(store, numbers, store.poses[numbers], config)
            assert grid.refused == refused
        with pytest.raises(ValueError, match="zip"):
            integrate_keyframes(store, [0, 1], store.poses, config)


def test_a_patrol_of_any_length_tells_as_much_as_the_place_holds() -> None:
    lap = [(0.1 * step, 0.2, 0.1) for step in range(30)]
    patrol = np.array([*lap, *[(x, y, -3.0) for x, y, _ in lap[::-1]]] * 40)
    chosen = keyframes.informative(patrol)
    assert len(chosen) == 2 * 6 * 16  # two directions, six places half a metre wide
    assert (np.diff(chosen) > 0).all()
    laps = np.bincount(chosen // 60, minlength=40)
    assert laps[:20].sum() == pytest.approx(laps[20:].sum(), rel=0.2)  # neither first nor last
    assert len(keyframes.informative(patrol[: 2 * 60])) == 2 * 60  # first laps are taken in whole
    assert len(keyframes.informative(np.zeros((0, 3)))) == 0


def laser(beams: int, view_deg: float, range_max: float) -> PlanarScan:
    bearings = np.radians(np.linspace(-view_deg / 2, view_deg / 2, beams))
    return PlanarScan(0, bearings, np.full(beams, np.inf), range_max, view_deg > 350)


@pytest.mark.parametrize(
    ("scan", "looks"),
    [
        (laser(181, 180.0, 81.0), 7),  # beams 0.35 m apart at 20 m, where the grid ends
        (laser(181, 180.0, 5.0), 2),
        (laser(1081, 270.0, 30.0), 2),
        (laser(36, 350.0, 30.0), 16),  # no cell needs more than a grid takes in
        (laser(1, 0.0, 30.0), 1),
    ],
)
def test_a_place_is_shown_when_every_cell_of_a_wall_is_hit(scan: PlanarScan, looks: int) -> None:
    assert keyframes.views_needed(scan, GridConfig()) == looks


def along(start: float, end: float, y: float = 0.0, heading: float = 0.0) -> FloatArray:
    """A way along a line, a keyframe every 0.1 m."""
    x = start + 0.1 * np.arange(round((end - start) / 0.1))
    return np.column_stack([x, np.full(len(x), y), np.full(len(x), heading)])


def recorded(ways: Sequence[FloatArray], all_round: bool = False) -> keyframes.Recorded:
    return keyframes.Recorded(
        poses=np.concatenate(ways),
        of=np.repeat(np.arange(len(ways)), [len(way) for way in ways]),
        enough=np.full(len(ways), ENOUGH),
        all_round=np.full(len(ways), all_round),
    )


def gone(drive: keyframes.Recorded, needed: Sequence[int] = ()) -> list[IntArray]:
    """The keyframes that are repeated, of each recording by their own numbers."""
    marked = np.zeros(len(drive.poses), dtype=bool)
    marked[list(needed)] = True
    found = keyframes.repeated(drive, marked)
    return [np.flatnonzero(found[drive.of == k]) for k in range(len(drive.enough))]


def test_what_was_driven_again_goes_and_the_rest_and_what_is_needed_stays() -> None:
    old, new = gone(recorded([along(0.0, 10.0), along(4.0, 6.0, 0.3)]))
    assert len(new) == 0
    assert set(old.tolist()) <= set(range(36, 65))  # within half a metre of enough newer ones
    assert set(range(42, 58)) <= set(old.tolist())
    old, _ = gone(recorded([along(0.0, 10.0), along(4.0, 6.0)]), needed=[50])
    assert {49, 51} == {49, 50, 51} & set(old.tolist())


WAY, FEW = along(0.0, 3.0), along(1.0, 1.2)


@pytest.mark.parametrize(
    ("ways", "all_round", "numbers"),
    [
        # the way back shows the other side, but not to a laser that looks all round
        ([WAY, along(0.0, 3.0, heading=np.pi)], False, [0, 0]),
        ([WAY, along(0.0, 3.0, heading=np.pi)], True, [30, 0]),
        # where the last recording was not nothing goes
        ([WAY, WAY, along(0.0, 3.0, y=8.0)], False, [0, 0, 0]),
        # only what is left speaks for a place: the third is beside the second, not the first
        ([WAY, along(0.0, 3.0, 0.3), along(0.0, 3.0, 0.6)], False, [0, 30, 0]),
    ],
    ids=["there and back", "there and back, all round", "elsewhere", "side by side"],
)
def test_so_many_are_repeated(ways: list[FloatArray], all_round: bool, numbers: list[int]) -> None:
    assert [len(own) for own in gone(recorded(ways, all_round))] == numbers


def test_looks_of_newer_recordings_add_up_until_they_are_enough() -> None:
    assert len(FEW) == ENOUGH / 2
    assert len(gone(recorded([WAY, along(1.0, 1.0 + 0.1 * (ENOUGH - 1))]))[0]) == 0
    assert len(gone(recorded([WAY, along(1.0, 1.0 + 0.1 * ENOUGH)]))[0]) > 0
    assert len(gone(recorded([WAY, FEW, FEW]))[0]) > 0


APART = [k + 0.05 for k in range(10)]  # a metre apart; each sees the wall at its left alone


@pytest.mark.parametrize(
    ("xs", "marked", "unseen", "left"),
    [
        (APART, range(10), [30, 70], [3, 7]),  # the only one that shows a wall
        (APART, [1, 2, 4], [30], []),  # one that is kept shows it
        (APART, range(10), [], []),  # newer recordings looked at it
        ([3.05, 3.07, 3.09], range(3), [30], [2]),  # of several witnesses the last
    ],
)
def test_the_only_keyframe_that_shows_a_wall_stays(
    xs: Sequence[float], marked: Sequence[int], unseen: list[int], left: list[int]
) -> None:
    """Each sees a wall along y = 1 m; of it cells are `unseen` by newer recordings."""
    cells = np.full((20, 100), UNKNOWN, dtype=np.uint8)
    cells[:10], cells[10] = FREE, OCCUPIED
    old = np.zeros(cells.shape, dtype=bool)
    old[10, unseen] = True
    dropped = np.isin(np.arange(len(xs)), marked)
    scan = PlanarScan(0, np.array([np.pi / 2]), np.array([1.04]), 10.0, False)
    with store_of(at(x, scan) for x in xs) as store:
        found = keyframes.sole_views(store, dropped, store.poses, GridMap(cells, 0.1), old, 20.0)
    assert [int(number) for number in found] == left
