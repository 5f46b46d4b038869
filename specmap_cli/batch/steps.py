"""The steps of a job: made of a plan and checked, and as arguments of the command line."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from specmap_cli.batch.records import COMMANDS, Command, Meaning, Option, Plan, Step
from specmap_cli.core.errors import UsageError
from specmap_cli.core.toml import choice

# What lies in the folder of a job.
MAP, REPORT, LABELS, CONFUSION = "map", "report.html", "labels.csv", "confusion.png"
JOB, LOG_TEXT = "job.json", "log.txt"
SUFFIXES = {  # of exports, for the programs that go by them
    "nav2": ".geojson",
    "tmap2": ".yaml",
    "geojson": ".geojson",
    "graphml": ".graphml",
    "csv": ".zip",
    "pose-graph": ".g2o",
    "foxglove": ".mcap",
    "rerun": ".rrd",
}
_OF_A_MAP = ("export", "report", "check")
_FILE_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9._-]{0,99}")
_FORMAT = "--format="
# What the batch says itself: where results go and how they are told is nobody else's.
_SAID = frozenset({"out", "overwrite", "json", "quiet", "log-level", "trajectory"})


def steps_of(plan: Plan, base: Path) -> tuple[Step, ...]:
    """The steps of a plan; paths in its options are relative to `base`.

    Raises UsageError for a step or an option that is none, one whose value is of the wrong kind,
    and a step that needs another one before it.
    """
    _check_commands(plan)
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
    own = [*step.options, "--json"]
    if step.command == "build":
        return ["build", *own, f"--out={MAP}", "--", *logs]
    if step.command == "localize":
        map_ = [] if _has(step, "map") else [f"--map={MAP}"]
        return ["localize", *own, *map_, f"--out={LABELS}", "--", *logs]
    if step.command == "evaluate":
        return ["evaluate", *own, *_evaluated(step, logs)]
    out = {"export": _export_name(step), "report": REPORT}.get(step.command)
    return [step.command, *own, *([] if out is None else [f"--out={out}"]), "--", MAP]


def _evaluated(step: Step, logs: Sequence[str]) -> list[str]:
    if _has(step, "protocol"):
        return [f"--out={CONFUSION}", "--", *logs]
    return ["--", *logs] if _has(step, "baseline") else [f"--trajectory={MAP}/trajectory.tum"]


def _has(step: Step, option: str) -> bool:
    return any(each.startswith(f"--{option}=") for each in step.options)


def _export_name(step: Step) -> str:
    chosen = [each.removeprefix(_FORMAT) for each in step.options if each.startswith(_FORMAT)]
    return "".join(f"{name}{SUFFIXES.get(name, '')}" for name in chosen)


def _check_commands(plan: Plan) -> None:
    """Refuse unknown steps, one given twice, and one that needs a map before there is one."""
    choices = ", ".join(COMMANDS)
    for name in [*plan.steps, *plan.options]:
        if name not in COMMANDS:
            raise UsageError(f"{name!r:.60}: no such step", f"choose from {choices}")
    for place, command in enumerate(plan.steps):
        before = plan.steps[:place]
        if command in before:
            raise UsageError(f"steps: {command} is given twice", "name each step once")
        if "build" not in before and _needs_map(command, plan.options.get(command, {})):
            raise UsageError(f"steps: {command} needs a map", "put build before it")


def _needs_map(command: Command, options: Mapping[str, Any]) -> bool:
    if command == "localize":
        return "map" not in options
    if command == "evaluate":
        return "protocol" not in options and "baseline" not in options
    return command in _OF_A_MAP


def _given(command: Command, plan: Plan, base: Path) -> Iterator[tuple[str, Meaning]]:
    """The options of one step as they stand on the command line, and what they take."""
    for name, value in plan.options.get(command, {}).items():
        place = f"options.{command}.{name}"
        option = _known(plan.known.get(command, {}), name, place)
        if command == "export" and name == "format":
            option = replace(option, several=True)  # an export for each
        values = value if option.several and isinstance(value, list) else [value]
        for each in values:
            for text in _option(name, option, each, base, place):
                yield text, option.meaning


def _known(options: Mapping[str, Option], name: str, place: str) -> Option:
    free = {each: option for each, option in options.items() if _SAID.isdisjoint(option.names)}
    if name in free:
        return free[name]
    if name in options:
        raise UsageError("the batch says that itself", "leave it out", where=place)
    hint = choice(name, free)
    raise UsageError("no such option", hint, where=place)


def _option(name: str, option: Option, value: Any, base: Path, place: str) -> Iterator[str]:
    """One use of an option; a flag that is false is none."""
    if option.meaning == "flag":
        if not isinstance(value, bool):
            raise UsageError(f"{place} is {value!r:.60}", "expected true or false")
        yield from [f"--{name}"] if value else []
        return
    if isinstance(value, bool) or not isinstance(value, str | int | float):
        many = " or a list of them" if option.several else ""
        raise UsageError(f"{place} is {value!r:.60}", f"expected a text or a number{many}")
    if option.meaning == "input":
        yield f"--{name}={_input(str(value), base, place)}"
        return
    if option.meaning == "output" and not _FILE_NAME.fullmatch(str(value)):
        raise UsageError(
            f"{place} is {value!r:.60}",
            "expected the bare name of a file: it goes into the job's folder",
        )
    yield f"--{name}={value}"


def _input(value: str, base: Path, place: str) -> Path:
    path = base / value
    if not path.exists():
        raise UsageError(f"{path}: no such file or directory", where=place)
    return path.absolute()


def _made(command: Command, plan: Plan, base: Path) -> tuple[list[Step], list[str]]:
    """The steps of one command: an export for each format, else a single one.

    And the files that they write by names of a person's choice.
    """
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
        if not _FILE_NAME.fullmatch(each.removeprefix(_FORMAT)):
            raise UsageError(f"no format has the name {each!r:.60}", where="options.export.format")
    steps = [Step(command, (*others, each), inputs) for each in formats]
    return steps, [*map(_export_name, steps), *outputs]
