"""Which job is handed out when, with workers that do as they are told."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import pytest

from specmap_cli.batch import dispatch
from specmap_cli.batch.dispatch import Finished, Happening, Quiet, Retried, Started, Turn
from specmap_cli.batch.records import JobResult
from tests.batch.results import failed, job, result

Answer = Callable[[Turn], JobResult | None]


class Obedient:
    """Workers that finish jobs in the order in which they got them."""

    def __init__(self, answer: Answer, slots: int = 2) -> None:
        self.answer = answer
        self.most = self.free = slots
        self.running: deque[Turn] = deque()
        self.got: list[tuple[str, int, bool]] = []
        self.largest = 0

    def slots(self) -> int:
        return self.free

    def alone_mb(self) -> float:
        return 1000.0 * self.most

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
        return turn, self.answer(turn)


def happenings(names: str, crew: Obedient, retries: int = 1) -> list[Happening]:
    return list(dispatch.worked_off([job(name) for name in names], crew, retries))


def finished(happened: list[Happening]) -> dict[str, str]:
    return {one.result.name: one.result.state for one in happened if isinstance(one, Finished)}


def test_long_logs_come_first_and_names_decide_among_equals() -> None:
    jobs = [job(name) for name in "dbca"]
    ordered = dispatch.longest_first(jobs, {"a": 5, "b": 7, "c": 7, "d": 1})
    assert "".join(one.name for one in ordered) == "bcad"


def test_every_job_is_started_and_finished_once_and_never_more_run_than_there_are_workers() -> None:
    crew = Obedient(lambda turn: result(turn.job.name))
    happened = happenings("abcdef", crew)
    assert finished(happened) == dict.fromkeys("abcdef", "done")
    assert [one.turn.job.name for one in happened if isinstance(one, Started)] == list("abcdef")
    assert crew.largest == 2


def test_a_bad_log_is_not_tried_again_and_stops_no_other() -> None:
    crew = Obedient(lambda turn: failed("b") if turn.job.name == "b" else result(turn.job.name))
    assert finished(happenings("abc", crew)) == {"a": "done", "b": "failed", "c": "done"}
    assert [name for name, *_ in crew.got] == ["a", "b", "c"]


@pytest.mark.parametrize(("retries", "attempts"), [(0, 1), (1, 2), (3, 4)])
def test_a_lost_worker_is_forgiven_so_often(retries: int, attempts: int) -> None:
    crew = Obedient(lambda turn: failed("a", "worker", attempts=turn.attempt))
    happened = happenings("a", crew, retries)
    assert crew.got == [("a", attempt, False) for attempt in range(1, attempts + 1)]
    assert sum(isinstance(one, Retried) for one in happened) == retries
    assert finished(happened) == {"a": "failed"}


def test_want_of_memory_is_tried_again_at_the_end_and_alone() -> None:
    def answer(turn: Turn) -> JobResult:
        small = turn.job.name in "bc" and not turn.alone
        return failed(turn.job.name, "memory") if small else result(turn.job.name)

    crew = Obedient(answer)
    assert finished(happenings("abcd", crew, retries=0)) == dict.fromkeys("abcd", "done")
    assert crew.got[-2:] == [("b", 2, True), ("c", 2, True)]


def test_a_job_that_wants_more_than_all_have_fails() -> None:
    crew = Obedient(lambda _: failed("a", "memory"))
    assert finished(happenings("a", crew, retries=5)) == {"a": "failed"}
    assert crew.got == [("a", 1, False), ("a", 2, True)]


def test_one_worker_has_no_more_memory_alone() -> None:
    crew = Obedient(lambda _: failed("a", "memory"), slots=1)
    assert finished(happenings("a", crew)) == {"a": "failed"}
    assert crew.got == [("a", 1, False)]


def test_what_the_scheduler_forgot_is_handed_out_again_as_the_same_attempt() -> None:
    forgotten = iter([None, None])
    crew = Obedient(lambda turn: next(forgotten, result(turn.job.name)))
    assert finished(happenings("ab", crew, retries=0)) == {"a": "done", "b": "done"}
    assert sorted(crew.got) == [("a", 1, False)] * 2 + [("b", 1, False)] * 2


def test_jobs_wait_while_no_worker_is_there() -> None:
    crew = Obedient(lambda turn: result(turn.job.name))
    crew.free = 0
    happened = happenings("a", crew)
    assert isinstance(happened[0], Quiet)
    assert finished(happened) == {"a": "done"}
