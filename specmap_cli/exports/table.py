"""The table of export formats, which other packages extend, and the writing of one file.

An exporter is any object with a `description` and a method `write`. A package of its own offers one
by an entry point of the group `specmap.exporters`; the entry point's name is the format's::

    class Names:
        description = "the names of the submaps, a line each"

        def write(self, stored: Map, target: IO[bytes], progress: Progress) -> None:
            for node in stored.record.nodes:
                target.write(f"{node.name}\\n".encode())

An exporter may have an `ending`, such as `.zip`: a file of another ending is refused. What would
mislead a user of the file is told by `progress.warn`; a map that cannot be written in the format at
all is a MapError.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import IO, Protocol

from specmap_cli.core.errors import UsageError
from specmap_cli.core.files import complete_file, refuse_existing
from specmap_cli.core.plugins import with_plugins
from specmap_cli.core.progress import Progress, Remembering, Silent
from specmap_cli.exports.flat_formats import csv_tables, geojson, graphml, pose_graph
from specmap_cli.exports.fleet_formats import lif, rmf
from specmap_cli.exports.foxglove import foxglove
from specmap_cli.exports.rerun import rerun
from specmap_cli.exports.route_formats import nav2, nav2_masks, tmap2
from specmap_cli.maps.store import Map

GROUP = "specmap.exporters"


class Exporter(Protocol):
    """Writes a finished map in one format."""

    description: str

    def write(self, stored: Map, target: IO[bytes], progress: Progress, /) -> None:
        """Write the map to an open file. Raises MapError when it is damaged, or lacks too much."""


class _Format:
    """A format that is a function, whose docstring begins with the description."""

    def __init__(
        self, write: Callable[[Map, IO[bytes], Progress], None], ending: str | None = None
    ) -> None:
        self.write, self.ending = write, ending
        self.description = str(write.__doc__).partition("\n")[0].removesuffix(".")


def exporters() -> dict[str, Exporter]:
    """Every exporter by the name of its format. Raises UsageError for a broken plug-in."""
    built_in: dict[str, Exporter] = {
        "csv": _Format(csv_tables, ".zip"),
        "foxglove": _Format(foxglove),
        "geojson": _Format(geojson),
        "graphml": _Format(graphml),
        "lif": _Format(lif),
        "nav2": _Format(nav2),
        "nav2-masks": _Format(nav2_masks, ".zip"),
        "pose-graph": _Format(pose_graph),
        "rerun": _Format(rerun),
        "rmf": _Format(rmf, ".zip"),
        "tmap2": _Format(tmap2),
    }
    offered = with_plugins(GROUP, built_in)
    return {name: each() if isinstance(each, type) else each for name, each in offered.items()}


def export_map(
    stored: Map,
    name: str,
    out: Path | str,
    *,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> list[str]:
    """Write a map in the format `name` to the file `out`, complete or not at all.

    Returns the warnings. Raises UsageError for a format that nobody offers, and for a file that
    has a wrong ending, exists (unless `overwrite`) or cannot be written; MapError for a damaged
    map, and for one that lacks what the format cannot do without.
    """
    target, known = Path(out), exporters()
    if name not in known:
        raise UsageError(f"unknown format {name!r}", f"choose from {', '.join(sorted(known))}")
    ending = getattr(known[name], "ending", None) or target.suffix
    if target.suffix not in {"", ending}:
        raise UsageError(known[name].description, f"name it {target.stem}{ending}", where=target)
    if not overwrite:
        refuse_existing(target)
    heard = Remembering(Silent() if progress is None else progress)
    with complete_file(target) as file:
        known[name].write(stored, file, heard)
    return heard.warnings
