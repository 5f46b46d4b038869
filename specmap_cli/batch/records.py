"""The records of a batch: what a job is, and what came of it.

`Job` and its parts say what is to be done; they are made by `batch.jobs`, and can be pickled.
`JobRecord` and its parts are the format of `job.json`, which a finished job leaves in its folder.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal, get_args

from pydantic import Field

from specmap_cli.core.json_values import Record, Value
from specmap_cli.core.schemas import ModelSchema

Command = Literal["build", "localize", "evaluate", "export", "report", "check"]
COMMANDS: tuple[Command, ...] = get_args(Command)

# Why a job failed:
#   log       a recording is missing, damaged or holds nothing usable (exit code 3)
#   no-result the step finished and has nothing to show (4)
#   rule      the result breaks a rule that was asked for; it is kept (5)
#   settings  an option or a setting is wrong (2)
#   memory    more memory than the limit, or than the machine has
#   time      more time than the limit
#   place     a disk or a store where files are cannot be used: full, out of reach
#   worker    the worker was lost or told to end
#   bug       a bug of the program (1)
Kind = Literal["log", "no-result", "rule", "settings", "memory", "time", "place", "worker", "bug"]

# What lies in the folder of a job.
MAP, REPORT, LABELS, CONFUSION = "map", "report.html", "labels.csv", "confusion.png"
JOB, LOG_TEXT = "job.json", "log.txt"

EXTRA = "'specmap-cli[batch]'"  # the extra of this package that a batch needs

OptionValue = str | int | float | bool | list[Any]
Meaning = Literal["flag", "text", "input", "output"]


@dataclass(frozen=True, slots=True)
class Option:
    """An option of a command: its long names without dashes, and what it takes.

    That is nothing, a text, the path of an input, or the name of an output.
    """

    names: tuple[str, ...]
    meaning: Meaning
    several: bool = False


@dataclass(frozen=True, slots=True)
class Step:
    """A command of a job, and its options as they stand on the command line: `--seed=3`.

    `inputs` are those of the options whose values are paths that the result depends on.
    """

    command: Command
    options: tuple[str, ...] = ()
    inputs: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Job:
    """Steps to run on one recording.

    `name` is that of its folder in the output: safe, and no other job's. `logs` are the files of
    the recording, one as a rule: absolute paths, or URLs that fsspec knows.
    """

    name: str
    logs: tuple[str, ...]
    steps: tuple[Step, ...]


@dataclass(frozen=True, slots=True)
class Plan:
    """What is to be done with each log: steps by name, and the options of each step.

    Options have their long names without the dashes; a list gives one several times, and `true`
    is a flag. It is what a TOML file of jobs says, and what holds where it is silent. `known` are
    the options that each command has, by each of their names.
    """

    steps: tuple[Command, ...] = ("build", "report", "check")
    options: Mapping[str, Mapping[str, OptionValue]] = field(default_factory=dict)
    known: Mapping[Command, Mapping[str, Option]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Limits(Value):
    """What a job may use: memory at any time, and time for all of its steps together."""

    memory_mb: Annotated[int | None, Field(description="megabytes; null: none")] = None
    time_s: Annotated[float | None, Field(description="seconds; null: none")] = None


@dataclass(frozen=True, slots=True)
class Terms:
    """What is the same for all jobs.

    `output` is a directory or a URL of fsspec, `scratch` a directory for temporary files (None:
    that of the system), `redo` whether results that are there are made again.
    """

    output: str
    limits: Limits = field(default_factory=Limits)
    scratch: str | None = None
    redo: bool = False


@dataclass(frozen=True, slots=True)
class Turn:
    """One attempt at a job; `alone`: nothing else runs, and it may use what all workers may."""

    job: Job
    attempt: int = 1
    alone: bool = False


class StepOutcome(Record, strict=True):
    """How one step ended."""

    command: Command = Field(description="the command that was run")
    exit_code: int = Field(description="of its process; negative: the signal that ended it")
    wall_s: float = Field(description="seconds that it took")
    cpu_s: float = Field(description="seconds of processor time that it used")
    memory_mb: float | None = Field(description="most megabytes it was seen to hold")
    reason: str | None = Field(description="why it failed, in a line; null where it did not")
    warnings: tuple[str, ...] = Field(
        default=(), description="what it warned of, such as parts of a log that are lost"
    )


class InputRecord(Record, strict=True):
    """One log of the job as it was when the job was run."""

    log: str = Field(description="path or URL")
    bytes: int | None = Field(description="its size; null where the store does not tell")
    identity: str = Field(description="hash of what it was known by: see docs/batch.md")


class JobRecord(Record, strict=True):
    """The whole of job.json: a folder that has it holds a complete result."""

    schema_version: Literal[1] = Field(description="the version of this format")
    name: str = Field(description="of the job, and of its folder")
    digest: str = Field(
        description="SHA-256 of all that decides the result; empty where a log cannot be reached"
    )
    version: str = Field(description="of specmap")
    state: Literal["done", "failed"] = Field(description="how the job ended")
    kind: Kind | None = Field(description="what kind of failure; null where it is done")
    reason: str | None = Field(description="why it failed, in a line; null where it is done")
    attempts: int = Field(description="how many times it was tried, this time included")
    limits: Limits = Field(description="the limits of the last attempt")
    started_utc: str = Field(description="when the last attempt began, ISO 8601")
    wall_s: float = Field(description="seconds of the last attempt, fetching of logs included")
    cpu_s: float = Field(description="seconds of processor time of its steps")
    memory_mb: float | None = Field(description="most megabytes that a step was seen to hold")
    steps: tuple[StepOutcome, ...] = Field(description="the steps that were run, in order")
    figures: dict[str, float | str | None] = Field(
        description="figures of the map, as `specmap check` has them, and its verdict; else empty"
    )
    inputs: tuple[InputRecord, ...] = Field(description="the logs")
    files: dict[str, int] = Field(description="the files of the result and their bytes")


@dataclass(frozen=True, slots=True)
class JobResult:
    """What a worker returns of a job: its record, and whether it was there already."""

    record: JobRecord
    resumed: bool = False


SCHEMA = ModelSchema(JobRecord, "job", 1, "specmap batch: job.json")
