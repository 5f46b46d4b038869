"""What all readers share: the notes on damage, the survey, the joining in time."""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.logs.readers import Contents, Message, Recording, survey
from specmap_cli.logs.readers.recording import merge_in_time

entries = st.lists(
    st.tuples(st.sampled_from("abc"), st.sampled_from("XY"), st.integers(-(10**18), 10**18))
)


class Empty(Recording):
    """A recording without messages."""

    format = "empty"
    contents = Contents((), 0, 0)

    def messages(self, topics: Collection[str] | None = None) -> Iterator[Message]:  # noqa: ARG002
        return iter(())

    def close(self) -> None:
        """Nothing to release."""


def test_damage_is_noted_once_under_the_name_the_user_gave_and_not_line_by_line() -> None:
    recording = Empty(Path("/tmp/unpacked"), Path("log.gz"))
    for what in ("the end is lost", "a chunk is lost", "the end is lost"):
        recording.report(what)
    assert recording.damage == ("log.gz: the end is lost", "log.gz: a chunk is lost")
    recording = Empty(Path("log"))
    assert recording.path == Path("log")
    for number in range(50):
        recording.report(f"message {number} is lost")
    assert len(recording.damage) == 21
    assert recording.damage[19] == "log: message 19 is lost"
    assert recording.damage[20] == "log: damaged at 30 more places"


@given(entries)
def test_a_survey_counts_every_message(found: list[tuple[str, str, int]]) -> None:
    contents = survey(iter(found))
    times = [time for _, _, time in found]
    counted = Counter((topic, kind) for topic, kind, _ in found)
    assert {(t.name, t.type): t.count for t in contents.topics} == counted
    assert [(t.name, t.type) for t in contents.topics] == sorted(counted)
    assert contents.messages == len(found)
    assert (contents.start_ns, contents.end_ns) == (min(times, default=0), max(times, default=0))


def message(time_ns: int, topic: str = "/a") -> Message:
    return Message(topic, "T", time_ns, b"")


def opener(messages: list[Message]) -> Callable[[], Iterator[Message]]:
    return lambda: iter(messages)


@given(st.lists(st.lists(st.integers(0, 50), min_size=1), max_size=6))
def test_sources_in_order_are_merged_in_order(times: list[list[int]]) -> None:
    sources = [[message(t, str(n)) for t in sorted(part)] for n, part in enumerate(times)]
    merged = list(merge_in_time([(s[0].time_ns, opener(s)) for s in sources]))
    expected = heapq.merge(*sources, key=lambda m: m.time_ns)
    assert [m.time_ns for m in merged] == [m.time_ns for m in expected]
    for source in sources:
        assert [m for m in merged if m.topic == source[0].topic] == source


def test_a_source_that_runs_backwards_keeps_its_own_order() -> None:
    back = [message(t, "back") for t in (10, 4, 12)]
    forth = [message(t, "forth") for t in (3, 11, 13)]
    merged = list(merge_in_time([(10, opener(back)), (3, opener(forth))]))
    assert [m.time_ns for m in merged] == [3, 10, 4, 11, 12, 13]


def test_a_source_is_opened_only_when_its_start_has_come() -> None:
    opened: list[int] = []

    def source(start: int) -> Iterator[Message]:
        opened.append(start)
        yield message(start)
        yield message(start + 5)

    merged = merge_in_time([(s, lambda s=s: source(s)) for s in (20, 0, 3)])  # type: ignore[misc]
    seen = [(found.time_ns, len(opened)) for found in merged]
    assert seen == [(0, 1), (3, 2), (5, 2), (8, 2), (20, 3), (25, 3)]
    assert opened == [0, 3, 20]
