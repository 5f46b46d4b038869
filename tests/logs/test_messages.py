"""Decoding: clouds of every layout, echoes, odometry, transforms, and rubbish."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from specmap_cli.core.geometry import Pose2
from specmap_cli.logs.clouds import cloud_points
from specmap_cli.logs.messages import (
    BadMessageError,
    CloudRecord,
    ScanRecord,
    decode_odometry,
    decode_scan,
    decode_transforms,
)
from specmap_cli.logs.readers.encoding import odometry_cdr, scan_cdr, transform_cdr
from specmap_cli.logs.readers.recording import Message
from specmap_cli.logs.readers.typestore import (
    LASER_SCAN,
    MULTI_ECHO,
    ODOMETRY,
    POINT_CLOUD,
    TF_MESSAGE,
    message_class,
    typestore,
)

DATATYPES = {"u1": 2, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}
STAMP = 1_700_000_000_250_000_000


def header(stamp_ns: int = STAMP, frame: str = "/lidar") -> Any:
    stamp = message_class("builtin_interfaces/msg/Time")(*divmod(stamp_ns, 10**9))
    return message_class("std_msgs/msg/Header")(stamp, frame)


def cloud_message(table: np.ndarray[Any, Any], row_padding: int = 0, **changes: Any) -> Message:
    """A PointCloud2 of a structured array (height, width) in its own layout and byte order."""
    layout = table.dtype
    assert layout.names is not None
    assert layout.fields is not None
    field = message_class("sensor_msgs/msg/PointField")
    fields = [
        field(n, layout.fields[n][1], DATATYPES[layout[n].str[1:]], 1)
        for n in layout.names
        if layout[n].str[1:] in DATATYPES
    ]
    rows = [row.tobytes() + bytes(row_padding) for row in table]
    values = {
        "header": header(),
        "height": table.shape[0],
        "width": table.shape[1],
        "fields": fields,
        "is_bigendian": layout["x"].byteorder == ">",
        "point_step": layout.itemsize,
        "row_step": table.shape[1] * layout.itemsize + row_padding,
        "data": np.frombuffer(b"".join(rows), dtype=np.uint8),
        "is_dense": False,
        **changes,
    }
    message = message_class(POINT_CLOUD)(**values)
    return Message(
        "/points", POINT_CLOUD, 1, bytes(typestore().serialize_cdr(message, POINT_CLOUD))
    )


def decoded_cloud(message: Message) -> CloudRecord:
    record = decode_scan(message)
    assert isinstance(record, CloudRecord)
    return record


@settings(max_examples=80, deadline=None, derandomize=True)
@given(
    order=st.permutations(["x", "y", "z", "intensity", "ring", "time"]),
    gaps=st.lists(st.integers(0, 9), min_size=6, max_size=6),
    coordinate=st.sampled_from(["f4", "f8"]),
    endian=st.sampled_from("<>"),
    shape=st.tuples(st.integers(1, 4), st.integers(1, 7)),
    padding=st.integers(0, 13),
    holes=st.integers(0, 3),
)
def test_any_layout_gives_the_points_and_their_times(
    order: list[str],
    gaps: list[int],
    coordinate: str,
    endian: str,
    shape: tuple[int, int],
    padding: int,
    holes: int,
) -> None:
    kinds = {"x": coordinate, "y": coordinate, "z": coordinate}
    kinds |= {"intensity": "f4", "ring": "u2", "time": "f4"}
    offsets, end = [], 0
    for name, gap in zip(order, gaps, strict=True):
        offsets.append(end + gap)
        end += gap + int(kinds[name][1])
    layout = np.dtype(
        {
            "names": order,
            "formats": [endian + kinds[name] for name in order],
            "offsets": offsets,
            "itemsize": end + gaps[0],
        }
    )
    rng = np.random.default_rng(1)
    table = np.zeros(shape, dtype=layout)
    for axis in "xyz":
        table[axis] = rng.uniform(1.0, 5.0, shape)
    table["time"] = np.linspace(0.0, 0.1, table.size).reshape(shape)
    flat = table.reshape(-1)
    flat["y"][:holes] = np.nan
    points, times = cloud_points(decoded_cloud(cloud_message(table, padding)), STAMP, 100.0)
    kept = flat[holes:]
    np.testing.assert_array_equal(points, np.column_stack([kept[axis] for axis in "xyz"]))
    if len(kept) > 1:
        np.testing.assert_array_equal(times, kept["time"])
    else:
        assert times is None


@pytest.mark.parametrize("name", ["t", "time", "timestamp", "time_stamp", "offset_time"])
@pytest.mark.parametrize(
    ("kind", "values"),
    [
        ("f4", [0.0, 0.05, 0.1]),  # seconds after the stamp
        ("f8", [STAMP / 1e9 + t for t in (0.0, 0.05, 0.1)]),  # seconds, absolute
        ("f8", [STAMP + t * 1e9 for t in (0.0, 0.05, 0.1)]),  # nanoseconds, absolute
        ("u4", [0, 50_000_000, 100_000_000]),  # nanoseconds after the stamp
        ("f4", [0.0, 5e7, 1e8]),
    ],
)
def test_point_times_of_every_kind(name: str, kind: str, values: list[float]) -> None:
    layout = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), (name, f"<{kind}")])
    table = np.ones((1, 3), dtype=layout)
    table[name] = values
    _, times = cloud_points(decoded_cloud(cloud_message(table)), STAMP, 100.0)
    assert times is not None
    np.testing.assert_allclose(times, [0.0, 0.05, 0.1], atol=3e-7)


def test_times_before_the_stamp_are_kept() -> None:
    table = np.ones((1, 3), dtype=[("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("time", "<f4")])
    table["time"] = [-0.1, -0.05, 0.0]
    _, times = cloud_points(decoded_cloud(cloud_message(table)), STAMP, 100.0)
    np.testing.assert_allclose(times, [-0.1, -0.05, 0.0], atol=1e-7)  # type: ignore[arg-type]


@pytest.mark.parametrize("values", [[0.1, 0.1, 0.1], [0.0, math.nan, 0.1], [0.0, 1e12, 2e12]])
def test_times_that_cannot_be_relied_on_are_none(values: list[float]) -> None:
    table = np.ones((1, 3), dtype=[("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("time", "<f8")])
    table["time"] = values
    points, times = cloud_points(decoded_cloud(cloud_message(table)), STAMP, 100.0)
    assert len(points) == 3
    assert times is None


def test_points_at_the_origin_and_beyond_range_are_left_out_with_their_times() -> None:
    table = np.ones((2, 3), dtype=[("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("t", "<u4")])
    table["t"] = [[0, 10, 20], [30, 40, 50]]
    for axis in "xyz":
        table[axis][0, 1] = 0.0
    table["x"][1, 0] = 300.0
    table["z"][1, 2] = np.inf
    points, times = cloud_points(decoded_cloud(cloud_message(table)), STAMP, 100.0)
    assert len(points) == 3
    np.testing.assert_allclose(times, [0.0, 20e-9, 40e-9])  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"width": 1000}, "too few for 1 x 1000 points"),
        ({"point_step": 4}, "impossible point layout"),
        ({"fields": []}, "no fields x, y and z"),
    ],
)
def test_impossible_clouds_are_refused(changes: dict[str, Any], said: str) -> None:
    table = np.ones((1, 3), dtype=[("x", "<f4"), ("y", "<f4"), ("z", "<f4")])
    with pytest.raises(BadMessageError, match=said):
        decode_scan(cloud_message(table, **changes))


def test_an_empty_cloud_has_no_points() -> None:
    table = np.ones((0, 3), dtype=[("x", "<f4"), ("y", "<f4"), ("z", "<f4")])
    points, times = cloud_points(decoded_cloud(cloud_message(table)), STAMP, 100.0)
    assert points.shape == (0, 3)
    assert times is None


def test_a_scan_is_decoded() -> None:
    data = scan_cdr("/laser", STAMP, -1.0, 0.25, [1.0, np.inf], range_max=9.0, time_increment=0.5)
    record = decode_scan(Message("/scan", LASER_SCAN, 1, data))
    assert isinstance(record, ScanRecord)
    assert (record.stamp_ns, record.frame) == (STAMP, "laser")
    assert (record.angle_min, record.angle_max, record.angle_increment) == (-1.0, -0.75, 0.25)
    assert (record.range_max, record.time_increment) == (9.0, 0.5)
    assert record.ranges.tolist() == [1.0, math.inf]


def test_the_first_echo_counts() -> None:
    echo = message_class("sensor_msgs/msg/LaserEcho")
    beams = [echo(np.array(e, dtype=np.float32)) for e in ([1.0, 2.0], [], [3.0])]
    message = message_class(MULTI_ECHO)(header(), -1.0, 1.0, 1.0, 0.0, 0.1, 0.1, 9.0, beams, [])
    data = bytes(typestore().serialize_cdr(message, MULTI_ECHO))
    record = decode_scan(Message("/echoes", MULTI_ECHO, 1, data))
    assert isinstance(record, ScanRecord)
    assert record.ranges.tolist() == [1.0, math.inf, 3.0]


def test_odometry_and_transforms_are_matrices() -> None:
    data = odometry_cdr("odom", "base", STAMP, Pose2(1.0, 2.0, 0.5))
    odometry = decode_odometry(Message("/odom", ODOMETRY, 1, data))
    assert (odometry.frame, odometry.child, odometry.stamp_ns) == ("odom", "base", STAMP)
    assert Pose2.from_matrix(odometry.frame_from_child) == pytest.approx((1.0, 2.0, 0.5))
    turn = Rotation.from_euler("xyz", [0.3, -0.2, 1.0])
    data = transform_cdr("base", "/laser", STAMP, (1.0, 2.0, 3.0), turn.as_quat())
    (transform,) = decode_transforms(Message("/tf", TF_MESSAGE, 1, data))
    assert (transform.parent, transform.child) == ("base", "laser")
    np.testing.assert_allclose(transform.parent_from_child[:3, :3], turn.as_matrix(), atol=1e-12)
    assert transform.parent_from_child[:3, 3].tolist() == [1.0, 2.0, 3.0]


def test_values_that_are_not_finite_are_refused() -> None:
    data = odometry_cdr("odom", "base", STAMP, Pose2(math.nan, 2.0, 0.5))
    with pytest.raises(BadMessageError, match="not finite"):
        decode_odometry(Message("/odom", ODOMETRY, 1, data))
    data = transform_cdr("base", "laser", STAMP, (math.inf, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    assert decode_transforms(Message("/tf", TF_MESSAGE, 1, data)) == []


@pytest.mark.parametrize("kind", [LASER_SCAN, MULTI_ECHO, POINT_CLOUD])
@pytest.mark.parametrize("data", [b"", b"\x00\x01\x00\x00", b"\x00\x01\x00\x00" + b"\xff" * 60])
def test_rubbish_is_refused(kind: str, data: bytes) -> None:
    with pytest.raises(BadMessageError):
        decode_scan(Message("/scan", kind, 1, data))


def test_every_cut_of_a_message_is_refused() -> None:
    whole = scan_cdr("laser", STAMP, -1.0, 0.25, np.ones(40), range_max=9.0)
    for end in range(0, len(whole) - 4, 3):
        with pytest.raises(BadMessageError):
            decode_scan(Message("/scan", LASER_SCAN, 1, whole[:end]))
