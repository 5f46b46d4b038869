"""Clouds: of every layout, the times of their points, the floor they show, planar lasers."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.records import Sweep
from specmap_cli.logs.clouds import CloudPoints, PointClock, cloud_points, floor_of
from specmap_cli.logs.messages import BadMessageError, CloudRecord, decode_scan
from specmap_cli.logs.readers.encoding import POINT_CLOUD, message_class, typestore
from specmap_cli.logs.readers.recording import Message
from specmap_cli.logs.writer import LogWriter
from tests.logs.recordings import sweeps_of
from tests.strategies import few
from tests.turning import turn

Tour = list[tuple[Sweep, Pose2]]

DATATYPES = {"u1": 2, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}
STAMP = 1_700_000_000_250_000_000
XYZ = [("x", "<f4"), ("y", "<f4"), ("z", "<f4")]
FIELD = message_class("sensor_msgs/msg/PointField")
SWEEP_S = np.linspace(0.0, 0.1, 400)


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
    time = message_class("builtin_interfaces/msg/Time")(*divmod(STAMP, 10**9))
    values = {
        "header": message_class("std_msgs/msg/Header")(time, "lidar"),
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
    made = message_class(POINT_CLOUD)(**values)
    return Message("/points", POINT_CLOUD, 1, bytes(typestore().serialize_cdr(made, POINT_CLOUD)))


def decoded_cloud(message: Message) -> CloudRecord:
    record = decode_scan(message)
    assert isinstance(record, CloudRecord)
    return record


@few(40)
@given(
    order=st.permutations(["x", "y", "z", "intensity", "ring", "time"]),
    gaps=st.lists(st.integers(0, 9), min_size=6, max_size=6),
    coordinate=st.sampled_from(["f4", "f8"]),
    endian=st.sampled_from("<>"),
    shape=st.tuples(st.integers(0, 4), st.integers(1, 7)),
    padding=st.integers(0, 13),
    holes=st.lists(st.sampled_from([0.0, 300.0, math.inf, math.nan]), max_size=3),
)
def test_any_layout_gives_the_points_and_their_times(
    order: list[str],
    gaps: list[int],
    coordinate: str,
    endian: str,
    shape: tuple[int, int],
    padding: int,
    holes: list[float],
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
    for place, wrong in enumerate(holes[: len(flat)]):  # at the origin, beyond range, or nowhere
        for axis in "xyz" if wrong == 0.0 else "y":
            flat[axis][place] = wrong
    record, kept = decoded_cloud(cloud_message(table, padding)), flat[len(holes) :]
    if not len(kept):
        with pytest.raises(BadMessageError, match="a cloud without points"):
            points_of(record)
        return
    points, times, _ = points_of(record)
    np.testing.assert_array_equal(points, np.column_stack([kept[axis] for axis in "xyz"]))
    if len(kept) > 1:
        np.testing.assert_array_equal(times, kept["time"])
    else:
        assert times is None


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"width": 1000}, "too few for 1 x 1000 points"),
        ({"point_step": 4}, "impossible point layout"),
        ({"fields": []}, "no fields x, y and z"),
        *(
            ({name: offset}, f"^impossible point layout: {name} is beyond the 12 bytes of a point$")
            for name in ("z", "intensity")
            for offset in (9, 12, 2**31 - 5, 2**31 - 2, 2**31, 2**32 - 4, 2**32 - 1)
        ),
    ],
)
def test_impossible_clouds_are_refused(changes: dict[str, Any], said: str) -> None:
    if changes.keys() <= {"z", "intensity"}:  # of a field that is beyond its point
        places = {"x": 0, "y": 4, "z": 8, **changes}
        changes = {"fields": [FIELD(name, at, 7, 1) for name, at in places.items()]}
    with pytest.raises(BadMessageError, match=said):
        decode_scan(cloud_message(np.ones((1, 3), dtype=XYZ), **changes))


def test_fields_of_unknown_datatypes_are_passed_over() -> None:
    table = np.ones((2, 2), dtype=[*XYZ, ("odd", "<f4")])
    fields = [FIELD(name, 4 * i, 7, 1) for i, name in enumerate("xyz")]
    fields += [FIELD("odd", 12, 99, 1), FIELD("", 12, 7, 1)]
    record = decoded_cloud(cloud_message(table, fields=fields))
    assert record.points.dtype.names == ("x", "y", "z")
    assert len(cloud_points(record, STAMP).points) == 4


def cloud(name: str, kind: str, values: ArrayLike) -> CloudRecord:
    """Points alike, each with its time."""
    table = np.ones((1, len(np.asarray(values))), dtype=[*XYZ, ("intensity", "<f4"), (name, kind)])
    table[name] = values
    return CloudRecord(STAMP, "lidar", table)


def points_of(record: CloudRecord, clock: PointClock | None = None) -> CloudPoints:
    return cloud_points(record, STAMP, clock)


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
    points, times, are_far = points_of(cloud("time", "<f8", values))
    assert len(points) == 3
    assert (times is not None) is kept
    assert are_far is far


def test_a_time_that_is_not_finite_counts_only_with_its_point() -> None:
    record = cloud("time", "<f8", [0.0, math.nan, 0.1])
    record.points["x"][0, 1] = math.nan
    np.testing.assert_allclose(points_of(record).times_s, [0.0, 0.1], atol=1e-7)  # type: ignore[arg-type]
    assert points_of(cloud("ring", "<f8", [0.0, 0.1, 0.2])).times_s is None, "of another name"


@pytest.mark.parametrize(
    ("name", "kind", "values", "precision"),
    [
        pytest.param("time", "<f4", SWEEP_S, 1e-7, id="Velodyne"),
        pytest.param("time", "<f4", SWEEP_S - 0.1, 1e-7, id="Velodyne, before the stamp"),
        pytest.param("t", "<u4", SWEEP_S * 1e9, 1e-8, id="Ouster"),
        pytest.param("timestamp", "<f8", SWEEP_S + STAMP / 1e9, 1e-6, id="Hesai, RoboSense"),
        pytest.param("timestamp", "<f8", SWEEP_S * 1e9 + STAMP, 1e-6, id="Livox, driver 2"),
        pytest.param("offset_time", "<u4", SWEEP_S * 1e9, 1e-8, id="Livox, driver 1"),
        pytest.param("time_stamp", "<u4", SWEEP_S * 1e9, 1e-8, id="Autoware"),
        pytest.param("time_stamp", "<f8", SWEEP_S + STAMP / 1e9, 1e-6, id="Autoware, older"),
        pytest.param("time_offset_ns", "<i4", SWEEP_S * 1e9 - 5e7, 1e-8, id="Aeva"),
        pytest.param("t", "<u4", SWEEP_S * 1e6, 2e-6, id="microseconds"),
        pytest.param("timestamp", "<u8", SWEEP_S * 1e6 + STAMP // 1000, 2e-6, id="absolute us"),
        pytest.param("timestamp", "<f8", SWEEP_S * 1e6 + STAMP / 1e3, 2e-6, id="absolute us float"),
        pytest.param("time", "<f4", SWEEP_S * 1e3, 1e-6, id="milliseconds"),
        pytest.param("time", ">f4", SWEEP_S * 1e6, 1e-6, id="microseconds, big endian"),
        pytest.param("Timestamp", "<f8", SWEEP_S + STAMP / 1e9, 1e-6, id="capital"),
    ],
)
def test_times_of_usual_drivers(name: str, kind: str, values: FloatArray, precision: float) -> None:
    found = points_of(cloud(name, kind, values))
    assert found.times_s is not None
    assert not found.far_times
    begin = -0.1 if values[0] == -0.1 else -0.05 if name == "time_offset_ns" else 0.0
    np.testing.assert_allclose(found.times_s, SWEEP_S + begin, atol=precision)


@pytest.mark.parametrize("since_s", [1234.5, STAMP / 1e9 - 3600.0])
def test_times_of_another_clock_count_from_the_earliest(since_s: float) -> None:
    """Such as seconds since the lidar was switched on, under stamps of the computer."""
    clock = PointClock()
    found = points_of(cloud("timestamp", "<f8", SWEEP_S[::-1] + since_s), clock)
    assert clock.foreign == 1
    np.testing.assert_allclose(found.times_s, SWEEP_S[::-1], atol=1e-6)  # type: ignore[arg-type]
    points_of(cloud("timestamp", "<f8", SWEEP_S + STAMP / 1e9), clock)
    assert clock.foreign == 1


def test_the_first_full_sweep_settles_the_unit() -> None:
    """A sliver of a later sweep spans too little to tell."""
    whole, sliver, few = SWEEP_S * 1e9, np.linspace(0.0, 1e6, 400), np.array([0.0, 1e6])
    for first, second, longest_s in ((whole, sliver, 0.001), (few, whole, 0.1)):
        clock = PointClock()
        points_of(cloud("t", "<u4", first), clock)
        times_s = points_of(cloud("t", "<u4", second), clock).times_s
        assert times_s is not None
        assert times_s.max() == pytest.approx(longest_s)


def test_a_foreign_clock_is_said_once(path: Path) -> None:
    rng = np.random.default_rng(1)
    with LogWriter(path) as log:
        for number in range(3):
            points, stamp = rng.uniform(1.0, 5.0, (400, 3)), STAMP + number * 100_000_000
            log.cloud("/points", "lidar", stamp, points, times_s=SWEEP_S + 500.0)
    sweeps, stream = sweeps_of(path)
    assert all(sweep.cloud_times_s is not None for sweep in sweeps)
    assert (
        "scans whose point times have another clock than their stamps and were counted from "
        "the earliest point: 3"
    ) in stream.warnings


def room(seed: int = 0) -> FloatArray:
    """A room of 8 by 6 m around the origin, its floor at -1.2 m, with a ceiling and a table."""
    rng = np.random.default_rng(seed)
    flat = rng.uniform((-4, -3, 0), (4, 3, 0), (3000, 3))
    walls = rng.uniform((-4, -3, -1.2), (4, 3, 1.8), (2400, 3))
    walls[:800, 0], walls[800:1600, 1], walls[1600:, 1] = 4.0, -3.0, 3.0
    table = rng.uniform((1, 1, -0.45), (2.5, 2.5, -0.45), (800, 3))
    points = np.concatenate([flat - (0, 0, 1.2), flat + (0, 0, 1.8), walls, table])
    return np.asarray(points + rng.normal(0.0, 0.01, points.shape))


@pytest.mark.parametrize("roll", [-0.6, -0.2, 0.0, 0.3])
@pytest.mark.parametrize("pitch", [-0.4, 0.0, 0.25])
@pytest.mark.parametrize("yaw", [0.0, 2.0])
def test_a_tilted_lidar_is_levelled_not_turned(roll: float, pitch: float, yaw: float) -> None:
    turned = Rotation.from_euler("Z", yaw).apply(room())
    level_from_lidar = Rotation.from_euler("YX", [pitch, roll])
    found = floor_of(level_from_lidar.inv().apply(turned))
    assert found is not None
    assert (Rotation.from_matrix(found.rotation) * level_from_lidar.inv()).magnitude() < 0.004
    assert found.floor_m == pytest.approx(-1.2, abs=0.01)


def test_returns_beneath_the_floor_do_not_hide_it() -> None:
    """A shiny floor mirrors the ceiling."""
    mirrored = room()[3000:6000][::40] * (1.0, 1.0, -1.0) - (0.0, 0.0, 2.4)
    clean, found = floor_of(room()), floor_of(np.concatenate([room(), mirrored]))
    assert clean is not None
    assert found is not None
    assert found.floor_m == pytest.approx(-1.2, abs=0.01)
    assert (clean.clear, found.clear) == (True, False)


def only(*keep: str) -> FloatArray:
    parts = {"floor": (0, 3000), "ceiling": (3000, 6000), "walls": (6000, 8400)}
    return np.concatenate([room()[slice(*parts[name])] for name in keep])


@pytest.mark.parametrize(
    ("cloud", "settings_"),
    [
        (np.zeros((0, 3)), {}),
        (only("floor")[:20], {}),
        (only("walls", "ceiling"), {}),
        (only("floor")[np.abs(only("floor")[:, 1]) < 0.1], {}),  # a strip says nothing across it
        (only("floor"), {"floor_radius_m": 1.0}),
        (room(), {"floor_share": 0.9}),
        (Rotation.from_euler("X", 0.5).apply(only("floor")), {"floor_tilt_max_rad": 0.3}),
    ],
    ids=["nothing", "few", "no floor", "strip", "too far", "small share", "tilted"],
)
def test_a_cloud_without_a_floor_says_so(cloud: FloatArray, settings_: dict[str, float]) -> None:
    turn("logs", **settings_)
    assert floor_of(cloud) is None


def test_a_cloud_without_a_floor_has_the_level_of_the_one_before(path: Path) -> None:
    tilt, clouds = Rotation.from_euler("X", 0.2), [only("walls", "ceiling"), room(), only("walls")]
    with LogWriter(path) as log:
        for number, cloud in enumerate(clouds):
            log.cloud("/points", "lidar", number * 100_000_000, tilt.apply(cloud))
    sweeps, stream = sweeps_of(path)
    assert any("levelled by the floor that it shows" in line for line in stream.warnings)
    found = [sweep.cloud for sweep in sweeps]
    for sweep, cloud in zip(found, [tilt.apply(clouds[0]), *clouds[1:]], strict=True):
        assert sweep is not None
        np.testing.assert_allclose(sweep, cloud, atol=0.05)


@pytest.mark.parametrize(
    ("height_m", "tilt_rad", "floor_m", "said"),
    [
        (1.2, 0.0, 0.0, ""),
        (1.3, 0.02, 0.0, ""),
        (1.2, 0.3, None, "a floor that is tilted by 17 degrees against 'base_link'"),
        (1.4, 0.0, None, "a floor that lies 0.20 m above that of 'base_link'"),
        (0.0, 0.0, None, "a floor that lies 1.20 m below that of 'base_link'"),
    ],
)
def test_the_floor_that_clouds_show_counts_for_more_than_transforms(
    path: Path, height_m: float, tilt_rad: float, floor_m: float | None, said: str
) -> None:
    """The lidar is 1.2 m above the floor; those of no height are recorded in the base frame."""
    seen = Rotation.from_euler("X", tilt_rad).apply(room())
    with LogWriter(path) as log:
        if height_m:
            log.static_transform("base_link", "lidar", (0.0, 0.0, height_m))
        for number in range(3):
            log.odometry("/odom", "odom", "base_link", number, Pose2(0.1 * number, 0.0, 0.0))
            log.cloud("/points", "lidar" if height_m else "base_link", number, seen)
    sweeps, stream = sweeps_of(path)
    assert stream.selection.floor_m == pytest.approx(floor_m, abs=0.01)
    assert said in " ".join(stream.warnings)
    assert bool(said) == any("first clouds" in line for line in stream.warnings)
    for sweep in sweeps:  # the table is in the way, the floor is not
        assert np.hypot(*sweep.planar.hits().T).min() > 1.3


LASTS_S = 0.08


def write(path: Path, tour: Tour, mounted: bool, height_m: float) -> None:
    """The returns of a tour as clouds, in a laser frame on the floor or in that of the base."""
    with LogWriter(path) as log:
        if mounted:
            log.static_transform("base_link", "laser", (0.0, 0.0, 0.0))
        for sweep, _ in tour:
            scan = sweep.planar
            hit = np.isfinite(scan.ranges)
            r, b = scan.ranges[hit], scan.bearings[hit]
            points = np.column_stack([r * np.cos(b), r * np.sin(b), np.full(len(r), height_m)])
            times = np.linspace(0.0, LASTS_S, len(hit))[hit]
            log.cloud("/points", "laser" if mounted else "base_link", sweep.stamp_ns, points, times)


@pytest.mark.parametrize(("mounted", "height_m"), [(True, 0.0), (False, 0.1), (False, 2.0)])
def test_their_points_and_times_count_at_any_height_and_become_a_planar_scan(
    flat_tour: Tour, path: Path, mounted: bool, height_m: float
) -> None:
    tour = flat_tour[:20]
    write(path, tour, mounted, height_m)
    sweeps, stream = sweeps_of(path)
    assert len(sweeps) == len(tour)
    assert "height band" not in stream.selection.note
    for found, (true, _) in zip(sweeps, tour, strict=True):
        assert found.cloud is None
        assert len(found.planar.hits()) == pytest.approx(len(true.planar.hits()), rel=0.02)
        times = found.planar.beam_times_s
        assert times is not None
        hit = np.isfinite(found.planar.ranges)
        hit[[0, -1]] = False  # straight behind, where the first beam is the last as well
        of_beams = np.linspace(0.0, LASTS_S, len(true.planar.bearings))
        expected = np.interp(found.planar.bearings[hit], true.planar.bearings, of_beams)
        assert times[hit] == pytest.approx(expected, abs=2e-3)


def test_one_cloud_with_height_makes_it_a_lidar_in_space(flat_tour: Tour, path: Path) -> None:
    with LogWriter(path) as log:
        for number, (sweep, _) in enumerate(flat_tour[:5]):
            points = np.column_stack([sweep.planar.hits(), np.full(len(sweep.planar.hits()), 0.5)])
            points[0, 2] += 0.1 if number == 3 else 0.0
            log.cloud("/points", "base_link", sweep.stamp_ns, points)
    sweeps, stream = sweeps_of(path)
    assert "height band 0.15 to 1.5 m" in stream.selection.note
    assert all(sweep.cloud is not None for sweep in sweeps)


def write_camera(path: Path, yaw: float, view_deg: float = 80.0, frame: str = "camera") -> None:
    """Clouds of a camera, 0.5 m up, its frame known: floor, a wall 3 m ahead, 0.1 s a turn."""
    columns = np.radians(np.arange(view_deg) - view_deg / 2 + 0.25)
    b, z = (grid.ravel() for grid in np.meshgrid(columns, np.arange(9)))
    wall = np.column_stack([3.0 * np.cos(b), 3.0 * np.sin(b), 0.2 * z - 0.5])
    floor = np.column_stack([wall[:, :2] * (z / 9.0)[:, None], np.full(len(z), -0.5)])
    points = np.concatenate([floor, wall, np.zeros((1, 3))])
    if "optical" in frame:
        points = points[:, [1, 2, 0]] * (-1.0, -1.0, 1.0)
    times = 0.1 * np.concatenate([b, b, [0.0]]) / math.tau + 0.05
    with LogWriter(path) as log:
        if frame == "camera":
            turned = (0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))
            log.static_transform("base_link", "camera", (0.2, 0.0, 0.5), turned)
        for number in range(5):
            log.odometry("/odom", "odom", "base_link", number, Pose2(0.1 * number, 0.0, 0.0))
            log.cloud("/points", frame, number, points, times)


@pytest.mark.parametrize("yaw", [0.0, 3.0])
@pytest.mark.parametrize("view_deg", [80.0, 240.0, 360.0])
def test_of_a_robot_with_odometry_the_planar_scan_of_its_clouds_is_registered(
    path: Path, yaw: float, view_deg: float
) -> None:
    """It ends where the view does, also behind the robot, and its beams have their times."""
    write_camera(path, yaw, view_deg)
    sweeps, stream = sweeps_of(path)
    assert "m above the floor, registered by it alone" in stream.selection.note
    for sweep in sweeps:
        scan = sweep.planar
        assert sweep.cloud is None
        assert scan.full_circle == (view_deg == 360.0)
        assert np.degrees(np.ptp(scan.bearings)) == pytest.approx(view_deg, abs=1.0)
        assert np.isfinite(scan.ranges).all()
        assert scan.beam_times_s is not None
        expected = 0.1 * np.remainder((scan.bearings - yaw) / math.tau + 0.5, 1.0)
        assert scan.beam_times_s == pytest.approx(expected, abs=5e-4)
        away = sweep.base_from_laser.apply(scan.hits()) - (0.2, 0.0)
        assert np.hypot(*away.T) == pytest.approx(3.0)
        assert away[len(away) // 2] @ (math.cos(yaw), math.sin(yaw)) > 2.5 or scan.full_circle


@pytest.mark.parametrize("frame", ["camera", "unknown", "camera_optical_frame"])
def test_clouds_are_registered_in_space_without_odometry(path: Path, frame: str) -> None:
    write_camera(path, 0.0, frame=frame)
    for use_odometry in (True, False):
        sweeps, _ = sweeps_of(path, use_odometry=use_odometry)
        assert all((sweep.cloud is None) == use_odometry for sweep in sweeps)
        assert np.hypot(*sweeps[0].planar.hits().T) == pytest.approx(3.0, abs=0.01)
