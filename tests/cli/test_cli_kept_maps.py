"""A map that was damaged is taken for a merge as far as it is whole, or refused in one line."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.cli.conftest import QUICK, Run

Damage = Callable[[Path], object]


def without(name: str) -> Damage:
    return lambda map_: (map_ / name).unlink()


def with_text(name: str, text: str) -> Damage:
    return lambda map_: (map_ / name).write_text(text, encoding="utf-8")


def changed(name: str, pattern: str, new: str) -> Damage:
    """The first match of a pattern replaced."""

    def change(map_: Path) -> None:
        text = (map_ / name).read_text(encoding="utf-8")
        assert re.search(pattern, text)
        (map_ / name).write_text(re.sub(pattern, new, text, count=1), encoding="utf-8")

    return change


def binary(name: str) -> Damage:
    return lambda map_: (map_ / name).write_bytes(b"\xff\xfe\x00")


@pytest.mark.parametrize(
    ("damage", "complaint"),
    [
        (without("trajectory.g2o"), r"trajectory\.g2o: cannot be read: .*; build the map again"),
        (binary("trajectory.g2o"), r"trajectory\.g2o: not UTF-8 text: build the map again"),
        (
            changed("trajectory.g2o", r"(EDGE_SE2 \d+ \d+) \S+", r"\1 nan"),
            r"trajectory\.g2o: g2o, line \d+: 'EDGE_SE2 .*' is no EDGE_SE2",
        ),
        (
            changed("trajectory.g2o", r"VERTEX_SE2 \d+", "VERTEX_SE2 99999"),
            r"trajectory\.g2o: its vertices are not among the \d+ keyframes of labels\.csv",
        ),
        (with_text("trajectory.g2o", ""), None),  # nothing but the way from keyframe to keyframe
        (without("trajectory.tum"), r"trajectory\.tum: cannot read the trajectory: "),
        (binary("trajectory.tum"), r"trajectory\.tum: not a text file: build the map again"),
        (with_text("trajectory.tum", ""), r"trajectory\.tum: .*: build the map again"),
        (
            changed("trajectory.tum", r"(?m)^(\d+\.\d+) \S+", r"\1 far"),
            r"trajectory\.tum: line \d+ is '.* far .*': expected t x y z qx qy qz qw",
        ),
        (
            changed("trajectory.tum", r"(?m)^\d+\.\d+ .*\n", ""),
            r"trajectory\.tum: is not the way through the keyframes of labels\.csv",
        ),
        (changed("run.json", r'"counts": \{', '"counts": {"a": null, "scans": "many", '), None),
        (changed("run.json", r'"counts": \{[^}]*\}', '"counts": [1, 2]'), None),
        (with_text("edits.toml", "changes = 3"), r"edits\.toml: changes: must be tables such as"),
    ],
)
def test_what_is_damaged_is_said_in_one_line(
    damage: Damage,
    complaint: str | None,
    own_map: Path,
    tiny_map: Path,
    tmp_path: Path,
    run: Run,
) -> None:
    damage(own_map)
    out = tmp_path / "out"
    found = run("merge", tiny_map, own_map, "-o", out, "--quiet", *QUICK)
    assert found.code == 3
    assert re.search(complaint or r"holds tiny\.mcap, and so does", found.error)
    assert not out.exists()
