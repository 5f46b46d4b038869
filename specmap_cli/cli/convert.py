"""`specmap convert`: recordings of other formats as MCAP."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from specmap_cli.cli import options


def convert(
    logs: options.Logs,
    out: Annotated[Path, typer.Argument(metavar="OUT.mcap", help="MCAP to write.")],
    overwrite: options.Overwrite = False,
    as_json: options.Json = False,
) -> None:
    """Convert a CARMEN log, ROS 1 bag or rosbag2 recording to MCAP with ROS 2 messages.

    Keeps scans, point clouds, odometry and transforms; says what it left out.
    Example: specmap convert log.bag log.mcap
    """
    from specmap_cli.cli.console import print_result
    from specmap_cli.logs.convert import convert as convert_log

    conversion = convert_log(logs, out, overwrite=overwrite)
    print_result({**asdict(conversion), "path": str(out)}, conversion.lines(), as_json)
