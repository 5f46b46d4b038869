"""MCAP files: what their index says, and single records that are damaged or out of place."""

import struct
from collections import Counter
from pathlib import Path

import pytest
import zstandard
from mcap.reader import make_reader
from mcap.records import ChunkIndex
from mcap.writer import CompressionType, IndexType, Writer

from specmap_cli.logs.opening import open_log
from specmap_cli.logs.readers.chunked import ChunkRef
from specmap_cli.logs.readers.compression import Unpacked
from specmap_cli.logs.readers.encoding import typestore
from specmap_cli.logs.readers.mcap import McapFile
from specmap_cli.logs.readers.recording import Message, TopicInfo
from tests.logs.recordings import overwrite, read_rest, write_mcap

Row = tuple[int, bytes]  # time and data of a message

PLAIN = CompressionType.NONE


def chunks_of(path: Path) -> list[ChunkIndex]:
    """The chunks by the reference reader."""
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    return summary.chunk_indexes


def write_channel(path: Path, schema: str | None, encodings: tuple[str, str], *rows: Row) -> None:
    """Messages on /scan, of a schema and in an encoding that may be any."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        number = writer.register_schema(schema, encodings[0], b"") if schema else 0
        channel = writer.register_channel("/scan", encodings[1], number)
        for time_ns, data in rows:
            writer.add_message(channel, time_ns, data, time_ns)
        writer.finish()  # type: ignore[no-untyped-call]


def records(data: bytes) -> list[bytes]:
    """The records of an MCAP file between its first and last bytes."""
    found, place = [], 8
    while place < len(data) - 8:
        end = place + 9 + struct.unpack_from("<Q", data, place + 1)[0]
        found.append(data[place:end])
        place = end
    return found


def places_of(found: list[bytes], opcode: int) -> list[int]:
    return [place for place, record in enumerate(found) if record[0] == opcode]


def rewrite(path: Path, found: list[bytes]) -> None:
    magic = path.read_bytes()[:8]
    path.write_bytes(magic + b"".join(found) + magic)


@pytest.mark.parametrize("compression", [CompressionType.ZSTD, PLAIN])
def test_a_chunk_costs_itself(
    path: Path, driven: list[Message], compression: CompressionType
) -> None:
    write_mcap(path, driven, compression=compression)
    overwrite(path, chunks_of(path)[3].chunk_start_offset + 200, b"damaged" * 5)
    with open_log(path) as log:
        found = list(log.messages())
        assert len(log.damage) == 1
        assert "is damaged: " in log.damage[0]
        assert ", between 100.350 s and 100.450 s, are lost" in log.damage[0]
        assert list(log.messages()) == found
        assert len(log.damage) == 1, "said once, however often it is read"
        assert len(found) + log.missing.total() == len(driven)
    assert 0.5 * len(driven) < len(found) < len(driven)
    assert all(m in driven for m in found)


def test_ros1_messages_in_mcap_are_read(path: Path, driven: list[Message]) -> None:
    scans = [m for m in driven if m.topic == "/scan"]
    rows = [(m.time_ns, bytes(typestore().cdr_to_ros1(m.data, m.type))) for m in scans]
    write_channel(path, "sensor_msgs/LaserScan", ("ros1msg", "ros1"), *rows)
    assert read_rest(path) == (scans, [])


def test_what_is_wrong_beside_the_messages_costs_nothing(path: Path, driven: list[Message]) -> None:
    """A wrong checksum of the index, a private record, statistics that contradict themselves."""
    write_mcap(path, driven)
    last = path.read_bytes()[-9]  # of the checksum, right before the closing magic
    overwrite(path, path.stat().st_size - 9, bytes([last ^ 0xFF]))
    assert read_rest(path) == (driven, [])
    write_mcap(path, driven, use_chunking=False)
    head, *rest = records(path.read_bytes())
    rewrite(path, [head, struct.pack("<BQ", 0x93, 5) + b"extra", *rest])
    assert read_rest(path) == (driven, [])
    found = [head, *rest]
    (place,) = places_of(found, 0x0B)
    count = struct.unpack_from("<Q", found[place], 9)[0]
    found[place] = found[place][:9] + struct.pack("<Q", count + 1) + found[place][17:]
    rewrite(path, found)
    assert read_rest(path) == (driven, [])


@pytest.mark.parametrize(
    ("opcode", "length", "told"),
    [
        (0x7A, None, "is of no known kind (opcode 122)"),
        (0x05, 0, "is damaged (opcode 5)"),  # a message shorter than its head
        (0x05, 21, "is damaged (opcode 5)"),
    ],
)
def test_a_record_that_is_no_message_any_more_is_passed_over_and_said(
    path: Path, driven: list[Message], opcode: int, length: int | None, told: str
) -> None:
    write_mcap(path, driven, use_chunking=False, index_types=IndexType.NONE)
    found, lost = records(path.read_bytes()), driven[40]
    place = places_of(found, 5)[40]
    body = found[place][9:] if length is None else bytes(length)
    found[place] = struct.pack("<BQ", opcode, len(body)) + body
    rewrite(path, found)
    start = 8 + sum(map(len, found[:place]))
    with open_log(path) as log:
        assert list(log.messages()) == driven[:40] + driven[41:]
        assert log.damage[0] == (
            f"{path}: the record at byte {start} {told}: what it holds in its {9 + len(body)} "
            "bytes is lost"
        )
        assert log.missing == {lost.topic: 1}
        said = log.damage[1:]
    if length is None:
        total = sum(m.topic == lost.topic for m in driven)
        gone = f"1 of {total} messages on {lost.topic} of the index are not in the file"
        assert said == [f"{path}: {gone}"]
        overwrite(path, start, b"\x7a\x01")  # of a length behind which no record follows
        last, size = driven[39].time_ns / 1e9, path.stat().st_size
        end = f"damaged at byte {start} of {size}: what followed {last:.3f} s is lost"
        assert read_rest(path) == (driven[:40], [f"{path}: {end}"])


def test_messages_that_rosbag2_compressed_one_by_one_are_read(
    path: Path, driven: list[Message]
) -> None:
    """One that is damaged is told, and the others are read."""
    packed = [m._replace(data=zstandard.compress(m.data)) for m in driven]
    write_mcap(path, packed)
    assert read_rest(path) == (driven, [])
    packed[3] = packed[3]._replace(data=packed[3].data[:20])
    write_mcap(path, packed)
    found, (told,) = read_rest(path)
    assert found == driven[:3] + driven[4:]
    assert "is damaged in its compression; left out" in told


def test_an_unknown_compression_costs_its_chunks(path: Path, driven: list[Message]) -> None:
    write_mcap(path, driven, compression=CompressionType.ZSTD)
    _, *chunks = chunks_of(path)
    for chunk in chunks:
        overwrite(path, path.read_bytes().index(b"zstd", chunk.chunk_start_offset), b"best")
    found, said = read_rest(path)
    assert found == driven[: len(found)]
    assert 0 < len(found) < len(driven)
    assert len(said) == min(len(chunks), 21)


def test_a_damaged_head_of_indexed_chunks_costs_nothing(path: Path, driven: list[Message]) -> None:
    write_mcap(path, driven, compression=PLAIN)
    place = chunks_of(path)[2].chunk_start_offset
    overwrite(path, place, b"\x05")  # no chunk any more
    said = f"chunk at byte {place} is damaged, but all of its 4 messages are found"
    assert read_rest(path) == (driven, [f"{path}: {said}"])


def test_a_file_without_messages_is_a_log_without_messages(path: Path) -> None:
    write_mcap(path, [])
    with open_log(path) as log:
        assert list(log.messages()) == []
        assert (log.topics(), log.damage) == ([], [])
        assert (log.contents.start_ns, log.contents.end_ns) == (0, 0)


def test_chunks_of_one_topic_each_are_joined_in_time_and_only_those_wanted_are_read(
    path: Path, driven: list[Message], monkeypatch: pytest.MonkeyPatch
) -> None:
    write_mcap(path, sorted(driven, key=lambda m: (m.topic, m.time_ns)))
    read: list[int] = []
    opened = McapFile._open_chunk

    def spy(file: McapFile, ref: ChunkRef) -> Unpacked:
        read.append(ref.offset)
        return opened(file, ref)

    monkeypatch.setattr(McapFile, "_open_chunk", spy)
    with open_log(path) as log:
        assert len(list(log.messages(["/tf_static"]))) == 1
        assert len(read) == 1
        assert [m.time_ns for m in log.messages()] == sorted(m.time_ns for m in driven)
        assert len(read) > 3


@pytest.mark.parametrize("indexed", [True, False])
@pytest.mark.parametrize(
    ("place", "value"),
    [(0, 0x77), (0, 0x06), (1, 0xF0), (8, 0x01), (9, 0x4D)],
    ids=["opcode", "other opcode", "length", "huge length", "channel"],
)
def test_a_damaged_record_in_a_chunk_without_checksum_is_told(
    path: Path, driven: list[Message], indexed: bool, place: int, value: int
) -> None:
    index = IndexType.ALL if indexed else IndexType.NONE
    write_mcap(path, driven, enable_crcs=False, compression=PLAIN, index_types=index)
    record = path.read_bytes().index(driven[50].data) - 31
    overwrite(path, record + place, bytes([value]))
    with open_log(path) as log:
        found = list(log.messages())
        assert len(found) + log.missing.total() >= len(driven)
        wrong = [m for m in found if m not in driven]
        assert wrong == found[50:51] * (place == 1 and value == 0xF0)
        assert len(log.damage) == (1 if indexed else 2)  # the place, and the numbers
        assert "is damaged" in log.damage[0]


WITHOUT_INDEX: list[dict[str, object]] = [
    {"use_chunking": False},
    {"index_types": IndexType.NONE},
    {"index_types": IndexType.NONE, "compression": CompressionType.LZ4},
]


@pytest.mark.parametrize("style", WITHOUT_INDEX)
def test_what_was_taken_out_of_a_file_without_index_is_counted(
    path: Path, driven: list[Message], style: dict[str, object]
) -> None:
    write_mcap(path, driven, **style)
    found = records(path.read_bytes())
    data = places_of(found, 6 if "index_types" in style else 5)
    del found[data[len(data) // 2]]
    rewrite(path, found)
    with open_log(path) as log:
        read = list(log.messages({"/scan", "/odom"}))
        lost = Counter(m.topic for m in driven) - Counter(m.topic for m in log.messages())
        assert log.missing == lost != {}
        (said,) = log.damage
        assert said.endswith(" of the index are not in the file")
        assert len(read) == len(driven) - 1 - lost.total()  # one is on /tf_static


def end_of_data_moved_up(path: Path) -> tuple[int, int]:
    """The last message or chunk and the end of the data change places; where they are now."""
    found = records(path.read_bytes())
    last = max(places_of(found, 5) + places_of(found, 6))
    (end,) = places_of(found, 0x0F)
    found[last], found[end] = found[end], found[last]
    rewrite(path, found)
    return 8 + sum(map(len, found[:end])), 8 + sum(map(len, found[:last]))


@pytest.mark.parametrize("style", WITHOUT_INDEX)
def test_what_stands_behind_the_end_of_the_data_is_read_and_told(
    path: Path, driven: list[Message], style: dict[str, object]
) -> None:
    write_mcap(path, driven, **style)
    behind, end = end_of_data_moved_up(path)
    said = f"the record at byte {behind} stands behind the end of the data at byte {end}"
    assert read_rest(path) == (driven, [f"{path}: {said}: it is read all the same"])
    whole = path.read_bytes()
    path.write_bytes(whole[: behind + 12])
    found, (cut,) = read_rest(path)
    assert len(found) < len(driven)
    assert cut.startswith(f"{path}: cut off in the index at byte {behind}: no message should")
    if "use_chunking" in style:
        path.write_bytes(whole)
        overwrite(path, behind, b"\x05" + b"\xff" * 8)  # a message longer than any file
        found, told = read_rest(path)
        assert len(found) == len(driven) - 1
        assert f"{path}: damaged in the index at byte {behind}: " in told[-1]


@pytest.mark.parametrize("checked", [True, False])
def test_a_chunk_in_another_place_is_told(path: Path, driven: list[Message], checked: bool) -> None:
    write_mcap(path, driven, enable_crcs=checked)
    end_of_data_moved_up(path)
    with open_log(path) as log:
        read = list(log.messages())
        assert 0 < log.missing.total() == len(driven) - len(read)
        assert log.damage


def test_a_second_file_behind_the_end_is_told(path: Path, driven: list[Message]) -> None:
    write_mcap(path, driven)
    size = path.stat().st_size
    path.write_bytes(path.read_bytes() * 2)
    said = f"{size:,} bytes follow the end of the file at byte {size}: what they hold is lost"
    assert read_rest(path) == (driven, [f"{path}: {said}"])


@pytest.mark.parametrize(
    ("schema", "encoding", "kind"),
    [
        ("foxglove.LaserScan", "protobuf", "foxglove.LaserScan (protobuf)"),
        (None, "", "unknown (no encoding)"),
    ],
)
def test_any_encoding_is_listed(path: Path, schema: str | None, encoding: str, kind: str) -> None:
    write_channel(path, schema, (encoding, encoding), (5, b"?"))
    with open_log(path) as log:
        assert log.topics() == [TopicInfo("/scan", kind, 1)]
