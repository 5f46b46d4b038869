"""`specmap export`: a finished map in the format of another tool."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from specmap_cli.cli.options import Common, Overwrite, Settings, output
from specmap_cli.cli.targets import check_files

Map = Annotated[
    Path, typer.Argument(metavar="MAP", help="Map directory written by `specmap build`.")
]
Format = Annotated[
    str, typer.Option("--format", "-f", help="geojson, graphml, or one of an installed package.")
]
Out = Annotated[Path, output("File to write.")]


def export(
    map_: Map,
    format_: Format,
    out: Out,
    overwrite: Overwrite = False,
    *,
    settings: Settings,
    common: Common,
) -> None:
    """Write a map in the format of another tool.

    graphml: the graph alone, for yEd, Gephi and networkx. geojson: outlines and links in metres of
    the map, for QGIS. Installed packages may add formats. Of the settings only the section `limits`
    counts: how large a file of the map may be.

    \b
    specmap export map --format graphml -o map.graphml
    """
    from specmap_cli.exports.table import export_map, exporters
    from specmap_cli.maps.store import read_map

    check_files([out], [map_], common, overwrite=overwrite)
    stored = read_map(map_, settings.load().limits)
    with common.progress() as progress:
        if stored.note:
            progress.note(stored.note)
    export_map(stored, format_, out, overwrite=overwrite)
    result = {
        "map": str(map_),
        "out": str(out),
        "format": format_,
        "submaps": len(stored.record.nodes),
        "edges": len(stored.record.edges),
    }
    common.show(result, [f"{out}: {exporters()[format_].description}"])
