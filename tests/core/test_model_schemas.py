"""Schemas that models make: the files of the package hold the same."""

from __future__ import annotations

import json
import subprocess
import sys
from importlib import import_module

import jsonschema
import pytest

from specmap_cli.core.schemas import PACKAGE, ModelSchema, read_schema, schema_files

MODULES = [
    "batch.ledger",
    "batch.records",
    "checking.record",
    "history.record",
    "maps.comparison",
    "maps.schema",
]


def schema_of(module: str) -> ModelSchema:
    found = import_module(f"specmap_cli.{module}").SCHEMA
    assert isinstance(found, ModelSchema)
    return found


@pytest.mark.parametrize("module", MODULES)
def test_the_file_of_the_package_is_what_the_models_make(module: str) -> None:
    schema = schema_of(module)
    file = schema_files()[schema.name].relative_to(PACKAGE.parent)
    made = json.loads(schema.text())
    assert read_schema(schema.name) == made, f"run `python -m specmap_cli.{module} > {file}`"
    assert made["$id"] == f"urn:specmap:{schema.name}:{schema.version}"
    jsonschema.Draft202012Validator.check_schema(made)


def test_a_module_prints_the_file_to_ship() -> None:
    command = [sys.executable, "-m", "specmap_cli.maps.schema"]
    printed = subprocess.run(command, capture_output=True, check=True)
    assert json.loads(printed.stdout) == read_schema("topology")
    assert printed.stderr == b""
