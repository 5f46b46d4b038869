"""Messages as files: every format and variant that specmap reads, a few kilobytes each."""

from __future__ import annotations

import sqlite3
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import CompressionType, IndexType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as BagWriter
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_typestore

from fuzz.bag_records import closed_to_active
from specmap_cli.logs.readers.encoding import (
    LASER_SCAN,
    ODOMETRY,
    SUPPORTED_TYPES,
    message_definition,
    typestore,
)
from specmap_cli.logs.readers.recording import Message

_CHUNK_BYTES = 1500  # some four scans
_ANY_TYPE = get_typestore(Stores.ROS2_DASHING)  # those that nobody reads, too
_LAST_BAG_NS = ((1 << 32) - 1) * 10**9  # seconds are told in 32 bits

Encoder = Callable[[Sequence[Message]], bytes]


@dataclass(frozen=True, slots=True, kw_only=True)
class Variant:
    """A way to store messages.

    `family` says which mutations of records fit. `counts` is whether the file itself tells how
    many messages it holds, so that even one that was cut out cleanly is missed.
    """

    name: str
    family: str
    encode: Encoder
    counts: bool = False
    drives: tuple[str, ...] = ("planar", "echo", "cloud")


def mcap(
    messages: Sequence[Message],
    compression: CompressionType,
    *,
    chunked: bool = True,
    indexed: bool = True,
    crc: bool = True,
) -> bytes:
    """An MCAP file; without `indexed` it has neither summary nor message indexes."""
    file = BytesIO()
    writer = McapWriter(
        file,
        chunk_size=_CHUNK_BYTES,
        compression=compression,
        use_chunking=chunked,
        index_types=IndexType.ALL if indexed else IndexType.NONE,
        use_statistics=indexed,
        use_summary_offsets=indexed,
        repeat_channels=indexed,
        repeat_schemas=indexed,
        enable_crcs=crc,
    )
    writer.start(profile="ros2", library="fuzz")
    schemas: dict[str, int] = {}
    channels: dict[tuple[str, str], int] = {}
    for number, message in enumerate(messages):
        kind = message.type
        if kind not in schemas:
            text = message_definition(kind) if kind in SUPPORTED_TYPES else b""
            schemas[kind] = writer.register_schema(kind, "ros2msg", text)
        key = (message.topic, kind)
        if key not in channels:
            channels[key] = writer.register_channel(message.topic, "cdr", schemas[kind])
        time = message.time_ns
        writer.add_message(channels[key], time, message.data, time, sequence=number)
    writer.finish()  # type: ignore[no-untyped-call]
    return file.getvalue()


def bag(
    messages: Sequence[Message],
    compression: BagWriter.CompressionFormat | None = None,
    *,
    active: bool = False,
) -> bytes:
    """A ROS 1 bag; an `active` one was never closed and has no list of chunks.

    A message that does not fit its type is stored without its encapsulation.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "bag"
        writer = BagWriter(path)
        writer.chunk_threshold = _CHUNK_BYTES
        if compression is not None:
            writer.set_compression(compression)
        with writer:
            connections = {}
            for message in messages:
                key = (message.topic, message.type)
                if key not in connections:
                    connections[key] = writer.add_connection(*key, typestore=_ANY_TYPE)
                time_ns = min(message.time_ns, _LAST_BAG_NS)
                writer.write(connections[key], time_ns, _ros1(message))
        data = path.read_bytes()
    return closed_to_active(data) if active else data


def db3(messages: Sequence[Message], *, time_index: bool = True) -> bytes:
    """A rosbag2 SQLite file."""
    db = sqlite3.connect(":memory:")
    with db:
        db.execute(
            "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL, "
            "serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL)"
        )
        db.execute(
            "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, "
            "timestamp INTEGER NOT NULL, data BLOB NOT NULL)"
        )
        if time_index:
            db.execute("CREATE INDEX timestamp_idx ON messages (timestamp ASC)")
        topics: dict[tuple[str, str], int] = {}
        for message in messages:
            key = (message.topic, message.type)
            if key not in topics:
                topics[key] = len(topics) + 1
                db.execute("INSERT INTO topics VALUES (?, ?, ?, 'cdr', '')", (topics[key], *key))
            row = (topics[key], message.time_ns, message.data)
            db.execute("INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)", row)
    data = db.serialize()
    db.close()
    return data


def carmen(messages: Sequence[Message], keyword: str = "FLASER") -> bytes:
    """A CARMEN log of the scans, each with the odometry before it; other messages have no line."""
    lines, pose = ["# a log of CARMEN", "PARAM robot_frontlaser_offset 0.1"], "0.0 0.0 0.0"
    for message in messages:
        try:
            record: Any = typestore().deserialize_cdr(message.data, message.type)
        except (SerdeError, KeyError):
            continue
        if message.type == ODOMETRY:
            place, turn = record.pose.pose.position, record.pose.pose.orientation
            pose = f"{place.x:.6f} {place.y:.6f} {2.0 * np.arctan2(turn.z, turn.w):.6f}"
            lines.append(f"ODOM {pose} 0 0 0 {_seconds(record)} fuzz {_seconds(record)}")
        elif message.type == LASER_SCAN:
            ranges = " ".join(f"{value:.3f}" for value in np.minimum(record.ranges, 81.83))
            count, time = len(record.ranges), _seconds(record)
            tail = f"{pose} {pose} {time} fuzz {time}"
            lines.append(_laser_line(keyword, ranges, count, pose, tail))
    return ("\n".join(lines) + "\n").encode()


def _laser_line(keyword: str, ranges: str, count: int, pose: str, tail: str) -> str:
    if keyword == "FLASER":
        return f"FLASER {count} {ranges} {tail}"
    time = tail.split(" ", 6)[6]
    head = f"ROBOTLASER1 0 -1.57 3.14 0.105 81 0.01 0 {count} {ranges} 0"
    return f"{head} {pose} {pose} 0 0 0.5 0.5 1000000 {time}"


def _seconds(record: Any) -> str:
    stamp = record.header.stamp
    return f"{stamp.sec}.{stamp.nanosec // 1000:06d}"


def _ros1(message: Message) -> bytes:
    try:
        return bytes(_ANY_TYPE.cdr_to_ros1(message.data, message.type))
    except (SerdeError, KeyError):
        return message.data[4:]


def variants() -> Mapping[str, Variant]:
    """Every variant by its name."""
    none, lz4, zstd = CompressionType.NONE, CompressionType.LZ4, CompressionType.ZSTD
    bz2 = BagWriter.CompressionFormat
    rows: list[tuple[str, str, Encoder, bool]] = [
        ("mcap-zstd", "mcap", partial(mcap, compression=zstd), True),
        ("mcap-lz4", "mcap", partial(mcap, compression=lz4), True),
        ("mcap-crc", "mcap", partial(mcap, compression=none), True),
        ("mcap-plain", "mcap", partial(mcap, compression=none, crc=False), True),
        ("mcap-zstd-plain", "mcap", partial(mcap, compression=zstd, crc=False), True),
        ("mcap-unindexed", "mcap", partial(mcap, compression=lz4, indexed=False), False),
        ("mcap-bare", "mcap", partial(mcap, compression=none, indexed=False, crc=False), False),
        ("mcap-unchunked", "mcap", partial(mcap, compression=none, chunked=False), True),
        ("bag", "bag", bag, True),
        ("bag-bz2", "bag", partial(bag, compression=bz2.BZ2), True),
        ("bag-lz4", "bag", partial(bag, compression=bz2.LZ4), True),
        ("bag-active", "bag", partial(bag, active=True), True),
        ("db3", "db3", db3, False),
        ("db3-unsorted", "db3", partial(db3, time_index=False), False),
    ]
    found = {
        name: Variant(name=name, family=family, encode=encode, counts=counts)
        for name, family, encode, counts in rows
    }
    for name, keyword in (("carmen", "FLASER"), ("carmen-robotlaser", "ROBOTLASER1")):
        encode = partial(carmen, keyword=keyword)
        found[name] = Variant(name=name, family="carmen", encode=encode, drives=("planar",))
    return found
