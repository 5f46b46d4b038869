"""The tables of a map, read as a spreadsheet reads them."""

from __future__ import annotations

import csv
import io
import zipfile
from pathlib import Path

import pytest

from specmap_cli.core.errors import UsageError
from specmap_cli.exports.table import export_map
from specmap_cli.maps.store import Map
from specmap_cli.maps.writing import MapResult
from tests.exports.conftest import with_submaps

Rows = list[dict[str, str]]


def tables(stored: Map, out: Path) -> dict[str, Rows]:
    assert export_map(stored, "csv", out) == []
    with zipfile.ZipFile(out) as archive:
        assert archive.testzip() is None
        texts = {name: archive.read(name).decode() for name in archive.namelist()}
    return {name: list(csv.DictReader(io.StringIO(text))) for name, text in texts.items()}


def test_the_rows_are_the_map_s(home: Map, tmp_path: Path) -> None:
    found = tables(home, tmp_path / "home.zip")
    record = home.record
    nodes, edges, doors = (found[f"{name}.csv"] for name in ("nodes", "edges", "doors"))
    assert [int(row["id"]) for row in nodes] == [node.id for node in record.nodes]
    assert [float(row["area_m2"]) for row in nodes] == [node.area_m2 for node in record.nodes]
    assert [(row["anchor_x"], row["anchor_y"]) for row in nodes][1] == ("-3.0", "3.5")
    assert [row["property.owner"] for row in nodes] == ["", "Ann", ""]
    lengths = [float(row["length_m"]) if row["length_m"] else None for row in edges]
    assert lengths == [edge.length_m for edge in record.edges]
    assert [row["passable"] for row in edges] == ["True", "True", "False"]
    assert [row["doors"] for row in edges] == ["0", "1", ""]
    sides = [(row["source"], row["target"], row["width_m"]) for row in doors]
    assert sides == [("0", "1", "0.9"), ("0", "2", "0.8")]


def test_what_a_person_noted_is_no_formula(lived_in: MapResult, tmp_path: Path) -> None:
    said = {"name": "=cmd|' /C calc'!A0", "properties": {"of": "@Ann", "floor": -2}}
    home = with_submaps(tmp_path / "home", lived_in, said)
    row = tables(home, tmp_path / "home.zip")["nodes.csv"][0]
    assert row["name"] == "'=cmd|' /C calc'!A0"
    assert (row["property.of"], row["property.floor"]) == ("'@Ann", "-2")


def test_empty_tables_have_headings_and_a_zip_is_not_csv(stored: Map, tmp_path: Path) -> None:
    tables(stored, tmp_path / "house.zip")
    with zipfile.ZipFile(tmp_path / "house.zip") as archive:
        text = archive.read("doors.csv").decode()
    assert text.startswith("id,source,target,x,y,width_m,")
    assert text.count("\n") == 1
    with pytest.raises(UsageError, match=r"house\.csv: a zip of .*: name it house\.zip"):
        export_map(stored, "csv", tmp_path / "house.csv")
    assert not (tmp_path / "house.csv").exists()
