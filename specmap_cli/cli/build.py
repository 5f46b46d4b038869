"""`specmap build`: a recorded log into a topological map."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from specmap_cli.cli import options


def build(
    logs: options.Logs,
    out: Annotated[Path, typer.Option("--out", "-o", help="Map directory to write.")] = Path("out"),
    overwrite: options.Overwrite = False,
    preset: options.Preset = None,
    config: options.ConfigFile = None,
    settings: options.Settings = None,
    scan_topic: options.ScanTopic = None,
    odom_topic: options.OdomTopic = None,
    base_frame: options.BaseFrame = None,
    no_odometry: options.NoOdometry = False,
    no_relax: Annotated[
        bool, typer.Option("--no-relax", help="Leave the layout as registration found it.")
    ] = False,
    explain: Annotated[
        Path | None,
        typer.Option(help="Directory for a picture of every test that may split a submap."),
    ] = None,
    seed: options.Seed = None,
    quiet: options.Quiet = False,
    as_json: options.Json = False,
) -> None:
    """Build a topological map of a recorded log.

    Streams the scans, registers them, splits the space into submaps as the robot moves, closes
    loops, and writes the map directory. Example: specmap build log.mcap -o map
    """
    from specmap_cli.cli.console import ConsoleProgress, print_result
    from specmap_cli.config import load_config
    from specmap_cli.pipeline import build_map

    flags = options.overrides(
        settings,
        scan_topic=scan_topic,
        odom_topic=odom_topic,
        base_frame=base_frame,
        no_odometry=no_odometry,
        seed=seed,
    )
    if no_relax:
        flags["relaxation"] = {**flags.get("relaxation", {}), "enabled": False}
    effective = load_config(config, preset, flags)
    with ConsoleProgress(quiet) as progress:
        report = build_map(
            logs, out, effective, overwrite=overwrite, progress=progress, explain=explain
        )
    print_result(report.as_dict(), report.lines(), as_json)
