"""`specmap segment`: an existing occupancy grid into submaps."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from specmap_cli.cli import options
from specmap_cli.cli.targets import check_files, keep_inputs

Grid = Annotated[
    Path, typer.Argument(metavar="MAP", help="map_server .yaml, or .png/.pgm with --resolution.")
]
Out = Annotated[Path, typer.Option("--out", "-o", help="Directory to write.")]
Resolution = Annotated[
    float | None, typer.Option(help="Metres per pixel of a map without a .yaml.")
]
Explain = Annotated[
    Path | None, typer.Option(help="PNG of the nodes, the sight lines and the eigenvalues.")
]


def segment(
    grid: Grid,
    out: Out = Path("out"),
    resolution: Resolution = None,
    explain: Explain = None,
    overwrite: options.Overwrite = False,
    preset: options.Preset = None,
    config: options.ConfigFile = None,
    settings: options.Settings = None,
    as_json: options.Json = False,
) -> None:
    """Divide an existing occupancy grid into submaps.

    Rooms, corridors and halls. Writes topology.json, labels.png (16 bit), overview.png and a grid
    of each submap.

    \b
    specmap segment map.yaml -o rooms
    specmap segment plan.png --resolution 0.05 -o rooms
    """
    from specmap_cli.cli.console import print_result
    from specmap_cli.core.config import load_config
    from specmap_cli.pipelines.segment import partition_map

    effective = load_config(config, preset, options.overrides(settings))
    check_files([explain], [grid], overwrite=overwrite)
    keep_inputs([out], [grid])
    report = partition_map(
        grid, out, effective, resolution=resolution, overwrite=overwrite, explain=explain
    )
    print_result(report.as_dict(), report.lines(), as_json)
