"""Every variety of a recording: whole, cut off, and damaged anywhere without a loss unsaid."""

import random
from collections import Counter
from pathlib import Path

import pytest
from mcap.writer import CompressionType, IndexType

from specmap_cli.core.errors import InputError, UsageError
from specmap_cli.core.settings import LogConfig
from specmap_cli.logs.opening import open_log
from specmap_cli.logs.readers.recording import Message, lost_text
from specmap_cli.logs.stream import SweepStream
from tests.logs.recordings import VARIETIES, change_db3, overwrite, read_rest, write_db3, write_mcap
from tests.strategies import MANY

PLACES = 300 if MANY else 30  # of a byte that is damaged, a file and kind of damage
PLAIN = CompressionType.NONE


def scans_read(path: Path) -> tuple[int, int, list[str]]:
    """The scans that `build` would get, those said to be missing, and everything that is said."""
    try:
        with open_log(path) as log:
            stream = SweepStream(log, LogConfig())
            found = sum(1 for _ in stream)
            return found, log.missing["/scan"] + stream.counts["unusable_scans"], stream.warnings
    except (InputError, UsageError) as error:
        return 0, 0, [str(error)]


def damage_everywhere(path: Path, scans: int) -> None:
    whole, rng = path.read_bytes(), random.Random(7)
    assert scans_read(path) == (scans, 0, [])
    damaged = path.with_name(f"damaged{path.suffix}")
    for number in range(PLACES):
        place = (number * len(whole) + rng.randrange(len(whole))) // PLACES
        for byte in (whole[place] ^ 1 << rng.randrange(8), rng.randrange(256)):
            damaged.write_bytes(whole[:place] + bytes([byte]) + whole[place + 1 :])
            found, missing, said = scans_read(damaged)
            case = f"byte {place} {whole[place]:#04x} -> {byte:#04x}: {found} scans, {said}"
            assert said or found + missing >= scans, case
            assert found <= scans, case
            assert all("\n" not in line for line in said), case


@pytest.fixture
def few(driven: list[Message]) -> list[Message]:
    """A third of the drive: ten scans."""
    return driven[:31]


@pytest.mark.parametrize("name", VARIETIES)
def test_a_byte_of_a_recording(path: Path, few: list[Message], name: str) -> None:
    VARIETIES[name](path, few)
    damage_everywhere(path, 10)


def test_a_byte_of_a_carmen_log(path: Path) -> None:
    ranges = " ".join(f"{2 + n / 7:.2f}" for n in range(20))
    path.write_text(
        "".join(
            f"ODOM {n / 10} 0.0 0.1 0 0 0 {n}.1 host {n}.1\n"
            f"FLASER 20 {ranges} {n / 10} 0.0 0.1 {n / 10} 0.0 0.1 {n}.2 host {n}.2\n"
            for n in range(1, 11)
        )
    )
    damage_everywhere(path, 10)


@pytest.mark.parametrize("listed", [True, False])
def test_a_message_on_another_topic_is_missed(path: Path, few: list[Message], listed: bool) -> None:
    index = IndexType.ALL if listed else IndexType.CHUNK
    write_mcap(path, few, compression=PLAIN, enable_crcs=False, index_types=index)
    data = path.read_bytes()
    scan = next(m for m in few[11:] if m.topic == "/scan")
    other = data.index(next(m for m in few if m.topic == "/odom").data)
    # 22 bytes before a message is its channel.
    overwrite(path, data.index(scan.data) - 22, data[other - 22 : other - 21])
    with open_log(path) as log:
        list(log.messages())
        (line,) = log.damage
        assert log.missing == {"/scan": 1}
    if listed:
        assert "chunk at byte " in line
        assert " messages on /scan, between 100." in line
    else:
        assert line == f"{path}: 1 of 10 messages on /scan of the index are not in the file"


def test_rows_of_a_database_that_are_gone_are_counted(tmp_path: Path, few: list[Message]) -> None:
    path = tmp_path / "log.db3"
    write_db3(path, few)
    change_db3(path, "DELETE FROM messages WHERE id IN (4, 9)")
    (tmp_path / "metadata.yaml").write_text(
        "rosbag2_bagfile_information:\n  message_count: 99\n  files:\n    - path: other.db3\n"
        "      message_count: 7\n    - path: log.db3\n      message_count: 33\n"
    )
    with open_log(path) as log:
        assert len(list(log.messages())) == 29
        assert log.damage == [
            f"{path}: 4 of 33 messages are not in its table: the numbers of the messages, the "
            "index or metadata.yaml tell of them"
        ]


UNLESS = "unless it was renamed, "


@pytest.mark.parametrize(
    ("there", "counts", "said"),
    [
        ("a b c", "12 7 13", {}),
        ("a b", "12 7 13", {"c": "its 13 messages"}),
        ("a c.gz", "12 7 13", {"b": "its 7 messages"}),
        ("a b other", "12 7 12", {}),
        ("b other", "13 7 1", {"a": UNLESS + "its 13 messages", "c": UNLESS + "its 1 message"}),
        ("b c", "", {"a": "its messages"}),
        ("b c", "0 7 12", {}),
        ("b c", "-1 7 12", {"a": "its messages"}),
    ],
)
def test_files_that_are_named_and_missing_are_told(
    tmp_path: Path, few: list[Message], there: str, counts: str, said: dict[str, str]
) -> None:
    """A renamed file has the messages that the metadata counts; without a count, or empty, none."""
    bag = tmp_path / "bag"
    bag.mkdir()
    (bag / "c").touch()
    for name, part in zip(there.split(), (few[:12], few[12:19], few[19:]), strict=False):
        write_mcap(bag / name, part)
    files = [
        f"    - {{path: {name}, message_count: {count}}}"
        for name, count in zip("abc", counts.split(), strict=False)
    ]
    told = ["rosbag2_bagfile_information:", "  relative_file_paths: [bag/a, bag/b, bag/c]"]
    told += ["  files:", *files] if files else []
    (bag / "metadata.yaml").write_text("\n".join(told))
    with open_log(bag) as log:
        assert log.damage == [
            f"{bag}: {name}, which metadata.yaml names, is missing or no recording: {what} "
            "cannot be read"
            for name, what in said.items()
        ]
        assert SweepStream(log, LogConfig()).warnings[: len(said)] == log.damage


@pytest.mark.parametrize(
    ("lost", "of", "said"),
    [
        ({"/scan": 1}, None, "1 message on /scan"),
        ({"/scan": 1}, {"/scan": 5}, "1 of 5 messages on /scan"),
        ({"/scan": 2000, "/odom": 1}, None, "1 message on /odom and 2,000 on /scan"),
        ({"/b": 2, "/a": 3}, {"/a": 3, "/b": 3}, "3 of 3 messages on /a and 2 of 3 on /b"),
        ({"/c": 1, "/b": 2, "/a": 3}, None, "3 messages on /a, 2 on /b and 1 on /c"),
    ],
)
def test_losses_in_words(lost: dict[str, int], of: dict[str, int] | None, said: str) -> None:
    assert lost_text(lost, of) == said


FORMATS = {"mcap": "MCAP", "bag": "ROS 1 bag", "db3": "rosbag2 (SQLite)"}
CHUNKED = [name for name in VARIETIES if not name.startswith("db3")]


@pytest.mark.parametrize("name", VARIETIES)
def test_every_variety_has_the_same_messages(path: Path, driven: list[Message], name: str) -> None:
    """Also where the file's name says something else."""
    VARIETIES[name](path, driven)
    odometry, scans = ([m for m in driven if m.topic == t] for t in ("/odom", "/scan"))
    with open_log(path) as log:
        assert log.format == FORMATS[name.split()[0]]
        assert list(log.messages()) == driven
        assert {t.name: t.count for t in log.topics()} == Counter(m.topic for m in driven)
        assert log.contents.start_ns == driven[0].time_ns
        assert log.contents.end_ns == max(m.time_ns for m in driven)
        assert list(log.messages(["/odom"])) == odometry
        assert list(log.messages(["/scan"])) == scans
        assert all(a == b for a, b in zip(log.messages(), log.messages(), strict=True))
        at_once = zip(log.messages(["/scan"]), log.messages(["/odom"]), strict=False)
        assert list(at_once) == list(zip(scans, odometry, strict=False))
        assert log.damage == []


@pytest.mark.parametrize("name", CHUNKED)
def test_what_precedes_a_cut_is_read(path: Path, driven: list[Message], name: str) -> None:
    """And one line says what was lost."""
    VARIETIES[name](path, driven)
    whole = path.read_bytes()
    counts: list[int] = []
    for tenth in range(10):
        path.write_bytes(whole[: len(whole) * tenth // 10 + 3])
        found, (said,) = read_rest(path)
        assert str(path) in said
        assert found == driven[: len(found)]
        counts.append(len(found))
    assert counts == sorted(counts)
    assert counts[-1] > 0.5 * len(driven)


@pytest.mark.parametrize("name", CHUNKED)
def test_random_damage_is_survived(path: Path, driven: list[Message], name: str) -> None:
    VARIETIES[name](path, driven[:20])
    whole, head = path.read_bytes(), 8 if name.startswith("mcap") else 13
    for seed in range(25):
        data, rng = bytearray(whole), random.Random(seed)
        for _ in range(rng.randrange(1, 40)):
            data[rng.randrange(head, len(data))] = rng.randrange(256)
        path.write_bytes(data)
        found, said = read_rest(path)
        assert len(found) <= 20
        assert all(str(path) in line and "\n" not in line for line in said)
