"""The steps of a job: made of a plan and checked, and as arguments of the command line."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path

from specmap_cli.batch.records import COMMANDS, Command, Meaning, Plan, Step
from specmap_cli.core.errors import UsageError
from specmap_cli.core.text import quoted
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
    "rmf": ".zip",
    "nav2-masks": ".zip",
    "lif": ".json",
    "pose-graph": ".g2o",
    "foxglove": ".mcap",
    "rerun": ".rrd",
}
# Options that spare a step the map that the others need.
_INSTEAD_OF_A_MAP = {"localize": {"map"}, "evaluate": {"protocol", "baseline"}}
_FILE_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9._-]{0,99}")
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
            elif meaning == "output" and not _FILE_NAME.fullmatch(text):
                raise UsageError(
                    f"{place} is {quoted(each)}",
                    "expected the bare name of a file: it goes into the job's folder",
                )
            yield f"--{name}={text}", meaning
