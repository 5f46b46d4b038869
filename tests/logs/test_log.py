"""Recordings joined to one log."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.logs import Log, Message, TopicInfo
from specmap_cli.logs.readers import survey
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


@given(st.lists(st.lists(st.integers(1, 99)), min_size=1, max_size=4))
def test_its_contents_are_those_of_its_messages(times: list[list[int]]) -> None:
    parts = [listed(str(n), at(*part, topic=f"/{n % 2}")) for n, part in enumerate(times)]
    log = Log(parts, [Path("log")])
    assert log.contents == survey((m.topic, m.type, m.time_ns) for m in log.messages())


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
