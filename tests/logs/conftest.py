"""Recordings made on the spot, in every format, all with the same messages."""

from __future__ import annotations

import random
import sqlite3
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Rosbag1Writer

from specmap_cli.core.errors import LogError
from specmap_cli.core.geometry import Pose2
from specmap_cli.logs.opening import open_log
from specmap_cli.logs.readers.encoding import typestore
from specmap_cli.logs.readers.recording import Message
from specmap_cli.logs.writer import LogWriter

SECOND = 1_000_000_000
START = 100 * SECOND


def write_drive(path: Path, scans: int = 30, beams: int = 40) -> None:
    """A robot that drives along x at 1 m/s: scans at 10 Hz, odometry at 20 Hz, a mounted laser."""
    rng = np.random.default_rng(5)
    with LogWriter(path) as log:
        log.static_transform("base_link", "laser", (0.2, 0.0, 0.3), stamp_ns=START)
        for number in range(scans):
            for half in range(2):
                stamp = START + number * SECOND // 10 + half * SECOND // 20
                pose = Pose2((stamp - START) / SECOND, 0.0, 0.0)
                log.odometry("/odom", "odom", "base_link", stamp, pose)
            ranges = rng.uniform(1.0, 5.0, beams)
            stamp = START + number * SECOND // 10 + SECOND // 40
            log.scan("/scan", "laser", stamp, -1.5, 3.0 / (beams - 1), ranges, range_max=8.0)


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Install a package of one module that offers a reader, as pip would, for one test."""

    def add(module: str, code: str, *, entry: str, name: str = "") -> None:
        site = tmp_path / f"site-{module}"
        info = site / f"{module}-1.0.dist-info"
        info.mkdir(parents=True)
        (site / f"{module}.py").write_text(code)
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {module}\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text(f"[specmap.readers]\n{name or module} = {entry}\n")
        monkeypatch.syspath_prepend(site)
        monkeypatch.delitem(sys.modules, module, raising=False)

    return add


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    path = tmp_path / "drive.mcap"
    write_drive(path)
    return path


@pytest.fixture
def drive_messages(drive: Path) -> list[Message]:
    with open_log(drive) as log:
        return list(log.messages())


@pytest.fixture
def read_rest() -> Callable[[Path], tuple[list[Message], list[str]]]:
    """Read a damaged file: its messages and what is said of the damage, or of its refusal."""

    def read(path: Path) -> tuple[list[Message], list[str]]:
        try:
            with open_log(path) as log:
                return list(log.messages()), log.damage
        except LogError as error:
            return [], [str(error)]

    return read


@pytest.fixture
def cut_in_tenths(
    read_rest: Callable[[Path], tuple[list[Message], list[str]]],
) -> Callable[[Path, list[Message]], None]:
    """Cut a file at ten places: what precedes the cut is read, and one line says what was lost."""

    def check(path: Path, messages: list[Message]) -> None:
        whole = path.read_bytes()
        counts = []
        for tenth in range(10):
            path.write_bytes(whole[: len(whole) * tenth // 10 + 3])
            found, said = read_rest(path)
            assert len(said) == 1
            assert str(path) in said[0]
            assert found == messages[: len(found)]
            counts.append(len(found))
        assert counts == sorted(counts)
        assert counts[-1] > 0.5 * len(messages)

    return check


@pytest.fixture
def spoil() -> Callable[[Path, int, int], None]:
    """Overwrite some bytes of a file, behind its first `kept`, with random ones."""

    def change(path: Path, seed: int, kept: int) -> None:
        data = bytearray(path.read_bytes())
        rng = random.Random(seed)
        for _ in range(rng.randrange(1, 40)):
            data[rng.randrange(kept, len(data))] = rng.randrange(256)
        path.write_bytes(data)

    return change


@pytest.fixture
def write_db3() -> Callable[..., None]:
    """Write messages to a SQLite file as ROS 2 Foxy did, which knew no message definitions."""

    def write(path: Path, messages: list[Message], *, time_index: bool = True) -> None:
        with sqlite3.connect(path) as db:
            db.execute(
                "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT "
                "NULL, serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL)"
            )
            db.execute(
                "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, "
                "timestamp INTEGER NOT NULL, data BLOB NOT NULL)"
            )
            if time_index:
                db.execute("CREATE INDEX timestamp_idx ON messages (timestamp ASC)")
            numbers: dict[str, int] = {}
            for message in messages:
                if message.topic not in numbers:
                    numbers[message.topic] = len(numbers) + 1
                    row = (numbers[message.topic], message.topic, message.type, "cdr", "")
                    db.execute("INSERT INTO topics VALUES (?, ?, ?, ?, ?)", row)
                values = (numbers[message.topic], message.time_ns, message.data)
                db.execute(
                    "INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)", values
                )
        db.close()

    return write


@pytest.fixture
def write_bag() -> Callable[..., None]:
    """Write messages to a ROS 1 bag with rosbags, in ROS 1 serialisation."""

    def write(
        path: Path,
        messages: list[Message],
        compression: Rosbag1Writer.CompressionFormat | None = None,
        chunk_bytes: int = 4096,
    ) -> None:
        writer = Rosbag1Writer(path)
        writer.chunk_threshold = chunk_bytes
        if compression is not None:
            writer.set_compression(compression)
        with writer:
            types = {m.topic: m.type for m in messages}
            connections = {
                topic: writer.add_connection(topic, name, typestore=typestore())
                for topic, name in types.items()
            }
            for m in messages:
                raw = typestore().cdr_to_ros1(m.data, m.type)
                writer.write(connections[m.topic], m.time_ns, raw)

    return write
