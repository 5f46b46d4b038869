"""The format of topology.json: its models, its JSON Schema, and what other tools make of it."""

from __future__ import annotations

import json
import ntpath
import os
from pathlib import Path
from typing import Any

import jsonschema
import networkx as nx
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import TypeAdapter, ValidationError

from specmap_cli.core import json_values
from specmap_cli.core.schemas import read_schema
from specmap_cli.maps import schema
from tests.maps.conftest import place_in


@pytest.fixture
def document(stored: Path) -> Any:
    return json.loads((stored / "topology.json").read_text())


def test_topology_follows_its_schema_and_networkx_reads_it_as_it_is(document: Any) -> None:
    jsonschema.Draft202012Validator.check_schema(read_schema("topology"))
    jsonschema.validate(document, read_schema("topology"))
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate({**document, "nodes": [{"id": 0}]}, read_schema("topology"))
    graph = nx.node_link_graph(document, edges="edges")
    assert list(graph.nodes) == [0, 1, 2]
    assert sorted(graph.edges) == [(0, 1), (0, 2)]
    assert graph.edges[0, 1]["kind"] == "traversed"
    assert graph.graph["logs"][0]["scans"] == 30
    assert nx.is_connected(graph)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("directed", True),
        ("multigraph", None),
        ("graph__schema_version", 1),
        ("graph__frame", 7),
        ("graph__logs__0__scans", -1),
        ("graph__logs", []),
        ("graph__logs__0__keyframes", [1]),
        ("graph__next_id", -1),
        ("graph__stays__0__keyframes", []),
        ("graph__stays__0__keyframes", [[0, 1, 2]]),
        ("graph__breaks__0__keyframe", None),
        ("graph__closures__0__new_submap", "first"),
        ("nodes__0__kind", "kitchen"),
        ("nodes__0__properties", {"floor": [1]}),
        ("graph__closures__0__xi", "high"),
        ("graph__closures__0__transform", [1.0, 2.0]),
        ("nodes__0__id", -1),
        ("nodes__0__id", 0.5),
        ("nodes__0__area_m2", -0.1),
        ("nodes__0__visits", {}),
        ("nodes__0__polygon", [[1.0, 2.0, 3.0]]),
        ("nodes__0__colour", "red"),
        ("edges__0__kind", "tunnel"),
        ("edges__0__traversals__0__from", None),
        ("edges__0__distance_m", -2.0),
        ("edges", None),
    ],
)
def test_models_and_json_schema_refuse_the_same_documents(
    document: Any, key: str, value: Any
) -> None:
    *parents, last = key.split("__")
    schema.TopologyRecord.model_validate(document)
    place_in(document, parents)[last] = value
    with pytest.raises(ValidationError):
        schema.TopologyRecord.model_validate(document)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(document, read_schema("topology"))


def test_no_key_may_be_missing(document: Any) -> None:
    records = ("logs__0", "stays__0", "closures__0")
    for record in (
        *("graph", *(f"graph__{each}" for each in records)),
        *("nodes__0", "edges__0", "edges__0__traversals__0"),
    ):
        place = place_in(document, record.split("__"))
        for key in set(place) - {"path_m"}:  # of logs; maps of schema 2 are older than it
            value = place.pop(key)
            with pytest.raises(ValidationError, match=key):
                schema.TopologyRecord.model_validate(document)
            place[key] = value


def test_every_field_is_described_and_the_schema_has_a_name() -> None:
    document = read_schema("topology")
    assert document["$id"] == "urn:specmap:topology:2"
    for name, record in [("topology", document), *document["$defs"].items()]:
        assert record["description"], name
        for key, field in record["properties"].items():
            assert field.get("description"), f"{name}.{key}"


def accepted(name: str) -> bool:
    try:
        TypeAdapter(json_values.InnerPath).validate_python(name)
    except ValidationError:
        return False
    return True


@given(st.lists(st.sampled_from([*"ab./\\:", "..", "../", "\n"]), max_size=8).map("".join))
def test_images_lie_inside_the_map_directory(name: str) -> None:
    """Whatever name is accepted, no way of reading it leads out of the directory."""
    if accepted(name):
        inside = os.path.normpath(os.path.join("/maps/home", name))
        assert inside == "/maps/home" or inside.startswith("/maps/home/")
        assert ntpath.splitdrive(name)[0] == ""
        assert "\n" not in name
    assert all(map(accepted, ("submaps/000.png", "a.b/c", "..a", "räume/küche.png")))
