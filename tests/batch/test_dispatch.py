"""Which job is handed out when, with workers that do as they are told; and the events of it."""

import json
from collections import deque
from collections.abc import Iterable

import jsonschema
import pytest

from specmap_cli.batch.batch import Ledger, work_off
from specmap_cli.batch.records import JobResult, Turn
from specmap_cli.batch.workers import Workers
from specmap_cli.core.schemas import read_schema
from tests.batch.results import failed, job, result

Ends = dict[str, list[str | None]]


class Obedient(Workers):
    """Workers that finish jobs in the order in which they got them, each attempt as told.

    It is done, fails for a reason of some kind, or is forgotten (None).
    """

    def __init__(self, ends: Ends, slots: int) -> None:
        self.ends = {name: list(told) for name, told in ends.items()}
        self.most, self.free = slots, 0  # jobs wait while no worker is there
        self.running: deque[Turn] = deque()
        self.got: list[str] = []
        self.largest = 0

    def slots(self) -> int:
        return self.free

    def alone_mb(self) -> int:
        return 1000 * self.most

    def submit(self, turn: Turn) -> None:
        self.running.append(turn)
        self.got.append(f"{turn.job.name}{turn.attempt}{' alone' * turn.alone}")
        self.largest = max(self.largest, len(self.running))
        assert not (turn.alone and len(self.running) > 1)

    def next_result(self) -> tuple[Turn, JobResult | None] | None:
        if not self.running:
            self.free = self.most
            return None
        turn = self.running.popleft()
        name, told = turn.job.name, self.ends[turn.job.name].pop(0)
        if told is None:
            return turn, None
        record = result(name) if told == "done" else failed(name, told)
        return turn, JobResult(record.model_copy(update={"attempts": turn.attempt}))


def ledger_of(names: Iterable[str]) -> Ledger:
    return Ledger([job(name) for name in names], dict.fromkeys(names, 1))


@pytest.mark.parametrize(
    ("ends", "slots", "retries", "got"),
    [
        # a bad log is not tried again, and stops no other
        ({"a": ["done"], "b": ["log"], "c": ["done"]}, 2, 1, ["a1", "b1", "c1"]),
        # a lost worker is forgiven so often
        ({"a": ["worker"]}, 2, 0, ["a1"]),
        ({"a": ["worker", "worker"]}, 2, 1, ["a1", "a2"]),
        ({"a": ["worker"] * 4}, 2, 3, ["a1", "a2", "a3", "a4"]),
        # want of memory is tried again at the end and alone
        (
            {"a": ["done"], "b": ["memory", "done"], "c": ["memory", "done"], "d": ["done"]},
            *(2, 0, ["a1", "b1", "c1", "d1", "b2 alone", "c2 alone"]),
        ),
        ({"a": ["memory", "memory"]}, 2, 5, ["a1", "a2 alone"]),  # more than all have
        ({"a": ["memory"]}, 1, 5, ["a1"]),  # one worker has no more alone
        # what the scheduler forgot is handed out again as the same attempt
        ({"a": [None, "done"], "b": [None, "done"]}, 2, 0, ["a1", "b1", "a1", "b1"]),
    ],
)
def test_jobs_are_tried_again_or_not(ends: Ends, slots: int, retries: int, got: list[str]) -> None:
    ledger, workers = ledger_of(ends), Obedient(ends, slots)
    happened = list(work_off(workers, retries, ledger))
    assert happened[0] is None, "nobody is there yet"
    assert workers.got == got
    assert workers.largest == min(slots, len(ends))
    events = [(one.job, one.event) for one in happened if one is not None]
    ended = [each for each in events if each[1] in ("done", "failed")]
    lasts = {name: "done" if told[-1] == "done" else "failed" for name, told in ends.items()}
    assert sorted(ended) == list(lasts.items())
    again = [turn for turn in got if turn[1] != "1"]
    assert len([event for _, event in events if event == "retried"]) == len(again)


def test_long_jobs_are_first_and_names_decide_among_equals() -> None:
    ledger = Ledger([job(name) for name in "dbca"], {"a": 5, "b": 7, "c": 7, "d": 1})
    assert "".join(one.name for one in ledger.jobs) == "bcad"


def test_events_say_what_happened_in_order_as_their_schema_says() -> None:
    ledger = ledger_of("abc")
    heard = [
        ledger.event("began"),
        ledger.event("started", "b", attempt=1),
        ledger.ended("retried", failed("b", "worker", attempts=1)),
        ledger.finished(JobResult(result("a"))),
        ledger.finished(JobResult(result("c"), resumed=True)),
        *(ledger.waits(slots) for slots in (2, 0, 0, 1, 0)),
        ledger.finished(JobResult(failed("b", attempts=2))),
        ledger.event("ended"),
    ]
    told = [one for one in heard if one is not None]
    for one in told:
        jsonschema.validate(json.loads(one.line()), read_schema("batch"))
        assert one.line().count("\n") == 1
    assert [(one.event, one.job, one.attempt, one.done, one.failed) for one in told] == [
        ("began", None, None, 0, 0),
        ("started", "b", 1, 0, 0),
        ("retried", "b", 1, 0, 0),
        ("done", "a", 1, 1, 0),
        ("resumed", "c", 1, 2, 0),
        *[("stranded", None, None, 2, 0)] * 2,
        ("failed", "b", 2, 2, 1),
        ("ended", None, None, 2, 1),
    ]
    assert ledger.resumed == 1
