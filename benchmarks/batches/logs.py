"""Short logs for the benchmark of batches: tours, pieces of recordings, damaged ones, hungry ones.

python -m benchmarks.batches.logs DIR [--logs 200]
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from specmap_cli.core.geometry import Pose2
from specmap_cli.grids.gridmap import FREE, OCCUPIED, GridMap
from specmap_cli.logs.writer import LogWriter
from specmap_cli.pipelines.simulate import simulate
from specmap_cli.simulation.simulator import SimulationOptions

SECONDS = 16.0  # of each log
_NS = 1_000_000_000
_SAMPLES = (Path("sample_logs/office.mcap"), Path("sample_logs/office_again.mcap"))
_REAL = ("fr079", "mit_csail")
# Field of view, beams, range and rate of the lasers that are on the market most.
_SENSORS = ((360.0, 180, 12.0, 8.0), (270.0, 541, 20.0, 10.0), (180.0, 181, 30.0, 8.0))


def make_logs(folder: Path, count: int) -> dict[str, str]:
    """Write `count` logs; returns the names of those that must fail, with the kind of failure.

    Of 200 are 180 good, 18 damaged in nine ways and 2 in want of more memory than there is.
    """
    folder.mkdir(parents=True, exist_ok=True)
    damaged, hungry = round(0.09 * count), max(1, round(0.01 * count))
    pieces = (count - damaged - hungry) // 5
    made = list(itertools.islice(_pieces(folder, _SAMPLES, "office"), pieces))
    made += itertools.islice(_pieces(folder, _real(), "real"), pieces)
    for number in range(count - damaged - hungry - len(made)):
        _tour(folder / f"tour-{number:03}.mcap", number)
    bad = {}
    ways = itertools.cycle(_WAYS.items())
    for number, (name, damage) in zip(range(damaged), ways, strict=False):
        damage(folder / f"bad-{number:03}-{name}")
        bad[f"bad-{number:03}-{name}"] = "no-result" if damage is _blind else "log"
    for number in range(hungry):
        _hungry(folder / f"hungry-{number}.mcap")
        bad[f"hungry-{number}"] = "memory"
    return bad


def _real() -> tuple[Path, ...]:
    """Real recordings, where there are some."""
    root = Path(os.environ.get("SPECMAP_DATA", "../shared/data")) / "logs"
    return tuple(path for name in _REAL if (path := root / f"{name}.mcap").is_file())


def _tour(path: Path, seed: int) -> None:
    """A tour of a building of three rooms, each seed another one, in turn by three lasers."""
    random = np.random.default_rng(seed)
    width, height = int(random.integers(140, 220)), int(random.integers(100, 140))
    wall, split = int(random.integers(34, 44)), int(random.integers(60, width - 60))
    cells = np.full((height, width), OCCUPIED, dtype=np.uint8)
    cells[4:wall, 4 : width - 4] = FREE
    cells[wall + 4 : height - 4, 4:split] = FREE
    cells[wall + 4 : height - 4, split + 4 : width - 4] = FREE
    for left in (split // 2, (split + width) // 2):
        cells[wall : wall + 4, left : left + 18] = FREE
    view, beams, range_m, rate = _SENSORS[seed % len(_SENSORS)]
    options = SimulationOptions(
        field_of_view_deg=view,
        beams=beams,
        range_max_m=range_m,
        rate_hz=rate,
        seed=seed,
        max_duration_s=SECONDS,
    )
    simulate(GridMap(cells, 0.05), options, path).truth.unlink()


def _pieces(folder: Path, logs: tuple[Path, ...], name: str) -> Iterator[Path]:
    """Pieces of recordings, one after the other, from each recording in turn."""
    numbers = itertools.count()
    for windows in zip(*(_windows(log) for log in logs), strict=False) if logs else ():
        for log, begin in zip(logs, windows, strict=True):
            yield _piece(log, begin, folder / f"{name}-{next(numbers):03}.mcap")


def _windows(log: Path) -> Iterator[int]:
    """When the pieces of a recording begin, nanoseconds."""
    with log.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    span = summary.statistics
    step = int(SECONDS * _NS)
    yield from range(span.message_start_time, span.message_end_time - step, step)


def _piece(log: Path, begin: int, path: Path) -> Path:
    """Some seconds of a recording, with its static transforms."""
    end = begin + int(SECONDS * _NS)
    channels: dict[int, int] = {}
    with log.open("rb") as source, path.open("wb") as target:
        writer = Writer(target, compression=CompressionType.ZSTD)
        writer.start(profile="ros2")
        for schema, channel, message in make_reader(source).iter_messages():
            if not begin <= message.log_time < end and channel.topic != "/tf_static":
                continue
            if channel.id not in channels:
                assert schema is not None
                kind = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, kind, channel.metadata
                )
            when = max(begin, message.log_time)
            writer.add_message(channels[channel.id], when, message.data, when)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def _cut(path: Path) -> None:
    whole = path.with_suffix(".whole")
    _tour(whole, 1)
    path.with_suffix(".mcap").write_bytes(whole.read_bytes()[:5000])
    whole.unlink()


def _zeros(path: Path) -> None:
    path.with_suffix(".mcap").write_bytes(bytes(100_000))


def _empty(path: Path) -> None:
    path.with_suffix(".bag").touch()


def _text(path: Path) -> None:
    path.with_suffix(".mcap").write_text("this is no recording\n" * 100, encoding="utf-8")


def _without_scans(path: Path) -> None:
    with LogWriter(path.with_suffix(".mcap")) as writer:
        for k in range(100):
            writer.odometry("/odom", "odom", "base_link", k * _NS, Pose2(0.1 * k, 0.0, 0.0))


def _wrong_types(path: Path) -> None:
    with LogWriter(path.with_suffix(".mcap")) as writer:
        for k in range(100):
            writer.raw("/scan", "std_msgs/msg/String", b"\0\1\0\0\5\0\0\0beam\0", k * _NS)


def _broken_bag(path: Path) -> None:
    path.with_suffix(".bag").write_bytes(b"#ROSBAG V2.0\n" + bytes(range(256)) * 40)


def _blind(path: Path) -> None:
    with LogWriter(path.with_suffix(".mcap")) as writer:
        for k in range(100):
            ranges = np.full(180, np.nan)
            writer.scan("/scan", "laser", k * _NS // 10, -1.5, 0.017, ranges, range_max=10.0)


def _noise(path: Path) -> None:
    random = np.random.default_rng(7)
    path.with_suffix(".mcap").write_bytes(b"\x89MCAP0\r\n" + random.bytes(50_000))


_WAYS: dict[str, Callable[[Path], None]] = {
    "cut": _cut,
    "zeros": _zeros,
    "empty": _empty,
    "text": _text,
    "scanless": _without_scans,
    "types": _wrong_types,
    "bag": _broken_bag,
    "blind": _blind,
    "noise": _noise,
}


def _hungry(path: Path) -> None:
    """Clouds of as many points as are read, with times: little on a disk, much in memory."""
    count = 3_900_000
    angle, height = np.linspace(-np.pi, np.pi, count), np.linspace(0.1, 0.9, count)
    points = np.stack([5.0 * np.cos(angle), 4.0 * np.sin(angle), height], axis=1).round(2)
    times_s = np.linspace(0.0, 0.09, count).round(4)
    with LogWriter(path) as writer:
        for k in range(1, 7):
            writer.cloud("/points", "lidar", k * _NS, points, times_s)
