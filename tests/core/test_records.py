"""The records that travel between stages: frozen, and what they compute of themselves."""

from __future__ import annotations

import itertools
from dataclasses import FrozenInstanceError

import numpy as np
import pytest
from hypothesis import given

from specmap_cli.core import records
from specmap_cli.core.geometry import Pose2
from specmap_cli.core.records import Labels, PlanarScan, PosedScan
from tests.strategies import planar_scans, pose_arrays, poses


def test_records_are_frozen_slotted_and_documented() -> None:
    of_here = (kind for kind in vars(records).values() if isinstance(kind, type))
    for kind in (kind for kind in of_here if kind.__module__ == records.__name__):
        assert kind.__dataclass_params__.frozen, kind  # type: ignore[attr-defined]
        assert "__slots__" in vars(kind), kind
        assert kind.__doc__, kind


@given(planar_scans())
def test_hits_are_the_returns_in_order(scan: PlanarScan) -> None:
    hits = scan.hits(4.0)
    kept = [(r, b) for r, b in zip(scan.ranges, scan.bearings, strict=True) if r <= 4.0]
    expected = [(r * np.cos(b), r * np.sin(b)) for r, b in kept]
    np.testing.assert_allclose(hits, np.array(expected).reshape(-1, 2))
    assert len(scan.hits()) == np.isfinite(scan.ranges).sum()


@given(poses, poses)
def test_the_laser_stands_where_its_mounting_says(base: Pose2, mounting: Pose2) -> None:
    scan = PlanarScan(0, np.zeros(0), np.zeros(0), 1.0, False)
    posed = PosedScan(
        index=0, stamp_ns=0, map_from_base=base, planar=scan, base_from_laser=mounting
    )
    assert posed.map_from_laser == base @ mounting
    with pytest.raises(FrozenInstanceError):
        posed.lost = True  # type: ignore[misc]


@given(pose_arrays())
def test_the_way_of_keyframes_is_that_from_each_to_the_next(track: np.ndarray) -> None:
    labels = Labels(
        stamps_ns=np.arange(len(track)), poses=track, submaps=np.zeros(len(track), dtype=np.int64)
    )
    steps = [float(np.linalg.norm(b[:2] - a[:2])) for a, b in itertools.pairwise(track)]
    assert labels.driven_m() == pytest.approx(sum(steps))
    if steps:  # nobody drove from one recording to the next
        assert labels.driven_m([len(track) - 1]) == pytest.approx(sum(steps[:-1]))
