"""Maps of schema 1 are read; `topology_1.json` is `tests.house` as that version wrote it."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.errors import MapError
from specmap_cli.core.json_values import Record
from specmap_cli.core.text import plain as plain_values
from specmap_cli.exports.table import export_map
from specmap_cli.maps.schema import TopologyRecord
from specmap_cli.maps.store import read_map
from specmap_cli.maps.topology_file import upgraded
from specmap_cli.maps.writing import MapResult
from tests.maps.conftest import edit

OLD = Path(__file__).with_name("topology_1.json")
JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.sampled_from(["id", "log", "a"]), inner),
    max_leaves=8,
)


@pytest.fixture
def old(stored: Path) -> Path:
    (stored / "topology.json").write_bytes(OLD.read_bytes())
    return stored


def plain(record: Record, *without: str) -> dict[str, Any]:
    return record.model_dump(exclude=set(without))


def test_all_that_it_says_is_read(old: Path, result: MapResult) -> None:
    stored = read_map(old)
    record = TopologyRecord.of(result.topology, result.regions, result.logs, quality=result.quality)
    read, new = stored.record, TopologyRecord.model_validate_json(record.text())
    for ours, theirs in zip(read.nodes, new.nodes, strict=True):
        assert plain(ours, "kind", "properties") == plain(theirs, "kind", "properties")
        assert (ours.kind, ours.properties) == (None, {})
    assert read.edges == new.edges
    assert (read.graph.quality, read.graph.frame) == (new.graph.quality, new.graph.frame)
    (ours_log,), (theirs_log,) = read.graph.logs, new.graph.logs
    assert ours_log == replace(theirs_log, keyframes=None)
    for was, is_ in zip(read.graph.closures, new.graph.closures, strict=True):
        left_out = replace(is_, new_submap=None, old_submap=None)
        assert plain_values(was.as_dict()) == plain_values(left_out.as_dict())
    assert (read.graph.next_id, read.graph.stays, read.graph.breaks) == (3, (), ())


def test_it_is_a_map_like_any_other(old: Path, tmp_path: Path) -> None:
    stored = read_map(old)
    assert math.isnan(stored.topology.closures[1].score)
    assert len(stored.topology.submaps) == 3
    for name in ("csv", "foxglove", "geojson", "graphml"):
        export_map(stored, name, tmp_path / name)
    for name in ("nav2", "tmap2"):  # a robot would drive along ways, which it has not
        with pytest.raises(MapError, match="nobody looked for ways when it was made: build"):
            export_map(stored, name, tmp_path / name)
    with pytest.raises(MapError, match=r"has no keyframes\.mcap"):
        stored.keyframes()


def test_a_line_says_what_it_lacks_and_the_first_maps_held_no_verdict(stored: Path) -> None:
    assert read_map(stored).note == "", "a map of this version needs no word"
    (stored / "topology.json").write_bytes(OLD.read_bytes())
    note = read_map(stored).note
    lacks = f"{stored}: a map of an earlier version (schema 1): it keeps no keyframes"
    assert note.startswith(lacks)
    assert "\n" not in note
    document = json.loads(OLD.read_text())
    del document["graph"]["quality"]
    (stored / "topology.json").write_text(json.dumps(document))
    assert read_map(stored).record.graph.quality is None


@pytest.mark.parametrize(
    ("key", "value"),
    [
        *(("graph__log", None), ("graph__log", [1]), ("graph__log__scans", "many")),
        *(("graph__closures", {}), ("graph__closures", [1])),
        *(("nodes", None), ("nodes", {"id": 1}), ("nodes__0", 7), ("nodes__0__id", "x")),
    ],
)
def test_damage_is_told_as_in_a_map_of_this_version(old: Path, key: str, value: Any) -> None:
    edit(old / "topology.json", **{key: value})
    with pytest.raises(MapError, match=r"topology\.json: .*build the map again") as caught:
        read_map(old)
    assert "\n" not in str(caught.value)


@given(JSON, JSON, JSON)
def test_no_document_is_too_strange(nodes: Any, log: Any, closures: Any) -> None:
    graph = {"schema_version": 1, "log": log, "closures": closures}
    document = {"graph": graph, "nodes": nodes}
    assert upgraded(document)["graph"]["schema_version"] == 2
    assert document["graph"] is graph
