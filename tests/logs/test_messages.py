"""Decoding: clouds of every layout, echoes, odometry, transforms, and rubbish."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from specmap_cli.core.geometry import Pose2
from specmap_cli.logs.clouds import CloudPoints, cloud_points
from specmap_cli.logs.messages import (
    BadMessageError,
    CloudRecord,
    ScanLayout,
    ScanRecord,
    decode_odometry,
    decode_scan,
    decode_transforms,
)
from specmap_cli.logs.readers.encoding import (
    LASER_SCAN,
    MULTI_ECHO,
    ODOMETRY,
    POINT_CLOUD,
    TF_MESSAGE,
    Transform,
    cloud_cdr,
    message_class,
    odometry_cdr,
    scan_cdr,
    transform_cdr,
    transforms_cdr,
    typestore,
)
from specmap_cli.logs.readers.recording import Message
from tests.strategies import few
from tests.turning import turn

DATATYPES = {"u1": 2, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}
STAMP = 1_700_000_000_250_000_000
XYZ = [("x", "<f4"), ("y", "<f4"), ("z", "<f4")]
FIELD = message_class("sensor_msgs/msg/PointField")


def header(stamp_ns: int = STAMP, frame: str = "/lidar") -> Any:
    stamp = message_class("builtin_interfaces/msg/Time")(*divmod(stamp_ns, 10**9))
    return message_class("std_msgs/msg/Header")(stamp, frame)


def cloud_message(table: np.ndarray[Any, Any], row_padding: int = 0, **changes: Any) -> Message:
    """A PointCloud2 of a structured array (height, width) in its own layout and byte order."""
    layout = table.dtype
    assert layout.names is not None
    assert layout.fields is not None
    fields = [
        FIELD(n, layout.fields[n][1], DATATYPES[layout[n].str[1:]], 1)
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


def timed(values: list[float], name: str = "time") -> np.ndarray[Any, Any]:
    """A cloud of points alike, each with its time."""
    table = np.ones((1, len(values)), dtype=[*XYZ, (name, "<f8")])
    table[name] = values
    return table


def points_of(table: np.ndarray[Any, Any], row_padding: int = 0) -> CloudPoints:
    return cloud_points(decoded_cloud(cloud_message(table, row_padding)), STAMP)


@few(40)
@given(
    order=st.permutations(["x", "y", "z", "intensity", "ring", "time"]),
    gaps=st.lists(st.integers(0, 9), min_size=6, max_size=6),
    coordinate=st.sampled_from(["f4", "f8"]),
    endian=st.sampled_from("<>"),
    shape=st.tuples(st.integers(0, 4), st.integers(1, 7)),
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
    formats, size = [endian + kinds[name] for name in order], end + gaps[0]
    layout = np.dtype({"names": order, "formats": formats, "offsets": offsets, "itemsize": size})
    rng = np.random.default_rng(1)
    table = np.zeros(shape, dtype=layout)
    for axis in "xyz":
        table[axis] = rng.uniform(1.0, 5.0, shape)
    table["time"] = np.linspace(0.0, 0.1, table.size).reshape(shape)
    flat = table.reshape(-1)
    flat["y"][:holes] = np.nan
    points, times, _ = points_of(table, padding)
    kept = flat[holes:]
    np.testing.assert_array_equal(points, np.column_stack([kept[axis] for axis in "xyz"]))
    if len(kept) > 1:
        np.testing.assert_array_equal(times, kept["time"])
    else:
        assert times is None


def test_points_at_the_origin_and_beyond_range_are_left_out_with_their_times() -> None:
    table = np.ones((2, 3), dtype=[*XYZ, ("t", "<u4")])
    table["t"] = [[0, 10, 20], [30, 40, 50]]
    for axis in "xyz":
        table[axis][0, 1] = 0.0
    table["x"][1, 0] = 300.0
    table["z"][1, 2] = np.inf
    points, times, _ = cloud_points(decoded_cloud(cloud_message(table)), STAMP)
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
    with pytest.raises(BadMessageError, match=said):
        decode_scan(cloud_message(np.ones((1, 3), dtype=XYZ), **changes))


@pytest.mark.parametrize("name", ["z", "intensity"])
@pytest.mark.parametrize("offset", [9, 12, 2**31 - 5, 2**31 - 2, 2**31, 2**32 - 4, 2**32 - 1])
def test_a_field_beyond_its_point_is_refused(name: str, offset: int) -> None:
    places = {"x": 0, "y": 4, "z": 8, name: offset}
    fields = [FIELD(n, at, 7, 1) for n, at in places.items()]
    message = cloud_message(np.ones((1, 3), dtype=XYZ), fields=fields)
    with pytest.raises(BadMessageError) as caught:
        decode_scan(message)
    assert str(caught.value) == f"impossible point layout: {name} is beyond the 12 bytes of a point"


def test_a_scan_is_decoded() -> None:
    data = scan_cdr("/laser", STAMP, -1.0, 0.25, [1.0, np.inf], range_max=9.0, time_increment=0.5)
    record = decode_scan(Message("/scan", LASER_SCAN, 1, data))
    assert isinstance(record, ScanRecord)
    assert (record.stamp_ns, record.frame) == (STAMP, "laser")
    assert record.layout == ScanLayout(
        angle_min=-1.0, angle_max=-0.75, angle_increment=0.25, time_increment=0.5, beams=2
    )
    assert record.range_max == 9.0
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
    assert (odometry.parent, odometry.child, odometry.stamp_ns) == ("odom", "base", STAMP)
    assert Pose2.from_matrix(odometry.parent_from_child) == pytest.approx((1.0, 2.0, 0.5))
    turn = Rotation.from_euler("xyz", [0.3, -0.2, 1.0])
    data = transform_cdr("base", "/laser", STAMP, (1.0, 2.0, 3.0), turn.as_quat())
    (transform,) = decode_transforms(Message("/tf", TF_MESSAGE, 1, data)).records
    assert (transform.parent, transform.child) == ("base", "laser")
    np.testing.assert_allclose(transform.parent_from_child[:3, :3], turn.as_matrix(), atol=1e-12)
    assert transform.parent_from_child[:3, 3].tolist() == [1.0, 2.0, 3.0]


@pytest.mark.parametrize("kind", [LASER_SCAN, MULTI_ECHO, POINT_CLOUD])
def test_rubbish_and_every_cut_of_a_message_are_refused(kind: str) -> None:
    whole = scan_cdr("laser", STAMP, -1.0, 0.25, np.ones(40), range_max=9.0)
    cuts = [whole[:end] for end in range(0, len(whole) - 4, 3)] if kind == LASER_SCAN else []
    for data in (b"", b"\x00\x01\x00\x00", b"\x00\x01\x00\x00" + b"\xff" * 60, *cuts):
        with pytest.raises(BadMessageError):
            decode_scan(Message("/scan", kind, 1, data))


@pytest.mark.parametrize(
    ("values", "longest", "kept", "far"),
    [
        ([-0.15, -0.05, 0.0], 10.0, True, False),
        ([-0.15, -0.05, 0.0], 0.2, True, False),
        ([-0.15, -0.05, 0.0], 0.1, False, True),
        ([0.1, 0.1, 0.1], 10.0, False, False),
        ([0.0, math.nan, 0.1], 10.0, False, False),
        ([0.0, 1e12, 2e12], 10.0, False, True),
    ],
)
def test_times_are_used_where_they_can_be_relied_on_as_far_from_the_stamp_as_the_settings_allow(
    values: list[float], longest: float, kept: bool, far: bool
) -> None:
    turn("logs", cloud_time_max_s=longest)
    points, times, are_far = points_of(timed(values))
    assert len(points) == 3
    assert (times is not None) is kept
    assert are_far is far


def test_a_time_that_is_not_finite_counts_only_with_its_point() -> None:
    table = timed([0.0, math.nan, 0.1])
    table["x"][0, 1] = math.nan
    np.testing.assert_allclose(points_of(table).times_s, [0.0, 0.1], atol=1e-7)  # type: ignore[arg-type]
    assert points_of(timed([0.0, 0.1, 0.2], "intensity")).times_s is None, "of another name"


def test_fields_of_unknown_datatypes_are_passed_over() -> None:
    table = np.ones((2, 2), dtype=[*XYZ, ("odd", "<f4")])
    fields = [FIELD(name, 4 * i, 7, 1) for i, name in enumerate("xyz")]
    fields += [FIELD("odd", 12, 99, 1), FIELD("", 12, 7, 1)]
    record = decoded_cloud(cloud_message(table, fields=fields))
    assert record.points.dtype.names == ("x", "y", "z")
    assert len(cloud_points(record, STAMP).points) == 4


@pytest.mark.parametrize("decode", [decode_odometry, decode_transforms, decode_scan])
@pytest.mark.parametrize("kind", ["geometry_msgs/msg/Twist", "foxglove.LaserScan (protobuf)"])
def test_messages_of_another_type_on_a_topic_are_refused(
    decode: Callable[[Message], object], kind: str
) -> None:
    with pytest.raises(BadMessageError) as caught:
        decode(Message("/topic", kind, 1, bytes(100)))
    assert str(caught.value).startswith(kind)


@pytest.mark.parametrize("far", [1.1e8, 1e20, 1e308, -1e9, math.nan, math.inf])
def test_places_that_are_not_on_earth_are_refused_and_other_transforms_read(far: float) -> None:
    near = odometry_cdr("odom", "base", STAMP, Pose2(4e7, -4e7, 0.5))
    assert decode_odometry(Message("/odom", ODOMETRY, 1, near)).parent_from_child[0, 3] == 4e7
    data = odometry_cdr("odom", "base", STAMP, Pose2(0.0, far, 0.5))
    with pytest.raises(BadMessageError, match="beyond all bounds"):
        decode_odometry(Message("/odom", ODOMETRY, 1, data))
    places = {"/b": (1.0, 0.0, 0.0), "/c": (0.0, 0.0, far), "/d": (2.0, 0.0, 0.0)}
    sent = [Transform("/a", child, xyz, (0.0, 0.0, 0.0, 0.0)) for child, xyz in places.items()]
    data = transforms_cdr(STAMP, sent)
    found = decode_transforms(Message("/tf", TF_MESSAGE, 1, data))
    assert found.absurd == (("a", "c"),)
    kept = [(r.parent, r.child, r.parent_from_child[0, 3]) for r in found.records]
    assert kept == [("a", "b", 1.0), ("a", "d", 2.0)]
    np.testing.assert_array_equal(found.records[0].parent_from_child[:3, :3], np.eye(3))


def test_scans_and_clouds_of_absurd_size_are_refused() -> None:
    wide = scan_cdr("laser", STAMP, -1.0, 1e-5, np.zeros(100_001), range_max=8.0)
    with pytest.raises(BadMessageError, match=r"a scan of 100,001 beams"):
        decode_scan(Message("/scan", LASER_SCAN, 1, wide))
    with pytest.raises(BadMessageError, match=r"2,000,001 bytes are no .*LaserScan of a robot"):
        decode_scan(Message("/scan", LASER_SCAN, 1, bytes(2_000_001)))
    dense = cloud_cdr("laser", STAMP, np.zeros((4_000_001, 3), dtype=np.float32))
    with pytest.raises(BadMessageError, match=r"a cloud of 1 x 4,000,001 points"):
        decode_scan(Message("/points", POINT_CLOUD, 1, dense))
