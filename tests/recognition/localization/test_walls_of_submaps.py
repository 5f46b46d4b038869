"""Scans against the walls of submaps: own places fit, others do not, and searches are rare."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import expon, norm

from specmap_cli.core.geometry import IDENTITY, Pose2
from specmap_cli.core.records import PlanarScan, PosedScan
from specmap_cli.core.settings import LocalizationConfig
from specmap_cli.grids.gridmap import UNKNOWN, GridMap
from specmap_cli.grids.matching import ScoreField, search_everywhere
from specmap_cli.recognition.learning.misfit import HeldOutMisfit, pooled
from specmap_cli.recognition.localization.walls import Ratio, WallCheck

CONFIG = LocalizationConfig()


def posed(scan: PlanarScan, pose: Pose2, **more: Any) -> PosedScan:
    return PosedScan(
        index=0, stamp_ns=0, map_from_base=pose, planar=scan, base_from_laser=IDENTITY, **more
    )


class Counted:
    """The walls of one room for every submap; counts what is asked for."""

    def __init__(self, building: Any, room: int = 0) -> None:
        self.grid = building.walk(room, 0, "pairs").grid
        self.walls = ScoreField.from_grid(self.grid)
        self.asked: list[int] = []

    def __call__(self, submap: int) -> ScoreField:
        self.asked.append(submap)
        return self.walls


def walls_of(building: Any, **settings: float) -> tuple[WallCheck, Counted]:
    config, field = LocalizationConfig.model_validate(settings), Counted(building)
    grids = dict.fromkeys((7, 8, 9), field.grid)
    return WallCheck(grids, field, Ratio(None, config), config), field


@pytest.mark.parametrize("typical", [0.0, 0.06, 0.3])
def test_the_ratio_is_that_of_scipy_s_distributions(typical: float) -> None:
    ratio = Ratio(HeldOutMisfit(typical, 60), CONFIG)
    for misfit in (0.02, 0.1, 0.2, 0.3):
        unknown = norm.logpdf(misfit, CONFIG.foreign_misfit, CONFIG.foreign_misfit_spread)
        expected = unknown - expon.logpdf(misfit, scale=ratio.known)
        most = CONFIG.fit_most
        assert ratio.of(misfit) == pytest.approx(min(max(expected, -most), most))


@given(st.floats(0.0, 1.0), st.floats(0.0, 1.0), st.floats(0.0, 1.0), st.integers(0, 60))
def test_more_misfit_never_speaks_for_the_map(
    one: float, other: float, typical: float, views: int
) -> None:
    ratio = Ratio(HeldOutMisfit(typical, views), CONFIG)
    low, high = sorted((one, other))
    assert ratio.of(low) <= ratio.of(high) + 1e-12


def test_few_views_widen_what_is_taken_for_known() -> None:
    means = [pooled(HeldOutMisfit(0.01, views), CONFIG) for views in (0, 2, 10, 60)]
    assert means == sorted(means, reverse=True)
    assert means[0] == pooled(None, CONFIG) == CONFIG.usual_misfit
    assert pooled(HeldOutMisfit(0.0, 60), CONFIG) == CONFIG.least_misfit
    assert pooled(HeldOutMisfit(0.2, 60), CONFIG) == pytest.approx(0.2 / math.log(2.0), rel=0.1)


def test_own_scans_fit_and_those_of_another_room_do_not(building: Any) -> None:
    for room, sign in ((0, -1.0), (2, 1.0)):
        poses = building.path(room, 3)[::6]
        for pose, scan in zip(poses, building.scans(poses), strict=True):
            walls, _ = walls_of(building)
            said = walls.unknown(posed(scan, Pose2(*pose.tolist())), scan, [7])
            assert said is not None
            assert sign * said > 0.5


def test_a_scan_that_fits_where_motion_leads_is_not_sought_again(
    building: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    searched = []

    def counting(*given: Any, **more: Any) -> Any:
        searched.append(given)
        return search_everywhere(*given, **more)

    module = "specmap_cli.recognition.localization.walls.search_everywhere"
    monkeypatch.setattr(module, counting)
    walls, _ = walls_of(building)
    poses = building.path(0, 3)
    for pose, scan in zip(poses, building.scans(poses), strict=True):
        walls.unknown(posed(scan, Pose2(*pose.tolist())), scan, [7])
    assert len(searched) == 1
    walls.restart()
    walls.unknown(posed(scan, Pose2(*pose.tolist())), scan, [7])
    assert len(searched) == 2


def test_standing_elsewhere_is_searched_ever_more_rarely(building: Any) -> None:
    walls, field = walls_of(building)
    scan = building.scans(building.path(2, 3)[:1])[0]
    said = [walls.unknown(posed(scan, IDENTITY), scan, [7]) for _ in range(32)]
    # at the 1st scan, then 2, 4, 8 and 16 scans later
    assert [k for k, ratio in enumerate(said) if ratio is not None] == [0, 2, 6, 14, 30]
    assert len(set(field.asked)) == 1


def test_driving_elsewhere_is_searched_by_the_way(building: Any) -> None:
    walls, _ = walls_of(building, fit_search_m=1.0)
    scan = building.scans(building.path(2, 3)[:1])[0]
    said = [
        walls.unknown(posed(scan, Pose2(0.1 * k, 0.0, 0.0)), scan, [7]) is not None
        for k in range(60)
    ]
    assert said.count(True) in range(6, 12)


def test_the_likeliest_submap_that_fits_ends_the_search(building: Any) -> None:
    walls, field = walls_of(building)
    pose = building.path(0, 3)[:1]
    scan = building.scans(pose)[0]
    walls.unknown(posed(scan, Pose2(*pose[0].tolist())), scan, [7, 8, 9])
    assert set(field.asked) == {7}


def test_returns_where_the_map_saw_nothing_count_less(building: Any) -> None:
    """The scan of a room against a map of its left half."""
    ratios = []
    for weight in (0.0, 1.0):
        walls, field = walls_of(building, unseen_weight=weight)
        cells = field.grid.cells.copy()
        cells[:, cells.shape[1] // 2 :] = UNKNOWN
        field.walls = ScoreField.from_grid(GridMap(cells, field.grid.resolution, field.grid.origin))
        walls.grids = {7: GridMap(cells, field.grid.resolution, field.grid.origin)}
        pose = building.path(0, 3)[:1]
        scan = building.scans(pose)[0]
        ratios.append(walls.unknown(posed(scan, Pose2(*pose[0].tolist())), scan, [7]))
    assert ratios[0] is not None
    assert ratios[1] is not None
    assert ratios[0] < ratios[1]


def test_lost_and_empty_scans_say_nothing(building: Any) -> None:
    walls, _ = walls_of(building)
    scan = building.scans(building.path(0, 3)[:1])[0]
    assert walls.unknown(posed(scan, IDENTITY, lost=True), scan, [7]) is None
    few = replace(scan, ranges=np.where(np.arange(len(scan.ranges)) < 9, scan.ranges, np.inf))
    assert walls.unknown(posed(few, IDENTITY), few, [7]) is None
