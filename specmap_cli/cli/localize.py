"""`specmap localize`: in which submap of a map the scans of another log were taken."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from specmap_cli.cli import options


def localize(
    logs: options.Logs,
    map_directory: Annotated[
        Path, typer.Option("--map", "-m", help="Map directory written by `specmap build`.")
    ],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="CSV to write, a line a scan.")
    ] = None,
    plot: Annotated[
        Path | None, typer.Option(help="PNG of the predicted submap along the trajectory.")
    ] = None,
    offline: Annotated[
        bool, typer.Option("--offline", help="Smooth over the whole log instead of filtering.")
    ] = False,
    metric: Annotated[
        bool, typer.Option("--metric", help="Also match each scan within its submap's grid.")
    ] = False,
    settings: options.Settings = None,
    scan_topic: options.ScanTopic = None,
    odom_topic: options.OdomTopic = None,
    base_frame: options.BaseFrame = None,
    no_odometry: options.NoOdometry = False,
    overwrite: options.Overwrite = False,
    quiet: options.Quiet = False,
    as_json: options.Json = False,
) -> None:
    """Tell, scan by scan, in which submap of a map another log was taken.

    Gives the raw vote of single scans and the label of a hidden Markov filter over the topology.
    Uses the settings of the map; --set changes one. Example: specmap localize scans.mcap --map out
    """
    from specmap_cli.cli.console import ConsoleProgress, print_result
    from specmap_cli.config import LogConfig, with_overrides
    from specmap_cli.errors import UsageError
    from specmap_cli.localization import localize_log, write_csv, write_plot
    from specmap_cli.outputs.store import read_map

    for target in (output, plot):
        if target is not None and target.exists() and not overwrite:
            raise UsageError(f"{target}: exists already: choose another name or say --overwrite")
    stored = read_map(map_directory)
    flags = options.overrides(
        settings,
        scan_topic=scan_topic,
        odom_topic=odom_topic,
        base_frame=base_frame,
        no_odometry=no_odometry,
    )
    built_with = stored.config.model_copy(update={"log": LogConfig()})
    with ConsoleProgress(quiet) as progress:
        report = localize_log(
            logs,
            stored,
            with_overrides(built_with, flags),
            offline=offline,
            metric=metric,
            progress=progress,
        )
    if output is not None:
        write_csv(output, report, metric)
    if plot is not None:
        write_plot(plot, report, stored, metric)
    print_result(report.as_dict(), report.lines(), as_json)
