"""Which jobs there are: from logs, directories, patterns, and TOML files of jobs::

    steps = ["build", "report", "check"]     # of every job that names no others
    logs = ["monday/*.mcap"]                 # a job for each of these recordings

    [options.build]                          # long options, as on the command line
    preset = "paper"
    set = ["grid.resolution_m=0.1"]

    [[job]]                                  # one job, whose logs are one recording
    name = "lobby"
    logs = ["lobby/part_*.mcap"]

    [job.options.build]                      # over those above, option by option
    seed = 3

Paths are relative to the file.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, cast

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field

from specmap_cli.batch.discovery import Found, logs_at
from specmap_cli.batch.naming import Names
from specmap_cli.batch.places import path_at
from specmap_cli.batch.records import Command, Job, Plan
from specmap_cli.batch.steps import steps_of
from specmap_cli.core.errors import SETTING, UsageError
from specmap_cli.core.toml import TomlFormat, UnfitError, unless


def jobs_of(inputs: Sequence[str], defaults: Plan | None = None) -> tuple[Job, ...]:
    """The jobs of LOG, DIR, GLOB and jobs.toml, paths or fsspec URLs, in order of the inputs.

    A log, and each recording below a directory or behind a pattern, is a job with the steps of
    `defaults`; a file whose name ends in .toml says itself which jobs there are, and `defaults`
    hold where it is silent. Jobs are called as their logs, those of TOML files as these say. Raises
    UsageError for what makes no jobs, and for a TOML file that says what cannot be.
    """
    plan = Plan() if defaults is None else defaults
    names = Names()
    files = [place for place in inputs if place.lower().endswith(".toml")]
    named = {place: _in_file(_local(place), plan, names) for place in dict.fromkeys(files)}
    jobs: list[Job] = []
    seen: set[str] = set()
    for place in dict.fromkeys(inputs):
        jobs += named[place] if place in named else _plain(place, plan, names, seen)
    if not jobs:
        raise UsageError("no job given: name a log, a directory, a pattern or a TOML file of jobs")
    return tuple(jobs)


def _local(place: str) -> Path:
    path = path_at(place)
    if path is None:
        raise UsageError(f"{place}: a file of jobs must be on this machine: copy it here")
    return path


def _plain(place: str, plan: Plan, names: Names, seen: set[str]) -> Iterator[Job]:
    """A job for each recording that a place stands for; none for one that has a job already."""
    steps = steps_of(plan, Path())
    for found in logs_at(place):
        if found.log not in seen:
            seen.add(found.log)
            yield Job(names.of_log(found.name, found.log), (found.log,), steps)


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


_FILE: TomlFormat[_File] = TomlFormat(model=_File, error=partial(UsageError, code=SETTING))
_JOB: TomlFormat[_JobTable] = TomlFormat(model=_JobTable, error=UsageError)


def _in_file(path: Path, defaults: Plan, names: Names) -> list[Job]:
    """The jobs of a file; where it is silent, `defaults` hold."""
    file = _FILE.read(path)
    try:
        return _jobs(file, path, defaults, names)
    except UsageError as error:
        error.code = SETTING
        raise


def _jobs(file: _File, path: Path, defaults: Plan, names: Names) -> list[Job]:
    where = f"{path}: "
    plan = _plan(file, defaults)
    places = [f"{where}{_place(table, number)}" for number, table in enumerate(file.job)]
    tables = [_JOB.value(table, place) for table, place in zip(file.job, places, strict=True)]
    chosen = [_name(table, names, place) for table, place in zip(tables, places, strict=True)]
    jobs = list(_each(file.logs, path.parent, plan, names, where)) if file.logs else []
    for table, name, place in zip(tables, chosen, places, strict=True):
        jobs.append(_job(table, name, path.parent, plan, names, place))
    if not jobs:
        raise UsageError(f"{where}no jobs: give logs = [...], or tables [[job]] with logs")
    return jobs


def _place(table: Mapping[str, Any], number: int) -> str:
    """Which [[job]] it is."""
    name = table.get("name")
    return f"job {number + 1}{f' ({name})' if isinstance(name, str) else ''}: "


def _name(table: _JobTable, names: Names, where: str) -> str | None:
    """The name that a person gave; those of all jobs are taken before any is made."""
    return None if table.name is None else names.of_person(table.name, where)


def _each(
    places: tuple[str, ...], base: Path, plan: Plan, names: Names, where: str
) -> Iterator[Job]:
    """A job for each log of the whole file."""
    steps = steps_of(plan, base, where)
    for found in _logs(places, base, where):
        yield Job(names.of_log(found.name, found.log), (found.log,), steps)


def _job(
    table: _JobTable, name: str | None, base: Path, plan: Plan, names: Names, where: str
) -> Job:
    """One job; all its logs are one recording."""
    if table.logs is None:
        raise UsageError(f'{where}logs: missing: say which, such as logs = ["lobby.mcap"]')
    found = _logs(table.logs, base, where)
    steps = steps_of(_plan(table, plan), base, where)
    logs = tuple(each.log for each in found)
    return Job(name or names.of_log(found[0].name, found[0].log), logs, steps)


def _logs(places: tuple[str, ...], base: Path, where: str) -> list[Found]:
    """The recordings at some places, each once."""
    found: dict[str, Found] = {}
    for place in places:
        path = path_at(place)
        try:
            logs = logs_at(place if path is None else str(base / path))
        except UsageError as error:
            raise UsageError(f"{where}logs: {error}") from None
        found |= {each.log: each for each in logs if each.log not in found}
    return list(found.values())


def _plan(table: _Table, over: Plan) -> Plan:
    """What a table says of steps and options, over what holds where it is silent."""
    options = {command: dict(values) for command, values in over.options.items()}
    for command, values in table.options.items():
        options.setdefault(command, {}).update(values)
    steps = cast(tuple[Command, ...], table.steps or over.steps)
    return replace(over, steps=steps, options=options)
