"""A fast vehicle without odometry, and clouds thinned before anything else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from specmap_cli.core.records import PosedScan
from specmap_cli.core.settings import RegistrationConfig
from specmap_cli.registration import FrontEnd
from tests.registration.street import STEP_M, drive, way

STEPS = 32


@pytest.fixture(scope="module")
def scans() -> list[PosedScan]:
    front_end = FrontEnd(RegistrationConfig())
    return [front_end.register(sweep) for sweep in drive(way(STEPS))]


def test_a_fast_vehicle_is_followed_without_odometry(scans: list[PosedScan]) -> None:
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


def test_a_dense_cloud_is_registered_with_few_points() -> None:
    """A cloud of every point three times is registered as the cloud itself."""
    sweeps = drive(way(3))
    thrice = [
        replace(sweep, cloud=np.repeat(sweep.cloud, 3, axis=0))
        for sweep in sweeps
        if sweep.cloud is not None
    ]
    found = []
    for log in (sweeps, thrice):
        front_end = FrontEnd(RegistrationConfig())
        found.append([front_end.register(sweep).map_from_base for sweep in log])
    assert found[0] == found[1]
