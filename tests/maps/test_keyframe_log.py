"""keyframes.mcap: written, read back, opened as a recording, and damaged.

Its scans are on evenly spaced beams, as a LaserScan carries them.
"""

import math
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.errors import MapError
from specmap_cli.core.geometry import FloatArray, Pose2, compose
from specmap_cli.core.records import PlanarScan, PosedScan
from specmap_cli.core.settings import LimitsConfig, LogConfig
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.logs import open_log
from specmap_cli.logs.messages import decode_transforms
from specmap_cli.logs.planar import covers_circle
from specmap_cli.logs.stream import SweepStream
from specmap_cli.logs.writer import LogWriter
from specmap_cli.maps.keyframe_log import EvenBeams, EvenSpacing, read_keyframes, write_keyframes
from specmap_cli.maps.store import read_map
from specmap_cli.maps.writing import MapResult, write_map, write_scans
from specmap_cli.registration.sweep_view import deskewed
from tests.casting import keyframe, store_of
from tests.strategies import planar_scans, poses

BEARINGS = np.linspace(-math.pi, math.pi, 180, endpoint=False)
MOUNT = Pose2(0.2, -0.1, 0.5)
MOST, START_NS = 1_000, 1_700_000_000_000_000_000
STAMPS = st.integers(-2, 2).map(lambda stamp: 1_000 * stamp - 7) | st.integers(0, 10**12)


def planar(number: int) -> PlanarScan:
    """Walls, beams without a return, and invalid readings."""
    ranges = np.round(2.0 + np.cos(BEARINGS * (1 + number % 3)), 3)
    ranges[number % 90] = np.inf
    ranges[90 + number % 90] = np.nan
    return PlanarScan(START_NS + 1_000_000_000 * number, BEARINGS, ranges, 30.0, True)


def posed(number: int, mount: Pose2 = MOUNT) -> PosedScan:
    pose = Pose2(0.05 * number, math.sin(number), 0.1 * number - 2.0)
    return keyframe(planar(number), pose, mount, number)


SCANS = [posed(number) for number in range(40)]


def laid_out(store: KeyframeStore) -> FloatArray:
    return compose(np.array([1.0, -2.0, 0.3]), store.poses)


def written(path: Path, scans: Iterable[PosedScan]) -> Path:
    with store_of(scans) as store:
        write_keyframes(path, store, laid_out(store))
    return path


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return written(tmp_path / "keyframes.mcap", SCANS)


def assert_same(read: KeyframeStore, scans: Sequence[PosedScan], range_m: float = 1e-6) -> None:
    assert read.stamps_ns.tolist() == [scan.stamp_ns for scan in scans]
    for number, scan in enumerate(scans):
        away = scan.map_from_base.inverse() @ read.pose(number)
        assert tuple(away) == pytest.approx((0.0, 0.0, 0.0), abs=1e-6)
        assert read.base_from_laser(number) == pytest.approx(scan.base_from_laser, abs=1e-12)
        found = read.scan(number)
        assert (found.stamp_ns, found.full_circle) == (scan.stamp_ns, scan.planar.full_circle)
        assert found.range_max == pytest.approx(scan.planar.range_max, rel=1e-6)
        assert found.bearings == pytest.approx(scan.planar.bearings, abs=1e-6)
        assert found.ranges == pytest.approx(scan.planar.ranges, abs=range_m, nan_ok=True)


@given(st.lists(st.tuples(planar_scans(), STAMPS, poses), max_size=4))
def test_any_scans_there_and_back(
    tmp_path_factory: pytest.TempPathFactory, taken: list[tuple[PlanarScan, int, Pose2]]
) -> None:
    """In their order though stamps repeat or go back, to a micrometre and a millimetre."""
    scans = [keyframe(replace(scan, stamp_ns=at), pose, MOUNT) for scan, at, pose in taken]
    path = written(tmp_path_factory.mktemp("any") / "keyframes.mcap", scans)
    with read_keyframes(path, MOST) as read:
        assert_same(read, scans, range_m=0.000501)


def test_what_was_read_is_written_again_with_the_same_bytes(path: Path, tmp_path: Path) -> None:
    again = tmp_path / "again.mcap"
    with store_of(SCANS) as store, read_keyframes(path, MOST) as back:
        write_keyframes(again, back, laid_out(store))
    assert again.read_bytes() == path.read_bytes()


def test_several_lasers_have_a_frame_each(tmp_path: Path) -> None:
    behind = Pose2(-0.3, 0.0, math.pi / 2)
    scans = [posed(number, behind if number % 2 else MOUNT) for number in range(6)]
    path = written(tmp_path / "a.mcap", scans)
    with read_keyframes(path, MOST) as read:
        assert_same(read, scans)
    with open_log([path]) as log:
        stream = SweepStream(log, LogConfig(scan_frame="laser_2"))
        assert [sweep.stamp_ns for sweep in stream] == [scan.stamp_ns for scan in scans[1::2]]


def test_a_laser_that_does_not_look_all_around(tmp_path: Path) -> None:
    """As a 3D lidar in a corner of the robot gives it: all bearings, a part of them blind."""
    blind = np.where(np.abs(BEARINGS) > 2.0, np.nan, 3.0)
    scan = replace(posed(0), planar=replace(planar(0), ranges=blind, full_circle=False))
    with read_keyframes(written(tmp_path / "a.mcap", [scan]), MOST) as read:
        found = read.scan(0)
    assert not found.full_circle
    assert found.bearings == pytest.approx(BEARINGS[np.abs(BEARINGS) <= 2.0], abs=1e-6)
    assert np.isfinite(found.ranges).all()


def test_it_is_an_ordinary_recording(path: Path) -> None:
    with open_log([path]) as log:
        assert (log.contents.start_ns, log.contents.end_ns) == (START_NS, SCANS[-1].stamp_ns)
        stream = SweepStream(log, LogConfig())
        assert (stream.selection.odometry, stream.selection.base_frame) == ("tf", "base_link")
        sweeps = list(stream)
        last = decode_transforms(list(log.messages(["/tf"]))[-1])[0]
    assert [sweep.stamp_ns for sweep in sweeps] == [scan.stamp_ns for scan in SCANS]
    for sweep, scan in zip(sweeps, SCANS, strict=True):
        assert sweep.odom_from_base is not None
        away = scan.map_from_base.inverse() @ sweep.odom_from_base
        assert tuple(away) == pytest.approx((0.0, 0.0, 0.0), abs=1e-6)
        assert tuple(sweep.base_from_laser) == pytest.approx(tuple(MOUNT))
        assert sweep.planar.ranges == pytest.approx(scan.planar.ranges, abs=1e-6, nan_ok=True)
    assert [(t.parent, t.child) for t in last] == [("map", "odom"), ("odom", "base_link")]
    map_from_base = Pose2.from_matrix(last[0].parent_from_child @ last[1].parent_from_child)
    expected = Pose2(1.0, -2.0, 0.3) @ SCANS[-1].map_from_base
    assert tuple(map_from_base) == pytest.approx(tuple(expected), abs=1e-5)


@pytest.mark.parametrize("kept", [0, 7, 8, 200, 2_000, -200, -30, -1])
def test_a_file_that_was_cut_off(path: Path, kept: int) -> None:
    path.write_bytes(path.read_bytes()[:kept])
    with pytest.raises(MapError, match=r"keyframes\.mcap: .*build the map again") as caught:
        read_keyframes(path, MOST)
    assert "\n" not in str(caught.value)


def test_any_byte_of_the_data_may_be_damaged(path: Path) -> None:
    """It is refused, or nothing is lost."""
    whole = path.read_bytes()
    for place in range(0, len(whole) // 2, 97):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 0x5A]) + whole[place + 1 :])
        with suppress(MapError), read_keyframes(path, MOST) as read:
            assert_same(read, SCANS)


def test_a_file_that_is_none_and_files_beyond_the_limits(path: Path, tmp_path: Path) -> None:
    (tmp_path / "text").write_text("keyframes " * 100)
    with pytest.raises(MapError, match=r"text: .*build the map again"):
        read_keyframes(tmp_path / "text", MOST)
    with pytest.raises(MapError, match="cannot read the keyframes: No such file"):
        read_keyframes(tmp_path / "nowhere", MOST)
    with pytest.raises(MapError, match="not a regular file"):
        read_keyframes(tmp_path, MOST)
    with pytest.raises(MapError, match=r"larger than 0\.001 MB; if it is meant, raise limits"):
        read_keyframes(path, MOST, LimitsConfig(keyframes_max_mb=0.001))
    with pytest.raises(MapError, match="has more than 39 scans"):
        read_keyframes(path, 39)


@pytest.mark.parametrize("lack", ["pose", "laser", "stamp"])
def test_scans_that_lack_something(tmp_path: Path, lack: str) -> None:
    with LogWriter(tmp_path / "a.mcap") as log:
        if lack != "laser":
            log.static_transform("base_link", "laser")
        if lack != "pose":
            log.transform("odom", "base_link", 6 if lack == "stamp" else 5, Pose2(0.0, 0.0, 0.0))
        log.scan("/scan", "laser", 7 if lack == "stamp" else 5, 0.0, 0.1, [1.0], range_max=9.0)
    with pytest.raises(MapError, match=r"a\.mcap: scan 0 .*: build the map again"):
        read_keyframes(tmp_path / "a.mcap", MOST)


def test_keyframes_are_those_of_the_labels(stored: Path, tmp_path: Path, result: MapResult) -> None:
    with pytest.raises(MapError, match=r"has no keyframes\.mcap: .*build the map again") as caught:
        read_map(stored).scans()
    assert caught.value.found == "has no keyframes.mcap"
    stamps, pose = result.labels.stamps_ns.tolist(), Pose2(0.0, 0.0, 0.0)
    scans = [keyframe(replace(planar(0), stamp_ns=stamp), pose) for stamp in stamps]
    shifted = replace(result.labels, stamps_ns=result.labels.stamps_ns + 1)
    for name, labels in (("own", result.labels), ("others", shifted)):
        (tmp_path / name).mkdir()
        with store_of(scans) as store:
            write_scans(tmp_path / name, store, labels)
        write_map(tmp_path / name, replace(result, labels=labels))
    with read_map(tmp_path / "own").scans() as read:
        assert read.stamps_ns.tolist() == stamps
    with pytest.raises(MapError, match=r"its 30 scans are not the 30 keyframes of labels\.csv"):
        read_map(tmp_path / "others").scans()


CIRCLE = 2 * math.pi


def seen_along(bearings: FloatArray, ranges: FloatArray) -> EvenBeams:
    """The beams that a first scan of a part of the circle is written with."""
    return EvenSpacing().beams(PlanarScan(0, bearings, ranges, 30.0, False))


def bearings_of(beams: EvenBeams) -> FloatArray:
    return np.asarray(beams.angle_min + beams.increment * np.arange(len(beams.ranges)))


def turned(full_circle: bool) -> tuple[PlanarScan, PlanarScan]:
    """A scan at rest, and one in motion with its beams de-skewed."""
    span = CIRCLE if full_circle else 4.0
    bearings = np.linspace(-span / 2, span / 2, 360, endpoint=not full_circle)
    ranges, times = 3.0 + np.cos(bearings), np.linspace(0.0, 0.1, 360)
    rest = PlanarScan(0, bearings, ranges, 30.0, full_circle, times)
    return rest, deskewed(rest, Pose2(0.2, 0.0, 0.0), Pose2(0.1, 0.0, 0.3), 0.1)


@pytest.mark.parametrize("full_circle", [True, False])
def test_what_was_measured_in_motion_keeps_the_bearings_of_the_laser(full_circle: bool) -> None:
    rest, moving = turned(full_circle)
    spacing = EvenSpacing()
    spacing.beams(rest)
    beams = spacing.beams(moving)
    assert (beams.angle_min, len(beams.ranges)) == (float(np.float32(rest.bearings[0])), 360)
    half = beams.increment / 2 * 1.2  # motion spreads the beams by a tenth
    seen = np.isfinite(beams.ranges)
    assert seen.mean() > (0.99 if full_circle else 0.9), "the view of a sector has turned away"
    for bearing, found in zip(bearings_of(beams)[seen], beams.ranges[seen], strict=True):
        away = np.abs((moving.bearings - bearing + math.pi) % CIRCLE - math.pi)
        assert found in moving.ranges[away <= half], "the reading of a neighbour"
    first = EvenSpacing().beams(moving)  # which may be one in motion
    assert covers_circle(len(first.ranges), first.increment) == full_circle
    assert np.isfinite(first.ranges).all() or not full_circle


def test_no_reading_is_made_up_in_a_hole_of_a_single_beam_or_of_none() -> None:
    hole = np.concatenate([np.linspace(-1.0, -0.5, 50), np.linspace(0.5, 1.0, 50)])
    beams = seen_along(hole, np.ones(100))
    assert np.isnan(beams.ranges[np.abs(bearings_of(beams)) < 0.45]).all()
    assert np.isnan(beams.ranges).mean() == pytest.approx(0.5, abs=0.03)
    beams = seen_along(np.array([0.3]), np.array([2.0]))
    assert (beams.angle_min, beams.increment) == (float(np.float32(0.3)), 0.0)
    assert beams.ranges.tolist() == [2.0]
    bearings = np.linspace(-math.pi, math.pi, 90, endpoint=False)
    blind = seen_along(bearings, np.full(90, np.nan)).ranges
    assert len(blind) == 1
    assert np.isnan(blind).all()


@pytest.mark.parametrize("blind", [(150, 250), (0, 60), (340, 400), (380, 20), (7, 8), (7, 7)])
def test_a_circle_goes_without_its_blind_part(blind: tuple[int, int]) -> None:
    bearings = np.asarray(-math.pi + (np.arange(400) + 0.5) * (CIRCLE / 400), dtype=np.float64)
    ranges, (start, end) = np.arange(400.0), blind
    run = np.arange(start, end if end >= start else end + 400) % 400
    ranges[run] = np.nan
    beams = seen_along(bearings, ranges)
    assert not covers_circle(len(beams.ranges), beams.increment)
    assert len(beams.ranges) == 400 - max(len(run), 2)
    places = np.round((bearings_of(beams) + math.pi) / (CIRCLE / 400) - 0.5).astype(int) % 400
    assert (beams.ranges == places).all(), "each reading at its bearing"
