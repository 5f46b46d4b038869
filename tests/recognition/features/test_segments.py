"""Sums and the like over pieces of flat arrays, against a loop."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.recognition.features.returns import Segments, ratio

pieces = st.lists(st.lists(st.floats(-5.0, 5.0), max_size=6), max_size=6)


@given(pieces)
def test_values_of_every_piece_are_those_of_a_loop(given_pieces: list[list[float]]) -> None:
    segments = Segments.of_counts(np.array([len(piece) for piece in given_pieces]))
    values = np.array([value for piece in given_pieces for value in piece])
    assert len(segments) == len(given_pieces)
    assert segments.sum(values) == pytest.approx([sum(piece) for piece in given_pieces])
    means = np.array([float(np.mean(piece)) if piece else 0.0 for piece in given_pieces])
    assert segments.mean(np.stack([values, -values])) == pytest.approx(np.stack([means, -means]))
    assert segments.max(values).tolist() == [max(piece, default=0.0) for piece in given_pieces]
    assert segments.sum(values > 0).tolist() == [
        sum(v > 0 for v in piece) for piece in given_pieces
    ]
    largest = segments.argmax(values) - segments.starts[:-1]
    assert largest.tolist() == [int(np.argmax(piece)) if piece else 0 for piece in given_pieces]
    summed = [total for piece in given_pieces for total in np.cumsum(piece)]
    assert segments.cumsum(values).tolist() == summed
    after = [value for piece in given_pieces for value in (*piece[1:], *piece[:1])]
    assert values[segments.following].tolist() == after
    rows = segments.padded(values, np.nan, width=2)
    assert [row[np.isfinite(row)].tolist() for row in rows] == given_pieces
    positive = segments.kept(values > 0.0)
    assert positive.counts.tolist() == [sum(v > 0 for v in piece) for piece in given_pieces]
    assert segments.last.sum() == sum(bool(piece) for piece in given_pieces)


def test_a_ratio_to_nothing_is_nought() -> None:
    assert ratio(np.array([1.0, 3.0]), np.array([0.0, 2.0])).tolist() == [0.0, 1.5]
