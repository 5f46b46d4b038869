"""`specmap segment`: an existing occupancy grid into submaps."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from specmap_cli.cli.options import WRITTEN, Common, Overwrite, Resolution, Settings, output
from specmap_cli.cli.targets import check_files, keep_inputs

Grid = Annotated[
    Path, typer.Argument(metavar="MAP", help="map_server .yaml, or .png/.pgm with --resolution.")
]
Explain = Annotated[
    Path | None,
    typer.Option(help="PNG of the nodes, the sight lines and the eigenvalues."),
    WRITTEN,
]


def segment(
    grid: Grid,
    out: Annotated[Path, output("Directory to write.")] = Path("out"),
    resolution: Resolution = None,
    explain: Explain = None,
    overwrite: Overwrite = False,
    *,
    settings: Settings,
    common: Common,
) -> None:
    """Divide an existing occupancy grid into submaps.

    Rooms, corridors and halls. Writes topology.json, labels.png (16 bit), overview.png and a grid
    of each submap.

    \b
    specmap segment map.yaml -o rooms
    specmap segment plan.png --resolution 0.05 -o rooms
    """
    from specmap_cli.pipelines.segment import segment_map

    effective = settings.load()
    check_files([explain], [grid], common, overwrite=overwrite)
    keep_inputs([out], [grid])
    report = segment_map(
        grid, out, effective, resolution=resolution, overwrite=overwrite, explain=explain
    )
    common.show(report.as_dict(), report.lines())
