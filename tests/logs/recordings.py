"""Writing recordings in every format, damaging them, and reading what is left."""

import bz2
import gzip
import sqlite3
from collections.abc import Callable, Collection, Iterable, Iterator
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import lz4.frame
import numpy as np
import pytest
import zstandard
from mcap.writer import CompressionType, IndexType, Writer
from rosbags.rosbag1 import Writer as Rosbag1Writer

from specmap_cli.core.errors import LogError
from specmap_cli.core.geometry import Pose2
from specmap_cli.core.records import Sweep
from specmap_cli.core.settings import LogConfig
from specmap_cli.logs.opening import open_log
from specmap_cli.logs.readers.encoding import typestore
from specmap_cli.logs.readers.recording import Contents, Message, Recording, survey
from specmap_cli.logs.stream import SweepStream
from specmap_cli.logs.writer import LogWriter
from tests.turning import configured


class Told(Recording):
    """A recording whose messages are made while it is read; it counts those handed out."""

    format = "list"

    def __init__(
        self, name: str, make: Callable[[], Iterable[Message]], shown: Path | None = None
    ) -> None:
        super().__init__(Path(name), shown)
        self.make = make
        self.handed_out = self.closed = 0

    @cached_property
    def contents(self) -> Contents:
        return survey((m.topic, m.type, m.time_ns) for m in self.make())

    def messages(self, topics: Collection[str] | None = None) -> Iterator[Message]:
        self.handed_out = 0
        for message in self.make():
            if topics is None or message.topic in topics:
                self.handed_out += 1
                yield message

    def close(self) -> None:
        self.closed += 1


SECOND = 1_000_000_000
START = 100 * SECOND
COUNTS = {"/odom": 60, "/scan": 30, "/tf_static": 1}  # of the messages of a drive
PACK: dict[str, Callable[[bytes], bytes]] = {
    "zstd": zstandard.compress,
    "lz4": lz4.frame.compress,
    "bz2": bz2.compress,
    "gzip": gzip.compress,
}


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


def read_rest(path: Path | list[Path]) -> tuple[list[Message], list[str]]:
    """Read a damaged file: its messages and what is said of the damage, or of its refusal."""
    try:
        with open_log(path) as log:
            return list(log.messages()), log.damage
    except LogError as error:
        return [], [str(error)]


def refusal(path: Path | str, config: LogConfig | None = None) -> str:
    """What is said of a log that cannot be opened."""
    with pytest.raises(LogError) as caught:
        open_log(path, config)
    return str(caught.value)


def write_db3(path: Path, messages: list[Message], *, time_index: bool = True) -> None:
    """Write messages to a SQLite file as ROS 2 Foxy did, which knew no message definitions."""
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
            db.execute("INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)", values)
    db.close()


def change_db3(path: Path, statement: str, *rows: tuple[object, ...]) -> None:
    """Run a statement of SQL, for each of the rows of values if there are any."""
    with sqlite3.connect(path) as db:
        for row in rows or [()]:
            db.execute(statement, row)
    db.close()


def write_bag(
    path: Path,
    messages: list[Message],
    compression: Rosbag1Writer.CompressionFormat | None = None,
    chunk_bytes: int = 4096,
    *,
    indexed: bool = True,
) -> None:
    """Write messages to a new ROS 1 bag with rosbags, in ROS 1 serialisation."""
    path.unlink(missing_ok=True)
    writer = Rosbag1Writer(path)
    writer.chunk_threshold = chunk_bytes
    if compression is not None:
        writer.set_compression(compression)
    with writer:
        connections = {
            topic: writer.add_connection(topic, name, typestore=typestore())
            for topic, name in {m.topic: m.type for m in messages}.items()
        }
        for m in messages:
            writer.write(connections[m.topic], m.time_ns, typestore().cdr_to_ros1(m.data, m.type))
    if not indexed:  # as a recorder leaves it that was killed
        overwrite(path, path.read_bytes().index(b"index_pos=") + len(b"index_pos="), bytes(8))


def write_mcap(path: Path, messages: list[Message], **style: object) -> None:
    """Write messages by the reference writer of MCAP, in small chunks."""
    with path.open("wb") as file:
        writer = Writer(file, **{"chunk_size": 2000, **style})  # type: ignore[arg-type]
        writer.start(profile="ros2")
        channels: dict[str, int] = {}
        for m in messages:
            if m.topic not in channels:
                schema = writer.register_schema(m.type, "ros2msg", b"")
                channels[m.topic] = writer.register_channel(m.topic, "cdr", schema)
            writer.add_message(channels[m.topic], m.time_ns, m.data, m.time_ns)
        writer.finish()  # type: ignore[no-untyped-call]


def sweeps_of(path: Path, **options: object) -> tuple[list[Sweep], SweepStream]:
    """The sweeps of a log, read with these settings, and their stream."""
    with open_log(path) as log:
        stream = SweepStream(log, configured(LogConfig, "logs", options))
        return list(stream), stream


def overwrite(path: Path, place: int, by: bytes) -> None:
    """Put other bytes in the place of some of a file."""
    data = bytearray(path.read_bytes())
    data[place : place + len(by)] = by
    path.write_bytes(data)


_PLAIN, _WEAK = {"compression": CompressionType.NONE}, {"enable_crcs": False}
_MCAP: dict[str, dict[str, Any]] = {
    "zstd": {"compression": CompressionType.ZSTD},
    "lz4": {"compression": CompressionType.LZ4},
    "plain": _PLAIN,
    "without index": {"index_types": IndexType.NONE},
    "without chunks": {"use_chunking": False},
    "without checksums": _WEAK,
    "without checksums, lz4": {"compression": CompressionType.LZ4, **_WEAK},
    "without checksums, plain": {**_PLAIN, **_WEAK},
    "without a list of messages": {**_PLAIN, **_WEAK, "index_types": IndexType.CHUNK},
    "without summary": {**_PLAIN, **_WEAK, "index_types": IndexType.NONE}
    | {"use_statistics": False, "repeat_channels": False},
    "without chunks and checksums": {"use_chunking": False, **_WEAK},
}
VARIETIES: dict[str, Callable[[Path, list[Message]], None]] = {
    **{f"mcap {name}": partial(write_mcap, **style) for name, style in _MCAP.items()},
    **{
        f"bag {kind} {'with' if indexed else 'without'} index": partial(
            write_bag, compression=kind, indexed=indexed
        )
        for kind in (None, *Rosbag1Writer.CompressionFormat)
        for indexed in (True, False)
    },
    "bag of small chunks": partial(write_bag, chunk_bytes=1500),
    "db3 by time": write_db3,
    "db3 without index": partial(write_db3, time_index=False),
}
