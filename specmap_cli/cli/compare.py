"""`specmap compare`: what differs between two maps of one building."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from specmap_cli.cli.options import Common, Overwrite, Settings, output
from specmap_cli.cli.targets import keep_inputs

Old = Annotated[
    Path, typer.Argument(metavar="OLD", help="Map directory written by `specmap build`.")
]
New = Annotated[Path, typer.Argument(metavar="NEW", help="A later map of the same building.")]


def compare(
    old: Old,
    new: New,
    out: Annotated[
        Path | None, output("Directory to write: summary.txt, compare.json, compare.png.")
    ] = None,
    overwrite: Overwrite = False,
    *,
    settings: Settings,
    common: Common,
) -> None:
    """Tell what differs between two maps of one building.

    The maps find each other by what they show; they need no common frame. Then: submaps that are
    the same, new, gone, split or merged; ways that were closed or opened; walls and furniture that
    appeared or vanished, judged where both maps saw. Maps that do not fit in one way only are
    refused with the reason, exit code 4. The settings are those the old map was built with;
    --config, --set and --preset change them as for `localize`.

    \b
    specmap compare monday friday
    specmap compare monday friday -o changes --json
    """
    from specmap_cli.maps.store import read_map
    from specmap_cli.pipelines.compare import compare_maps, write_comparison
    from specmap_cli.pipelines.localize import settings_for

    if out is not None:
        keep_inputs([out], [old, new])
    limits = settings.load().limits
    one, other = read_map(old, limits), read_map(new, limits)
    effective = settings_for(one, settings.overrides(), settings.config, settings.preset)
    with common.progress() as progress:
        found = compare_maps(one, other, effective, progress)
        if out is not None:
            write_comparison(found, out, overwrite, progress)
    common.show(found.as_dict(), found.lines())
