"""The machine interface: what every command prints with `--json`, and every JSON file, by schema.

Beside the commands here, everything that a test of the command line prints with `--json` is held
to its schema: see `run` in conftest.py.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jsonschema
import pytest
import typer

from specmap_cli.cli.app import app
from specmap_cli.core.errors import UsageError
from specmap_cli.core.schemas import SETTINGS, read_schema, schema_names
from tests.cli.conftest import ERROR_SCHEMA, FILE_SCHEMAS, QUICK, Run, name_of_command, validate
from tests.flats import Mapped

COMMANDS: dict[str, Any] = typer.main.get_command(app).commands  # type: ignore[attr-defined]


@dataclass(frozen=True)
class Things:
    """What commands are tried on."""

    one: Mapped
    other: Mapped
    log: Path
    map: Path
    plan: Path
    place: Path

    @property
    def tum(self) -> Path:
        """The trajectory of the map."""
        return self.map / "trajectory.tum"

    def out(self, name: str) -> Path:
        """An output."""
        return self.place / name


EDITS = ("--rename", "0", "Hall", "--kind", "0", "hall", "--set-property", "0", "floor=2")
Line = Callable[[Things], list[str | Path]]
LINES: dict[str, list[Line]] = {
    "info": [lambda of: [of.log], lambda of: [of.log, "--check"]],
    "build": [
        lambda of: [of.log, "-o", of.out("map"), *QUICK],
        lambda of: [of.other.log.log, "-o", of.out("alike"), "--like", of.one.map, *QUICK],
    ],
    "localize": [lambda of: [of.log, "--map", of.map, "--metric"]],
    "update": [lambda of: [of.one.map, of.other.log.log, "-o", of.out("map"), *QUICK]],
    "merge": [lambda of: [of.one.map, of.other.map, "-o", of.out("map"), *QUICK]],
    "compare": [
        lambda of: [of.map, of.map],
        lambda of: [of.one.map, of.other.map, "-o", of.out("comparison")],
    ],
    "check": [lambda of: [of.map], lambda of: [of.one.map, "--against", of.other.map]],
    "history": [
        lambda of: [of.one.map, of.other.map, of.map],
        lambda of: [of.one.map, "-o", of.out("history")],
    ],
    "edit": [lambda of: [of.map, "-o", of.out("map"), *EDITS]],
    "report": [lambda of: [of.map, "-o", of.out("map.html")]],
    "segment": [lambda of: [of.plan, "-o", of.out("rooms")]],
    "evaluate": [
        lambda of: [of.log, "--protocol", "holdout", "--share", "0.3", *QUICK],
        lambda of: [of.map, of.log, "--protocol", "revisit", *2 * ("--reference", of.tum)],
        lambda of: ["--trajectory", of.tum, "--reference", of.tum],
        lambda of: ["--trajectory", of.tum, "--relations", relations(of)],
    ],
    "simulate": [lambda of: [of.plan, "-o", of.out("tour.mcap"), "--max-duration", "2"]],
    "convert": [lambda of: [of.log, of.out("log.mcap")]],
    "export": [lambda of: [of.map, "--format", "geojson", "-o", of.out("map.geojson")]],
    "config": [lambda _: []],
    "schema": [lambda _: [], lambda _: ["build"]],
}


def relations(of: Things) -> Path:
    """One relation between two poses of the map's trajectory."""
    stamps = [line.split()[0] for line in of.tum.read_text().splitlines()]
    path = of.out("relations.txt")
    path.write_text(f"{stamps[0]} {stamps[-1]} 1 0 0 0 0 0\n", encoding="utf-8")
    return path


CASES = [(name, line) for name, lines in LINES.items() for line in lines]


@pytest.fixture
def things(
    first_tour: Mapped,
    second_tour: Mapped,
    tiny_log: Path,
    tiny_map: Path,
    plan: Path,
    tmp_path: Path,
) -> Things:
    return Things(first_tour, second_tour, tiny_log, tiny_map, plan, tmp_path)


def test_every_command_is_tried() -> None:
    has_json = {
        name
        for name, command in COMMANDS.items()
        if any("--json" in parameter.opts for parameter in command.params)
    }
    assert {*LINES, "batch"} == has_json  # that has lines of JSON, and tests of its own


@pytest.mark.parametrize(("name", "line"), CASES, ids=[name for name, _ in CASES])
def test_what_a_command_prints_is_as_its_schema_says(
    name: str, line: Line, things: Things, run: Run
) -> None:
    said = run(name, *line(things), "--json", "-q")
    assert (said.code, said.err) == (0, "")
    found = json.loads(said.out)
    assert "$schema" in found or name == SETTINGS or found["schema_version"] == 1
    for path in things.place.rglob("*.json"):
        validate(json.loads(path.read_text(encoding="utf-8")), FILE_SCHEMAS[path.name])


def test_what_was_learned_by_the_paper_s_method_is_as_its_schema_says(
    tiny_log: Path, tmp_path: Path, run: Run
) -> None:
    out = tmp_path / "map"
    assert run("build", tiny_log, "-o", out, "--preset", "paper", "-q").code == 0
    found = json.loads((out / "classifiers.json").read_text(encoding="utf-8"))
    validate(found, FILE_SCHEMAS["classifiers.json"])


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


def test_every_schema_is_of_a_command_or_a_file() -> None:
    assert set(schema_names()) == {
        *map(name_of_command, COMMANDS),
        *FILE_SCHEMAS.values(),
        ERROR_SCHEMA,
    }


def test_a_part_that_several_schemas_have_is_the_same_everywhere() -> None:
    parts: dict[str, Any] = {}
    for name in ("build", "update", "merge", "run"):
        for title, part in read_schema(name)["$defs"].items():
            assert parts.setdefault(title, part) == part


def test_a_schema_that_there_is_none_of(run: Run) -> None:
    said = run("schema", "biuld")
    assert said.code == UsageError.exit_code
    assert said.error.startswith("no schema 'biuld': choose from batch, build, check, ")


def test_what_is_not_in_a_schema_is_found() -> None:
    with pytest.raises(jsonschema.ValidationError, match="'more' was unexpected"):
        validate({"schema_version": 1, "schemas": [], "more": 1}, "schema")
