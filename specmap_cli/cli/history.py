"""`specmap history`: maps of many days, room by room."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from specmap_cli.cli.options import Common, Overwrite, Settings, output
from specmap_cli.cli.targets import keep_inputs
from specmap_cli.core.errors import MapError

Maps = Annotated[
    list[Path],
    typer.Argument(
        metavar="MAP...", help="Map directories, or directories of them.", show_default=False
    ),
]
Timezone = Annotated[
    str, typer.Option(metavar="NAME", help="Where days begin and end, such as Europe/Berlin.")
]


def history(
    maps: Maps,
    out: Annotated[
        Path | None,
        output(
            "Directory to write: history.html, history.json, visits.csv, days.csv, changes.csv."
        ),
    ] = None,
    timezone: Timezone = "UTC",
    overwrite: Overwrite = False,
    *,
    settings: Settings,
    common: Common,
) -> None:
    """Tell which rooms were visited how often, and what changed when.

    Maps of many days are put in the order of their recordings. Those that fit to one another are
    one building; each is compared with the one before. A recording that several maps were made of
    counts once. A map that cannot be read is left out and told, and the exit code is 3 at the end.
    Of the settings only the section `limits` counts.

    \b
    specmap history monday tuesday wednesday
    specmap history maps/ -o week --timezone Europe/Berlin
    """
    from specmap_cli.pipelines.history import history_of, write_history

    if out is not None:
        keep_inputs([out], maps)
    limits = settings.load().limits
    with common.progress() as progress:
        report = history_of(maps, timezone, limits, progress)
        if out is not None:
            write_history(report, out, overwrite, limits, progress)
    common.show(report.as_dict(), report.lines())
    if not report.whole:
        raise typer.Exit(MapError.exit_code)
