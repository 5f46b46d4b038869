"""CSV: tables of submaps, links and doors, for spreadsheets, pandas and R.

Three tables make one export, so they come as one file: a zip. Values are those of the other
formats, an empty cell is an unknown one.
"""

from __future__ import annotations

import zipfile
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from operator import attrgetter
from typing import IO, Any

from specmap_cli.core.json_values import PropertyValue
from specmap_cli.core.progress import Progress
from specmap_cli.core.tables import csv_text
from specmap_cli.core.text import plain
from specmap_cli.exports.fields import DOOR, LINK, SUBMAP, fields_of
from specmap_cli.maps.schema import NodeRecord, TopologyRecord
from specmap_cli.maps.store import StoredMap

_SAME_DAY = (1980, 1, 1, 0, 0, 0)  # the first a zip knows: the same map gives the same bytes
_FOR_ALL = 0o644 << 16  # readable, once unpacked

_ENDS: Mapping[str, Callable[[Any], Any]] = {
    "source": attrgetter("source"),
    "target": attrgetter("target"),
}
_PLACE: Mapping[str, Callable[[Any], Any]] = {
    "id": attrgetter("id"),
    "source": lambda door: door.between[0],
    "target": lambda door: door.between[1],
    "x": attrgetter("x"),
    "y": attrgetter("y"),
}


class CsvTables:
    """`nodes.csv`, `edges.csv` and `doors.csv`, each with a line of headings, in a zip."""

    description = "a zip of nodes.csv, edges.csv and doors.csv, for spreadsheets and pandas"
    ending = ".zip"

    def write(self, stored: StoredMap, target: IO[bytes], _: Progress) -> None:
        """Write the tables of a map."""
        record = stored.record
        tables = {
            "nodes.csv": _table(record.nodes, {"id": attrgetter("id"), **SUBMAP, **_noted(record)}),
            "edges.csv": _table(record.edges, {**_ENDS, **LINK}),
            "doors.csv": _table(record.graph.doors, {**_PLACE, **DOOR}),
        }
        with zipfile.ZipFile(target, "w") as archive:
            for name, text in tables.items():
                entry = zipfile.ZipInfo(name, _SAME_DAY)
                entry.external_attr = _FOR_ALL
                archive.writestr(entry, text, zipfile.ZIP_DEFLATED)


def _noted(record: TopologyRecord) -> dict[str, Callable[[Any], Any]]:
    """Whatever a person noted of submaps, a column each."""
    keys = sorted({key for node in record.nodes for key in node.properties})
    return {f"property.{key}": partial(_note, key) for key in keys}


def _note(key: str, node: NodeRecord) -> PropertyValue | None:
    return node.properties.get(key)


def _table(records: Iterable[Any], columns: Mapping[str, Callable[[Any], Any]]) -> str:
    """A table as CSV (RFC 4180)."""
    rows = (plain(fields_of(record, columns)) for record in records)
    return csv_text(list(columns), (list(row.values()) for row in rows), "\r\n")
