"""A TOML file of jobs::

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
from pathlib import Path
from typing import Any, cast

from specmap_cli.batch.discovery import Found, logs_at
from specmap_cli.batch.naming import Names
from specmap_cli.batch.places import path_at
from specmap_cli.batch.records import Command, Job, Plan
from specmap_cli.batch.steps import steps_of
from specmap_cli.core.errors import SETTING, UsageError
from specmap_cli.core.tomltext import read_toml

_OF_THE_FILE = ("steps", "options", "logs", "job")
_OF_A_JOB = ("name", "logs", "steps", "options")


def jobs_in(path: Path, defaults: Plan, names: Names) -> list[Job]:
    """The jobs of a file; where it is silent, `defaults` hold.

    Raises UsageError, naming file and place, for what cannot be.
    """
    try:
        return _jobs(path, defaults, names)
    except UsageError as error:
        raise UsageError(str(error), code=SETTING) from None


def _jobs(path: Path, defaults: Plan, names: Names) -> list[Job]:
    written, where = read_toml(path), f"{path}: "
    _check_keys(written, _OF_THE_FILE, where)
    plan = _plan(written, defaults, where)
    tables = written.get("job", [])
    if not isinstance(tables, list) or not all(isinstance(table, Mapping) for table in tables):
        raise UsageError(f"{where}job is {tables!r:.60}: expected tables [[job]]")
    chosen = [_name(table, names, f"{where}{_place(table, n)}") for n, table in enumerate(tables)]
    jobs = list(_each(written, path.parent, plan, names, where)) if "logs" in written else []
    for number, (table, name) in enumerate(zip(tables, chosen, strict=True)):
        jobs.append(_job(table, name, path.parent, plan, names, f"{where}{_place(table, number)}"))
    if not jobs:
        raise UsageError(f"{where}no jobs: give logs = [...], or tables [[job]] with logs")
    return jobs


def _place(table: Mapping[str, Any], number: int) -> str:
    """Which [[job]] it is."""
    name = table.get("name")
    return f"job {number + 1}{f' ({name})' if isinstance(name, str) else ''}: "


def _name(table: Mapping[str, Any], names: Names, where: str) -> str | None:
    """The name that a person gave; those of all jobs are taken before any is made."""
    _check_keys(table, _OF_A_JOB, where)
    return names.of_person(table["name"], where) if "name" in table else None


def _each(
    written: Mapping[str, Any], base: Path, plan: Plan, names: Names, where: str
) -> Iterator[Job]:
    """A job for each log of the whole file."""
    steps = steps_of(plan, base, where)
    for found in _logs(written, base, where):
        yield Job(names.of_log(found.name, found.log), (found.log,), steps)


def _job(
    table: Mapping[str, Any], name: str | None, base: Path, plan: Plan, names: Names, where: str
) -> Job:
    """One job; all its logs are one recording."""
    if "logs" not in table:
        raise UsageError(f'{where}logs: missing: say which, such as logs = ["lobby.mcap"]')
    found = _logs(table, base, where)
    steps = steps_of(_plan(table, plan, where), base, where)
    logs = tuple(each.log for each in found)
    return Job(name or names.of_log(found[0].name, found[0].log), logs, steps)


def _logs(table: Mapping[str, Any], base: Path, where: str) -> list[Found]:
    """The recordings that `logs` names, each once."""
    found: dict[str, Found] = {}
    for place in _texts(table["logs"], f"{where}logs"):
        path = path_at(place)
        try:
            logs = logs_at(place if path is None else str(base / path))
        except UsageError as error:
            raise UsageError(f"{where}logs: {error}") from None
        found |= {each.log: each for each in logs if each.log not in found}
    return list(found.values())


def _plan(table: Mapping[str, Any], over: Plan, where: str) -> Plan:
    """What a table says of steps and options, over what holds where it is silent."""
    steps = _texts(table["steps"], f"{where}steps") if "steps" in table else over.steps
    options = {command: dict(values) for command, values in over.options.items()}
    for command, values in _table(table.get("options", {}), f"{where}options").items():
        options.setdefault(command, {}).update(_table(values, f"{where}options.{command}"))
    return Plan(cast(tuple[Command, ...], tuple(steps)), options)


def _table(value: Any, place: str) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise UsageError(f"{place} is {value!r:.60}: expected a table [{place.split()[-1]}]")
    return value


def _texts(value: Any, place: str) -> Sequence[str]:
    """A list of texts; a single one stands for itself."""
    values = [value] if isinstance(value, str) else value
    if not isinstance(values, list) or not all(isinstance(each, str) for each in values):
        raise UsageError(f'{place} is {value!r:.60}: expected a list such as ["one", "two"]')
    if not values:
        raise UsageError(f"{place}: empty: name one at least")
    return values


def _check_keys(table: Mapping[str, Any], known: Sequence[str], where: str) -> None:
    for key in table:
        if key not in known:
            raise UsageError(f"{where}{key}: no such key: use {', '.join(known)}")
