"""`specmap build`: a recorded log into a topological map."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from specmap_cli.cli import options
from specmap_cli.cli.targets import keep_inputs

Out = Annotated[Path, typer.Option("--out", "-o", help="Map directory to write.")]
NoRelax = Annotated[
    bool, typer.Option("--no-relax", help="Leave the layout as registration found it.")
]
Explain = Annotated[
    Path | None,
    typer.Option(help="Directory for a picture of every test that may split a submap."),
]


def build(
    logs: options.Logs,
    out: Out = Path("out"),
    overwrite: options.Overwrite = False,
    preset: options.Preset = None,
    config: options.ConfigFile = None,
    settings: options.Settings = None,
    scan_topic: options.ScanTopic = None,
    odom_topic: options.OdomTopic = None,
    base_frame: options.BaseFrame = None,
    no_odometry: options.NoOdometry = False,
    no_relax: NoRelax = False,
    explain: Explain = None,
    seed: options.Seed = None,
    quiet: options.Quiet = False,
    as_json: options.Json = False,
) -> None:
    """Build a topological map of a recording.

    Streams the scans, registers them, splits the space into submaps as the robot moves, closes
    loops, and writes the map directory: complete, or not at all.

    \b
    specmap build log.mcap
    specmap build log.bag -o map --scan-topic /scan --set grid.resolution_m=0.1
    """
    from specmap_cli.cli.console import ConsoleProgress, print_result
    from specmap_cli.core.config import load_config
    from specmap_cli.pipelines.build import build_map

    flags = options.overrides(
        settings, scan_topic, odom_topic, base_frame, no_odometry, no_relax=no_relax, seed=seed
    )
    effective = load_config(config, preset, flags)
    keep_inputs([out], logs)
    with ConsoleProgress(quiet) as progress:
        report = build_map(
            logs, out, effective, overwrite=overwrite, progress=progress, explain=explain
        )
    print_result(report.as_dict(), report.lines(), as_json)
