"""Schemas that models make: the files of the package hold the same."""

from __future__ import annotations

import json
import subprocess
import sys
from importlib import import_module

import pytest

from specmap_cli.core.schemas import PACKAGE, ModelSchema, read_schema, schema_files

MODULES = "batch.ledger batch.records checking.record history.record maps.comparison maps.schema"


@pytest.mark.parametrize("module", MODULES.split())
def test_the_file_of_the_package_is_what_the_models_make(module: str) -> None:
    """That it is a schema, and says its version: tests/cli/test_cli_schemas.py."""
    schema: ModelSchema = import_module(f"specmap_cli.{module}").SCHEMA
    file = schema_files()[schema.name].relative_to(PACKAGE.parent)
    made = json.loads(schema.text())
    assert read_schema(schema.name) == made, f"run `python -m specmap_cli.{module} > {file}`"


def test_a_module_prints_the_file_to_ship() -> None:
    command = [sys.executable, "-m", "specmap_cli.maps.schema"]
    printed = subprocess.run(command, capture_output=True, check=True)
    assert json.loads(printed.stdout) == read_schema("topology")
    assert printed.stderr == b""
