"""The commands about recordings: info, convert, simulate."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import typer

from specmap_cli.cli.options import (
    RECORDING,
    Bounds,
    Common,
    Logs,
    LogSettings,
    Overwrite,
    Resolution,
    check_files,
    output,
)
from specmap_cli.core.errors import UsageError


def info(
    logs: Logs,
    settings: LogSettings,
    common: Common,
    check: Annotated[
        bool,
        typer.Option(
            "--check", help="Read every message, and compare with the counts of the recording."
        ),
    ] = False,
) -> None:
    """Show what a recording holds, and what to run next.

    Topics with their types, counts and rates, the duration, the frames, the scans, and what
    `specmap build` would read with the same options. Only the beginning is read. --check reads the
    recording to its end: for each topic it shows how many of its messages can be read, where they
    pause, and how many stamps step back.

    \b
    specmap info log.mcap
    specmap info recording_directory --json
    specmap info log.mcap --check
    """
    from specmap_cli.logs import open_log
    from specmap_cli.logs.inspection import summarize

    effective = settings.load()
    with open_log(logs, effective.log) as log, common.progress() as progress:
        summary = summarize(log, effective.log, complete=check, progress=progress)
    common.show(summary.to_dict(), summary.lines())


_OTHERS = frozenset({".bag", ".db3", ".log", ".clf", ".gz"})  # names of recordings of other kinds


def convert(
    paths: Annotated[
        list[Path],
        typer.Argument(
            metavar="LOG",
            help=f"{RECORDING} Without --out the last one is the MCAP to write.",
            show_default=False,
        ),
    ],
    out: Annotated[Path | None, output("MCAP to write.")] = None,
    overwrite: Overwrite = False,
    *,
    settings: Bounds,
    common: Common,
) -> None:
    """Convert a recording of another format to MCAP.

    A CARMEN log, ROS 1 bag or rosbag2 recording becomes an MCAP of ROS 2 messages. Keeps scans,
    point clouds, odometry and transforms; says what it left out. Of the settings, those that bound
    what is unpacked count, such as log.chunk_max_mb.

    \b
    specmap convert log.bag -o log.mcap
    specmap convert log.bag log.mcap
    """
    from specmap_cli.logs.writer import convert as convert_log

    logs, target = (paths, out) if out is not None else (paths[:-1], paths[-1])
    if not logs:
        raise UsageError(f"name the MCAP to write: specmap convert {target} -o OUT.mcap")
    check_files([target], logs, common, overwrite=overwrite)
    if target.suffix.lower() in _OTHERS:
        raise UsageError("what is written is an MCAP", "name it so: OUT.mcap", where=target)
    bounds = settings.load().log
    with common.progress() as progress:
        conversion = convert_log(
            logs, target, overwrite=overwrite, progress=progress, config=bounds
        )
    common.show({**asdict(conversion), "path": str(target)}, conversion.lines())


@dataclass(frozen=True, slots=True, kw_only=True)
class Simulated:
    """The options of the laser, then of the robot and its tour, as in `SimulationOptions`."""

    field_of_view_deg: Annotated[float, typer.Option("--fov", help="Field of view, degrees.")] = (
        270.0
    )
    beams: Annotated[int, typer.Option(help="Beams a scan.")] = 541
    range_max_m: Annotated[float, typer.Option("--range", help="Longest range, metres.")] = 20.0
    rate_hz: Annotated[float, typer.Option("--rate", help="Scans a second.")] = 10.0
    sweep_s: Annotated[
        float, typer.Option("--sweep", help="Seconds from a scan's first beam to its last.")
    ] = 0.0
    noise_m: Annotated[
        float, typer.Option("--noise", help="Standard deviation of a range, metres.")
    ] = 0.01
    dropouts: Annotated[float, typer.Option(help="Share of beams that return nothing.")] = 0.0
    rings: Annotated[
        int, typer.Option(help="Of a 3D lidar, each of so many beams. 1: a planar laser.")
    ] = 1
    vertical_fov_deg: Annotated[
        float, typer.Option("--vertical-fov", help="3D: lowest ring to highest, degrees.")
    ] = 45.0
    laser_height_m: Annotated[
        float, typer.Option("--laser-height", help="3D: lidar above the floor, metres.")
    ] = 0.6
    ceiling_m: Annotated[
        float, typer.Option("--ceiling", help="3D: walls and ceiling above the floor, metres.")
    ] = 2.5
    speed_mps: Annotated[float, typer.Option("--speed", help="Metres a second.")] = 0.6
    odometry_drift: Annotated[
        float, typer.Option(help="Errors of the odometry: 0 exact, 1 a usual robot.")
    ] = 1.0
    spacing_m: Annotated[
        float, typer.Option("--spacing", help="The path comes this near to every place, metres.")
    ] = 2.0
    laps: Annotated[int, typer.Option(help="Tours, each by another route.")] = 1
    max_duration_s: Annotated[
        float | None,
        typer.Option("--max-duration", help="End the recording after so many seconds."),
    ] = None
    seed: Annotated[int, typer.Option(help="Another seed, another route and other errors.")] = 0


def simulate(
    context: typer.Context,
    plan: Annotated[
        Path,
        typer.Argument(
            metavar="PLAN", help="Floor plan: map_server .yaml, or .png with --resolution."
        ),
    ],
    out: Annotated[Path, output("MCAP to write; the true poses go beside it, as .tum.")],
    resolution: Resolution = None,
    overwrite: Overwrite = False,
    *,
    simulated: Simulated,
    settings: Bounds,
    common: Common,
) -> None:
    """Record a simulated robot that tours a floor plan.

    A robot with a planar laser drives through all space it can reach. Writes an MCAP with /scan,
    /odom and /tf_static, and the true poses beside it as .tum. With --rings it has a 3D lidar, and
    /points in place of /scan. Of the settings only the section `limits` counts: how large the
    picture of the plan may be.

    \b
    specmap simulate plan.yaml -o tour.mcap --laps 2
    specmap simulate plan.png --resolution 0.05 -o tour.mcap --fov 360 --beams 720
    specmap simulate plan.yaml -o tour.mcap --fov 360 --rings 64 --beams 1024
    """
    from specmap_cli.grids.map_server import files_of_grid, read_grid
    from specmap_cli.pipelines.simulate import simulate as record
    from specmap_cli.simulation.simulator import simulation_options

    limits = settings.load().limits
    try:
        options = simulation_options(**asdict(simulated))
    except UsageError as error:
        names = {one.name: one.opts[0] for one in context.command.params}
        raise UsageError(error.found, where=names.get(error.where or "")) from None
    truth = out.parent / f"{out.stem}.tum"
    check_files([out, truth], files_of_grid(plan), common, overwrite=overwrite)
    with common.progress() as progress:
        floor = read_grid(plan, resolution, limits, progress)
        made = record(floor, options, out, truth, progress)
    common.show(made.as_dict(), made.lines())
