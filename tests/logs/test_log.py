"""What all recordings share, and several joined to one log: surveys, damage, order in time."""

import heapq
from collections import Counter
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.logs import Log, Message, TopicInfo
from specmap_cli.logs.readers.recording import merge_in_time
from tests.logs.recordings import Told


class Other(Told):
    format = "another"


def listed(name: str, messages: list[Message], kind: type[Told] = Told) -> Told:
    return kind(name, lambda: messages)


def at(*times: int, topic: str = "/a", kind: str = "T") -> list[Message]:
    return [Message(topic, kind, time, b"") for time in times]


def test_files_come_in_the_order_of_their_first_messages() -> None:
    parts = [listed("b", at(5, 9)), listed("c", at(1, 2), Other), listed("a", at(5, 6))]
    log = Log(parts, [Path("folder"), Path("c"), Path("d")])
    assert [path.name for path in log.paths] == ["c", "a", "b"]
    assert [m.time_ns for m in log.messages()] == [1, 2, 5, 5, 6, 9]
    assert log.format == "another + list"
    assert log.name == "folder and 2 more"
    assert Log(parts[:1], [Path("b")]).name == "b"
    assert Log(parts[:1], [Path("b")]).format == "list"


def test_files_that_hold_a_topic_at_the_same_time_are_found() -> None:
    parts = [
        listed("a", at(1, 9)),
        listed("b", at(2, 4)),
        listed("other", at(1, 9, topic="/b")),
        listed("c", at(7, 12)),
        listed("d", at(12, 20)),
        listed("empty", []),
    ]
    found = list(Log(parts, [Path("folder")]).side_by_side("/a"))
    assert found == [(Path("a"), Path("b"), 2), (Path("a"), Path("c"), 2)]
    assert list(Log(parts, [Path("folder")]).side_by_side("/b")) == []


def test_a_topic_with_two_types_is_listed_for_each_and_only_those_wanted_are_read() -> None:
    parts = [listed("a", at(1)), listed("b", at(2, 3, kind="U")), listed("c", at(2, topic="/b"))]
    log = Log(parts, [Path("a")])
    expected = [TopicInfo("/a", "T", 1), TopicInfo("/a", "U", 2), TopicInfo("/b", "T", 1)]
    assert log.topics() == expected
    assert [m.time_ns for m in log.messages(["/b"])] == [2]
    assert list(log.messages([])) == []


def test_damage_is_told_file_by_file_as_it_is_met() -> None:
    late, early = listed("late", at(7)), listed("early", at(1))
    log = Log([late, early], [Path("a")])
    assert log.damage == []
    late.report("cut off")
    early.report("a chunk is lost")
    assert log.damage == ["early: a chunk is lost", "late: cut off"]


def test_a_block_releases_the_files_once() -> None:
    parts = [listed("a", at(1)), listed("b", at(2))]
    with pytest.raises(KeyError), Log(parts, [Path("a")]) as log:
        raise KeyError
    log.close()
    assert [part.closed for part in parts] == [1, 1]


entries = st.lists(
    st.tuples(st.sampled_from("abc"), st.sampled_from("XY"), st.integers(-(10**18), 10**18))
)


def test_damage_is_noted_once_under_the_name_the_user_gave_and_not_line_by_line() -> None:
    recording = Told("/tmp/unpacked", lambda: [], Path("log.gz"))
    for what in ("the end is lost", "a chunk is lost", "the end is lost"):
        recording.report(what)
    assert recording.damage == ("log.gz: the end is lost", "log.gz: a chunk is lost")
    recording = listed("log", [])
    for number in range(50):
        recording.report(f"message {number} is lost")
    assert len(recording.damage) == 21
    assert recording.damage[19] == "log: message 19 is lost"
    assert recording.damage[20] == "log: damaged at 30 more places"


@given(st.lists(entries, min_size=1, max_size=4))
def test_contents_count_the_messages_of_all_parts(parts: list[list[tuple[str, str, int]]]) -> None:
    messages = [[Message(*entry, b"") for entry in part] for part in parts]
    log = Log([listed(str(n), part) for n, part in enumerate(messages)], [Path("log")])
    found = [entry for part in parts for entry in part]
    times = [time for _, _, time in found]
    counted = Counter((topic, kind) for topic, kind, _ in found)
    contents = log.contents
    assert {(t.name, t.type): t.count for t in contents.topics} == counted
    assert [(t.name, t.type) for t in contents.topics] == sorted(counted)
    assert contents.messages == len(found)
    assert (contents.start_ns, contents.end_ns) == (min(times, default=0), max(times, default=0))


@given(st.lists(st.lists(st.integers(0, 50), min_size=1), max_size=6))
def test_sources_in_order_are_merged_in_order(times: list[list[int]]) -> None:
    sources = [at(*sorted(part), topic=str(n)) for n, part in enumerate(times)]
    merged = list(merge_in_time([(s[0].time_ns, partial(iter, s)) for s in sources]))
    expected = heapq.merge(*sources, key=lambda m: m.time_ns)
    assert [m.time_ns for m in merged] == [m.time_ns for m in expected]
    for source in sources:
        assert [m for m in merged if m.topic == source[0].topic] == source


def test_a_source_is_opened_only_when_its_start_has_come() -> None:
    opened: list[int] = []

    def source(start: int) -> Iterator[Message]:
        opened.append(start)
        yield from at(start, start + 5)

    merged = merge_in_time([(start, partial(source, start)) for start in (20, 0, 3)])
    seen = [(found.time_ns, len(opened)) for found in merged]
    assert seen == [(0, 1), (3, 2), (5, 2), (8, 2), (20, 3), (25, 3)]
    assert opened == [0, 3, 20]
