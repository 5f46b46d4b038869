"""Pieces of the way that are held out, and the labels of their scans."""

from __future__ import annotations

import numpy as np

from specmap_cli.core.settings import RecognitionConfig
from specmap_cli.recognition.features.sets import feature_names
from specmap_cli.recognition.learning.training import Pieces, held_out_margins
from specmap_cli.recognition.learning.training_data import Samples

CONFIG = RecognitionConfig(rounds=10)
SET = "table1"


def straight(metres: float) -> np.ndarray:
    """Poses 0.1 m apart along a line."""
    x = np.arange(0.0, metres, 0.1) + 0.01
    return np.column_stack([x, np.zeros_like(x), np.zeros_like(x)])


def samples(centre: float, keyframes: np.ndarray) -> Samples:
    rng = np.random.default_rng(int(100 * centre))
    shape = len(keyframes), len(feature_names(SET))
    return Samples(rng.normal(centre, 1.0, shape), keyframes)


def test_a_piece_in_four_is_held_out_but_not_the_first() -> None:
    held = Pieces(straight(60.0), 1.5).held_out
    assert not held[:49].any()
    assert held[52:98].all()
    assert not held[102:248].any()
    assert 0.2 < held.mean() < 0.3


def test_only_places_that_the_rest_shows_are_tested() -> None:
    pieces, line = Pieces(straight(60.0), 1.5), samples(0.0, np.arange(600))
    tested = pieces.tested(line).keyframes
    assert set(tested) < set(np.flatnonzero(pieces.held_out))
    assert {51, 97} <= set(tested)
    assert not {75} & set(tested)
    assert len(pieces.rest(line).keyframes) == (~pieces.held_out).sum()
    there_and_back = np.vstack([straight(30.0), straight(30.0)[::-1]])
    both = Pieces(there_and_back, 1.5)
    again = both.tested(samples(0.0, np.arange(600))).keyframes
    assert len(again) == both.held_out.sum()


def test_a_submap_of_which_nothing_is_left_is_not_tested() -> None:
    pieces = Pieces(straight(60.0), 1.5)
    assert not len(pieces.tested(samples(0.0, np.arange(55, 90))).keyframes)


def test_held_out_scans_are_told_by_what_was_learned_of_the_rest() -> None:
    rest = {2: samples(0.0, np.arange(40)), 5: samples(3.0, np.arange(40)), 7: none()}
    asked = {
        2: samples(0.1, np.arange(9)),
        5: samples(3.1, np.arange(7)),
        7: samples(6.0, np.arange(3)),
    }
    found = held_out_margins(rest, asked, SET, CONFIG, np.random.default_rng(0))
    assert found.column.tolist() == [0] * 9 + [1] * 7
    assert (found.margins.argmax(axis=1) == found.column).mean() > 0.9
    assert (found.margins[:, 2] < -100.0).all()


def test_one_submap_alone_is_not_tested() -> None:
    rest = {2: samples(0.0, np.arange(40)), 5: none()}
    asked = {2: samples(0.1, np.arange(9)), 5: samples(3.0, np.arange(9))}
    found = held_out_margins(rest, asked, SET, CONFIG, np.random.default_rng(0))
    assert found.margins.shape == (0, 2)
    assert not len(found.column)


def none() -> Samples:
    return samples(0.0, np.zeros(0, dtype=np.intp))
