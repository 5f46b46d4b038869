"""Regions that the robot came straight back to, and what is told of a pair compared twice."""

from __future__ import annotations

from unittest.mock import Mock, call

import numpy as np
import pytest

from specmap_cli.core.config import load_config
from specmap_cli.core.records import Closure, Trajectory
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.pipelines import exploration as module
from specmap_cli.pipelines.exploration import Exploration
from specmap_cli.pipelines.session import Session
from specmap_cli.segmentation.online import Region


def closure(old: int, new: int, *, merged: bool) -> Closure:
    return Closure(
        new=new,
        old=old,
        xi=0.5,
        claims_new_by_old=1.0,
        claims_old_by_new=0.5,
        verified=merged,
        merged=merged,
        score=0.9,
        reason="",
        old_from_new=None,
    )


def test_a_region_that_grew_is_compared_again_whole_and_the_last_word_counts(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(module, "online_labels", Mock(return_value=np.zeros(0, dtype=np.int64)))
    monkeypatch.setattr(Exploration, "_stay", lambda self, number: list(self.regions[number]))
    with KeyframeStore() as store:
        exploration = Exploration(Session(load_config(), store))
        closer = exploration.closer = Mock()
        closer.consider.side_effect = [[], [closure(0, 1, merged=False)]]
        closer.consider_again.return_value = [closure(1, 0, merged=True)]
        closer.consider_leftovers.return_value = []
        exploration.recognise([Region(0, (0, 1), None), Region(1, (2,), None), Region(2, (3,), 1)])
        exploration.recognise_leftovers()
        assert closer.grow.mock_calls == [call([2, 3])]
        assert closer.consider_again.mock_calls == [call(1)]
        explored = exploration.explored(Trajectory(np.zeros(0, dtype=np.int64), np.zeros((0, 3))))
        assert explored.closures == (closure(1, 0, merged=True),)
        assert explored.regions == {0: (0, 1), 1: (2, 3)}
        closer.merge.assert_called_once_with(1, 0)
