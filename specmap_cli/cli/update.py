"""`specmap update`: another recording of the building added to its map."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from specmap_cli.cli.options import Common, Logs, LogSettings, NewMap, Overwrite
from specmap_cli.cli.targets import keep_inputs

Map = Annotated[
    Path, typer.Argument(metavar="MAP", help="Map directory to start from.", show_default=False)
]
AllowApart = Annotated[
    bool,
    typer.Option(
        "--allow-apart", help="Append a recording that fits nowhere as a part of its own."
    ),
]


def update(
    map_: Map,
    logs: Logs,
    out: NewMap = Path("out"),
    allow_apart: AllowApart = False,
    overwrite: Overwrite = False,
    *,
    settings: LogSettings,
    common: Common,
) -> None:
    """Add another recording of the building to its map.

    Every submap of the map keeps its id, its name and its border. Only new space is divided, and
    gets ids that no submap ever had. A recording that fits nowhere is refused.

    \b
    specmap update out tomorrow.mcap -o out2
    specmap update out tomorrow.mcap -o out --overwrite
    """
    from specmap_cli.maps.store import read_map
    from specmap_cli.pipelines.localize import settings_for
    from specmap_cli.pipelines.update import update_map

    stored = read_map(map_, settings.load().limits)
    effective = settings_for(stored, settings.overrides(), settings.config, settings.preset)
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
