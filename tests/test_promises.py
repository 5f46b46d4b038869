"""What stays: names that other programs use, held against those of the release.

`stable_names.json` is the record. A name that goes is a break, and needs a new major version; a new
one is recorded by `python -m tests.test_promises`.
"""

import inspect
import json
import re
from pathlib import Path
from typing import Any

import typer

import specmap_cli
from specmap_cli import Map, SpecmapError
from specmap_cli.cli.app import app
from specmap_cli.core.errors import CODES
from specmap_cli.core.findings import Quality
from specmap_cli.core.records import Labels, PlanarScan, Sweep, Trajectory
from specmap_cli.core.schemas import read_schema, schema_names
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.maps.filenames import OF_A_MAP
from specmap_cli.maps.rooms import Room
from specmap_cli.pipelines.localizer import LocalizedScan
from specmap_cli.pipelines.reports import BuildReport
from specmap_cli.recognition.localization.localizer import Label
from specmap_cli.topology.navigation import Route
from specmap_cli.topology.regions import Regions
from specmap_cli.topology.topological_map import Door

ROOT = Path(__file__).parent.parent
RECORD = Path(__file__).with_name("stable_names.json")
PAGE = (ROOT / "docs" / "library.md").read_text(encoding="utf-8")
# What a program is given, and does not make.
GIVEN: tuple[type, ...] = (BuildReport, Door, GridMap, Label, Labels, LocalizedScan, Map)
GIVEN += (PlanarScan, Quality, Regions, Room, Route, SpecmapError, Sweep, Trajectory)


def _members(kind: Any) -> list[str]:
    """What a program may name of a class or function: what the page names of it, or parameters."""
    named = {*re.findall(r"\w+", " ".join(re.findall(r"```.+?```|`.+?`", PAGE, flags=re.DOTALL)))}
    fields = {*getattr(kind, "__dataclass_fields__", {}), *dir(kind)} & named
    parameters = set(inspect.signature(kind).parameters) - {"args", "kwargs"}
    return sorted(fields if kind in GIVEN else fields | parameters)


def _properties(part: Any) -> set[str]:
    """The names of all properties in a schema."""
    if isinstance(part, list):
        return set().union(*map(_properties, part))
    if not isinstance(part, dict):
        return set()
    named = part.get("properties", {})
    own = set(named) if isinstance(named, dict) else set()
    return own.union(*map(_properties, part.values()))


def found() -> dict[str, Any]:
    """The names of this tree."""
    commands = typer.main.get_command(app).commands  # type: ignore[attr-defined]
    schemas = {name: read_schema(name) for name in schema_names()}
    return {
        "library": {name: _members(getattr(specmap_cli, name)) for name in specmap_cli.__all__}
        | {kind.__name__: _members(kind) for kind in GIVEN},
        "commands": {
            name: sorted({option for one in command.params for option in one.opts})
            for name, command in commands.items()
        },
        "errors": {code: exit_code for code, (exit_code, _) in CODES.items()},
        "schemas": {
            name: {"id": schema["$id"], "properties": sorted(_properties(schema))}
            for name, schema in schemas.items()
        },
        "map": sorted(OF_A_MAP),
    }


def missing(old: Any, new: Any, where: str = "") -> list[str]:
    """What `old` holds and `new` does not."""
    if isinstance(old, dict) and isinstance(new, dict):
        gone = [f"{where}{name}" for name in old if name not in new]
        return gone + [
            line
            for name, part in old.items()
            if name in new
            for line in missing(part, new[name], f"{where}{name}: ")
        ]
    if isinstance(old, list) and isinstance(new, list):
        return [f"{where}{name}" for name in old if name not in new]
    return [] if old == new else [f"{where}{old!r} is {new!r}"]


def test_nothing_that_was_promised_is_gone_and_what_is_new_is_recorded() -> None:
    record, now = json.loads(RECORD.read_text(encoding="utf-8")), found()
    assert missing(record, now) == [], "a break: docs/promises.md says how names change"
    assert missing(now, record) == [], "run `python -m tests.test_promises`"


def test_a_break_would_be_seen() -> None:
    now = found()
    less = json.loads(json.dumps(now))
    del less["library"]["read_map"], less["commands"]["export"]
    less["errors"]["map-missing"] = 4
    less["schemas"]["run"]["properties"].remove("counts")
    assert missing(now, less) == [
        "library: read_map",
        "commands: export",
        "errors: map-missing: 3 is 4",
        "schemas: run: properties: counts",
    ]


def test_the_version_is_that_of_the_changelog() -> None:
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    versions = re.findall(r"^## (\d+\.\d+\.\d+) \(\d{4}-\d\d-\d\d\)$", text, flags=re.MULTILINE)
    assert versions[0] == specmap_cli.__version__


if __name__ == "__main__":
    RECORD.write_text(json.dumps(found(), indent=1, sort_keys=True) + "\n", encoding="utf-8")
