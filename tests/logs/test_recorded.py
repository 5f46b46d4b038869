"""The public recordings, where they are at hand: set SPECMAP_DATA to their folder."""

import os
from pathlib import Path

import numpy as np
import pytest

from specmap_cli.core.settings import LogConfig
from specmap_cli.logs.inspection import summarize
from specmap_cli.logs.opening import open_log
from specmap_cli.logs.stream import SweepStream
from specmap_cli.logs.summary import LogSummary

DATA = Path(os.environ.get("SPECMAP_DATA", Path(__file__).parents[2] / ".." / "shared" / "data"))

pytestmark = pytest.mark.skipif(
    not (DATA / "logs").is_dir(), reason=f"no recordings in {DATA} (set SPECMAP_DATA)"
)


TOPIC = "odometry from /odom"
TRANSFORMS = "odometry from transforms odom -> base_link"


def summary_of(name: str) -> LogSummary:
    with open_log(DATA / name) as log:
        return summarize(log)


@pytest.mark.parametrize(
    ("name", "scans", "odometry", "view", "beams", "mount"),
    [
        ("logs/fr079.mcap", 4934, TOPIC, 179.5, 360, (-0.04, 0.0, 0.0)),
        ("logs/mit_csail.mcap", 1988, TRANSFORMS, 180.0, 361, (0.0, 0.0, 0.0)),
        ("logs/turtlebot4_office", 357, TOPIC, 360.0, 720, (0.00393584, 0.0, np.pi / 2)),
        ("logs/fr079_3d.mcap", 849, TOPIC, 360.0, 720, (0.0, 0.0, 0.0)),
        ("damaged/laser_scan_matcher_demo.bag", 360, "no odometry", 239.06, 681, (0, 0, 0)),
    ],
)
def test_recordings_are_read_whole(
    name: str, scans: int, odometry: str, view: float, beams: int, mount: tuple[float, float, float]
) -> None:
    summary = summary_of(name)
    assert summary.chosen is not None
    assert odometry in summary.chosen
    assert summary.scan is not None
    assert summary.scan.field_of_view_deg == pytest.approx(view, abs=0.01)
    assert summary.scan.beams == beams
    with open_log(DATA / name) as log:
        stream = SweepStream(log, LogConfig())
        stamps, usable = [], 0
        for sweep in stream:
            stamps.append(sweep.stamp_ns)
            usable += bool(np.isfinite(sweep.planar.ranges).any())
            assert sweep.base_from_laser == pytest.approx(mount, abs=1e-8)
        assert len(stamps) == usable == scans == stream.selection.topic.count
        assert stream.counts["without_odometry"] <= (scans if odometry == "no odometry" else 2)
    assert stamps == sorted(stamps)


def test_the_damaged_bag_says_what_is_wrong_and_loses_no_scan(tmp_path: Path) -> None:
    summary = summary_of("damaged/laser_scan_matcher_demo.bag")
    assert len(summary.damage) == 1
    assert "the record at byte 792650 is damaged" in summary.damage[0]
    assert summary.messages == 360
    assert summary.duration_s == pytest.approx(35.811, abs=0.001)
    path = tmp_path / "cut.bag"  # which keeps its first chunk
    path.write_bytes((DATA / "damaged/laser_scan_matcher_demo.bag").read_bytes()[:800_000])
    summary = summary_of(str(path))
    assert 278 <= summary.messages < 360
    assert "the record at byte 792650 is damaged" in summary.damage[0]
    assert "what followed" in summary.damage[1]
