"""Transforms worth a closer look: what is tried, and that nothing is correlated twice."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from specmap_cli.core.geometry import Pose2, wrap_angle
from specmap_cli.grids.correlation import Target
from specmap_cli.grids.matching import refine
from specmap_cli.recognition.closure import verification
from specmap_cli.recognition.closure.prepared import PreparedGrid, prepared
from specmap_cli.recognition.closure.verification import TransformSearch, differ, verify
from tests.turning import turn


@pytest.fixture
def correlated(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """The pictures that were correlated so far."""
    done: list[Any] = []
    real = Target.correlate_turned

    def counting(self: Target, pictures: Any) -> Any:
        done.append(pictures)
        return real(self, pictures)

    monkeypatch.setattr(Target, "correlate_turned", counting)
    return done


def two(building: Any, first: int, second: int) -> tuple[PreparedGrid, PreparedGrid]:
    """Grids of a room and of another, or of the same one seen on another walk."""
    old, new = (
        prepared(building.visit(k, room, seed=k).grid) for k, room in enumerate((first, second))
    )
    assert old is not None
    assert new is not None
    return old, new


def test_the_best_transforms_are_different_and_turn_as_the_walls_do(building: Any) -> None:
    search = TransformSearch(*two(building, 1, 1))
    found = search.best(search.few)
    assert 1 < len(found) <= 8
    for pose in found:
        off = (pose.theta - search._aligned) / (math.pi / 2)
        assert abs(wrap_angle((off - round(off)) * math.pi / 2)) < 1e-9
    pairs = [(a, b) for k, a in enumerate(found) for b in found[:k]]
    assert all(differ(a, b, search.centre, 0.5, math.radians(2.0)) for a, b in pairs)


def test_a_rotation_is_correlated_once_with_the_one_turned_by_half_a_turn(
    building: Any, correlated: list[Any]
) -> None:
    search = TransformSearch(*two(building, 0, 1))
    first = search.best(search.few)
    assert len(correlated) == 2 * len(search.few)
    assert search.best(search.few) == first
    search.best(search.many)
    assert len(correlated) == 2 * len(search.many)


@pytest.mark.parametrize(
    ("score", "lead", "overlap", "passes"),
    [
        (0.9, 0.0, 0.1, 1),  # right
        (0.2, 0.0, 0.1, 1),  # hopeless
        (0.6, 0.5, 0.6, 1),  # clear: it is another place
        (0.6, 0.05, 0.6, 2),
        (0.6, 0.5, 0.3, 2),
    ],
)
def test_other_directions_are_tried_when_the_first_answer_is_neither_right_nor_clear(
    score: float,
    lead: float,
    overlap: float,
    passes: int,
    building: Any,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    check = verification.Check(
        old_from_new=Pose2(0.0, 0.0, 0.0),
        score=score,
        confirmed_m=9.0,
        overlap=overlap,
        least_overlap=overlap,
        lead=lead,
    )
    tried: list[Any] = []

    def answer(*given: Any) -> verification.Check:
        tried.append(given)
        return check

    monkeypatch.setattr(verification, "_best", answer)
    assert verify(*two(building, 0, 1)) == check
    assert len(tried) == passes


def test_a_guess_is_refined_once(building: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    guesses: list[Any] = []

    def counting(field: Any, points: Any, guess: Pose2, *limits: Any) -> Any:
        guesses.append((guess, len(points)))
        return refine(field, points, guess, *limits)

    monkeypatch.setattr(verification, "refine", counting)
    grids = two(building, 0, 1)
    turn("recognition", sure_score=1.0, hopeless_score=-1.0, min_lead=9.0)
    assert verify(*grids) is not None
    assert len(guesses) >= 4  # three, the last centimetres, and others of the second pass
    assert len(set(guesses)) == len(guesses)
    assert np.isfinite([guess for guess, _ in guesses]).all()
