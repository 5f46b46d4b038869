"""`specmap info`: what a recording holds and which command to run next."""

from __future__ import annotations

from typing import Annotated

import typer

from specmap_cli.cli.options import Common, Logs, LogSettings

Check = Annotated[
    bool,
    typer.Option(
        "--check", help="Read every message, and compare with the counts of the recording."
    ),
]


def info(logs: Logs, settings: LogSettings, common: Common, check: Check = False) -> None:
    """Show what a recording holds, and what to run next.

    Topics with their types, counts and rates, the duration, the frames, the scans, and what
    `specmap build` would read with the same options. Only the beginning is read. --check reads the
    recording to its end: for each topic it shows how many of its messages can be read, where they
    pause, and how many stamps step back.

    \b
    specmap info log.mcap
    specmap info recording_directory --json
    specmap info log.mcap --check
    """
    from specmap_cli.logs import open_log
    from specmap_cli.logs.inspection import summarize

    effective = settings.load()
    with open_log(logs, effective.log) as log, common.progress() as progress:
        summary = summarize(log, effective.log, complete=check, progress=progress)
    common.show(summary.to_dict(), summary.lines())
