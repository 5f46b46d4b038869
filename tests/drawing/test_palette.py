"""Colours: neighbours are told apart, letters are legible, and the choice is always the same."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from specmap_cli.drawing import palette
from specmap_cli.drawing.palette import Colour
from specmap_cli.maps.writing import MapResult
from specmap_cli.topology.regions import NOBODY
from tests.strategies import seeds


def luminance(colour: Colour) -> float:
    """Relative luminance by WCAG 2.1."""
    blue, green, red = (
        part / 12.92 if part <= 0.03928 else ((part + 0.055) / 1.055) ** 2.4
        for part in (channel / 255.0 for channel in colour)
    )
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


def contrast(one: Colour, other: Colour) -> float:
    """Contrast ratio by WCAG 2.1: 4.5 is asked of text, 3 of lines and symbols."""
    low, high = sorted([luminance(one), luminance(other)])
    return (high + 0.05) / (low + 0.05)


@settings(max_examples=40)
@given(st.integers(2, 40), st.integers(0, 1000))
def test_neighbours_on_a_ring_with_chords_differ_strongly(count: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    chords = {(0, int(i)) for i in rng.integers(2, count + 1, 3) if i < count}
    pairs = {(i, i + 1) for i in range(count - 1)} | chords
    fills = palette.colour_graph(range(count), pairs)
    far = {
        (palette.FILLS[i], palette.FILLS[j])
        for i, j in np.argwhere(palette.fill_distances() >= palette.DISTINCT).tolist()
    }
    assert all((fills[a], fills[b]) in far for a, b in pairs)


@pytest.mark.parametrize("times", [1, 2, 3])
def test_submaps_without_links_use_all_colours_alike(times: int) -> None:
    count = times * len(palette.FILLS)
    fills = list(palette.colour_graph(range(count), []).values())
    assert {fills.count(fill) for fill in palette.FILLS} == {times}


def test_more_neighbours_than_colours() -> None:
    pairs = list(itertools.combinations(range(20), 2))
    fills = palette.colour_graph(range(20), pairs)
    assert len(fills) == 20
    assert len(set(list(fills.values())[:12])) == 12


@given(seeds)
def test_the_choice_does_not_depend_on_the_order_of_pairs_nor_on_strangers(seed: int) -> None:
    rng = np.random.default_rng(seed)
    pairs = [(int(a), int(b)) for a, b in rng.integers(0, 15, (20, 2))]
    usual = palette.colour_graph(range(15), pairs)
    mixed = [(b, a) for a, b in reversed(pairs)] + [(-1, 3), (99, 4), (98, 99), (5, 5)]
    assert palette.colour_graph(range(15), mixed) == usual


@pytest.mark.parametrize("fill", palette.FILLS)
def test_shades_of_a_fill(fill: Colour) -> None:
    assert max(sum(palette.darker(fill)), sum(palette.vivid(fill))) < sum(fill)
    assert sum(fill) < sum(palette.paler(fill)) < 3 * 255
    assert palette.paler(fill, 0.0) == palette.darker(fill, 1.0) == fill
    assert palette.paler(fill, 1.0) == palette.PAPER
    assert palette.darker(fill, 0.0) == (0, 0, 0)


@pytest.mark.parametrize("fill", palette.FILLS)
def test_what_is_drawn_on_a_fill_can_be_read(fill: Colour) -> None:
    assert contrast(palette.INK, fill) > 4.5
    assert contrast(palette.TRAVERSED, fill) > 3.0
    assert contrast(palette.DOOR, fill) > 3.0
    assert contrast(palette.darker(fill), palette.PAPER) > 3.0
    pale = np.array(palette.paler(fill)) - palette.vivid(fill)
    assert np.abs(pale).max() > 80  # a line of predictions over its own region


def test_the_graph_is_lighter_than_the_walls() -> None:
    walls = contrast(palette.INK, palette.PAPER)
    assert contrast(palette.TRAVERSED, palette.PAPER) < walls / 1.5


def test_links_that_mean_different_things_differ() -> None:
    kinds = (palette.TRAVERSED, palette.CLOSURE, palette.LOOSE, palette.PAPER)
    for one, other in itertools.combinations(kinds, 2):
        assert max(abs(a - b) for a, b in zip(one, other, strict=True)) > 60


def test_fills_are_far_from_each_other() -> None:
    distances = palette.fill_distances()
    assert distances.shape == (len(palette.FILLS),) * 2
    np.testing.assert_allclose(distances, distances.T)
    np.testing.assert_array_equal(np.diag(distances), 0.0)
    assert distances[~np.eye(len(distances), dtype=bool)].min() > 10.0


def test_regions_across_a_wall_are_neighbours() -> None:
    owner = np.full((6, 20), NOBODY)
    owner[:, :5], owner[:, 8:12], owner[:, 19] = 0, 4, 2
    assert palette.touching(owner, 4) == {(0, 4)}
    assert palette.touching(owner, 8) == {(0, 4), (2, 4)}


@given(seeds, st.integers(1, 6))
def test_touching_regions_are_found_and_far_ones_are_not(seed: int, reach: int) -> None:
    """Against all pairs of cells of a row or a column."""
    owner = np.random.default_rng(seed).choice([NOBODY, NOBODY, 0, 1, 2, 3], size=(7, 9))
    near, side_by_side = set(), set()
    for lines in (owner, owner.T):
        for line in lines.tolist():
            for i, j in itertools.combinations(range(len(line)), 2):
                a, b = sorted([line[i], line[j]])
                if a != NOBODY and a != b and j - i <= reach:
                    near.add((a, b))
                    side_by_side |= {(a, b)} if j - i == 1 else set()
    assert side_by_side <= palette.touching(owner, reach) <= near


def test_submaps_of_a_map_differ_from_those_linked_and_those_beside(result: MapResult) -> None:
    fills = palette.colours_of(result.topology, result.regions)
    assert sorted(fills) == [0, 1, 2]
    assert len(set(fills.values())) == 3
