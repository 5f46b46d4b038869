"""One classifier a class: the estimator's contract, and every booster against one fitted alone."""

from __future__ import annotations

import numpy as np
import pytest

from specmap_cli.core.arrays import evenly
from specmap_cli.core.settings import Config, RecognitionConfig
from specmap_cli.recognition.features.sets import feature_names
from specmap_cli.recognition.learning.boosting import OneVsAll, StumpBoost
from tests.recognition.learning.made_up import PAPER, SMALL, samples_of


def one_vs_all(config: Config) -> OneVsAll:
    return OneVsAll(config.recognition.feature_set, config.recognition)


def test_each_booster_is_one_fitted_against_an_even_choice_of_the_others() -> None:
    config = RecognitionConfig(feature_set="table1", booster="stumps", rounds=6, negatives=40)
    made = samples_of(PAPER)
    model = OneVsAll("table1", config).fit(made, np.random.default_rng(0))
    for own, booster in model.boosters_.items():
        others = np.vstack([X for i, X in made.items() if i != own])
        chosen = evenly(others, 40)
        y = np.repeat([1.0, -1.0], [len(made[own]), len(chosen)])
        alone = StumpBoost(feature_names("table1"), 6).fit(np.vstack([made[own], chosen]), y)
        assert booster.to_dict() == alone.to_dict()


def test_one_class_is_enough_and_fitting_again_forgets_it() -> None:
    made = samples_of(SMALL)
    model = one_vs_all(SMALL).fit({7: made[0]}, np.random.default_rng(0))
    assert list(model.classes_) == [7]
    assert (model.margins(made[0]) > 0.0).all()
    model.fit({9: made[0], 5: made[2]}, np.random.default_rng(1))
    assert model.classes_ == tuple(model.boosters_) == (5, 9)
    assert model.margins(made[0]).shape == (90, 2)


@pytest.mark.parametrize("config", [SMALL, PAPER])
def test_margins_are_those_of_the_boosters(config: Config) -> None:
    model = one_vs_all(config).fit(samples_of(config), np.random.default_rng(0))
    X = samples_of(config, seed=5)[2]
    expected = np.column_stack([b.margins(X) for b in model.boosters_.values()])
    assert model.margins(X) == pytest.approx(expected)
    assert model.margins(X[:1]) == pytest.approx(expected[:1])
    assert model.margins(X[:0]).shape == (0, 3)
