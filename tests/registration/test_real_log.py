"""The first minutes of a real log against its ground truth."""

from __future__ import annotations

import itertools
import os
from pathlib import Path

import numpy as np
import pytest

from specmap_cli.core.records import Trajectory
from specmap_cli.core.settings import LogConfig, RegistrationConfig
from specmap_cli.evaluation.trajectories import read_relations, relation_errors
from specmap_cli.logs import open_log
from specmap_cli.logs.stream import SweepStream
from specmap_cli.registration import FrontEnd

DATA = Path(os.environ.get("SPECMAP_DATA", "../shared/data"))


@pytest.mark.skipif(
    not (DATA / "logs" / "fr079.mcap").exists(),
    reason=f"no fr079.mcap in {DATA}/logs; SPECMAP_DATA names the folder",
)
@pytest.mark.parametrize("odometry", [True, False])
def test_relations_of_fr079_hold(odometry: bool) -> None:
    config = LogConfig(use_odometry=odometry)
    front_end = FrontEnd(RegistrationConfig())
    with open_log([DATA / "logs" / "fr079.mcap"]) as log:
        sweeps = itertools.islice(SweepStream(log, config), 700)
        scans = [front_end.register(sweep) for sweep in sweeps]
    trajectory = Trajectory(
        np.array([scan.stamp_ns for scan in scans]),
        np.array([scan.map_from_base for scan in scans]),
    )
    found = relation_errors(trajectory, read_relations(DATA / "truth" / "fr079.relations"))
    assert found.matched > 150
    assert found.translation_m.mean < 0.045
    assert found.rotation_deg.mean < 0.7
    assert front_end.counts["lost"] <= 1
