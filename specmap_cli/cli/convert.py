"""`specmap convert`: recordings of other formats as MCAP."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from specmap_cli.cli import options
from specmap_cli.cli.targets import check_files


def convert(
    logs: options.Logs,
    out: Annotated[Path, typer.Argument(metavar="OUT.mcap", help="MCAP to write.")],
    overwrite: options.Overwrite = False,
    quiet: options.Quiet = False,
    as_json: options.Json = False,
) -> None:
    """Convert a recording of another format to MCAP.

    A CARMEN log, ROS 1 bag or rosbag2 recording becomes an MCAP of ROS 2 messages. Keeps scans,
    point clouds, odometry and transforms; says what it left out.

    \b
    specmap convert log.bag log.mcap
    """
    from specmap_cli.cli.console import ConsoleProgress, print_result
    from specmap_cli.logs.convert import convert as convert_log

    check_files([out], logs, overwrite=overwrite)
    with ConsoleProgress(quiet) as progress:
        conversion = convert_log(logs, out, overwrite=overwrite, progress=progress)
    print_result({**asdict(conversion), "path": str(out)}, conversion.lines(), as_json)
