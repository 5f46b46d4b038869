"""`specmap report`: a page about a finished map."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from specmap_cli.cli.options import Common, Map, Overwrite, Settings, output
from specmap_cli.cli.targets import check_files, files_of_map

Compare = Annotated[
    Path | None,
    typer.Option(
        metavar="OLD", help="An older map of the same building: what differs is drawn and listed."
    ),
]


def report(
    map_: Map,
    out: Annotated[Path, output("HTML file to write.")] = Path("report.html"),
    compare: Compare = None,
    overwrite: Overwrite = False,
    *,
    settings: Settings,
    common: Common,
) -> None:
    """Write a page about a map, for any browser.

    One file that loads nothing: the map in layers, its submaps with all that is known of them, the
    way of the robot over time, findings, split tests, loop closures, and how the map was made. Of
    the settings only the section `limits` counts: how large a file of the map may be.

    \b
    specmap report map -o map.html
    specmap report friday --compare monday -o friday.html
    """
    from specmap_cli.core.files import write_text
    from specmap_cli.maps.store import read_map
    from specmap_cli.pipelines.report import report_map

    inputs = [*files_of_map(map_), *([] if compare is None else files_of_map(compare))]
    check_files([out], [map_, *inputs], common, overwrite=overwrite)
    limits = settings.load().limits
    stored = read_map(map_, limits)
    with common.progress() as progress:
        page = report_map(stored, compare, limits, progress)
    write_text(out, page)
    size_mb = len(page.encode("utf-8")) / 1e6
    result = {
        "map": str(map_),
        "compare": None if compare is None else str(compare),
        "out": str(out),
        "submaps": len(stored.record.nodes),
        "bytes": len(page.encode("utf-8")),
    }
    common.show(result, [f"{out}: {size_mb:.1f} MB: open it in a browser"])
