"""The machine interface: what every command prints with `--json`, and every JSON file, by schema.

Beside the commands here, everything that a test of the command line prints with `--json` is held
to its schema: see `run` in conftest.py.
"""

import json
from collections.abc import Callable, Iterator, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from specmap_cli.core import schemas
from specmap_cli.core.schemas import SETTINGS, read_schema, schema_names
from tests.cli.conftest import COMMANDS, ERROR_SCHEMA, FILE_SCHEMAS, Run, name_of_command, validate

MODULES = "batch.batch batch.records checking.rules history.record maps.comparison maps.schema"
# Lines of commands that succeed, but for `batch`; see `words` in conftest.py.
LINES = {
    "info": ["{log}", "{log} --check"],
    "build": [
        "{log} -o {out}/map {quick}",
        "{log} -o {out}/map --preset paper",  # which learns by its own method
        "{other_log} -o {out}/alike --like {one} {quick}",
    ],
    "localize": ["{log} --map {map} --metric"],
    "update": ["{one} {other_log} -o {out}/map {quick}"],
    "merge": ["{one} {other} -o {out}/map {quick}"],
    "compare": ["{map} {map}", "{one} {other} -o {out}/comparison"],
    "check": ["{map}", "{one} --against {other}"],
    "history": ["{one} {other} {map}", "{one} -o {out}/history"],
    "edit": ["{map} -o {out}/map --rename 0 Hall --kind 0 hall --set-property 0 floor=2"],
    "report": ["{map} -o {out}/map.html"],
    "segment": ["{plan} -o {out}/rooms"],
    "evaluate": [
        "{log} --protocol holdout --share 0.3 {quick}",
        "{map} {log} --protocol revisit --reference {tum} --reference {tum}",
        "--trajectory {tum} --reference {tum}",
        "--trajectory {tum} --relations {relations}",
    ],
    "simulate": ["{plan} -o {out}/tour.mcap --max-duration 2"],
    "convert": ["{log} {out}/log.mcap"],
    "export": ["{map} --format geojson -o {out}/map.geojson"],
    "config": [""],
    "schema": ["", "build"],
}
CASES = [(name, line) for name, lines in LINES.items() for line in lines]


def test_every_command_is_tried() -> None:
    has_json = {
        name
        for name, command in COMMANDS.items()
        if any("--json" in parameter.opts for parameter in command.params)
    }
    assert {*LINES, "batch"} == has_json  # that has lines of JSON, and tests of its own


@pytest.mark.parametrize(("name", "line"), CASES, ids=[name for name, _ in CASES])
def test_what_a_command_prints_is_as_its_schema_says(
    name: str, line: str, words: Callable[[str], list[str]], tmp_path: Path, run: Run
) -> None:
    said = run(name, *words(line), "--json", "-q")
    assert (said.code, said.err) == (0, "")
    found = json.loads(said.out)
    assert "$schema" in found or name == SETTINGS or found["schema_version"] == 1
    for path in tmp_path.rglob("*.json"):
        validate(json.loads(path.read_text(encoding="utf-8")), FILE_SCHEMAS[path.name])


@pytest.mark.parametrize("name", schema_names())
def test_a_schema_is_one_and_says_its_version(name: str) -> None:
    schema = read_schema(name)
    jsonschema.Draft202012Validator.check_schema(schema)
    kind, version = schema["$id"].rsplit(":", 1)
    assert kind == f"urn:specmap:{name}"
    assert schema["title"]
    for given in versions_in(schema):
        assert str(given) == version


def versions_in(schema: Mapping[str, Any]) -> Iterator[int]:
    """The values that a schema allows for `schema_version`."""
    for key, value in schema.items():
        if key == "schema_version":
            yield value["const"]
        elif isinstance(value, dict):
            yield from versions_in(value)


def test_every_schema_is_of_a_command_or_a_file_and_parts_are_the_same_in_all_of_them() -> None:
    expected = {*map(name_of_command, COMMANDS), *FILE_SCHEMAS.values(), ERROR_SCHEMA}
    assert set(schema_names()) == expected
    parts: dict[str, Any] = {}
    for name in ("build", "update", "merge", "run"):
        for title, part in read_schema(name)["$defs"].items():
            assert parts.setdefault(title, part) == part


def test_a_schema_that_there_is_none_of_and_what_is_not_in_one_are_told(run: Run) -> None:
    assert run("schema", "compare").out == run("schema", "comparison").out
    run("schema", "biuld").fails(2, "no schema 'biuld': choose from batch, build, check, ")
    with pytest.raises(jsonschema.ValidationError, match="'more' was unexpected"):
        validate({"schema_version": 1, "schemas": [], "more": 1}, "schema")


@pytest.mark.parametrize("module", MODULES.split())
def test_the_file_of_the_package_is_what_the_models_make(module: str) -> None:
    schema: schemas.ModelSchema = import_module(f"specmap_cli.{module}").SCHEMA
    file = schemas.schema_files()[schema.name].relative_to(schemas.PACKAGE.parent)
    made = json.loads(schema.text())
    make = f"from specmap_cli.{module} import SCHEMA; print(SCHEMA.text(), end='')"
    assert read_schema(schema.name) == made, f'run `python -c "{make}" > {file}`'
