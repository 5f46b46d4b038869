"""`specmap simulate`: a recording of a simulated robot touring a floor plan."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from specmap_cli.cli import options
from specmap_cli.cli.targets import check_files

Plan = Annotated[
    Path,
    typer.Argument(metavar="PLAN", help="Floor plan: map_server .yaml, or .png with --resolution."),
]
Out = Annotated[
    Path, typer.Option("--out", "-o", help="MCAP to write; the true poses go beside it, as .tum.")
]
Resolution = Annotated[
    float | None, typer.Option(help="Metres per pixel of a plan without a .yaml.")
]
FieldOfView = Annotated[float, typer.Option(help="Field of view, degrees.")]
Beams = Annotated[int, typer.Option(help="Beams a scan.")]
Range = Annotated[float, typer.Option("--range", help="Longest range, metres.")]
Rate = Annotated[float, typer.Option(help="Scans a second.")]
SweepTime = Annotated[float, typer.Option(help="Seconds from a scan's first beam to its last.")]
Noise = Annotated[float, typer.Option(help="Standard deviation of a range, metres.")]
Dropouts = Annotated[float, typer.Option(help="Share of beams that return nothing.")]
Speed = Annotated[float, typer.Option(help="Metres a second.")]
Drift = Annotated[float, typer.Option(help="Errors of the odometry: 0 exact, 1 a usual robot.")]
Spacing = Annotated[float, typer.Option(help="The path comes this near to every place, metres.")]
Laps = Annotated[int, typer.Option(help="Tours, each by another route.")]
MaxDuration = Annotated[float | None, typer.Option(help="End the recording after so many seconds.")]
Seed = Annotated[int, typer.Option(help="Another seed, another route and other errors.")]


def simulate(
    plan: Plan,
    out: Out,
    resolution: Resolution = None,
    fov: FieldOfView = 270.0,
    beams: Beams = 541,
    range_max: Range = 20.0,
    rate: Rate = 10.0,
    sweep: SweepTime = 0.0,
    noise: Noise = 0.01,
    dropouts: Dropouts = 0.0,
    speed: Speed = 0.6,
    odometry_drift: Drift = 1.0,
    spacing: Spacing = 2.0,
    laps: Laps = 1,
    max_duration: MaxDuration = None,
    seed: Seed = 0,
    overwrite: options.Overwrite = False,
    quiet: options.Quiet = False,
    as_json: options.Json = False,
) -> None:
    """Record a simulated robot that tours a floor plan.

    A robot with a planar laser drives through all space it can reach. Writes an MCAP with /scan,
    /odom and /tf_static, and the true poses beside it as .tum.

    \b
    specmap simulate plan.yaml -o tour.mcap --laps 2
    specmap simulate plan.png --resolution 0.05 -o tour.mcap --fov 360 --beams 720
    """
    from specmap_cli.cli.console import ConsoleProgress, print_result
    from specmap_cli.grids.map_server import read_grid
    from specmap_cli.pipelines.simulate import simulate as record
    from specmap_cli.pipelines.simulate import simulation_options

    robot = simulation_options(
        field_of_view_deg=fov,
        beams=beams,
        range_max_m=range_max,
        rate_hz=rate,
        sweep_s=sweep,
        noise_m=noise,
        dropouts=dropouts,
        speed_mps=speed,
        odometry_drift=odometry_drift,
        spacing_m=spacing,
        laps=laps,
        max_duration_s=max_duration,
        seed=seed,
    )
    truth = out.parent / f"{out.stem}.tum"
    check_files([out, truth], [plan], overwrite=overwrite)
    with ConsoleProgress(quiet) as progress:
        made = record(read_grid(plan, resolution), robot, out, truth, progress)
    print_result(made.as_dict(), made.lines(), as_json)
