"""A fast vehicle without odometry."""

from __future__ import annotations

import pytest

from specmap_cli.core.settings import RegistrationConfig
from specmap_cli.registration import FrontEnd
from tests.registration.street import STEP_M, drive, way

STEPS = 32


def test_a_fast_vehicle_is_followed_without_odometry() -> None:
    front_end = FrontEnd(RegistrationConfig())
    scans = [front_end.register(sweep) for sweep in drive(way(STEPS))]
    assert sum(scan.lost for scan in scans) <= 2
    assert not any(scan.restarted for scan in scans)
    truth = way(STEPS)
    for k in range(22, STEPS):
        step = scans[k - 1].map_from_base.inverse() @ scans[k].map_from_base
        true = truth[k - 1].inverse() @ truth[k]
        assert true.x == pytest.approx(STEP_M, abs=0.02)
        assert (true.inverse() @ step).distance < 0.1
    away = (truth[0].inverse() @ truth[-1]).inverse() @ scans[-1].map_from_base
    assert away.distance < 0.08 * truth[-1].x
    assert abs(away.theta) < 0.02
