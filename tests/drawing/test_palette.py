"""Colours: neighbours are told apart, letters are legible, and the choice is always the same."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import Delaunay

from specmap_cli.core.geometry import IDENTITY
from specmap_cli.drawing import palette
from specmap_cli.drawing.palette import Colour
from specmap_cli.grids.gridmap import FREE, OCCUPIED, GridMap
from specmap_cli.topology.regions import NOBODY, Regions
from specmap_cli.topology.topological_map import Submap, TopologicalMap
from tests.drawing.looking import contrast, least_difference
from tests.strategies import few, seeds

APART = 15.0  # CIEDE2000: told apart at a glance


@pytest.mark.parametrize("colours", [palette.FILLS, palette.LINES], ids=["fills", "lines"])
def test_any_two_colours_are_told_apart_by_all_eyes(colours: tuple[Colour, ...]) -> None:
    assert min(least_difference(a, b) for a, b in itertools.combinations(colours, 2)) >= APART


@pytest.mark.parametrize("fill", palette.FILLS)
def test_a_fill_its_shades_and_what_is_drawn_on_it(fill: Colour) -> None:
    assert least_difference(fill, palette.PAPER) > 7.0
    for grey in (palette.SHADE, palette.SEEN):
        assert least_difference(fill, grey) > 7.0
    assert least_difference(palette.SEEN, palette.PAPER) > 9.0
    assert max(sum(palette.darker(fill)), sum(palette.vivid(fill))) < sum(fill)
    assert sum(fill) < sum(palette.paler(fill)) < 3 * 255
    assert palette.paler(fill, 0.0) == palette.darker(fill, 1.0) == fill
    assert palette.paler(fill, 1.0) == palette.PAPER
    assert palette.darker(fill, 0.0) == (0, 0, 0)
    assert contrast(palette.INK, fill) > 4.5
    assert contrast(palette.DOOR, fill) > 2.5
    assert contrast(palette.darker(fill), palette.PAPER) > 3.0
    assert contrast(palette.BORDER, fill) > 1.8
    # links and lines of predictions have a rim of paper
    assert contrast(palette.TRAVERSED, palette.PAPER) > 4.5
    assert contrast(palette.vivid(fill), palette.PAPER) > 3.0


def planar(seed: int, count: int) -> tuple[list[int], set[tuple[int, int]]]:
    """Regions of a random floor and their neighbours: points joined by triangles, some merged.

    Merged points make long regions with many neighbours, as corridors are. The numbers are in no
    order, so that a corridor may come after all its rooms.
    """
    rng = np.random.default_rng(seed)
    places = rng.random((count, 2))
    places[: count // 8, 1] = 0.5
    corners = Delaunay(places).simplices.tolist()
    pairs = {(a, b) for three in corners for a, b in itertools.combinations(sorted(three), 2)}
    label = np.arange(count)
    for hub in rng.choice(count, max(1, count // 12), replace=False).tolist():
        for pair in sorted(pairs):
            if hub in pair and rng.random() < 0.5:
                label[sum(pair) - hub] = hub
    label = rng.permutation(count)[label]
    joined = {(int(label[a]), int(label[b])) for a, b in pairs if label[a] != label[b]}
    return sorted(set(label.tolist())), joined


@few(30)
@given(seeds, st.integers(5, 70))
def test_neighbours_of_any_floor_are_told_apart_by_all_eyes(seed: int, count: int) -> None:
    ids, pairs = planar(seed, count)
    fills = palette.colour_graph(ids, pairs)
    worn = {frozenset((fills[a], fills[b])) for a, b in pairs}
    assert all(len(pair) == 2 and least_difference(*pair) >= APART for pair in worn)


@few(30)
@given(seeds, st.integers(12, 60))
def test_nearly_all_ids_keep_their_colours_when_a_map_grows(seed: int, count: int) -> None:
    ids, pairs = planar(seed, count)
    old = ids[: int(0.8 * len(ids))]
    before, after = palette.colour_graph(old, pairs), palette.colour_graph(ids, pairs)
    assert sum(before[id_] != after[id_] for id_ in old) <= max(3, 0.3 * len(old))


def test_more_neighbours_than_colours() -> None:
    fills = palette.colour_graph(range(20), list(itertools.combinations(range(20), 2)))
    assert len(fills) == 20
    assert set(fills.values()) == set(palette.FILLS)


def test_rooms_on_both_sides_of_a_wall_are_neighbours() -> None:
    """Both ids would like the same colour."""
    first, second = 0, len(palette.FILLS)
    owner = np.full((40, 93), NOBODY)
    owner[:, :40], owner[:, 53:] = first, second  # 0.65 m apart
    grid = GridMap(np.where(owner == NOBODY, OCCUPIED, FREE).astype(np.uint8), 0.05)
    submaps = {id_: Submap(id=id_, map_from_submap=IDENTITY, grid=grid) for id_ in (first, second)}
    fills = palette.colours_of(TopologicalMap(submaps=submaps), Regions.of(grid, owner))
    assert fills[first] != fills[second]
    owner = np.full((6, 20), NOBODY)
    owner[:, :5], owner[:, 8:12], owner[:, 19] = 0, 4, 2
    assert palette.touching(owner, 4) == {(0, 4)}
    assert palette.touching(owner, 8) == {(0, 4), (2, 4)}
