"""`specmap batch`: many logs at once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from specmap_cli.cli.entry import ConsoleProgress, print_text
from specmap_cli.cli.options import Common, Settings, cluster_of, options_of, output
from specmap_cli.core.errors import BROKEN_RULE

if TYPE_CHECKING:
    from specmap_cli.batch.batch import EventRecord, Ledger
    from specmap_cli.batch.records import Command, Option, Plan


class StepName(StrEnum):
    """The steps that a job may have; more of them, with options, in a TOML file of jobs."""

    build = "build"
    localize = "localize"
    evaluate = "evaluate"
    export = "export"
    report = "report"
    check = "check"


@dataclass(frozen=True, slots=True, kw_only=True)
class Sharing:
    """Who does the work, and how much of the machine it may take."""

    workers: Annotated[
        int | None, typer.Option(min=1, help="Worker processes; default: one a processor.")
    ] = None
    scheduler: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="Dask scheduler to use, such as tcp://host:8786."),
    ] = None
    memory_limit: Annotated[
        int | None,
        typer.Option(
            min=64, metavar="MB", help="Memory of a worker; default: its share of the machine's."
        ),
    ] = None
    time_limit: Annotated[
        float | None, typer.Option(min=1.0, metavar="SECONDS", help="Longest time of a job.")
    ] = None
    retries: Annotated[
        int,
        typer.Option(min=0, help="How often to try again what a lost worker or disk made fail."),
    ] = 1


def batch(
    inputs: Annotated[
        list[str],
        typer.Argument(
            metavar="LOG|DIR|GLOB|JOBS.toml",
            help="Recordings, directories and patterns of recordings, TOML files of jobs; paths or "
            "URLs such as s3://bucket/logs.",
            show_default=False,
        ),
    ],
    out: Annotated[
        str, output("Directory, or URL such as s3://bucket/maps, to write.", metavar="DIR")
    ],
    *,
    sharing: Sharing,
    step: Annotated[
        list[StepName] | None,
        typer.Option("--step", help="Step of each job; repeatable. Default: build, report, check."),
    ] = None,
    scratch: Annotated[
        Path | None, typer.Option(help="Directory of the workers for temporary files.")
    ] = None,
    redo: Annotated[bool, typer.Option("--redo", help="Do again what is complete.")] = False,
    settings: Settings,
    common: Common,
) -> None:
    """Build maps of many logs; exit code 5 when a job fails.

    Every log is a job with a folder of its own in DIR. A bad log stops none of the others; a job
    whose result is there, made of the same log with the same settings and version, is not done
    again. Summaries and index.html tell what came of all. With --json, a line of JSON an event.

    \b
    specmap batch logs/ -o maps
    specmap batch 'logs/*.mcap' -o maps --workers 4 --step build
    specmap batch jobs.toml -o s3://bucket/maps --scheduler tcp://host:8786
    """
    cluster = cluster_of(sharing.workers, sharing.scheduler, common)
    from specmap_cli.batch.batch import run_batch
    from specmap_cli.batch.jobs import jobs_of
    from specmap_cli.batch.records import Limits, Terms

    settings.load()  # a wrong setting is told of once, not by every job
    jobs = jobs_of(inputs, _plan(step, settings))
    limits = Limits(sharing.memory_limit, sharing.time_limit)
    terms = Terms(out, limits, str(scratch.absolute()) if scratch else None, redo)
    with common.progress() as progress:
        progress.start(f"0 of {len(jobs)} jobs", len(jobs))
        ledger = run_batch(jobs, terms, cluster, sharing.retries, *_listeners(common, progress))
    if not common.as_json:
        common.show({}, _lines(out, ledger))
    if ledger.failed:
        raise typer.Exit(BROKEN_RULE)


def _plan(steps: list[StepName] | None, settings: Settings) -> Plan:
    """What is done with each log where no file of jobs says otherwise."""
    from specmap_cli.batch.records import Plan

    given: dict[str, Any] = {
        "preset": settings.preset,
        "config": settings.config and str(settings.config),
        "set": settings.assignments,
    }
    options = {"build": {name: value for name, value in given.items() if value}}
    plan = Plan(options=options, known=known_options())
    return replace(plan, steps=tuple(one.value for one in steps)) if steps else plan


def known_options() -> dict[Command, dict[str, Option]]:
    """The options of the commands that a job may have."""
    from typer.main import get_command

    from specmap_cli.batch.records import COMMANDS
    from specmap_cli.cli.app import app

    commands: dict[str, Any] = get_command(app).commands  # type: ignore[attr-defined]
    return {command: options_of(commands[command]) for command in COMMANDS}


def _listeners(
    common: Common, progress: ConsoleProgress
) -> tuple[Callable[[EventRecord], None], Callable[[Ledger], None]]:
    """Events as lines of JSON on stdout; what a person should know, and a bar, on stderr."""

    def tell(event: EventRecord) -> None:
        if common.as_json:
            print_text(event.line())
        if event.event in ("failed", "retried") or event.state == "failed":
            again = "; it is tried again" if event.event == "retried" else ""
            progress.warn(f"{event.job}: {event.kind}: {event.reason}{again}")
        if event.event == "stranded":
            progress.warn(f"{event.reason}")

    def show(ledger: Ledger) -> None:
        progress.reach(len(ledger.results), ledger.headline())

    return tell, show


def _lines(out: str, ledger: Ledger) -> list[str]:
    """How it went, for a person; what failed and why was told when it failed."""
    from specmap_cli.batch.summaries import INDEX, headline, kinds_of, rows_of

    rows = rows_of((job.name for job in ledger.jobs), ledger.results)
    kinds = ", ".join(f"{count:,} {kind}" for kind, count in kinds_of(rows))
    return [
        f"{out}: {headline(rows)}",
        *(
            [f"{out}: {ledger.resumed:,} of the results were there already"]
            if ledger.resumed
            else []
        ),
        *([f"{out}: failures: {kinds}; reasons are in summary.md"] if kinds else []),
        f"look at {out}/{INDEX}",
    ]
