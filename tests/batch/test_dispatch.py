"""Which job is handed out when, with workers that do as they are told; and the events of it."""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Callable

import jsonschema
import pytest

from specmap_cli.batch.batch import longest_first, work_off
from specmap_cli.batch.ledger import EventRecord, Ledger
from specmap_cli.batch.records import JobRecord, JobResult, Turn
from specmap_cli.batch.workers import Workers
from specmap_cli.core.schemas import read_schema
from tests.batch.results import failed, job, result

Answer = Callable[[Turn], JobRecord | None]
ENDS = ("done", "failed")


class Obedient(Workers):
    """Workers that finish jobs in the order in which they got them."""

    def __init__(self, answer: Answer, slots: int = 2) -> None:
        self.answer = answer
        self.most = self.free = slots
        self.running: deque[Turn] = deque()
        self.got: list[tuple[str, int, bool]] = []
        self.largest = 0

    def slots(self) -> int:
        return self.free

    def alone_mb(self) -> int:
        return 1000 * self.most

    def submit(self, turn: Turn) -> None:
        self.running.append(turn)
        self.got.append((turn.job.name, turn.attempt, turn.alone))
        self.largest = max(self.largest, len(self.running))
        assert not (turn.alone and len(self.running) > 1)

    def next_result(self) -> tuple[Turn, JobResult | None] | None:
        if not self.running:
            self.free = self.most
            return None
        turn = self.running.popleft()
        record = self.answer(turn)
        return turn, None if record is None else JobResult(record)


def ledger_of(names: str) -> Ledger:
    return Ledger([job(name) for name in names], dict.fromkeys(names, 1))


def happenings(names: str, workers: Obedient, retries: int = 1) -> list[EventRecord | None]:
    """What happens; every job is done or failed in the end, and once."""
    ledger = ledger_of(names)
    happened = list(work_off(ledger.jobs, workers, retries, ledger))
    ends = [one for one in happened if one is not None and one.event in ENDS]
    assert sorted(str(one.job) for one in ends) == sorted(names)
    assert workers.largest <= workers.most
    return happened


def states(happened: list[EventRecord | None]) -> dict[str | None, str]:
    """How each job ended."""
    return {one.job: one.event for one in happened if one is not None and one.event in ENDS}


def test_a_bad_log_is_not_tried_again_and_stops_no_other() -> None:
    workers = Obedient(lambda turn: (failed if turn.job.name == "b" else result)(turn.job.name))
    assert states(happenings("abc", workers)) == {"a": "done", "b": "failed", "c": "done"}
    assert [name for name, *_ in workers.got] == ["a", "b", "c"]
    assert workers.largest == 2
    ordered = longest_first([job(name) for name in "dbca"], {"a": 5, "b": 7, "c": 7, "d": 1})
    assert "".join(one.name for one in ordered) == "bcad", "names decide among equals"


@pytest.mark.parametrize(("retries", "attempts"), [(0, 1), (1, 2), (3, 4)])
def test_a_lost_worker_is_forgiven_so_often(retries: int, attempts: int) -> None:
    workers = Obedient(lambda turn: failed("a", "worker", attempts=turn.attempt))
    happened = happenings("a", workers, retries)
    assert workers.got == [("a", attempt, False) for attempt in range(1, attempts + 1)]
    assert sum(one is not None and one.event == "retried" for one in happened) == retries
    assert states(happened) == {"a": "failed"}


def test_want_of_memory_is_tried_again_at_the_end_and_alone() -> None:
    def answer(turn: Turn) -> JobRecord:
        small = turn.job.name in "bc" and not turn.alone
        return failed(turn.job.name, "memory") if small else result(turn.job.name)

    workers = Obedient(answer)
    assert states(happenings("abcd", workers, retries=0)) == dict.fromkeys("abcd", "done")
    assert workers.got[-2:] == [("b", 2, True), ("c", 2, True)]


@pytest.mark.parametrize(
    ("slots", "got"),
    [(2, [("a", 1, False), ("a", 2, True)]), (1, [("a", 1, False)])],  # one has no more alone
)
def test_a_job_that_wants_more_than_all_have_fails(
    slots: int, got: list[tuple[str, int, bool]]
) -> None:
    workers = Obedient(lambda _: failed("a", "memory"), slots)
    assert states(happenings("a", workers, retries=5)) == {"a": "failed"}
    assert workers.got == got


def test_what_the_scheduler_forgot_is_handed_out_again_as_the_same_attempt() -> None:
    forgotten = iter([None, None])
    workers = Obedient(lambda turn: next(forgotten, result(turn.job.name)))
    workers.free = 0  # jobs wait while no worker is there
    happened = happenings("ab", workers, retries=0)
    assert happened[0] is None
    assert states(happened) == {"a": "done", "b": "done"}
    assert sorted(workers.got) == [("a", 1, False)] * 2 + [("b", 1, False)] * 2


def test_events_say_what_happened_in_order_as_their_schema_says() -> None:
    ledger = ledger_of("abc")
    heard = [
        ledger.event("began"),
        ledger.started(Turn(job("b"))),
        ledger.retried(failed("b", "worker", attempts=1)),
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
