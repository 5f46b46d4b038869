"""rosbag2's SQLite files and ROS 1 bags, whole, cut off and damaged."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import pytest
import zstandard
from rosbags.rosbag1 import Writer as Rosbag1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Rosbag2Writer
from rosbags.typesys import Stores, get_typestore

from specmap_cli.core.errors import LogError
from specmap_cli.logs.opening import open_log
from specmap_cli.logs.readers.recording import Message

CompressionFormat = Rosbag1Writer.CompressionFormat
ReadRest = Callable[[Path], tuple[list[Message], list[str]]]
CutInTenths = Callable[[Path, list[Message]], None]
WriteDb3 = Callable[..., None]
WriteBag = Callable[..., None]


@pytest.mark.parametrize("storage", [StoragePlugin.SQLITE3, StoragePlugin.MCAP])
def test_a_rosbag2_directory_is_read(
    tmp_path: Path, drive_messages: list[Message], storage: StoragePlugin
) -> None:
    store = get_typestore(Stores.ROS2_JAZZY)
    with Rosbag2Writer(tmp_path / "bag", version=9, storage_plugin=storage) as writer:
        types = {m.topic: m.type for m in drive_messages}
        connections = {
            topic: writer.add_connection(topic, name, typestore=store)
            for topic, name in types.items()
        }
        for m in drive_messages:
            writer.write(connections[m.topic], m.time_ns, m.data)
    with open_log(tmp_path / "bag") as log:
        assert list(log.messages()) == drive_messages
        assert log.damage == []
    file = next(path for path in (tmp_path / "bag").iterdir() if path.suffix != ".yaml")
    with open_log(file) as log:
        assert log.contents.messages == len(drive_messages)


@pytest.mark.parametrize("time_index", [True, False])
def test_a_bare_old_db3_is_read(
    tmp_path: Path, drive_messages: list[Message], write_db3: WriteDb3, time_index: bool
) -> None:
    path = tmp_path / "misnamed.mcap"
    write_db3(path, drive_messages, time_index=time_index)
    with open_log(path) as log:
        assert log.format == "rosbag2 (SQLite)"
        assert list(log.messages()) == drive_messages
        assert list(log.messages(["/odom"])) == [m for m in drive_messages if m.topic == "/odom"]
        assert {t.name: t.count for t in log.topics()}["/scan"] == 30


def test_messages_compressed_one_by_one_are_read(
    tmp_path: Path, drive_messages: list[Message], write_db3: WriteDb3
) -> None:
    path = tmp_path / "log.db3"
    packed = [m._replace(data=zstandard.compress(m.data)) for m in drive_messages]
    write_db3(path, packed)
    with open_log(path) as log:
        assert list(log.messages()) == drive_messages


def test_a_compressed_file_is_read_until_it_ends(
    tmp_path: Path, drive_messages: list[Message], write_db3: WriteDb3
) -> None:
    write_db3(tmp_path / "log.db3", drive_messages)
    path = tmp_path / "log.db3.zstd"
    path.write_bytes(zstandard.compress((tmp_path / "log.db3").read_bytes()))
    with open_log(path) as log:
        assert list(log.messages()) == drive_messages
        assert log.paths == [path]


def test_split_recordings_are_one_log_in_time_order(
    tmp_path: Path, drive_messages: list[Message], write_db3: WriteDb3
) -> None:
    (tmp_path / "split").mkdir()
    halves = [tmp_path / "split" / "z_first.db3", tmp_path / "split" / "a_second.db3"]
    write_db3(halves[0], drive_messages[:40])
    write_db3(halves[1], drive_messages[40:])
    for given_paths in (halves, halves[::-1], [tmp_path / "split"]):
        with open_log(given_paths) as log:
            assert list(log.messages()) == drive_messages
            assert log.paths == halves
            assert log.contents.messages == len(drive_messages)


def test_what_a_cut_database_still_holds_is_read(
    tmp_path: Path, drive_messages: list[Message], write_db3: WriteDb3, read_rest: ReadRest
) -> None:
    path = tmp_path / "log.db3"
    write_db3(path, drive_messages)
    whole = path.read_bytes()
    outcomes = set()
    for tenth in range(10):
        path.write_bytes(whole[: len(whole) * tenth // 10 + 20])
        found, said = read_rest(path)
        assert said
        assert all(str(path) in line for line in said)
        sound = [m for m in found if m in drive_messages]
        assert sound == [m for m in drive_messages if m in found]
        assert len(found) - len(sound) <= 1, "only the message that was cut through"
        outcomes.add(bool(found))
    assert outcomes == {True, False}


@pytest.mark.parametrize("compression", [None, CompressionFormat.BZ2, CompressionFormat.LZ4])
def test_ros1_bags_give_ros2_messages(
    tmp_path: Path,
    drive_messages: list[Message],
    write_bag: WriteBag,
    compression: CompressionFormat | None,
) -> None:
    path = tmp_path / "log.bag"
    write_bag(path, drive_messages, compression)
    with open_log(path) as log:
        assert log.format == "ROS 1 bag"
        assert list(log.messages()) == drive_messages
        assert {t.name: t.count for t in log.topics()} == {
            "/odom": 60,
            "/scan": 30,
            "/tf_static": 1,
        }
        assert log.contents.end_ns == max(m.time_ns for m in drive_messages)
        assert log.damage == []


@pytest.mark.parametrize("compression", [None, CompressionFormat.BZ2, CompressionFormat.LZ4])
def test_what_precedes_a_cut_in_a_bag_is_read(
    tmp_path: Path,
    drive_messages: list[Message],
    write_bag: WriteBag,
    cut_in_tenths: CutInTenths,
    compression: CompressionFormat | None,
) -> None:
    path = tmp_path / "log.bag"
    write_bag(path, drive_messages, compression)
    cut_in_tenths(path, drive_messages)


def test_a_bag_with_wrong_index_records_is_read_by_its_list_of_chunks(
    tmp_path: Path, drive_messages: list[Message], write_bag: WriteBag
) -> None:
    path = tmp_path / "log.bag"
    write_bag(path, drive_messages)
    data = bytearray(path.read_bytes())
    index_record = data.index(b"op=\x04")
    length = data.index(b"ver=", index_record) if data.find(b"ver=", index_record) > 0 else 0
    start = data.rindex(struct.pack("<I", 47), 0, index_record)
    assert length or start
    data[start + 4 + 47 : start + 4 + 47 + 4] = struct.pack("<I", 77_777)
    path.write_bytes(data)
    with open_log(path) as log:
        assert list(log.messages()) == drive_messages
        assert len(log.damage) == 1
        assert f"the record at byte {start} is damaged and was passed over" in log.damage[0]


def test_a_bag_without_index_is_walked(
    tmp_path: Path, drive_messages: list[Message], write_bag: WriteBag
) -> None:
    path = tmp_path / "log.bag.active"
    write_bag(path, drive_messages)
    data = path.read_bytes()
    place = data.index(b"index_pos=") + len(b"index_pos=")
    path.write_bytes(data[:place] + bytes(8) + data[place + 8 :])
    with open_log(path) as log:
        assert list(log.messages()) == drive_messages
        assert log.damage == []


def test_an_old_bag_format_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "log.bag"
    path.write_bytes(b"#ROSBAG V1.2\n" + bytes(100))
    with pytest.raises(LogError, match=r"bag format 1\.2 is not supported; bring it to 2\.0"):
        open_log(path)


def test_random_damage_in_a_bag_is_survived(
    tmp_path: Path,
    drive_messages: list[Message],
    write_bag: WriteBag,
    read_rest: ReadRest,
    spoil: Callable[[Path, int, int], None],
) -> None:
    path = tmp_path / "log.bag"
    for seed in range(60):
        path.unlink(missing_ok=True)
        write_bag(path, drive_messages[:20], chunk_bytes=1500)
        spoil(path, seed, 13)
        found, said = read_rest(path)
        assert len(found) <= 20
        assert all(str(path) in line and "\n" not in line for line in said)
