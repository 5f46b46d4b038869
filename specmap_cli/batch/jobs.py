"""Which jobs there are, and their steps: of logs, directories, patterns, and TOML files of jobs.

docs/batch.md shows such a file; paths are relative to it. A job has a name that is safe as a folder
anywhere, no other job's, and the same in the next batch.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, cast

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field

from specmap_cli.batch.places import path_at
from specmap_cli.batch.records import (
    COMMANDS,
    CONFUSION,
    JOB,
    LABELS,
    LOG_TEXT,
    MAP,
    REPORT,
    Command,
    Job,
    Meaning,
    Plan,
    Step,
)
from specmap_cli.batch.sources import Found, logs_at
from specmap_cli.core.errors import SETTING, LogError, UsageError
from specmap_cli.core.text import quoted
from specmap_cli.core.toml import TomlFormat, UnfitError, choice, unless

# Files that a batch writes beside the folders of its jobs.
BESIDE_JOBS = frozenset(
    {"index.html", "events.jsonl", "junit.xml", "summary.csv", "summary.md", "summary.parquet"}
)
_UNSAFE = re.compile(r"[^A-Za-z0-9._-]+")
_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9._-]{0,99}")  # of jobs, formats and files
_LONGEST = 80  # characters of a name made of that of a log
_TAG = 8  # hexadecimal digits


def jobs_of(inputs: Sequence[str], defaults: Plan = Plan()) -> tuple[Job, ...]:
    """The jobs of LOG, DIR, GLOB and jobs.toml, paths or fsspec URLs, in order of the inputs.

    A log, and each recording below a directory or behind a pattern, is a job with the steps of
    `defaults`; a file whose name ends in .toml says itself which jobs there are, and `defaults`
    hold where it is silent. Jobs are called as their logs, those of TOML files as these say. Raises
    LogError where no recording is, and UsageError for a TOML file that says what cannot be.
    """
    places = dict.fromkeys(inputs)
    names = _Names()
    files = [place for place in places if place.lower().endswith(".toml")]
    named = {place: _in_file(place, defaults, names) for place in files}
    jobs: list[Job] = []
    known: set[str] = set()  # logs that have a job already
    for place in places:
        if place in named:
            jobs += named[place]
            continue
        steps = steps_of(defaults, Path())
        for found in logs_at(place):
            if found.log not in known:
                known.add(found.log)
                jobs.append(Job(names.of_log(found), (found.log,), steps))
    if not jobs:
        raise UsageError(
            "no job given", "name a log, a directory, a pattern or a TOML file of jobs"
        )
    return tuple(jobs)


class _Names:
    """The names that are taken. Upper and lower case count as the same, as on some systems."""

    def __init__(self) -> None:
        self._taken: set[str] = set(BESIDE_JOBS)

    def of_person(self, name: object) -> str:
        """A name that a person chose. Raises UsageError when it is unsafe or taken."""
        if not isinstance(name, str) or not _NAME.fullmatch(name):
            hint = (
                "expected letters, digits, dots, dashes and underscores, a letter or digit first: "
                "it names a folder"
            )
            raise UsageError(f"name is {quoted(name)}", hint)
        if name.lower() in self._taken:
            whose = "a file of the batch's" if name.lower() in BESIDE_JOBS else "another job's"
            raise UsageError(f"name: {name} is {whose}, too", "choose another")
        self._taken.add(name.lower())
        return name

    def of_log(self, found: Found) -> str:
        """A name made of that of a log, which is `a/b` for one in a directory.

        A second one of the same name gets a tag made of its path, so that it is the same in the
        next batch, whichever logs came to it.
        """
        safe = _UNSAFE.sub("_", found.name.replace("/", "-")).strip(".-_")[:_LONGEST] or "log"
        if safe.lower() in self._taken:
            path = found.log.encode("utf-8", "replace")
            safe = f"{safe}-{hashlib.sha256(path).hexdigest()[:_TAG]}"
        number, unique = 2, safe
        while unique.lower() in self._taken:
            unique, number = f"{safe}-{number}", number + 1
        self._taken.add(unique.lower())
        return unique


def _are(kind: type, value: Any) -> bool:
    return isinstance(value, list) and all(isinstance(each, kind) for each in value)


def _some(texts: tuple[str, ...]) -> tuple[str, ...]:
    if not texts:
        raise UnfitError("name one at least", "empty")
    return texts


# A list of texts; a single one stands for itself.
_Texts = Annotated[
    tuple[str, ...],
    AfterValidator(_some),
    BeforeValidator(lambda value: [value] if isinstance(value, str) else value),
    unless(
        lambda value: isinstance(value, str) or _are(str, value),
        'expected a list such as ["one", "two"]',
    ),
]


class _Table(BaseModel):
    """What the whole file and each [[job]] may say."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    steps: _Texts | None = None
    options: dict[str, dict[str, Any]] = Field(default_factory=dict)
    logs: _Texts | None = None


class _JobTable(_Table):
    """A table [[job]]."""

    name: Any = None


class _File(_Table):
    """The whole file."""

    job: Annotated[
        tuple[dict[str, Any], ...],
        unless(lambda value: _are(Mapping, value), "expected tables [[job]]"),
    ] = ()


_FILE: TomlFormat[_File] = TomlFormat(model=_File, error=UsageError, code=SETTING)
_JOB: TomlFormat[_JobTable] = TomlFormat(model=_JobTable, error=UsageError)


def _in_file(place: str, defaults: Plan, names: _Names) -> list[Job]:
    """The jobs of a file; where it is silent, `defaults` hold."""
    path = path_at(place)
    if path is None:
        raise UsageError("a file of jobs must be on this machine", "copy it here", where=place)
    file = _FILE.read(path)
    try:
        return _jobs(file, path.parent, defaults, names)
    except UsageError as error:
        told = error.within(path)
        told.code = SETTING
        raise told from None
    except LogError as error:
        raise error.within(path) from None


def _jobs(file: _File, base: Path, defaults: Plan, names: _Names) -> list[Job]:
    """The jobs of the logs of the whole file, then those of its tables."""
    plan = _plan(file, defaults)
    tables: list[tuple[str, _JobTable, str | None]] = []
    for number, given in enumerate(file.job, 1):
        named = f" ({given['name']})" if isinstance(given.get("name"), str) else ""
        title = f"job {number}{named}"
        table = _JOB.value(given, f"{title}: ")
        with _told_of(title):  # names that a person gave are taken before any is made of a log
            chosen = None if table.name is None else names.of_person(table.name)
        tables.append((title, table, chosen))
    jobs: list[Job] = []
    if file.logs:
        steps = steps_of(plan, base)
        for found in _logs(file.logs, base):
            jobs.append(Job(names.of_log(found), (found.log,), steps))
    for title, table, chosen in tables:
        with _told_of(title):
            if table.logs is None:
                raise UsageError("logs: missing", 'say which, such as logs = ["lobby.mcap"]')
            logs = _logs(table.logs, base)  # all are one recording
            steps = steps_of(_plan(table, plan), base)
        jobs.append(Job(chosen or names.of_log(logs[0]), tuple(each.log for each in logs), steps))
    if not jobs:
        raise UsageError("no jobs", "give logs = [...], or tables [[job]] with logs")
    return jobs


@contextmanager
def _told_of(place: str) -> Iterator[None]:
    """Errors are told of a place in the file."""
    try:
        yield
    except (UsageError, LogError) as error:
        raise error.within(place) from None


def _logs(places: tuple[str, ...], base: Path) -> list[Found]:
    """The recordings at some places, each once."""
    found: dict[str, Found] = {}
    for place in places:
        path = path_at(place)
        with _told_of("logs"):
            logs = logs_at(place if path is None else str(base / path))
        found |= {each.log: each for each in logs if each.log not in found}
    return list(found.values())


def _plan(table: _Table, over: Plan) -> Plan:
    """What a table says of steps and options, over what holds where it is silent."""
    options = {command: dict(values) for command, values in over.options.items()}
    for command, values in table.options.items():
        options.setdefault(command, {}).update(values)
    steps = cast(tuple[Command, ...], table.steps or over.steps)
    return replace(over, steps=steps, options=options)


SUFFIXES = {  # of exports, for the programs that go by them
    "nav2": ".geojson",
    "tmap2": ".yaml",
    "geojson": ".geojson",
    "graphml": ".graphml",
    "csv": ".zip",
    "rmf": ".zip",
    "nav2-masks": ".zip",
    "lif": ".json",
    "pose-graph": ".g2o",
    "foxglove": ".mcap",
    "rerun": ".rrd",
}
# Options that spare a step the map that the others need.
_INSTEAD_OF_A_MAP = {"localize": {"map"}, "evaluate": {"protocol", "baseline"}}
_FORMAT = "--format="
# What the batch says itself: where results go and how they are told is nobody else's.
_SAID = frozenset({"out", "overwrite", "json", "quiet", "log-level", "trajectory"})


def steps_of(plan: Plan, base: Path) -> tuple[Step, ...]:
    """The steps of a plan; paths in its options are relative to `base`.

    Raises UsageError for a step or an option that is none, one whose value is of the wrong kind,
    and a step that needs another one before it.
    """
    choices = f"choose from {', '.join(COMMANDS)}"
    for name in [*plan.steps, *plan.options]:
        if name not in COMMANDS:
            raise UsageError(f"{quoted(name)}: no such step", choices)
    if not plan.steps:
        raise UsageError("steps: empty", choices)
    for place, command in enumerate(plan.steps):
        if command in plan.steps[:place]:
            raise UsageError(f"steps: {command} is given twice", "name each step once")
        instead = _INSTEAD_OF_A_MAP.get(command, set()) & plan.options.get(command, {}).keys()
        if "build" not in plan.steps[: place + 1] and not instead:
            raise UsageError(f"steps: {command} needs a map", "put build before it")
    steps: list[Step] = []
    taken = {MAP, REPORT, LABELS, CONFUSION, JOB, LOG_TEXT, *(f"{each}.json" for each in COMMANDS)}
    for command in plan.steps:
        made, outputs = _made(command, plan, base)
        for name in outputs:
            if name.lower() in taken:
                raise UsageError(f"options.{command}: {name} is written twice")
            taken.add(name.lower())
        steps += made
    return tuple(steps)


def arguments_of(step: Step, logs: Sequence[str]) -> list[str]:
    """The command line of a step that is run in the folder of its job."""

    def has(option: str) -> bool:
        return any(each.startswith(f"--{option}=") for each in step.options)

    match step.command:
        case "build":
            own = [f"--out={MAP}", "--", *logs]
        case "localize":
            own = [*([] if has("map") else [f"--map={MAP}"]), f"--out={LABELS}", "--", *logs]
        case "evaluate" if has("protocol"):
            own = [f"--out={CONFUSION}", "--", *logs]
        case "evaluate" if has("baseline"):
            own = ["--", *logs]
        case "evaluate":
            own = [f"--trajectory={MAP}/trajectory.tum"]
        case "export":
            own = [f"--out={_export_name(step)}", "--", MAP]
        case "report":
            own = [f"--out={REPORT}", "--", MAP]
        case "check":
            own = ["--", MAP]
    return [step.command, *step.options, "--json", *own]


def _export_name(step: Step) -> str:
    chosen = [each.removeprefix(_FORMAT) for each in step.options if each.startswith(_FORMAT)]
    return "".join(f"{name}{SUFFIXES.get(name, '')}" for name in chosen)


def _made(command: Command, plan: Plan, base: Path) -> tuple[list[Step], list[str]]:
    """The steps of one command, an export for each format; the files that they write by name."""
    given = list(_given(command, plan, base))
    options = tuple(text for text, _ in given)
    inputs = tuple(text for text, meaning in given if meaning == "input")
    outputs = [text.partition("=")[2] for text, meaning in given if meaning == "output"]
    if command != "export":
        return [Step(command, options, inputs)], outputs
    formats = [each for each in options if each.startswith(_FORMAT)]
    if not formats:
        raise UsageError("options.export.format: missing", 'say which, such as "nav2"')
    others = tuple(each for each in options if each not in formats)
    for each in formats:
        if not _NAME.fullmatch(each.removeprefix(_FORMAT)):
            raise UsageError(
                f"no format has the name {quoted(each)}", where="options.export.format"
            )
    steps = [Step(command, (*others, each), inputs) for each in formats]
    return steps, [*map(_export_name, steps), *outputs]


def _given(command: Command, plan: Plan, base: Path) -> Iterator[tuple[str, Meaning]]:
    """The options of one step as they stand on the command line, and what they take."""
    known = plan.known.get(command, {})
    free = {name: option for name, option in known.items() if _SAID.isdisjoint(option.names)}
    for name, value in plan.options.get(command, {}).items():
        place = f"options.{command}.{name}"
        if name not in free:
            if name in known:
                raise UsageError("the batch says that itself", "leave it out", where=place)
            raise UsageError("no such option", choice(name, free), where=place)
        meaning = free[name].meaning
        several = free[name].several or (command, name) == ("export", "format")  # one for each
        for each in value if several and isinstance(value, list) else [value]:
            if meaning == "flag":
                if not isinstance(each, bool):
                    raise UsageError(f"{place} is {quoted(each)}", "expected true or false")
                if each:
                    yield f"--{name}", meaning
                continue
            if isinstance(each, bool) or not isinstance(each, str | int | float):
                many = " or a list of them" if several else ""
                raise UsageError(f"{place} is {quoted(each)}", f"expected a text or a number{many}")
            text = str(each)
            if meaning == "input":
                path = base / text
                if not path.exists():
                    raise UsageError(f"{path}: no such file or directory", where=place)
                text = str(path.absolute())
            elif meaning == "output" and not _NAME.fullmatch(text):
                raise UsageError(
                    f"{place} is {quoted(each)}",
                    "expected the bare name of a file: it goes into the job's folder",
                )
            yield f"--{name}={text}", meaning
