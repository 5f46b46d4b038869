"""Running a case, and what was wrong: the promises of docs/reliability.md, one by one."""

from __future__ import annotations

import json
import re
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from fuzz.cases import Case, LogCase, MapCase
from fuzz.map_changes import write_map
from fuzz.running import Run, captured, has_command, place_of, run_command
from fuzz.seeds import INTACT, LOCALIZED
from specmap_cli.core.errors import SpecmapError
from specmap_cli.core.settings import LogConfig
from specmap_cli.exports.table import export_map, exporters
from specmap_cli.logs import open_log
from specmap_cli.logs.readers.encoding import SCAN_TYPES
from specmap_cli.logs.stream import SweepStream
from specmap_cli.maps.store import Map, read_map
from specmap_cli.pipelines.map_in_making import laid_out_of_stored
from specmap_cli.pipelines.overlaps import stored_to_align

CODES = {0, 2, 3, 4}  # that a command may end with on a damaged input; 1 is a bug
_LEFT_OUT = ("unusable_scans", "other_sensor", "unusable_odometry")  # counts of a stream
_UNREAD = re.compile(r"transforms that could not be read: (\d+)")
_NO_LOSS = re.compile(
    r"no message is lost|nothing is lost|are all there|messages .* are there|read all the same"
)
_CONTROL = re.compile(r"[\x00-\x09\x0b-\x1f\x7f-\x9f]")  # all but the end of a line


@dataclass(frozen=True, slots=True)
class Failure:
    """A promise that was not kept: `kind` in two words, and what happened."""

    kind: str
    what: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Reading:
    """What came of reading a log to its end: the stamps of its scans, and what was said.

    `damage` are lines that tell of losses, `unusable` the scans that were counted as unusable
    or as those of another sensor.
    """

    stamps_ns: tuple[int, ...] = ()
    expected: int = 0
    damage: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    unusable: int = 0
    error: str | None = None
    bug: BaseException | None = field(default=None, compare=False)


def judge(case: Case, folder: Path, settings: Sequence[str], intact: Path) -> list[Failure]:
    """Run a case in an empty folder; what was wrong, nothing for a case that passes.

    `settings` are options of quick settings for `build`; `intact` is the folder of the inputs that
    `write_intact` wrote.
    """
    temporary = folder / "tmp"
    temporary.mkdir()
    before, tempfile.tempdir = tempfile.tempdir, str(temporary)
    try:
        if isinstance(case, LogCase):
            found = [*_judge_log(case, folder, settings)]
        else:
            found = [*_judge_map(case, folder, intact)]
        return [*found, *_left_behind(folder)]
    except MemoryError:
        return [Failure("memory", "more than the bound was asked for")]
    finally:
        tempfile.tempdir = before


def log_commands(case: LogCase, folder: Path, settings: Sequence[str]) -> Iterator[list[str]]:
    """The commands that a damaged log is given to, one after the other."""
    log = str(folder / "log")
    yield ["info", log, "--json"]
    if case.number % 4 == 0:  # the same in words, where no control character may come through
        yield ["info", log]
    elif case.number % 4 == 2:  # every message read, on every topic
        yield ["info", log, "--check", "--json"]
    if case.convert:
        yield ["convert", log, "-o", str(folder / "converted.mcap")]
    if case.build:
        yield ["build", log, "-o", str(folder / "map"), "--json", *settings]


def map_commands(case: MapCase, folder: Path, intact: Path) -> Iterator[list[str]]:
    """The commands that a damaged map is given to."""
    out, plot = str(folder / "out.csv"), str(folder / "out.png")
    plotted = ["--plot", plot] if case.plot else []
    where, log, other = str(folder / "damaged"), str(intact / LOCALIZED), str(intact / INTACT)
    yield ["localize", log, "--map", where, "--metric", "--out", out, *plotted]
    if has_command("export"):
        graph = str(folder / "out.graphml")
        yield ["export", where, "--format", "graphml", "--out", graph]
    made = ["--out", str(folder / "out.made"), "--json"]
    yield {
        "compare": ["compare", where, other, *made],
        "update": ["update", where, log, "--allow-apart", *made],
        "merge": ["merge", other, where, *made],
        "edit": ["edit", where, "--undo", "2", *made],
        "like": ["build", log, "--like", where, *made],
    }[case.keeper]
    if has_command("report"):
        yield ["report", where, "--out", str(folder / "out.html")]


def _judge_log(case: LogCase, folder: Path, settings: Sequence[str]) -> Iterator[Failure]:
    log = folder / "log"
    log.write_bytes(case.data)
    with captured() as printed:
        reading = read_log(log)
    spoken = "".join(printed()).splitlines()
    if spoken:
        yield Failure("error line", f"reading the log wrote {spoken[0][:120]!r}")
    if reading.bug is not None:
        yield _bug(reading.bug, "reading the log")
    runs = [run_command(command) for command in log_commands(case, folder, settings)]
    for run in runs:
        yield from check_run(run)
    yield from _silent_loss(case, reading, runs[0])
    for run in runs:
        yield from _check_output(case, run, reading, folder)


def read_log(log: Path) -> Reading:
    """Read a log to its end as `build` would."""
    stamps: list[int] = []
    stream = None
    try:
        with open_log(log) as opened:
            stream = SweepStream(opened, LogConfig())
            stamps.extend(sweep.stamp_ns for sweep in stream)
            return _told(stream, stamps, opened.damage, None)
    except SpecmapError as error:
        return Reading(stamps_ns=tuple(stamps), error=str(error))
    except MemoryError:
        raise
    except Exception as error:
        return Reading(stamps_ns=tuple(stamps), bug=error)


def _told(stream: SweepStream, stamps: list[int], damage: Sequence[str], error: Any) -> Reading:
    return Reading(
        stamps_ns=tuple(stamps),
        expected=stream.selection.topic.count,
        damage=tuple(line for line in damage if not _NO_LOSS.search(line)),
        warnings=tuple(stream.warnings),
        unusable=_unusable(stream),
        error=error,
    )


def _unusable(stream: SweepStream) -> int:
    """Messages told to be left out; a damaged one may have been a scan, on another topic now."""
    counted = sum(stream.counts[name] for name in _LEFT_OUT)
    return counted + sum(int(found[1]) for found in map(_UNREAD.search, stream.warnings) if found)


def _bug(error: BaseException, where: str) -> Failure:
    kind = "memory" if isinstance(error, MemoryError) else "traceback"
    return Failure(kind, f"{place_of(error)} ({where})")


def check_run(run: Run) -> Iterator[Failure]:
    """The promises every command keeps: exit codes, one line of error, nothing raw, whole JSON."""
    name = run.arguments[0]
    if run.bug is not None:
        yield _bug(run.bug, name)
        return
    if run.code not in CODES:
        yield Failure("exit code", f"{name} ended with {run.code}")
    if "not enough memory" in run.stderr:
        yield Failure("memory", f"{name}: {run.stderr.strip()[:200]}")
    yield from _check_stderr(run, name)
    raw = _CONTROL.search(run.stdout + run.stderr)
    if raw is not None:
        yield Failure("raw text", f"{name} printed {raw.group()!r}")
    if "--json" in run.arguments:
        try:
            json.loads(run.stdout)
        except ValueError as error:
            yield Failure("bad JSON", f"{name}: {error}")


def _check_stderr(run: Run, name: str) -> Iterator[Failure]:
    lines = run.stderr.splitlines()
    errors = [line for line in lines if line.startswith("specmap: error: ")]
    if len(errors) != (run.code != 0):
        yield Failure("error line", f"{name} ended with {run.code} and {len(errors)} error lines")
    strange = next((line for line in lines if not line.startswith("specmap: ")), None)
    if strange is not None:
        yield Failure("error line", f"{name} wrote {strange[:120]!r}")


def _silent_loss(case: LogCase, reading: Reading, info: Run) -> Iterator[Failure]:
    """Scans of the intact log, or of what `info` counts, that are missing without a word."""
    missing, added = lost_scans(case.stamps_ns, reading.stamps_ns)
    lost = missing - added - case.excused
    if case.must_tell and not _said(reading, info, 0):
        yield Failure("silent loss", f"not a word about what is no part of the log ({case.name})")
    if lost > 0 and not _said(reading, info, lost):
        yield Failure("silent loss", f"{lost} of {len(case.stamps_ns)} scans ({case.name})")
    elif reading.expected > len(reading.stamps_ns) and not _said(
        reading, info, reading.expected - len(reading.stamps_ns)
    ):
        counts = f"{len(reading.stamps_ns)} of the {reading.expected} scans that info counts"
        yield Failure("silent loss", f"read only {counts} ({case.name})")


def lost_scans(intact: Sequence[int], read: Sequence[int]) -> tuple[int, int]:
    """How many stamps are missing, and how many are there that the intact log does not have."""
    missing = Counter(intact) - Counter(read)
    known = set(intact)
    return missing.total(), sum(stamp not in known for stamp in read)


def _said(reading: Reading, info: Run, lost: int) -> bool:
    """Whether so many lost scans were told of: as damage, as unusable, or as an error."""
    if reading.error is not None or reading.bug is not None or reading.damage:
        return True
    if lost and reading.unusable >= lost:
        return True
    if info.code:
        return True
    try:
        found = json.loads(info.stdout)
    except ValueError:
        return False
    return bool(found.get("problem"))


def _check_output(case: LogCase, run: Run, reading: Reading, folder: Path) -> Iterator[Failure]:
    """What a command wrote is whole, or is not there; and it tells of the scans that are lost."""
    written = {"convert": folder / "converted.mcap", "build": folder / "map"}
    path = written.get(run.arguments[0])
    if path is None or run.bug is not None:
        return
    if path.exists() != (run.code == 0):
        yield Failure("half-written", f"{run.arguments[0]} ended with {run.code}: {path.name}")
    elif run.code == 0 and path.is_file():
        yield from _check_converted(path, reading)
    elif run.code == 0:
        missing, added = lost_scans(case.stamps_ns, reading.stamps_ns)
        told = json.loads(run.stdout)["warnings"] if run.stdout else []
        if missing - added - case.excused > 0 and not told:
            yield Failure("silent loss", "build warns of nothing")


def _check_converted(path: Path, reading: Reading) -> Iterator[Failure]:
    with open_log(path) as log:
        scans = sum(topic.count for topic in log.topics() if topic.type in SCAN_TYPES)
        if log.damage:
            yield Failure("half-written", f"convert: {log.damage[0]}")
    if scans < len(reading.stamps_ns):
        yield Failure("silent loss", f"convert wrote {scans} of {len(reading.stamps_ns)} scans")


def _judge_map(case: MapCase, folder: Path, intact: Path) -> Iterator[Failure]:
    write_map(folder / "damaged", case.files, list(case.deeds))
    for command in map_commands(case, folder, intact):
        run = run_command(command)
        yield from check_run(run)
        outputs = [Path(word) for word in command if word.startswith(str(folder / "out."))]
        for path in outputs if run.bug is None else []:
            if path.exists() != (run.code == 0):
                yield Failure("half-written", f"{command[0]} ended with {run.code}: {path.name}")
    yield from _check_export(folder)
    yield from _check_contents(folder)
    if case.foreign and not _refused(folder):
        yield Failure("foreign file", f"it was read: {case.notes[0]}")
    yield from _check_kept(folder)


def _refused(folder: Path) -> bool:
    """Whether one of the readers of a map's files refuses its file."""
    try:
        stored = read_map(folder / "damaged")
        for name in _READ:
            getattr(stored, name)
        _in_keyframes(stored)
        _in_layout(stored)
        _ = [*stored.grids.values()]
    except SpecmapError:
        return True
    return False


def _check_kept(folder: Path) -> Iterator[Failure]:
    """What is not of specmap stays where a command replaces a map, or refuses to."""
    own = folder / "damaged" / "photos" / "notes.txt"
    own.parent.mkdir(exist_ok=True)
    own.write_text("mine")
    yield from check_run(run_command(["edit", str(folder / "damaged"), "--undo", "1", "--json"]))
    if not own.is_file() or own.read_text() != "mine":
        yield Failure("foreign file", "edit removed it")


def _check_export(folder: Path) -> Iterator[Failure]:
    """Every format of export, by the library: written whole, or refused in one line.

    But that of Rerun, whose own library takes more memory than a case may.
    """
    for name in sorted(exporters().keys() - {"rerun"}):
        out = folder / f"exported-{name}"
        try:
            export_map(read_map(folder / "damaged"), name, out)
        except SpecmapError as error:
            if out.exists():
                yield Failure("half-written", f"export: {error}")
        except Exception as error:
            yield _bug(error, f"export of {name}")


def _check_contents(folder: Path) -> Iterator[Failure]:
    """What an update needs of a map, by the library: all of it, or refused in one line."""
    for name, read in _CONTENTS.items():
        try:
            stored = read_map(folder / "damaged")
            found = read(stored)
            if found != len(stored.labels.stamps_ns):
                yield Failure("silent loss", f"{name}: {found} keyframes")
        except SpecmapError as error:
            if "\n" in str(error):
                yield Failure("error line", f"{name}: {error}")
        except Exception as error:
            yield _bug(error, name)


def _in_topology(stored: Map) -> int:
    _ = stored.topology
    return len(stored.labels.stamps_ns)


def _in_keyframes(stored: Map) -> int:
    with stored.scans() as keyframes:
        return len([keyframes.scan(number) for number in range(len(keyframes))])


def _in_layout(stored: Map) -> int:
    stored_to_align(stored)
    return len(laid_out_of_stored(stored).layout.poses)


# The files of a map as a program reads them, beside scans, layout and grids.
_READ = ("topology", "classifiers", "features", "map_grid", "trajectory", "labels", "division")
# What a map is read for, and how many keyframes that tells of.
_CONTENTS: Mapping[str, Callable[[Map], int]] = {
    "topology": _in_topology,
    "keyframes": _in_keyframes,
    "layout": _in_layout,
}


def _left_behind(folder: Path) -> Iterator[Failure]:
    """Temporary and hidden files that nobody removed."""
    left = [*(folder / "tmp").iterdir(), *folder.glob(".*")]
    if left:
        names = ", ".join(path.name for path in left[:3])
        yield Failure("half-written", f"left behind: {names}")
