"""The first scans of a map wait until another one fits them; a map that is given up was lost."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from specmap_cli.core.geometry import IDENTITY, FloatArray, Pose2
from specmap_cli.core.records import PosedScan, Sweep
from specmap_cli.core.settings import RegistrationConfig
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.registration import FrontEnd
from specmap_cli.registration.judgement import Founding, looked_through
from tests.registration.drives import circle, path, sweeps, worst


def scan(index: int, *, lost: bool = False, restarted: bool = False) -> PosedScan:
    return PosedScan(
        index=index,
        stamp_ns=index,
        map_from_base=IDENTITY,
        planar=circle(index, np.ones(4)).planar,
        base_from_laser=IDENTITY,
        lost=lost,
        restarted=restarted,
    )


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
    assert told(founding.handed_on(scan(10), founded=True)) == [
        (9, False, True),
        (10, False, False),
    ]


def test_no_more_wait_than_allowed_and_the_end_of_a_log_settles_all() -> None:
    founding = Founding(3)
    handed = [founding.handed_on(scan(k), founded=False) for k in range(5)]
    assert [len(each) for each in handed] == [0, 0, 3, 0, 0]
    assert told(founding.rest()) == [(3, False, False), (4, False, False)]


def spoiled(items: list[Sweep], count: int) -> list[Sweep]:
    """The first sweeps hold ranges at random."""
    rng = np.random.default_rng(4)
    for k in range(count):
        ranges = rng.uniform(0.3, 3.0, len(items[k].planar.ranges))
        items[k] = dataclasses.replace(
            items[k], planar=dataclasses.replace(items[k].planar, ranges=ranges)
        )
    return items


@pytest.mark.parametrize("odometry", [True, False])
@pytest.mark.parametrize("count", [0, 1, 2, 5, 8])
def test_spoiled_first_scans_cost_themselves_and_no_other(
    world: GridMap, count: int, odometry: bool
) -> None:
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


def test_scans_come_out_one_by_one_once_a_map_stands(world: GridMap) -> None:
    front_end = FrontEnd(RegistrationConfig())
    sizes = [len(front_end.take(sweep)) for sweep in sweeps(world, path()[:8])]
    assert sizes == [0, 2, 1, 1, 1, 1, 1, 1]


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
def test_a_scan_that_looks_through_walls_refutes_them(
    walls: FloatArray, share: float, laser: Pose2
) -> None:
    scan = circle(0, np.full(90, 4.0)).planar
    assert looked_through(laser.apply(walls), scan, laser) == pytest.approx(share)


def test_walls_out_of_view_and_beams_without_return_say_nothing() -> None:
    full = circle(0, np.full(90, 4.0)).planar
    ahead = dataclasses.replace(
        full, bearings=np.linspace(-0.8, 0.8, 90), full_circle=False, stamp_ns=0
    )
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
