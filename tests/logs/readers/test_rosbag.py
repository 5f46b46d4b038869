"""rosbag2's directories and SQLite files and ROS 1 bags: what is peculiar to each."""

from __future__ import annotations

import shutil
import sqlite3
import struct
from pathlib import Path

import pytest
import zstandard
from rosbags.rosbag1 import Writer as Rosbag1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Rosbag2Writer
from rosbags.typesys import Stores, get_typestore

from specmap_cli.logs.opening import open_log
from specmap_cli.logs.readers.recording import Message
from tests.logs.recordings import (
    change_db3,
    overwrite,
    read_rest,
    refusal,
    write_bag,
    write_db3,
)


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
    assert read_rest(tmp_path / "bag") == (drive_messages, [])
    file = next(path for path in (tmp_path / "bag").iterdir() if path.suffix != ".yaml")
    with open_log(file) as log:
        assert log.contents.messages == len(drive_messages)


def test_messages_compressed_one_by_one_are_read(path: Path, drive_messages: list[Message]) -> None:
    write_db3(path, [m._replace(data=zstandard.compress(m.data)) for m in drive_messages])
    assert read_rest(path) == (drive_messages, [])


def test_a_compressed_file_is_read_and_its_name_may_hold_what_a_link_may_not(
    tmp_path: Path, drive_messages: list[Message]
) -> None:
    path = tmp_path / "my log?#100%.db3"
    write_db3(path, drive_messages)
    assert read_rest(path) == (drive_messages, [])
    path.write_bytes(zstandard.compress(path.read_bytes()))
    with open_log(path) as log:
        assert list(log.messages()) == drive_messages
        assert log.paths == [path]


def test_split_recordings_are_one_log_in_time_order(
    tmp_path: Path, drive_messages: list[Message]
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


def test_what_a_cut_database_still_holds_is_read(path: Path, drive_messages: list[Message]) -> None:
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


def test_a_bag_with_wrong_index_records_is_read_by_its_list_of_chunks(
    path: Path, drive_messages: list[Message]
) -> None:
    write_bag(path, drive_messages)
    data = path.read_bytes()
    index_record = data.index(b"op=\x04")
    start = data.rindex(struct.pack("<I", 47), 0, index_record)
    overwrite(path, start + 4 + 47, struct.pack("<I", 77_777))
    found, (said,) = read_rest(path)
    assert found == drive_messages
    assert f"the record at byte {start} is damaged and was passed over" in said


def test_a_database_of_a_recorder_that_was_killed_is_read(
    tmp_path: Path, drive_messages: list[Message]
) -> None:
    """Its last messages are still in the log beside it."""
    write_db3(tmp_path / "live.db3", drive_messages[:40])
    with sqlite3.connect(tmp_path / "live.db3") as db:
        db.execute("PRAGMA journal_mode = WAL")
        numbers = dict(db.execute("SELECT name, id FROM topics").fetchall())
        rows = [(numbers[m.topic], m.time_ns, m.data) for m in drive_messages[40:]]
        db.executemany("INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)", rows)
        db.commit()
        for file in ("live.db3", "live.db3-wal"):
            shutil.copy(tmp_path / file, tmp_path / file.replace("live", "killed"))
    db.close()
    assert read_rest(tmp_path / "killed.db3") == (drive_messages, [])


def test_rows_that_are_no_messages_are_passed_over(
    path: Path, drive_messages: list[Message]
) -> None:
    write_db3(path, drive_messages)
    insert = "INSERT INTO messages(topic_id, timestamp, data) VALUES (1, ?, ?)"
    change_db3(path, insert, ("yesterday", b"data"), (drive_messages[-1].time_ns + 1, "text"))
    assert read_rest(path)[0] == drive_messages


def test_a_database_of_something_else_is_refused(path: Path) -> None:
    change_db3(path, "CREATE TABLE people(name TEXT)")
    assert refusal(path) == f"{path}: no readable rosbag2 file: no such table: topics"


def test_an_old_transform_type_gets_its_new_name(path: Path, drive_messages: list[Message]) -> None:
    old = [m._replace(type="tf/tfMessage") for m in drive_messages if m.topic == "/tf_static"]
    write_db3(path, old)
    with open_log(path) as log:
        assert [t.type for t in log.topics()] == ["tf2_msgs/msg/TFMessage"]


def test_a_message_that_does_not_fit_its_type_is_left_out_and_said(
    path: Path, drive_messages: list[Message]
) -> None:
    scans = [m for m in drive_messages if m.topic == "/scan"][:3]
    with Rosbag1Writer(path) as writer:
        store = get_typestore(Stores.ROS2_HUMBLE)
        connection = writer.add_connection("/scan", scans[0].type, typestore=store)
        for number, m in enumerate(scans):
            raw = bytes(store.cdr_to_ros1(m.data, m.type))
            writer.write(connection, m.time_ns, raw[:9] if number == 1 else raw)
    said = f"the message on /scan at {scans[1].time_ns / 1e9:.3f} s does not fit its type"
    with open_log(path) as log:
        assert list(log.messages()) == [scans[0], scans[2]]
        assert log.damage == [f"{path}: {said} sensor_msgs/msg/LaserScan; left out"]
        assert log.missing == {"/scan": 1}


def test_types_that_nothing_reads_stay_as_they_are(path: Path) -> None:
    with Rosbag1Writer(path) as writer:
        store = get_typestore(Stores.ROS1_NOETIC)
        connection = writer.add_connection("/cmd_vel", "geometry_msgs/msg/Twist", typestore=store)
        writer.write(connection, 5, bytes(48))
    sent = Message("/cmd_vel", "geometry_msgs/msg/Twist", 5, bytes(48))
    assert read_rest(path) == ([sent], [])


@pytest.mark.parametrize("indexed", [True, False])
@pytest.mark.parametrize(
    ("old", "new"),
    [(b"op=\x02", b"op=\x04"), (b"op=\x02", b"op=\x42"), (b"op=\x02", b"xp=\x02")]
    + [(b"conn=", b"conm="), (b"conn=\x01", b"conn=\x51"), (b"time=", b"mite=")],
)
def test_a_damaged_record_in_a_chunk_is_told(
    path: Path, drive_messages: list[Message], old: bytes, new: bytes, indexed: bool
) -> None:
    write_bag(path, drive_messages, indexed=indexed)
    data = path.read_bytes()
    chunk = data.index(b"compression=none", data.index(b"compression=none") + 1)
    header = data.index(b"op=\x02", chunk) - 60  # of the first message in the second chunk
    overwrite(path, data.index(old, header), new)
    found, (said,) = read_rest(path)
    assert len(found) < len(drive_messages)
    assert all(m in drive_messages for m in found)
    assert "chunk at byte" in said
