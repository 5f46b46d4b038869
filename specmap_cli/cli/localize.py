"""`specmap localize`: in which submap of a map the scans of another log were taken."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from specmap_cli.cli import options
from specmap_cli.cli.targets import check_files

MapDirectory = Annotated[
    Path, typer.Option("--map", "-m", help="Map directory written by `specmap build`.")
]
Output = Annotated[Path | None, typer.Option("--output", "-o", help="CSV to write, a line a scan.")]
Plot = Annotated[
    Path | None, typer.Option(help="PNG to write: the predicted submap along the trajectory.")
]
Offline = Annotated[
    bool, typer.Option("--offline", help="Smooth over the whole log instead of filtering.")
]
Metric = Annotated[
    bool, typer.Option("--metric", help="Also match each scan within its submap's grid.")
]


def localize(
    logs: options.Logs,
    map_directory: MapDirectory,
    output: Output = None,
    plot: Plot = None,
    offline: Offline = False,
    metric: Metric = False,
    settings: options.Settings = None,
    scan_topic: options.ScanTopic = None,
    odom_topic: options.OdomTopic = None,
    base_frame: options.BaseFrame = None,
    no_odometry: options.NoOdometry = False,
    overwrite: options.Overwrite = False,
    quiet: options.Quiet = False,
    as_json: options.Json = False,
) -> None:
    """Tell, scan by scan, in which submap a log was recorded.

    Gives the raw vote of single scans and the label of a hidden Markov filter over the topology.
    Uses the settings of the map, but for topics and frames; --set changes one.

    \b
    specmap localize other.mcap --map map -o labels.csv --plot labels.png
    specmap localize other.mcap --map map --offline --metric --json
    """
    from specmap_cli.cli.console import ConsoleProgress, print_result
    from specmap_cli.maps.store import read_map
    from specmap_cli.pipelines.localize import localize_log, settings_for, write_csv, write_plot

    check_files([output, plot], logs, overwrite=overwrite)
    stored = read_map(map_directory)
    flags = options.overrides(settings, scan_topic, odom_topic, base_frame, no_odometry)
    config = settings_for(stored, flags)
    with ConsoleProgress(quiet) as progress:
        report = localize_log(
            logs, stored, config, offline=offline, metric=metric, progress=progress
        )
    if output is not None:
        write_csv(output, report, metric)
    if plot is not None:
        write_plot(plot, report, stored, metric)
    print_result(report.as_dict(), report.lines(), as_json)
