"""`specmap simulate`: a recording of a simulated robot touring a floor plan."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from specmap_cli.cli import options


def simulate(
    plan: Annotated[
        Path,
        typer.Argument(
            metavar="PLAN", help="Floor plan: map_server .yaml, or .png with --resolution."
        ),
    ],
    out: Annotated[
        Path, typer.Option("--out", "-o", help="MCAP to write; the truth goes beside it.")
    ],
    resolution: Annotated[
        float | None, typer.Option(help="Metres per pixel of a plan without a .yaml.")
    ] = None,
    fov: Annotated[float, typer.Option(help="Field of view, degrees.")] = 270.0,
    beams: Annotated[int, typer.Option(help="Beams a scan.")] = 541,
    range_max: Annotated[float, typer.Option("--range", help="Longest range, metres.")] = 20.0,
    rate: Annotated[float, typer.Option(help="Scans a second.")] = 10.0,
    sweep: Annotated[
        float, typer.Option(help="Seconds from a scan's first beam to its last.")
    ] = 0.0,
    noise: Annotated[float, typer.Option(help="Standard deviation of a range, metres.")] = 0.01,
    dropouts: Annotated[float, typer.Option(help="Share of beams that return nothing.")] = 0.0,
    speed: Annotated[float, typer.Option(help="Metres a second.")] = 0.6,
    odometry_drift: Annotated[
        float, typer.Option(help="Errors of the odometry: 0 exact, 1 a usual robot.")
    ] = 1.0,
    spacing: Annotated[
        float, typer.Option(help="The path comes this near to every place, metres.")
    ] = 2.0,
    laps: Annotated[int, typer.Option(help="Tours, each by another route.")] = 1,
    max_duration: Annotated[
        float | None, typer.Option(help="End the recording after so many seconds.")
    ] = None,
    seed: Annotated[int, typer.Option(help="Another seed, another route and other errors.")] = 0,
    overwrite: options.Overwrite = False,
    quiet: options.Quiet = False,
    as_json: options.Json = False,
) -> None:
    """Record a robot with a planar laser that tours all reachable space of a floor plan.

    Writes an MCAP with /scan, /odom and /tf_static, and the true poses beside it as .tum.
    Example: specmap simulate plan.png --resolution 0.05 -o tour.mcap --laps 2
    """
    from specmap_cli.cli.console import ConsoleProgress, print_result
    from specmap_cli.errors import UsageError
    from specmap_cli.evaluation import simulate as simulation
    from specmap_cli.mapfiles import read_grid

    robot = simulation.simulation_options(
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
    if out.exists() and not overwrite:
        raise UsageError(f"{out}: exists already: choose another name or say --overwrite")
    with ConsoleProgress(quiet) as progress:
        made = simulation.simulate(read_grid(plan, resolution), robot, out, progress=progress)
    print_result(
        {
            "log": str(made.log),
            "truth": str(made.truth),
            "scans": made.scans,
            "duration_s": round(made.duration_s, 3),
            "distance_m": round(made.distance_m, 3),
            "area_m2": round(made.area_m2, 3),
        },
        [
            f"{made.log}: {made.scans:,} scans in {made.duration_s:.0f} s over "
            f"{made.distance_m:.0f} m through {made.area_m2:.0f} m2",
            f"true poses in {made.truth}",
        ],
        as_json,
    )
