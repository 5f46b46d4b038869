"""Where submaps end, once the whole map is known."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.settings import SegmentationConfig
from specmap_cli.grids.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap
from specmap_cli.segmentation.division import regions_of
from tests.strategies import few

CONFIG = SegmentationConfig()


def two_rooms() -> GridMap:
    """Two rooms of 4 m x 4 m side by side, joined by a door 0.9 m wide at y = 2 m."""
    cells = np.full((80, 164), OCCUPIED, dtype=np.uint8)
    cells[2:78, 2:80] = FREE
    cells[2:78, 84:162] = FREE
    cells[31:49, 80:84] = FREE
    return GridMap(cells, 0.05)


def drive(xs: np.ndarray, y: float = 2.0) -> np.ndarray:
    return np.column_stack([xs, np.full(len(xs), y), np.zeros(len(xs))])


def test_keyframes_change_region_in_the_door() -> None:
    poses = drive(np.linspace(1.0, 7.0, 61))
    labels = regions_of(two_rooms(), poses, CONFIG)
    change = np.flatnonzero(np.diff(labels))
    assert len(change) == 1
    assert 3.8 < poses[change[0], 0] < 4.4


def test_a_map_without_free_space_is_one_region() -> None:
    grid = GridMap(np.full((20, 20), UNKNOWN, dtype=np.uint8), 0.05)
    assert regions_of(grid, drive(np.linspace(0.0, 1.0, 5)), CONFIG).tolist() == [0] * 5


def without_grazed(labels: list[int], poses: np.ndarray, way_m: float) -> list[int]:
    """The rule written out: short regions go to the one before, the first ones to the one after."""
    way = dict.fromkeys(labels, 0.0)
    for k in range(1, len(labels)):
        way[labels[k]] += float(np.hypot(*(poses[k, :2] - poses[k - 1, :2])))
    kept = [label for label in labels if way[label] >= way_m]
    result, last = [], kept[0] if kept else max(way, key=lambda name: (labels.count(name), -name))
    for label in labels:
        last = label if label in kept else last
        result.append(last)
    return result


@given(seed=st.integers(0, 10_000), way_m=st.sampled_from([0.5, 1.5, 4.0, 1e3]))
@few(8)
def test_regions_hardly_driven_through_go_to_the_one_before(seed: int, way_m: float) -> None:
    rng = np.random.default_rng(seed)
    stops = np.concatenate([[rng.uniform(0.5, 7.5)], rng.uniform(3.0, 5.5, 4)])
    xs = np.concatenate([np.linspace(a, b, 15) for a, b in itertools.pairwise(stops)])
    poses = drive(xs)
    every = regions_of(two_rooms(), poses, CONFIG.model_copy(update={"region_min_m": 0.0}))
    found = regions_of(two_rooms(), poses, CONFIG.model_copy(update={"region_min_m": way_m}))
    assert found.tolist() == without_grazed(every.tolist(), poses, way_m)


@pytest.mark.parametrize("x", [-3.0, 12.0])
def test_keyframes_beyond_the_map_go_to_its_nearest_edge(x: float) -> None:
    poses = drive(np.concatenate([np.linspace(1.0, 7.0, 31), [x]]))
    labels = regions_of(two_rooms(), poses, CONFIG.model_copy(update={"region_min_m": 0.0}))
    assert labels[-1] == (labels[0] if x < 0 else labels[30])
    assert labels.dtype == np.int64
