"""`specmap merge`: several maps of a building made one."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from specmap_cli.cli.options import Common, NewMap, Overwrite, Settings, cluster_of

if TYPE_CHECKING:
    from specmap_cli.pipelines.meetings import Spread

Maps = Annotated[
    list[Path], typer.Argument(metavar="MAP", help="Map directories.", show_default=False)
]
Workers = Annotated[
    int | None,
    typer.Option(
        min=1,
        help="Align pairs of maps on as many processes; needs the extra `batch`.",
    ),
]
Scheduler = Annotated[
    str | None,
    typer.Option(
        metavar="ADDRESS", help="Align them on the workers of a Dask scheduler, which see the maps."
    ),
]


def merge(
    maps: Maps,
    out: NewMap = Path("out"),
    overwrite: Overwrite = False,
    workers: Workers = None,
    scheduler: Scheduler = None,
    *,
    settings: Settings,
    common: Common,
) -> None:
    """Make one map of several.

    The order does not matter: frame, ids and names are those of the map with the earliest
    recording. Maps that meet nowhere stay apart, side by side, and are named. Every two maps are
    aligned: of many maps that takes the time, and workers share it.

    \b
    specmap merge monday tuesday wednesday -o week
    specmap merge maps/*/map -o building --workers 8
    """
    from specmap_cli.maps.store import read_map
    from specmap_cli.pipelines.localize import settings_for
    from specmap_cli.pipelines.merge import merge_maps, oldest

    stored = [read_map(path, settings.load().limits) for path in maps]
    with common.progress() as progress:
        report = merge_maps(
            stored,
            out,
            settings_for(oldest(stored), settings.overrides(), settings.config, settings.preset),
            overwrite=overwrite,
            progress=progress,
            spread=_spread(workers, scheduler),
        )
    common.show(report.as_dict(), report.lines())


def _spread(workers: int | None, scheduler: str | None) -> Spread | None:
    """Where pairs of maps are aligned; None: in this process."""
    if workers is None and scheduler is None:
        return None
    cluster = cluster_of(workers, scheduler)
    from functools import partial

    from specmap_cli.batch.workers import spread

    return partial(spread, cluster)
