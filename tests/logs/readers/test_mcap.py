"""MCAP in every variety, whole, cut off and damaged."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer

from specmap_cli.logs.opening import open_log
from specmap_cli.logs.readers.recording import Message

ReadRest = Callable[[Path], tuple[list[Message], list[str]]]
CutInTenths = Callable[[Path, list[Message]], None]

STYLES: list[dict[str, object]] = [
    {"compression": CompressionType.ZSTD},
    {"compression": CompressionType.LZ4},
    {"compression": CompressionType.NONE},
    {"index_types": IndexType.NONE},
    {"index_types": IndexType.NONE, "use_statistics": False, "repeat_channels": False},
    {"use_chunking": False},
    {"enable_crcs": False},
]


def write_mcap(path: Path, messages: list[Message], **style: object) -> None:
    """The messages by the reference writer, in small chunks."""
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


@pytest.mark.parametrize("style", STYLES)
def test_every_variety_gives_the_same_messages(
    tmp_path: Path, drive_messages: list[Message], style: dict[str, object]
) -> None:
    path = tmp_path / "log.mcap"
    write_mcap(path, drive_messages, **style)
    with open_log(path) as log:
        assert list(log.messages()) == drive_messages
        assert {t.name: t.count for t in log.topics()} == {
            "/odom": 60,
            "/scan": 30,
            "/tf_static": 1,
        }
        assert log.contents.start_ns == drive_messages[0].time_ns
        assert log.contents.end_ns == max(m.time_ns for m in drive_messages)
        assert log.damage == []
        scans = list(log.messages(["/scan"]))
        assert scans == [m for m in drive_messages if m.topic == "/scan"]


def test_topics_in_chunks_of_their_own_are_joined_in_time(
    tmp_path: Path, drive_messages: list[Message]
) -> None:
    path = tmp_path / "log.mcap"
    by_topic = sorted(drive_messages, key=lambda m: (m.topic, m.time_ns))
    write_mcap(path, by_topic)
    with open_log(path) as log:
        times = [m.time_ns for m in log.messages()]
    assert times == sorted(times)
    assert len(times) == len(drive_messages)


@pytest.mark.parametrize("style", STYLES)
def test_what_precedes_a_cut_is_read(
    tmp_path: Path,
    drive_messages: list[Message],
    cut_in_tenths: CutInTenths,
    style: dict[str, object],
) -> None:
    path = tmp_path / "log.mcap"
    write_mcap(path, drive_messages, **style)
    cut_in_tenths(path, drive_messages)


def test_messages_of_a_chunk_that_is_cut_are_read(
    tmp_path: Path, drive_messages: list[Message]
) -> None:
    path = tmp_path / "log.mcap"
    write_mcap(path, drive_messages, chunk_size=1 << 20, compression=CompressionType.NONE)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with open_log(path) as log:
        assert 20 < len(list(log.messages())) < len(drive_messages)


@pytest.mark.parametrize("compression", [CompressionType.ZSTD, CompressionType.NONE])
def test_a_damaged_chunk_costs_only_itself(
    tmp_path: Path, drive_messages: list[Message], compression: CompressionType
) -> None:
    path = tmp_path / "log.mcap"
    write_mcap(path, drive_messages, compression=compression)
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    middle = summary.chunk_indexes[3].chunk_start_offset + 200
    data = bytearray(path.read_bytes())
    data[middle : middle + 35] = b"damaged" * 5
    path.write_bytes(data)
    with open_log(path) as log:
        found = list(log.messages())
        assert len(log.damage) == 1
        assert "is damaged: messages between 10" in log.damage[0]
        assert "s are lost" in log.damage[0]
        assert list(log.messages()) == found
        assert len(log.damage) == 1, "said once, however often it is read"
    assert 0.5 * len(drive_messages) < len(found) < len(drive_messages)
    assert all(m in drive_messages for m in found)


@pytest.mark.parametrize("style", STYLES)
def test_random_damage_is_survived(
    tmp_path: Path,
    drive_messages: list[Message],
    read_rest: ReadRest,
    spoil: Callable[[Path, int, int], None],
    style: dict[str, object],
) -> None:
    path = tmp_path / "log.mcap"
    for seed in range(25):
        write_mcap(path, drive_messages[:20], **style)
        spoil(path, seed, 8)
        found, said = read_rest(path)
        assert len(found) <= 20
        assert all(str(path) in line and "\n" not in line for line in said)


def test_ros1_messages_in_mcap_are_read(tmp_path: Path, drive_messages: list[Message]) -> None:
    from specmap_cli.logs.readers.typestore import typestore

    path = tmp_path / "log.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros1")
        schema = writer.register_schema("sensor_msgs/LaserScan", "ros1msg", b"")
        channel = writer.register_channel("/scan", "ros1", schema)
        scans = [m for m in drive_messages if m.topic == "/scan"]
        for m in scans:
            raw = bytes(typestore().cdr_to_ros1(m.data, m.type))
            writer.add_message(channel, m.time_ns, raw, m.time_ns)
        writer.finish()  # type: ignore[no-untyped-call]
    with open_log(path) as log:
        assert list(log.messages()) == scans


def test_other_encodings_are_listed_but_no_scans(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("foxglove.LaserScan", "protobuf", b"")
        channel = writer.register_channel("/scan", "protobuf", schema)
        writer.add_message(channel, 5, b"?", 5)
        writer.finish()  # type: ignore[no-untyped-call]
    with open_log(path) as log:
        assert [t.type for t in log.topics()] == ["foxglove.LaserScan (protobuf)"]
