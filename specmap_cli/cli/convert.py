"""`specmap convert`: recordings of other formats as MCAP."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from specmap_cli.cli.options import RECORDING, Common, Overwrite, Settings, output
from specmap_cli.cli.targets import check_files
from specmap_cli.core.errors import UsageError

Paths = Annotated[
    list[Path],
    typer.Argument(
        metavar="LOG",
        help=f"{RECORDING} Without --out the last one is the MCAP to write.",
        show_default=False,
    ),
]


def convert(
    paths: Paths,
    out: Annotated[Path | None, output("MCAP to write.")] = None,
    overwrite: Overwrite = False,
    *,
    settings: Settings,
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
    bounds = settings.load().log
    with common.progress() as progress:
        conversion = convert_log(
            logs, target, overwrite=overwrite, progress=progress, config=bounds
        )
    common.show({**asdict(conversion), "path": str(target)}, conversion.lines())
