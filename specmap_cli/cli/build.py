"""`specmap build`: a recorded log into a topological map."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from specmap_cli.cli.options import WRITTEN, Common, Logs, LogSettings, NewMap, Overwrite
from specmap_cli.cli.targets import keep_inputs
from specmap_cli.core.errors import BROKEN_RULE, UsageError


class FailingVerdict(StrEnum):
    """The verdicts that a build can be asked to fail on."""

    doubtful = "doubtful"
    poor = "poor"


NoRelax = Annotated[
    bool, typer.Option("--no-relax", help="Leave the layout as registration found it.")
]
Explain = Annotated[
    Path | None,
    typer.Option(
        help="Directory for a picture of every test that may split a submap; not with --like."
    ),
    WRITTEN,
]
FailOn = Annotated[
    FailingVerdict | None,
    typer.Option(help="Exit with code 5 when the map is doubtful, or poor. It is written anyway."),
]
Like = Annotated[
    Path | None,
    typer.Option(help="Map directory whose frame, ids, names and borders the new map takes."),
]
Seed = Annotated[int | None, typer.Option(help="Seed of everything random.")]


def build(
    logs: Logs,
    out: NewMap = Path("out"),
    no_relax: NoRelax = False,
    explain: Explain = None,
    seed: Seed = None,
    like: Like = None,
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

    effective = settings.load({"relaxation.enabled": False if no_relax else None, "seed": seed})
    keep_inputs([out], logs)
    if like is not None and explain is not None:
        raise UsageError("--like and --explain do not go together: build without one of them")
    with common.progress() as progress:
        if like is None:
            from specmap_cli.pipelines.build import build_map

            report = build_map(
                logs, out, effective, overwrite=overwrite, progress=progress, explain=explain
            )
        else:
            from specmap_cli.pipelines.update import build_like

            report = build_like(logs, like, out, effective, overwrite=overwrite, progress=progress)
    common.show(report.as_dict(), report.lines())
    if fail_on is not None and at_least_as_bad(report.quality.verdict, fail_on.value):
        raise typer.Exit(BROKEN_RULE)
