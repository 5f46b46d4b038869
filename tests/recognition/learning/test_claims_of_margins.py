"""From margins to probabilities, and what held-out scans say of how sure these are."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from specmap_cli.core.geometry import FloatArray
from specmap_cli.recognition.learning.calibration import (
    Calibration,
    HeldOutMargins,
    calibrated,
    steadiness,
)

NOTHING = HeldOutMargins(np.zeros((0, 3)), np.zeros(0, dtype=np.intp))


def drawn(ratio: float, scans: int, submaps: int = 8) -> HeldOutMargins:
    """Margins of which the truth is drawn as a calibration of this ratio says."""
    rng = np.random.default_rng(5)
    margins = rng.normal(-10.0, 12.0, (scans, submaps))
    told = np.exp(Calibration(raw=ratio).alone(margins))
    column = [int(rng.choice(submaps, p=row / row.sum())) for row in told]
    return HeldOutMargins(margins, np.array(column, dtype=np.intp))


@pytest.mark.parametrize("virtual", [None, [[0.0, -3.0, 2.0]]])
def test_probabilities_sum_to_one_and_rise_with_the_margin(virtual: Any) -> None:
    seen = None if virtual is None else np.array(virtual)
    for first in (-400.0, -4.0, 0.0, 4.0, 400.0):
        told = np.exp(Calibration().together(np.array([[first, -1.0, 0.0]]), seen))
        assert told.sum() == pytest.approx(1.0)
        assert told.min() > 0.0
        more = np.exp(Calibration().together(np.array([[first + 3.0, -1.0, 0.0]]), seen))
        assert more[0, 0] >= told[0, 0]


def test_by_how_much_a_submap_refuses_a_scan_says_nothing() -> None:
    near, far = (Calibration().alone(np.array([[5.0, m, m]])) for m in (-60.0, -600.0))
    assert near == pytest.approx(far, abs=1e-6)
    unclaimed = np.exp(Calibration().alone(np.array([[-60.0, -90.0, -300.0]])))
    assert unclaimed == pytest.approx(np.full((1, 3), 1.0 / 3.0), abs=1e-3)


def test_scans_that_were_held_out_say_how_sure_a_map_is() -> None:
    usual = calibrated(drawn(0.48, 4000), None)
    assert usual.raw == pytest.approx(1.0, rel=0.15)
    assert (usual.virtual, usual.views) == (1.0, 400)
    sure, unsure = (calibrated(drawn(0.48 * ratio, 4000), None).raw for ratio in (4.0, 0.25))
    assert unsure < 0.7 * usual.raw < usual.raw < sure / 1.3
    few = calibrated(drawn(0.48 * 0.25, 12), None)
    assert unsure < few.raw


def test_both_kinds_are_calibrated_apart() -> None:
    found = calibrated(drawn(0.1, 400), drawn(2.0, 400))
    assert found.raw < 1.0 < found.virtual
    assert found.views == 800


def test_without_a_scan_held_out_all_is_as_usual() -> None:
    assert calibrated(NOTHING, None) == calibrated(NOTHING, NOTHING) == Calibration()


def test_a_view_that_leaves_more_open_goes_on_for_longer() -> None:
    def among(count: int) -> FloatArray:
        told: FloatArray = Calibration().alone(np.where(np.arange(9) < count, 50.0, -99.0)[None])
        return np.asarray(told[0])

    found = [steadiness(among(count)) for count in (1, 2, 9)]
    assert found == pytest.approx([0.3, 0.6, 2.7], rel=0.12)
