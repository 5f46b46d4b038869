"""`specmap localize`: in which submap of a map the scans of another log were taken."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from specmap_cli.cli.options import WRITTEN, Common, Logs, LogSettings, Overwrite, output
from specmap_cli.cli.targets import check_files, files_of_map

MapDirectory = Annotated[
    Path, typer.Option("--map", "-m", help="Map directory written by `specmap build`.")
]
Plot = Annotated[
    Path | None,
    typer.Option(help="PNG to write: the predicted submap along the trajectory."),
    WRITTEN,
]
Offline = Annotated[
    bool, typer.Option("--offline", help="Smooth over the whole log instead of filtering.")
]
Metric = Annotated[
    bool, typer.Option("--metric", help="Also match each scan within its submap's grid.")
]


def localize(
    logs: Logs,
    map_directory: MapDirectory,
    out: Annotated[Path | None, output("CSV to write, a line a scan.", "--output")] = None,
    plot: Plot = None,
    offline: Offline = False,
    metric: Metric = False,
    overwrite: Overwrite = False,
    *,
    settings: LogSettings,
    common: Common,
) -> None:
    """Tell, scan by scan, in which submap a log was recorded.

    Gives the raw vote of single scans and the label of a hidden Markov filter over the topology.

    The settings are those the map was built with, but for topics and frames. --config and --set
    change some of them. --preset, and a file that names a preset, take the place of all of them.

    \b
    specmap localize other.mcap --map map -o labels.csv --plot labels.png
    specmap localize other.mcap --map map --offline --metric --json
    """
    from specmap_cli.maps.store import read_map
    from specmap_cli.pipelines.localize import localize_log, settings_for, write_report

    check_files([out, plot], [*logs, *files_of_map(map_directory)], common, overwrite=overwrite)
    stored = read_map(map_directory, settings.load().limits)
    effective = settings_for(stored, settings.overrides(), settings.config, settings.preset)
    with common.progress() as progress:
        report = localize_log(
            logs, stored, effective, offline=offline, metric=metric, progress=progress
        )
    write_report(report, stored, metric=metric, csv=out, plot=plot)
    common.show(report.as_dict(), report.lines())
