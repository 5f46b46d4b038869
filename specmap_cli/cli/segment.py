"""`specmap segment`: an existing occupancy grid into submaps."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from specmap_cli.cli import options


def segment(
    grid: Annotated[
        Path,
        typer.Argument(metavar="MAP", help="map_server .yaml, or .png/.pgm with --resolution."),
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="Directory to write.")] = Path("out"),
    resolution: Annotated[
        float | None, typer.Option(help="Metres per pixel of a map without a .yaml.")
    ] = None,
    overwrite: options.Overwrite = False,
    preset: options.Preset = None,
    config: options.ConfigFile = None,
    settings: options.Settings = None,
    as_json: options.Json = False,
) -> None:
    """Divide an existing occupancy grid into submaps: rooms, corridors, halls.

    Writes topology.json, labels.png (16 bit), overview.png and a grid of each submap.
    Example: specmap segment map.yaml -o rooms
    """
    from specmap_cli.cli.console import print_result
    from specmap_cli.config import load_config
    from specmap_cli.partition import partition_map

    effective = load_config(config, preset, options.overrides(settings))
    report = partition_map(grid, out, effective, resolution=resolution, overwrite=overwrite)
    print_result(report.as_dict(), report.lines(), as_json)
