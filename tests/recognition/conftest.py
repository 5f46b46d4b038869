"""Rooms and the grids that a robot makes of them."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from specmap_cli.core.geometry import FloatArray, Pose2, compose, invert
from specmap_cli.core.records import PlanarScan, PosedScan
from specmap_cli.core.settings import GridConfig
from specmap_cli.grids.gridmap import FREE, OCCUPIED, GridMap, PackedGrid
from specmap_cli.grids.occupancy import OccupancyGrid
from specmap_cli.recognition.closure.loop_closer import Stay
from specmap_cli.recognition.features.sets import ENTRY_POINTS, feature_sets, scans_features
from tests import plugins
from tests.casting import ranges_at
from tests.recognition.posed import posed

BEARINGS = np.linspace(-np.pi, np.pi, 180, endpoint=False)


class Building:
    """Rooms 8 m apart, closed boxes with furniture; `visit` drives through one of them."""

    def __init__(self, twins: bool = False) -> None:
        cells = np.full((200, 800), OCCUPIED, dtype=np.uint8)
        for k, (width, height) in enumerate([(100, 90), (60, 140), (130, 60), (90, 120)]):
            if twins and k == 1:
                width, height = 100, 90
            left = 20 + 190 * k
            cells[20 : 20 + height, left : left + width] = FREE
            odd = 0 if twins and k == 1 else k
            cells[24 + 3 * odd : 34 + 3 * odd, left + 14 + 9 * odd : left + 26 + 9 * odd] = OCCUPIED
            cells[20 + height - 12 : 20 + height, left + 6 : left + 14 + 6 * odd] = OCCUPIED
        self.plan = GridMap(cells, 0.05)
        self.corners = [(0.05 * (20 + 190 * k), 1.0) for k in range(4)]
        self.sizes = [(5.0, 4.5), (5.0, 4.5) if twins else (3.0, 7.0), (6.5, 3.0), (4.5, 6.0)]

    def path(self, room: int, seed: int) -> FloatArray:
        """(40, 3) poses of a walk through the room."""
        rng = np.random.default_rng(seed)
        (x, y), (width, height) = self.corners[room], self.sizes[room]
        t = np.linspace(0.0, 1.0, 40)
        across, along = 0.5 + 0.22 * np.cos(2 * np.pi * t), 0.55 + 0.2 * t
        places = np.column_stack([x + width * across, y + height * along])
        places += rng.normal(0.0, 0.02, places.shape)
        return np.column_stack([places, rng.uniform(-np.pi, np.pi, len(t))])

    def scans(self, poses: FloatArray) -> list[PlanarScan]:
        """What a laser sees all round from each pose."""
        cast = ranges_at(self.plan, poses, BEARINGS, 20.0)
        return [PlanarScan(0, BEARINGS, ranges, 20.0, full_circle=True) for ranges in cast]

    def posed(self, poses: FloatArray) -> list[PosedScan]:
        """The scans from each pose, at that pose."""
        seen = zip(self.scans(poses), [Pose2(*pose) for pose in poses.tolist()], strict=True)
        return [posed(scan, place, k) for k, (scan, place) in enumerate(seen)]

    def frame(self, room: int, seed: int = 0) -> Pose2:
        """Where a walk through the room begins."""
        return Pose2(*self.path(room, seed)[0].tolist())

    @cache  # noqa: B019 (one building lasts for the session)
    def walk(self, room: int, seed: int, feature_set: str) -> Stay:
        """A stay of one walk through a room, in the frame of the walk's first pose."""
        poses = self.path(room, seed)
        track = compose(invert(poses[0]), poses)
        grid, scans = OccupancyGrid(GridConfig(footprint_m=0.0)), self.scans(poses)
        grid.integrate(scans, track, track)
        features = scans_features(scans, feature_set)
        return Stay(number=0, features=features, packed=PackedGrid.of(grid.snapshot()), track=track)

    def visit(
        self,
        number: int,
        room: int,
        seed: int = 0,
        feature_set: str = "full",
        travelled_m: float | None = None,
    ) -> Stay:
        """A walk as stay `number`; its frame is known when the path driven before it is."""
        stay = replace(self.walk(room, seed, feature_set), number=number)
        if travelled_m is None:
            return stay
        return replace(stay, map_from_stay=self.frame(room, seed), travelled_m=travelled_m)

    def truth(self, room: int, old_seed: int, new_seed: int) -> Pose2:
        """The true `old_from_new` of two visits to a room."""
        return self.frame(room, old_seed).inverse() @ self.frame(room, new_seed)


@pytest.fixture(scope="session")
def building() -> Building:
    """Four different rooms."""
    return Building()


@pytest.fixture(scope="session")
def twins() -> Building:
    """The first two of four rooms are alike."""
    return Building(twins=True)


# A package of somebody else: two groups of features, of which the second is a histogram.
MINE = """
import numpy as np
from specmap_cli.recognition.features.group import FeatureGroup

RINGS = ("rings_near", "rings_middle", "rings_far")

def reach(returns):
    return [float(returns.ranges.max()) if len(returns) else 0.0, float(len(returns))]

def rings(returns):
    counts = np.histogram(returns.ranges, [0.0, 2.0, 4.0, np.inf])[0]
    return (counts / max(1, len(returns))).tolist()

GROUPS = (FeatureGroup(reach, ("reach", "returns")), FeatureGroup(rings, RINGS, histogram=RINGS))
"""

Install = Callable[..., None]


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Install]:
    """Installs a package whose `GROUPS` are offered as a feature set of the given name."""

    def installed(feature_set: str, text: str = MINE) -> None:
        plugins.install(tmp_path, monkeypatch, ENTRY_POINTS, {feature_set: "GROUPS"}, text)
        feature_sets.cache_clear()

    yield installed
    feature_sets.cache_clear()
