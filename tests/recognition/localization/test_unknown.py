"""What speaks for unknown counts by the motion since it counted last."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from specmap_cli.core.records import PosedScan
from specmap_cli.core.settings import LocalizationConfig
from specmap_cli.recognition.localization.classification import ClassifiedScan
from specmap_cli.recognition.localization.unknown import UnknownOdds, WallCheck
from tests.recognition.posed import EMPTY, at
from tests.turning import turn

CONFIG = LocalizationConfig()


@pytest.fixture(autouse=True)
def _clues() -> None:
    strange = {"strange_from": 1.0, "strange_gain": 2.0, "strange_most": 1.0}
    turn("recognition", independent_m=1.0, independent_rad=2.0, **strange)


class Saying(WallCheck):
    """Walls that say what they are told to, scan by scan; some are `found` by a search."""

    def __init__(self, said: Sequence[float | None], found: Sequence[int]) -> None:
        self.told = [(ratio, k in found) for k, ratio in enumerate(said)]

    def unknown(self, *_: Any) -> float | None:
        ratio, self.found = self.told.pop(0)
        return ratio

    def restart(self) -> None:
        """Nothing to forget."""


def unknown_odds(said: Sequence[float | None], found: Sequence[int] = ()) -> UnknownOdds:
    return UnknownOdds(Saying(said, found), CONFIG)


def looks(strange: float = -math.inf, shown: float = 1.0) -> ClassifiedScan:
    none = np.zeros(1)
    return ClassifiedScan(
        margins=none, raw=none, all=none, strange=strange, seen=EMPTY, shown=shown
    )


@pytest.mark.parametrize(
    ("said", "late", "worth"),
    [
        ([3.0, -1.0, -2.0, None], [], [3.0, 1.0, 0.0, 0.0]),
        ([4, 3, -2, -3], [2], [4, 3.5, -2, -2.5]),
    ],
)
def test_scans_of_one_view_are_averaged_and_a_place_found_late_takes_the_place_of_those_before(
    said: list[float | None], late: list[int], worth: list[float]
) -> None:
    """As long as the right submap was not searched, a scan seems to fit none."""
    guide = unknown_odds(said, late)
    found = [guide.worth(at(0.0), looks(), [1], again=k > 0) for k in range(4)]
    assert found == pytest.approx(worth)


@pytest.mark.parametrize(
    ("scan", "share"), [(at(0.25), 0.25), (at(0.0, 0.5), 0.25), (at(0.3, 0.4), 0.5), (at(9.0), 1.0)]
)
def test_a_view_counts_by_the_motion_to_it_and_whole_after_a_restart(
    scan: PosedScan, share: float
) -> None:
    guide = unknown_odds([4.0, 4.0, -3.0])
    assert guide.worth(at(0.0), looks(), [1], again=False) == 4.0
    assert guide.worth(scan, looks(), [1], again=False) == pytest.approx(4.0 * share)
    assert guide.of_walls == 4.0
    guide.restart()
    assert guide.of_walls is None
    assert guide.worth(at(0.0), looks(), [1], again=False) == -3.0


def test_motion_that_nothing_was_said_of_counts_when_something_is_but_a_lost_scan_is_none() -> None:
    guide = unknown_odds([4.0, None, None, 2.0, None, 4.0])
    found = [guide.worth(at(0.3 * k), looks(), [1], again=False) for k in range(4)]
    assert found == pytest.approx([4.0, 0.0, 0.0, 0.9 * 2.0])
    guide.worth(at(50.0, lost=True), looks(), [1], again=True)
    assert guide.worth(at(1.0), looks(), [1], again=False) == pytest.approx(0.4)


@pytest.mark.parametrize(
    ("strange", "shown", "worth"),
    [
        (-math.inf, 1.0, 0.0),
        (1.0, 1.0, 0.0),
        (1.2, 1.0, 0.4),
        (9.0, 1.0, 1.0),
        (0.0, 1.0, -1.0),
        (1.2, 0.5, 0.1),
        (0.8, 0.5, -0.4),
    ],
)
def test_strange_looks_count_within_bounds(strange: float, shown: float, worth: float) -> None:
    """And only as far as enough was seen; that a view looks familiar counts from the start."""
    guide = unknown_odds([None])
    assert guide.worth(at(0.0), looks(strange, shown), [], again=False) == pytest.approx(worth)
