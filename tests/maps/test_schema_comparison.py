"""The format of compare.json: the models, and the JSON Schema that is shipped beside them."""

from __future__ import annotations

import json

import jsonschema

from specmap_cli.maps import comparison as schema


def test_the_schema_that_is_shipped_is_that_of_the_models() -> None:
    shipped = json.loads(schema.SCHEMA_FILE.read_text(encoding="utf-8"))
    assert shipped == json.loads(schema.schema_text()), (
        "run `python -m specmap_cli.maps.comparison > specmap_cli/maps/comparison.schema.json`"
    )
    jsonschema.Draft202012Validator.check_schema(schema.json_schema())
    assert schema.json_schema()["$id"].endswith(f":{schema.SCHEMA_VERSION}")
