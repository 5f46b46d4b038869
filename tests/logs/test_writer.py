"""The writer against the readers of rosbags and mcap, which know nothing of ours."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from specmap_cli.core.errors import UsageError
from specmap_cli.core.geometry import Pose2
from specmap_cli.logs.writer import LogWriter


def write_small(path: Path) -> None:
    with LogWriter(path) as log:
        log.static_transform("base_link", "laser", (0.1, 0.0, 0.3), (0.0, 0.0, 0.0, 1.0), 5)
        log.odometry("/odom", "odom", "base_link", 10, Pose2(1.0, 2.0, 0.5))
        log.transform("odom", "base_link", 10, Pose2(1.0, 2.0, 0.5))
        log.scan("/scan", "laser", 2_000_000_011, -1.0, 0.5, [1.0, np.inf, 2.0], range_max=8.0)
        log.cloud("/points", "lidar", 2_000_000_012, np.eye(3), times_s=[0.0, 0.1, 0.2])


def test_messages_are_read_back_by_other_readers(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    write_small(path)
    found = {}
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            assert schema is not None
            store = get_typestore(Stores.EMPTY)  # only what the file itself defines
            store.register(get_types_from_msg(schema.data.decode(), schema.name))
            found[channel.topic] = store.deserialize_cdr(message.data, schema.name)
    assert list(found) == ["/tf_static", "/odom", "/tf", "/scan", "/points"]
    scan, odom, cloud = found["/scan"], found["/odom"], found["/points"]
    assert scan.ranges.tolist() == [1.0, np.inf, 2.0]  # type: ignore[attr-defined]
    assert scan.angle_max == 0.0  # type: ignore[attr-defined]
    assert scan.header.stamp.sec == 2  # type: ignore[attr-defined]
    assert scan.header.stamp.nanosec == 11  # type: ignore[attr-defined]
    pose = odom.pose.pose  # type: ignore[attr-defined]
    assert (pose.position.x, pose.position.y) == (1.0, 2.0)
    assert 2 * np.arctan2(pose.orientation.z, pose.orientation.w) == pytest.approx(0.5)
    table = cloud.data.view("<f4").reshape(3, 4)  # type: ignore[attr-defined]
    np.testing.assert_array_equal(table[:, :3], np.eye(3))
    np.testing.assert_allclose(table[:, 3], [0.0, 0.1, 0.2], rtol=1e-6)


def test_same_calls_give_the_same_bytes(tmp_path: Path) -> None:
    write_small(tmp_path / "a.mcap")
    write_small(tmp_path / "b.mcap")
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()


def test_a_failed_run_leaves_nothing(tmp_path: Path) -> None:
    def interrupted() -> None:
        with LogWriter(tmp_path / "log.mcap") as log:
            log.odometry("/odom", "odom", "base_link", 10, Pose2(0.0, 0.0, 0.0))
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert list(tmp_path.iterdir()) == []


def test_an_unwritable_place_is_a_usage_error(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="is a directory"):
        LogWriter(tmp_path)
    with pytest.raises(UsageError, match="cannot write: No such file or directory"):
        LogWriter(tmp_path / "missing" / "log.mcap")
