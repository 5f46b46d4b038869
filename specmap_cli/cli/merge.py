"""`specmap merge`: several maps of a building made one."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from specmap_cli.cli.options import Common, Overwrite, Settings, output

Maps = Annotated[
    list[Path], typer.Argument(metavar="MAP", help="Map directories.", show_default=False)
]
Out = Annotated[Path, output("Map directory to write.")]


def merge(
    maps: Maps,
    out: Out = Path("out"),
    overwrite: Overwrite = False,
    *,
    settings: Settings,
    common: Common,
) -> None:
    """Make one map of several.

    The order does not matter: frame, ids and names are those of the map with the earliest
    recording. Maps that meet nowhere stay apart, side by side, and are named.

    \b
    specmap merge monday tuesday wednesday -o week
    """
    from specmap_cli.maps.store import read_map
    from specmap_cli.pipelines.localize import settings_for
    from specmap_cli.pipelines.merge import merge_maps, oldest

    stored = [read_map(path, settings.load().limits) for path in maps]
    with common.progress() as progress:
        report = merge_maps(
            stored,
            out,
            settings_for(oldest(stored), settings.overrides(), settings.config, settings.preset),
            overwrite=overwrite,
            progress=progress,
        )
    common.show(report.as_dict(), report.lines())
