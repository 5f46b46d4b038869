"""Which scans look like no place of the map: distances to exemplars and their limit."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.distance import cdist

from specmap_cli.core.arrays import evenly
from specmap_cli.core.geometry import FloatArray
from specmap_cli.recognition.features.sets import feature_names, histogram_columns
from specmap_cli.recognition.learning.calibration import Familiarity
from tests.recognition.learning.made_up import SMALL, samples_of

WIDTH = len(feature_names("pairs"))


def places(seed: int, counts: tuple[int, ...]) -> dict[int, FloatArray]:
    """Features of submaps 3, 6, ...: any shares in the histograms, anything in other columns."""
    rng = np.random.default_rng(seed)
    return {3 * k + 3: rng.uniform(0.0, 1.0, (count, WIDTH)) for k, count in enumerate(counts)}


@given(st.integers(0, 999))
def test_distances_are_those_of_scipy_to_the_nearest_exemplar(seed: int) -> None:
    made = places(seed, (30, 41))
    known = Familiarity("pairs", per_submap=10).fit(made)
    columns = histogram_columns("pairs")
    kept = np.vstack([evenly(X, 10) for X in made.values()])[:, columns]
    assert known.exemplars_.tolist() == np.round(255.0 * np.sqrt(kept)).tolist()
    fresh = places(seed + 1, (25,))[3]
    roots = np.sqrt(fresh[:, columns])
    expected = cdist(roots, known.exemplars_ / 255.0, "cityblock").min(axis=1)
    assert known.strangeness(fresh) == pytest.approx(expected / known.limit_, rel=1e-4)


@pytest.mark.parametrize("share", [0.02, 0.1, 0.4])
def test_about_the_wanted_share_of_samples_is_strange(share: float) -> None:
    known = Familiarity("pairs", share).fit(places(1, (400, 400)))
    fresh = np.vstack(list(places(2, (400, 400)).values()))
    assert (known.strangeness(fresh) > 1.0).mean() == pytest.approx(share, abs=0.06)


def test_columns_that_are_no_histogram_do_not_count_and_shares_are_cut_to_their_bounds() -> None:
    made = samples_of(SMALL)
    known = Familiarity("pairs").fit(made)
    changed = made[4].copy()
    others = np.setdiff1d(np.arange(WIDTH), histogram_columns("pairs"))
    changed[:, others] = -1e6
    assert known.strangeness(changed).tolist() == known.strangeness(made[4]).tolist()
    bounds, beyond = (np.where(np.arange(WIDTH) % 2, *ends)[None] for ends in ((0, 1.0), (-3, 4.0)))
    assert known.strangeness(beyond).tolist() == known.strangeness(bounds).tolist()


@pytest.mark.parametrize(
    ("feature_set", "counts", "can"),
    [
        ("pairs", (40,), True),
        ("pairs", (39,), False),  # 20 exemplars, 19 left for the limit
        ("pairs", (20, 20), True),
        ("pairs", (1,) * 100, False),  # a single sample of a submap is its exemplar
        ("pairs", (), False),
        ("table1", (60,), True),
    ],
)
def test_a_limit_needs_enough_samples(feature_set: str, counts: tuple[int, ...], can: bool) -> None:
    width = len(feature_names(feature_set))
    made = {k: np.zeros((count, width)) for k, count in enumerate(counts)}
    assert Familiarity(feature_set).can_fit(made) is can


def test_samples_that_are_all_alike_leave_a_limit_of_nought() -> None:
    alike = {0: np.full((60, WIDTH), 0.25)}
    known = Familiarity("pairs").fit(alike)
    assert known.limit_ == pytest.approx(0.0, abs=0.2)  # 0.5 is between two steps of 1 / 255
    other = np.full((1, WIDTH), 0.5)
    assert np.isfinite(known.strangeness(other)).all()
    assert known.strangeness(other)[0] > 1.0
