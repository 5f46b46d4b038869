"""rosbag2's directories and SQLite files and ROS 1 bags: what is peculiar to each, and damage."""

import re
import shutil
import sqlite3
import struct
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest
import zstandard
from rosbags.rosbag1 import Writer as Rosbag1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Rosbag2Writer
from rosbags.typesys import Stores, get_typestore

from specmap_cli.core.errors import LogError
from specmap_cli.core.settings import LogConfig
from specmap_cli.logs.opening import open_log
from specmap_cli.logs.readers.recording import Message
from tests.logs.recordings import change_db3, overwrite, read_rest, refusal, write_bag, write_db3


@pytest.mark.parametrize("storage", [StoragePlugin.SQLITE3, StoragePlugin.MCAP])
def test_a_rosbag2_is_read(tmp_path: Path, driven: list[Message], storage: StoragePlugin) -> None:
    store = get_typestore(Stores.ROS2_JAZZY)
    with Rosbag2Writer(tmp_path / "bag", version=9, storage_plugin=storage) as writer:
        connections = {
            topic: writer.add_connection(topic, name, typestore=store)
            for topic, name in {m.topic: m.type for m in driven}.items()
        }
        for m in driven:
            writer.write(connections[m.topic], m.time_ns, m.data)
    assert read_rest(tmp_path / "bag") == (driven, [])
    file = next(path for path in (tmp_path / "bag").iterdir() if path.suffix != ".yaml")
    with open_log(file) as log:
        assert log.contents.messages == len(driven)


def test_what_is_compressed_is_read_and_its_name_may_hold_what_a_link_may_not(
    tmp_path: Path, driven: list[Message]
) -> None:
    path = tmp_path / "my log?#100%.db3"
    write_db3(path, driven)
    assert read_rest(path) == (driven, [])
    path.write_bytes(zstandard.compress(path.read_bytes()))
    with open_log(path) as log:
        assert list(log.messages()) == driven
        assert log.paths == [path]
    path.unlink()
    write_db3(path, [m._replace(data=zstandard.compress(m.data)) for m in driven])
    assert read_rest(path) == (driven, [])


def test_what_a_cut_database_still_holds_is_read(path: Path, driven: list[Message]) -> None:
    write_db3(path, driven)
    whole = path.read_bytes()
    outcomes = set()
    for tenth in range(10):
        path.write_bytes(whole[: len(whole) * tenth // 10 + 20])
        found, said = read_rest(path)
        assert said
        assert all(str(path) in line for line in said)
        sound = [m for m in found if m in driven]
        assert sound == [m for m in driven if m in found]
        assert len(found) - len(sound) <= 1, "only the message that was cut through"
        outcomes.add(bool(found))
    assert outcomes == {True, False}


def test_a_bag_with_a_wrong_index_is_read_by_its_chunks(path: Path, driven: list[Message]) -> None:
    write_bag(path, driven)
    data = path.read_bytes()
    start = data.rindex(struct.pack("<I", 47), 0, data.index(b"op=\x04"))
    overwrite(path, start + 4 + 47, struct.pack("<I", 77_777))
    found, (said,) = read_rest(path)
    assert found == driven
    assert f"the record at byte {start} is damaged and was passed over" in said


def test_what_an_index_record_swallowed_is_told(path: Path, driven: list[Message]) -> None:
    """Bytes were cut out of it and of what follows, so that the file's own index is off by them."""
    write_bag(path, driven)
    data = path.read_bytes()
    overwrite(path, data.index(b"index_pos=") + len("index_pos="), bytes(8))
    places = [found.start() for found in re.finditer(rb"op=\x04", data)]
    starts = [data.rindex(struct.pack("<I", 47), 0, place) for place in places]
    gap = next(i for i, start in enumerate(starts[1:]) if start - starts[i] > 1000)
    length = starts[gap] + 4 + 47
    overwrite(path, length, struct.pack("<I", starts[gap + 1] - length - 4))
    overwrite(path, data.index(b"count=", starts[gap]) + len("count="), struct.pack("<I", 9999))
    found, said = read_rest(path)
    assert len(found) < len(driven)
    assert any(f"the record at byte {starts[gap]} is damaged: what it" in line for line in said)


def test_a_database_of_a_killed_recorder_is_read(tmp_path: Path, driven: list[Message]) -> None:
    """Its last messages are still in the log beside it."""
    write_db3(tmp_path / "live.db3", driven[:40])
    with sqlite3.connect(tmp_path / "live.db3") as db:
        db.execute("PRAGMA journal_mode = WAL")
        numbers = dict(db.execute("SELECT name, id FROM topics").fetchall())
        rows = [(numbers[m.topic], m.time_ns, m.data) for m in driven[40:]]
        db.executemany("INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)", rows)
        db.commit()
        for file in ("live.db3", "live.db3-wal"):
            shutil.copy(tmp_path / file, tmp_path / file.replace("live", "killed"))
    db.close()
    assert read_rest(tmp_path / "killed.db3") == (driven, [])


def test_rows_that_are_no_messages_are_passed_over(path: Path, driven: list[Message]) -> None:
    write_db3(path, driven)
    insert = "INSERT INTO messages(topic_id, timestamp, data) VALUES (1, ?, ?)"
    change_db3(path, insert, ("yesterday", b"data"), (driven[-1].time_ns + 1, "text"))
    assert read_rest(path)[0] == driven


def test_a_database_of_something_else_is_refused(path: Path) -> None:
    change_db3(path, "CREATE TABLE people(name TEXT)")
    assert refusal(path) == f"{path}: no readable rosbag2 file: no such table: topics"


def test_a_message_not_of_its_type_is_left_out_and_said(path: Path, driven: list[Message]) -> None:
    scans = [m for m in driven if m.topic == "/scan"][:3]
    with Rosbag1Writer(path) as writer:
        store = get_typestore(Stores.ROS2_HUMBLE)
        other = writer.add_connection("/cmd_vel", "geometry_msgs/msg/Twist", typestore=store)
        writer.write(other, 5, bytes(48))
        connection = writer.add_connection("/scan", scans[0].type, typestore=store)
        for number, m in enumerate(scans):
            raw = bytes(store.cdr_to_ros1(m.data, m.type))
            writer.write(connection, m.time_ns, raw[:9] if number == 1 else raw)
    said = f"the message on /scan at {scans[1].time_ns / 1e9:.3f} s does not fit its type"
    unread = Message("/cmd_vel", "geometry_msgs/msg/Twist", 5, bytes(48))  # stays as it is
    with open_log(path) as log:
        assert list(log.messages()) == [unread, scans[0], scans[2]]
        assert log.damage == [f"{path}: {said} sensor_msgs/msg/LaserScan; left out"]
        assert log.missing == {"/scan": 1}


@pytest.mark.parametrize("indexed", [True, False])
@pytest.mark.parametrize(
    ("old", "new"),
    [(b"op=\x02", b"op=\x04"), (b"op=\x02", b"op=\x42"), (b"op=\x02", b"xp=\x02")]
    + [(b"conn=", b"conm="), (b"conn=\x01", b"conn=\x51"), (b"time=", b"mite=")],
)
def test_a_damaged_record_in_a_chunk_is_told(
    path: Path, driven: list[Message], old: bytes, new: bytes, indexed: bool
) -> None:
    write_bag(path, driven, indexed=indexed)
    data = path.read_bytes()
    chunk = data.index(b"compression=none", data.index(b"compression=none") + 1)
    header = data.index(b"op=\x02", chunk) - 60  # of the first message in the second chunk
    overwrite(path, data.index(old, header), new)
    with open_log(path) as log:
        found, (said,), missing = list(log.messages()), log.damage, log.missing
    assert len(found) < len(driven)
    assert all(m in driven for m in found)
    assert "chunk at byte" in said
    if new == b"op=\x42":  # all others of its chunk are read: number, topic and place are told
        (lost,) = (m for m in driven if m not in found)
        assert missing == {lost.topic: 1}
        head, what = said.split(" is damaged: ")
        start = data.index(b"op=\x05", data.index(b"op=\x05") + 1)
        assert 0 < start - int(head.rsplit(" ", 1)[1]) < 200
        assert what.startswith("1 of ")
        assert f" on {lost.topic}, between 100." in what


PAGE = 512  # bytes: small ones, so that a drive takes many of them and messages flow over
INDEX_LEAF, TABLE_LEAF = 0x0A, 0x0D  # the first byte of a page


@pytest.fixture(params=[True], ids=["by time"])
def stored(tmp_path: Path, driven: list[Message], request: pytest.FixtureRequest) -> Path:
    """The drive in small pages, with or without an index of time."""
    path = tmp_path / "log.db3"
    with sqlite3.connect(path) as db:
        db.execute(f"PRAGMA page_size = {PAGE}")
        db.execute("CREATE TABLE schema(version INTEGER)")
    db.close()
    write_db3(path, driven, time_index=request.param)
    return path


def root_of(path: Path, name: str) -> int:
    """The number of the page that a table or an index begins at."""
    with sqlite3.connect(path) as db:
        query = "SELECT rootpage FROM sqlite_master WHERE name = ?"
        root: int = db.execute(query, (name,)).fetchone()[0]
    db.close()
    return root


def leaves(data: bytes, page: int) -> Iterator[int]:
    """The numbers of the leaf pages below a page, in order."""
    place = (page - 1) * PAGE
    if data[place] in (INDEX_LEAF, TABLE_LEAF):
        yield page
        return
    for cell in range(int.from_bytes(data[place + 3 : place + 5], "big")):
        pointer = place + 12 + 2 * cell
        start = place + int.from_bytes(data[pointer : pointer + 2], "big")
        yield from leaves(data, int.from_bytes(data[start : start + 4], "big"))
    yield from leaves(data, int.from_bytes(data[place + 8 : place + 12], "big"))


def leaf(path: Path, name: str, share: float) -> int:
    """The byte where a leaf of a table or an index begins, that share of the way through it."""
    found = list(leaves(path.read_bytes(), root_of(path, name)))
    return (found[int(share * len(found))] - 1) * PAGE


def read(path: Path, config: LogConfig | None = None) -> tuple[list[Message], list[str]]:
    with open_log(path, config) as log:
        found = list(log.messages())
        assert list(log.messages()) == found, "the second reading gives the same"
        return found, log.damage


IN_ORDER = "the index of time is damaged: read in the order of recording, nothing is lost by this"


@pytest.mark.parametrize("by", [b"\x00", b"\x0a\x00\x00\x00\x00"])
@pytest.mark.parametrize("share", [0.0, 0.5, 0.99])
def test_no_index_is_needed(stored: Path, driven: list[Message], share: float, by: bytes) -> None:
    overwrite(stored, leaf(stored, "timestamp_idx", share), by)
    found, damage = read(stored)
    assert found == driven
    assert damage[0] == f"{stored}: {IN_ORDER}"


def test_an_index_that_leads_to_other_rows_is_ignored(stored: Path, driven: list[Message]) -> None:
    place = leaf(stored, "timestamp_idx", 0.5)
    data = stored.read_bytes()
    first_cell = place + int.from_bytes(data[place + 8 : place + 10], "big")
    last = first_cell + data[first_cell]  # the lowest byte of the row's number
    overwrite(stored, last, bytes([data[last] ^ 0x20]))
    assert read(stored) == (driven, [f"{stored}: {IN_ORDER}"])


@pytest.mark.parametrize("share", [0.0, 0.4, 0.99])
def test_a_damaged_page_costs_its_own(stored: Path, driven: list[Message], share: float) -> None:
    place = leaf(stored, "messages", share)
    inside = int.from_bytes(stored.read_bytes()[place + 3 : place + 5], "big")
    overwrite(stored, place, b"\x00" * 8)
    found, (said,) = read(stored)
    assert len(found) == len(driven) - inside
    assert [m for m in driven if m in found] == found
    assert "database disk image is malformed " in said
    assert said.endswith(": what followed is lost" if share > 0.9 else "followed is lost")


@pytest.mark.parametrize("stored", [True, False], indirect=True)
def test_an_overflow_into_nowhere_costs_one_message(stored: Path, driven: list[Message]) -> None:
    data = stored.read_bytes()
    lost = next(m for m in driven[30:] if m.topic == "/odom")
    begin = data.index(lost.data[:60])
    place = begin // PAGE * PAGE  # its leaf: the number of the next page ends the part in it
    starts = sorted(
        place + int.from_bytes(data[place + 8 + 2 * n :][:2], "big")
        for n in range(int.from_bytes(data[place + 3 : place + 5], "big"))
    )
    end = next((start for start in starts if start > begin), place + PAGE)
    overwrite(stored, end - 4, b"\x7f\xff\xff\xff")
    said = f"one message on /odom at {lost.time_ns / 1e9:.3f} s is lost"
    assert read(stored) == (
        [m for m in driven if m is not lost],
        [f"{stored}: {said}: database disk image is malformed"],
    )


@pytest.mark.parametrize(
    ("time_index", "row", "more"),
    [(True, 6, ""), (False, 91, f", id = {2**63 - 1}")],
    ids=["by time", "in the last row there can be"],
)
def test_a_message_that_is_too_large_costs_only_itself(
    path: Path, driven: list[Message], time_index: bool, row: int, more: str
) -> None:
    write_db3(path, driven, time_index=time_index)
    change_db3(path, f"UPDATE messages SET data = zeroblob(200000){more} WHERE id = {row}")
    found, damage = read(path, LogConfig(chunk_max_mb=0.1))
    large = driven[row - 1]
    assert Counter(found) == Counter(driven) - Counter([large])
    said = f"one message on {large.topic} at {large.time_ns / 1e9:.3f} s is lost"
    assert damage[-1] == f"{path}: {said}: it is beyond log.chunk_max_mb"
    assert len(damage) == 1 or not time_index


@pytest.mark.parametrize("stored", [False], indirect=True)
def test_rows_may_have_any_number_of_64_bits(stored: Path, driven: list[Message]) -> None:
    change_db3(stored, "UPDATE messages SET id = id - 100")
    overwrite(stored, leaf(stored, "messages", 0.4), b"\x00" * 8)
    found, (said,) = read(stored)
    assert len(found) > 0.5 * len(driven)
    assert said.endswith("some of what followed is lost")


def test_a_table_with_a_byte_cut_out_is_survived(path: Path, driven: list[Message]) -> None:
    write_db3(path, driven, time_index=False)
    whole = path.read_bytes()
    for place in range(9000, len(whole), 4099):
        path.write_bytes(whole[:place] + whole[place + 1 :])
        try:
            found, damage = read(path)
        except LogError as error:
            assert str(error).endswith("no message can be read")  # noqa: PT017
        else:
            assert len(found) < len(driven)
            assert damage


@pytest.mark.parametrize("text", ["x'69ff'", "CAST(x'69ff' AS TEXT)", "CAST(x'6900' AS TEXT)", "5"])
@pytest.mark.parametrize("column", ["name", "sql"])
def test_a_list_of_indexes_with_other_bytes_in_it_costs_nothing(
    stored: Path, driven: list[Message], column: str, text: str
) -> None:
    with sqlite3.connect(stored) as db:
        db.execute("PRAGMA writable_schema = ON")
        db.execute(f"UPDATE sqlite_master SET {column} = {text} WHERE type = 'index'")
    db.close()
    assert read(stored)[0] == driven


def test_a_topic_with_a_damaged_byte_or_the_old_name_of_its_type_is_read_all_the_same(
    stored: Path, driven: list[Message]
) -> None:
    change_db3(stored, "UPDATE topics SET type = 'tf/tfMessage' WHERE name = '/tf_static'")
    assert read(stored) == (driven, [])
    change_db3(stored, "UPDATE topics SET name = CAST(x'2fff' AS TEXT) WHERE name = '/scan'")
    renamed = [m._replace(topic="/\ufffd") if m.topic == "/scan" else m for m in driven]
    assert read(stored) == (renamed, [])


@pytest.mark.parametrize("kind", [str(-(2**63)), "senwor_msgs/msg/LaserScan"])
def test_a_topic_whose_type_is_damaged_is_told(stored: Path, kind: str) -> None:
    change_db3(stored, "UPDATE topics SET type = ? WHERE name = '/scan'", (kind,))
    with open_log(stored) as log:
        count = next(topic.count for topic in log.topics() if topic.name == "/scan")
        said = f"the type of topic /scan is damaged ({kind})"
        assert log.damage == [f"{stored}: {said}: {count} messages cannot be read"]
