"""`specmap export`: a finished map in the format of another tool."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from specmap_cli.cli.options import Common, Map, Overwrite, Settings, output
from specmap_cli.cli.targets import check_files

Format = Annotated[
    str, typer.Option("--format", "-f", help="One of those above, or of an installed package.")
]


def export(
    map_: Map,
    format_: Format,
    out: Annotated[Path, output("File to write.")],
    overwrite: Overwrite = False,
    *,
    settings: Settings,
    common: Common,
) -> None:
    """Write a map in the format of another tool.

    \b
    nav2        the ways as a graph for Nav2's route server
    tmap2       the ways as a topological map for LCAS topological_navigation
    geojson     outlines, doors and ways in metres of the map, for QGIS
    graphml     the graph alone, for yEd, Gephi and networkx
    csv         submaps, links and doors as tables, in a zip
    pose-graph  the layout's graph as g2o, for GTSAM and g2o
    foxglove    map, graph, trajectory and scans over time, as an MCAP
    rerun       the same as an .rrd; needs `pip install 'specmap-cli[rerun]'`

    Installed packages may add formats. Of the settings only the section `limits` counts: how large
    a file of the map may be. What would mislead is told as a warning. A map that the format cannot
    hold is refused with exit code 3, such as one without any way for nav2.

    \b
    specmap export map --format nav2 -o map.geojson
    """
    from specmap_cli.exports.table import export_map, exporters
    from specmap_cli.maps.store import read_map

    check_files([out], [map_], common, overwrite=overwrite)
    stored = read_map(map_, settings.load().limits)
    with common.progress() as progress:
        if stored.note:
            progress.note(stored.note)
        warnings = export_map(stored, format_, out, overwrite=overwrite, progress=progress)
    result = {
        "map": str(map_),
        "out": str(out),
        "format": format_,
        "submaps": len(stored.record.nodes),
        "edges": len(stored.record.edges),
        "warnings": warnings,
    }
    common.show(result, [f"{out}: {exporters()[format_].description}"])
