"""The fuzzer: some of its cases and pairs pass, and it notices every kind of failure."""

import os
import signal
import tempfile
import time
from collections.abc import Callable, Collection, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest

import fuzz.__main__
from fuzz.__main__ import main
from fuzz.cases import KEEPERS, LogCase, MapCase, case_of
from fuzz.judging import Failure, check_run, judge, map_commands
from fuzz.map_changes import write_map
from fuzz.pairs import Bench, try_pair
from fuzz.report import Tally
from fuzz.running import run_command
from fuzz.seeds import Seeds, make_seeds, write_intact
from fuzz.workers import Limits, Outcome, Pool, _Worker
from specmap_cli.logs.readers.chunked import ChunkedFile
from specmap_cli.logs.readers.recording import Message
from specmap_cli.maps.store import Map
from tests.flats import Mapped

SEED, CASES = 2026, 60
CHUNKED = range(0, 40)  # cases of which most are MCAP files or bags

_intact = ChunkedFile.messages


@pytest.fixture(scope="module")
def seeds() -> Seeds:
    return make_seeds()


def outcomes(
    seeds: Seeds, numbers: Collection[int], limits: Limits | None = None, jobs: int = 2
) -> list[Outcome]:
    return list(Pool(seeds, SEED, limits or Limits(), jobs).run(numbers))


def kinds(found: list[Outcome]) -> set[str]:
    return {failure.kind for outcome in found for failure in outcome.failures}


def first_chunked(seeds: Seeds) -> int:
    """The number of a case whose log is read as a sequence of chunks, with messages in it."""
    cases = ((number, case_of(seeds, SEED, number)) for number in CHUNKED)
    return next(number for number, case in cases if case.name.startswith("mcap-zstd"))


def test_cases_pass(seeds: Seeds) -> None:
    found = outcomes(seeds, range(CASES))
    failed = {
        f"python -m fuzz --seed {SEED} --case {outcome.number}": outcome.failures
        for outcome in found
        if outcome.failures
    }
    assert sorted(outcome.number for outcome in found) == list(range(CASES))
    assert failed == {}


def plant(monkeypatch: pytest.MonkeyPatch, deed: Callable[[], object] | None) -> None:
    """A reader of chunked files does something bad at the fifth scan of a reading, or drops it."""

    def messages(self: ChunkedFile, topics: Collection[str] | None = None) -> Iterator[Message]:
        scans = 0
        for message in _intact(self, topics):
            scans += message.topic == "/scan"
            if scans == 5 and message.topic == "/scan":
                if deed is None:
                    continue
                deed()
            yield message

    monkeypatch.setattr(ChunkedFile, "messages", messages)


def crash() -> None:
    os.kill(os.getpid(), signal.SIGSEGV)


@pytest.mark.parametrize(
    ("deed", "kind", "what"),
    [
        (None, "silent loss", "scans"),
        (lambda: int("planted"), "traceback", "ValueError at logs/readers/"),
        (lambda: time.sleep(60), "hang", "more than 1 s"),
        (lambda: bytearray(2 << 30), "memory", ""),
        (crash, "died", "SIGSEGV"),
        (lambda: os.write(2, b"a library speaks\n"), "error line", "a library speaks"),
        (tempfile.mkstemp, "half-written", "left behind: tmp"),
    ],
    ids=["drop", "raise", "sleep", "eat", "crash", "write", "leave"],
)
def test_a_planted_fault_is_noticed(
    seeds: Seeds,
    monkeypatch: pytest.MonkeyPatch,
    deed: Callable[[], object] | None,
    kind: str,
    what: str,
) -> None:
    number = first_chunked(seeds)
    limits = Limits(time_s=1.0) if kind == "hang" else Limits()
    assert kind not in kinds(outcomes(seeds, [number], limits))
    plant(monkeypatch, deed)
    after = outcomes(seeds, [number], limits)
    assert kind in kinds(after)
    said = [failure.what for failure in after[0].failures if failure.kind == kind]
    assert any(what in text for text in said), said


def test_the_time_in_which_others_have_the_processor_is_no_hang() -> None:
    """On a busy machine cases failed of which each takes less than a second."""
    worker = _Worker(Mock(pid=os.getpid()), Mock())
    worker.give(0)
    assert not worker.hangs(20.0)
    worker.since_s -= 30.0
    assert worker.hangs(20.0)
    worker.before_s -= 25.0
    assert not worker.hangs(20.0)


def test_a_worker_that_dies_is_replaced(seeds: Seeds, monkeypatch: pytest.MonkeyPatch) -> None:
    plant(monkeypatch, crash)
    numbers = CHUNKED[:20]
    found = outcomes(seeds, numbers, jobs=1)
    assert sorted(outcome.number for outcome in found) == list(numbers)
    assert 1 < len([outcome for outcome in found if "died" in kinds([outcome])]) < len(numbers)


def test_a_case_is_the_same_every_time(seeds: Seeds) -> None:
    again = make_seeds()
    for number in range(25):
        one, other = case_of(seeds, SEED, number), case_of(again, SEED, number)
        if isinstance(one, LogCase):
            assert one == other
        else:
            assert one.notes == other.notes
    assert case_of(seeds, SEED, 3) != case_of(seeds, SEED + 1, 3)


def test_intact_inputs_pass(seeds: Seeds, tmp_path: Path) -> None:
    """What fails is the damage, never the intact file: the fuzzer cries no wolf."""
    whole: dict[str, Any] = {"number": 0, "notes": (), "excused": 0, "must_tell": False}
    whole |= {"build": False, "convert": True}
    for (variant, drive), data in seeds.files.items():
        stamps = seeds.drives[drive].stamps_ns
        case = LogCase(name=f"{variant} {drive}", data=data, stamps_ns=stamps, **whole)
        folder = tmp_path / case.name
        folder.mkdir()
        assert judge(case, folder, (), tmp_path / "none") == [], case.name


def test_an_intact_map_passes(seeds: Seeds, tmp_path: Path) -> None:
    """All commands, and then the others that make another map of it."""
    write_intact(seeds, tmp_path)
    files = dict(seeds.map_files)
    assert "edits.toml" in files
    whole = MapCase(number=0, name="map", notes=(), files=files, deeds=(), plot=True)
    (tmp_path / "whole").mkdir()
    assert judge(whole, tmp_path / "whole", (), tmp_path) == []
    assert {"out.png", "out.made"} <= {path.name for path in (tmp_path / "whole").iterdir()}
    for keeper in KEEPERS[1:]:
        folder = tmp_path / keeper
        write_map(folder / "damaged", files, [])
        commands = list(map_commands(replace(whole, keeper=keeper), folder, tmp_path))
        (kept,) = (run_command(each) for each in commands if str(folder / "out.made") in each)
        assert list(check_run(kept)) == [], keeper
        assert (folder / "out.made").exists() == (kept.code == 0) == (keeper in {"update", "edit"})


@pytest.mark.parametrize("name", ["features.npz", "map.png"])
def test_a_file_of_another_map_that_is_read_is_noticed(
    seeds: Seeds, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    write_intact(seeds, tmp_path)
    files = {**seeds.map_files, name: seeds.other_files[name]}
    case = MapCase(
        number=0, name="map", notes=(name,), files=files, deeds=(), plot=False, foreign=True
    )
    found = []
    for folder in (tmp_path / "as it is", tmp_path / "planted"):
        folder.mkdir()
        found.append({failure.kind for failure in judge(case, folder, (), tmp_path)})
        monkeypatch.setattr(Map, "checked", lambda _, value, *_names: value)
    assert found[0] == set()
    assert "foreign file" in found[1]


def test_a_case_can_be_kept_and_is_told(
    seeds: Seeds,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(fuzz.__main__, "make_seeds", lambda **_: seeds)
    number = first_chunked(seeds)
    main(["--seed", str(SEED), "--case", str(number), "--keep", str(tmp_path / "kept")])
    told = capsys.readouterr().out
    case = case_of(seeds, SEED, number)
    assert isinstance(case, LogCase)
    assert (tmp_path / "kept" / "log").read_bytes() == case.data
    assert f"case {number}, {case.name}: {'; '.join(case.notes)}" in told
    assert f"specmap info {tmp_path}/kept/log --json" in told


def test_failures_are_grouped_and_can_be_repeated() -> None:
    tally = Tally(7)
    for number in (12, 5, 30):
        failure = Failure("traceback", f"ValueError: {number} is too much (info)")
        failures = (failure,) if number != 30 else ()
        tally.add(Outcome(number=number, name="bag", notes=("cut",), failures=failures, cpu_s=0.02))
    assert tally.kinds() == {"traceback": 2}
    assert tally.lines(1.0) == [
        "3 cases of seed 7: 2 failed; 1 s, 20 ms of processor time a case",
        "traceback: 2 x ValueError: N is too much (info)",
        "    bag: cut",
        "    python -m fuzz --seed 7 --case 5",
    ]


@pytest.mark.parametrize("kinds", [("edit", "property"), ("update", "edit"), ("report", "edit")])
def test_two_commands_on_one_map_lose_nothing(
    kinds: tuple[str, str], first_tour: Mapped, second_tour: Mapped, tmp_path: Path
) -> None:
    faults, ends = try_pair(Bench(first_tour.map, second_tour.log.log, tmp_path), kinds, 0.5)
    assert faults == []
    assert 0 in ends


def test_a_lost_name_is_noticed(
    first_tour: Mapped, second_tour: Mapped, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As it was lost when commands did not look whether the map had changed meanwhile."""
    bench = Bench(first_tour.map, second_tour.log.log, tmp_path)
    monkeypatch.setattr(Bench, "command", lambda *_: ["check", str(tmp_path / "map")])
    faults, ends = try_pair(bench, ("edit", "check"), 0.0)
    assert ends == [0, 0]
    assert faults == ["lost: the name Kitchen"]


def test_only_damage_without_a_trace_is_excused(seeds: Seeds) -> None:
    cut = [
        case
        for case in (case_of(seeds, SEED, number) for number in range(2000))
        if isinstance(case, LogCase) and len(case.notes) == 1 and "taken out" in case.notes[0]
    ]
    excused = {case.name.split()[0] for case in cut if case.excused}
    held = {case.name.split()[0] for case in cut if not case.excused}
    assert excused == {"mcap-bare", "mcap-unindexed"}
    assert held >= {"mcap-zstd", "mcap-plain", "mcap-unchunked", "bag", "bag-active"}
