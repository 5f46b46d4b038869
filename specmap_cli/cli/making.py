"""The commands that make maps: build, update, merge; segment, of an occupancy grid; batch."""

from __future__ import annotations

import inspect
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, cast, get_args

import typer

from specmap_cli.cli.entry import ConsoleProgress, print_text
from specmap_cli.cli.options import (
    WRITTEN,
    Common,
    Logs,
    LogSettings,
    NewMap,
    Overwrite,
    Resolution,
    Settings,
    argument,
    check_files,
    cluster_of,
    keep_inputs,
    option,
    output,
)
from specmap_cli.core.errors import BROKEN_RULE, UsageError

if TYPE_CHECKING:
    from specmap_cli.batch.batch import EventRecord, Ledger
    from specmap_cli.batch.records import Command, Meaning, Option, Plan

FailOn = Annotated[
    Literal["doubtful", "poor"] | None,
    option("Exit with code 5 when the map is doubtful, or poor. It is written anyway."),
]


def build(
    logs: Logs,
    out: NewMap = Path("out"),
    no_relax: Annotated[
        bool, option("Leave the layout as registration found it.", "--no-relax")
    ] = False,
    explain: Annotated[
        Path | None,
        option("Directory for a picture of every test that may split a submap; not with --like."),
        WRITTEN,
    ] = None,
    seed: Annotated[int | None, option("Seed of everything random.")] = None,
    like: Annotated[
        Path | None, option("Map directory whose settings, frame, ids, names and borders it takes.")
    ] = None,
    overwrite: Overwrite = False,
    fail_on: FailOn = None,
    *,
    settings: LogSettings,
    common: Common,
) -> None:
    """Build a topological map of a recording.

    Streams the scans, registers them, splits the space into submaps as the robot moves, closes
    loops, and writes the map directory: complete, or not at all.

    \b
    specmap build log.mcap
    specmap build log.bag -o map --scan-topic /scan --set grid.resolution_m=0.1
    specmap build today.mcap -o today --like map
    """
    from specmap_cli.core.findings import at_least_as_bad

    flags = {"relaxation.enabled": False if no_relax else None, "seed": seed}
    effective = settings.load(flags)
    keep_inputs([out], logs)
    if like is not None and explain is not None:
        raise UsageError("--like and --explain do not go together", "build without one of them")
    with common.progress() as progress:
        if like is None:
            from specmap_cli.pipelines.build import build_map

            report = build_map(
                logs, out, effective, overwrite=overwrite, progress=progress, explain=explain
            )
        else:
            from specmap_cli.pipelines.update import build_like

            old = settings.read(like)
            of_old = settings.of_map(old, flags)
            report = build_like(logs, old, out, of_old, overwrite=overwrite, progress=progress)
    common.show(report.as_dict(), report.lines())
    if fail_on is not None and at_least_as_bad(report.quality.verdict, fail_on):
        raise typer.Exit(BROKEN_RULE)


def update(
    map_: Annotated[Path, argument("MAP", "Map directory to start from.")],
    logs: Logs,
    out: NewMap = Path("out"),
    allow_apart: Annotated[
        bool, option("Append a recording that fits nowhere as a part of its own.", "--allow-apart")
    ] = False,
    overwrite: Overwrite = False,
    *,
    settings: LogSettings,
    common: Common,
) -> None:
    """Add another recording of the building to its map.

    Every submap of the map keeps its id and its name, and its border where the robot does not now
    enter what it had only looked into. Only new space is divided, and gets ids that no submap ever
    had. A recording that fits nowhere is refused. The settings are those of the map, but for topics
    and frames; --config and --set change some of them, --preset takes the place of them all.

    \b
    specmap update out tomorrow.mcap -o out2
    specmap update out tomorrow.mcap -o out --overwrite
    """
    from specmap_cli.pipelines.update import update_map

    stored = settings.read(map_)
    effective = settings.of_map(stored)
    keep_inputs([out], logs)
    with common.progress() as progress:
        report = update_map(
            stored,
            logs,
            out,
            effective,
            allow_apart=allow_apart,
            overwrite=overwrite,
            progress=progress,
        )
    common.show(report.as_dict(), report.lines())


def merge(
    maps: Annotated[list[Path], argument("MAP", "Map directories.")],
    out: NewMap = Path("out"),
    overwrite: Overwrite = False,
    workers: Annotated[
        int | None, option("Align pairs of maps on as many processes.", min=1)
    ] = None,
    scheduler: Annotated[
        str | None,
        option(
            "Align them on the workers of a Dask scheduler, which see the maps.", metavar="ADDRESS"
        ),
    ] = None,
    *,
    settings: Settings,
    common: Common,
) -> None:
    """Make one map of several.

    The order does not matter: frame, ids and names are those of the map with the earliest
    recording. Maps that meet nowhere stay apart, side by side, and are named. Every two maps are
    aligned: of many maps that takes the time, and workers share it.

    \b
    specmap merge monday tuesday wednesday -o week
    specmap merge maps/*/map -o building --workers 8
    """
    from specmap_cli.pipelines.merge import merge_maps, oldest

    stored = [settings.read(path) for path in maps]
    shared = None  # in this process
    if workers is not None or scheduler is not None:
        cluster = cluster_of(workers, scheduler, common)
        from specmap_cli.batch.workers import spread

        shared = partial(spread, cluster)
    with common.progress() as progress:
        report = merge_maps(
            stored,
            out,
            settings.of_map(oldest(stored)),
            overwrite=overwrite,
            progress=progress,
            spread=shared,
        )
    common.show(report.as_dict(), report.lines())


def segment(
    grid: Annotated[Path, argument("MAP", "map_server .yaml, or .png/.pgm with --resolution.")],
    out: Annotated[Path, output("Directory to write.")] = Path("out"),
    resolution: Resolution = None,
    explain: Annotated[
        Path | None, option("PNG of the nodes, the sight lines and the eigenvalues."), WRITTEN
    ] = None,
    overwrite: Overwrite = False,
    *,
    settings: Settings,
    common: Common,
) -> None:
    """Divide an existing occupancy grid into submaps.

    Rooms, corridors and halls. Writes topology.json, labels.png (16 bit), overview.png, and grids
    of the map and of each submap.

    \b
    specmap segment map.yaml -o rooms
    specmap segment plan.png --resolution 0.05 -o rooms
    """
    from specmap_cli.grids.map_server import files_of_grid
    from specmap_cli.maps.directory import refuse_inside
    from specmap_cli.pipelines.segment import segment_map

    effective = settings.load()
    inputs = files_of_grid(grid)
    refuse_inside(explain, out)
    check_files([explain], inputs, common, overwrite=overwrite)
    keep_inputs([out], inputs)
    with common.progress() as progress:
        report = segment_map(
            grid,
            out,
            effective,
            resolution=resolution,
            overwrite=overwrite,
            explain=explain,
            progress=progress,
        )
    common.show(report.as_dict(), report.lines())


# The steps that a job may have; more of them, with options, in a TOML file of jobs.
StepName = StrEnum("StepName", "build localize evaluate export report check")


@dataclass(frozen=True, slots=True, kw_only=True)
class Sharing:
    """Who does the work, and how much of the machine it may take."""

    workers: Annotated[
        int | None, option("Jobs at once on this machine; default: one a processor.", min=1)
    ] = None
    scheduler: Annotated[
        str | None, option("Dask scheduler to use, such as tcp://host:8786.", metavar="ADDRESS")
    ] = None
    memory_limit: Annotated[
        int | None,
        option("Memory of a worker; default: its share of the machine's.", min=64, metavar="MB"),
    ] = None
    time_limit: Annotated[
        float | None, option("Longest time of a job.", min=1.0, metavar="SECONDS")
    ] = None
    retries: Annotated[
        int, option("How often to try again what a lost worker or disk made fail.", min=0)
    ] = 1


def batch(
    inputs: Annotated[
        list[str],
        argument(
            "LOG|DIR|GLOB|JOBS.toml",
            "Recordings, directories and patterns of recordings, TOML files of jobs; paths or "
            "URLs such as s3://bucket/logs.",
        ),
    ],
    out: Annotated[
        str, output("Directory, or URL such as s3://bucket/maps, to write.", metavar="DIR")
    ],
    *,
    sharing: Sharing,
    step: Annotated[
        list[StepName] | None,
        option("Step of each job; repeatable. Default: build, report, check."),
    ] = None,
    scratch: Annotated[Path | None, option("Directory of the workers for temporary files.")] = None,
    redo: Annotated[bool, option("Do again what is complete.", "--redo")] = False,
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
        ledger = run_batch(
            jobs,
            terms,
            cluster,
            sharing.retries,
            tell=partial(_tell, common, progress),
            show=lambda done: progress.reach(len(done.results), done.headline()),
        )
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
    chosen = cast("tuple[Command, ...]", tuple(map(str, steps or ())))
    return replace(plan, steps=chosen) if chosen else plan


def known_options() -> dict[Command, dict[str, Option]]:
    """The options of the commands that a job may have, by each of their long names."""
    from typer.main import get_command

    from specmap_cli.batch.records import COMMANDS, Option
    from specmap_cli.cli.app import app

    commands: dict[str, Any] = get_command(app).commands  # type: ignore[attr-defined]
    known: dict[Command, dict[str, Option]] = {command: {} for command in COMMANDS}
    for command, found in known.items():
        hints = inspect.signature(commands[command].callback).parameters
        for parameter in commands[command].params:
            names = tuple(name[2:] for name in parameter.opts if name.startswith("--"))
            if names:
                hint = hints[parameter.name].annotation
                meaning: Meaning = "flag" if parameter.is_flag else "text"
                if _holds_path(hint):
                    meaning = "output" if WRITTEN in hint.__metadata__ else "input"
                found |= dict.fromkeys(names, Option(names, meaning, parameter.multiple))
    return known


def _holds_path(hint: Any) -> bool:
    return hint is Path or any(map(_holds_path, get_args(hint)))


def _tell(common: Common, progress: ConsoleProgress, event: EventRecord) -> None:
    """An event as a line of JSON on stdout; what a person should know of it on stderr."""
    if common.as_json:
        print_text(event.line())
    if event.event in ("failed", "retried") or event.state == "failed":
        again = "; it is tried again" if event.event == "retried" else ""
        progress.warn(f"{event.job}: {event.kind}: {event.reason}{again}")
    if event.event == "stranded":
        progress.warn(str(event.reason))


def _lines(out: str, ledger: Ledger) -> list[str]:
    """How it went, for a person; what failed and why was told when it failed."""
    from specmap_cli.batch.summaries import INDEX, headline, kinds_of, rows_of

    rows = rows_of((job.name for job in ledger.jobs), ledger.results)
    kinds = ", ".join(f"{count:,} {kind}" for kind, count in kinds_of(rows))
    lines = [f"{out}: {headline(rows)}"]
    if ledger.resumed:
        lines.append(f"{out}: {ledger.resumed:,} of the results were there already")
    if kinds:
        lines.append(f"{out}: failures: {kinds}; reasons are in summary.md")
    return [*lines, f"look at {out}/{INDEX}"]
