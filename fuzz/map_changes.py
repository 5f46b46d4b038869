"""Mutations of map directories: values of JSON, CSV and YAML, pictures, scans, and the files."""

from __future__ import annotations

import json
import os
import random
import struct
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from fuzz.array_changes import change_arrays
from fuzz.byte_changes import change_bytes
from fuzz.changes import replaced
from fuzz.record_changes import change_records

Files = dict[str, bytes]  # by the path inside the directory

_RAW = "\x00raw\x00"  # stands for text of JSON that json.dumps does not write
_VALUES: tuple[Any, ...] = (
    None,
    True,
    0,
    -1,
    1,
    7,
    10**9,
    2**31,
    2**63,
    10**30,
    10**308,
    0.5,
    -0.5,
    1e-300,
    1e9,
    1e300,
    1.7e308,
    "",
    "text",
    "../../escape",
    "/dev/zero",
    "\x1b[31mred\x07\n",
    "a" * 5000,
    [],
    {},
    [[]],
    [1e308, 1e308],
)
_RAW_TEXTS = ("NaN", "-Infinity", "1e400", "9" * 5000, "[" * 3000 + "]" * 3000, "0x1", "")
_CELLS = (
    "",
    "nan",
    "inf",
    "-1",
    "1e300",
    "1e308",
    "9" * 30,
    "9" * 5000,
    "text",
    "999",
    "0.5",
    "1,2",
    "\x1b[31m",
    "-9" + "9" * 19,
)
_TOML_VALUES = (
    "",
    "0",
    "-1",
    "true",
    "nan",
    "1e300",
    "9" * 5000,
    '"text"',
    '"\\u001b[31m"',
    "'" + "a" * 5000 + "'",
    "[]",
    "[0, 0]",
    "[0, 99]",
    "[1, 0]",
    "[[1.0, -0.5], [1.0, -0.5]]",
    "[[1e308, 0.0], [-1e308, 0.0]]",
    "[[0.0, 0.0], [nan, inf]]",
    "[" * 2000,
    "{ floor = 2 }",
    "1979-05-27",
)
_TOML_LINES = (
    "[[changes]]",
    "[submaps.0]",
    "[submaps.99]",
    "[submaps.text]",
    "[changes]",
    "[[changes]]\nmerge = [0, 1]",
    "[[changes]]\nmerge = [1, 0]",
    "[[changes]]\nsplit = 0\nline = [[1.0, -1.5], [3.0, -1.5]]",
    "[[changes]]\nforbid = [0, 1]\nat = [1e9, 0]",
    "\x00",
)
_YAML_VALUES = (
    "0",
    "-1",
    "nan",
    ".inf",
    "1e300",
    "1e-300",
    "1e-9",
    "[0, 0]",
    "[nan, 0, 0]",
    "[1e300, 0, 0]",
    "../../../etc/passwd",
    "/dev/zero",
    "missing.png",
    "*anchor",
    "!!python/object:os.system",
    "[" * 2000,
    "9" * 5000,
    "",
)


def change_map(
    rng: random.Random, files: Mapping[str, bytes], intact: Mapping[str, bytes]
) -> tuple[Files, list[str], str]:
    """The files with one more of them changed, deeds for `write_map`, and a word on it all."""
    whole = [name for name in sorted(files) if files[name] == intact[name]]
    name = rng.choice(whole)
    kind = rng.random()
    if kind < 0.12:
        deed = rng.choice(list(_DEEDS))
        return dict(files), [f"{deed} {name}"], f"{name}: {deed}"
    if kind < 0.22:
        change = change_bytes(rng, files[name])
        return {**files, name: change.data}, [], f"{name}: {change.note}"
    family = rng.choice(_OFTEN)
    name = rng.choice([name for name in whole if _family(name) == family] or [name])
    family = _family(name)
    if family == "other":
        change = change_bytes(rng, files[name])
        return {**files, name: change.data}, [], f"{name}: {change.note}"
    data, note = _CHANGES[family](rng, files[name])
    return {**files, name: data}, [], f"{name}: {note}"


def without_digests(files: Mapping[str, bytes]) -> Files:
    """The files of a map that tells no digests: damage gets behind the check of them."""
    document = json.loads(files["topology.json"])
    document["graph"]["files"] = {}
    return {**files, "topology.json": json.dumps(document).encode()}


def bound(files: Mapping[str, bytes], other: Mapping[str, bytes]) -> set[str]:
    """The files that belong to a map by their digests, and are not the same in the other map."""
    listed = json.loads(files["topology.json"])["graph"]["files"]
    return {name for name in listed if other.get(name, files[name]) != files[name]}


def write_map(folder: Path, files: Mapping[str, bytes], deeds: list[str]) -> None:
    """Write a map directory, then do to its files what `change_map` asked for."""
    for name, data in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
    for deed in deeds:
        what, name = deed.split(" ", 1)
        _DEEDS[what](folder / name)


def _family(name: str) -> str:
    if name in ("run.json", "topology.json", "classifiers.json"):
        return "json"
    return _FAMILIES.get(Path(name).suffix, "other")


def _change_json(rng: random.Random, data: bytes) -> tuple[bytes, str]:
    document = json.loads(data)
    raw = rng.choice(_RAW_TEXTS) if rng.random() < 0.2 else None
    new = _RAW if raw is not None else rng.choice(_VALUES)
    changed, where = _with_value(rng, document, new)
    text = json.dumps(changed)
    if raw is not None:
        text = text.replace(json.dumps(_RAW), raw)
    return text.encode(), f"{where} = {str(new if raw is None else raw)[:30]!r}"


def _with_value(rng: random.Random, value: Any, new: Any) -> tuple[Any, str]:
    """A copy of a document with a value, at any depth, replaced, dropped or repeated."""
    if isinstance(value, dict) and value:
        key = rng.choice(sorted(value))
        if rng.random() < 0.06:
            return {k: v for k, v in value.items() if k != key}, f"{key} dropped, not"
        changed, where = _with_value(rng, value[key], new)
        return {**value, key: changed}, f"{key}.{where}"
    if isinstance(value, list) and value:
        place = rng.randrange(len(value))
        kind = rng.random()
        if kind < 0.1:
            return replaced(value, place), f"{place} dropped, not"
        if kind < 0.2:
            return replaced(value, place, value[place], value[place]), f"{place} twice, not"
        changed, where = _with_value(rng, value[place], new)
        return replaced(value, place, changed), f"{place}.{where}"
    return new, ""


def _change_csv(rng: random.Random, data: bytes) -> tuple[bytes, str]:
    lines = data.decode().split("\n")
    row = rng.randrange(len(lines))
    kind = rng.random()
    if kind < 0.1:
        return "\n".join(replaced(lines, row)).encode(), f"line {row} dropped"
    if kind < 0.2:
        other = lines[rng.randrange(len(lines))]
        return "\n".join(
            replaced(lines, row, lines[row], other)
        ).encode(), f"line {row} and another"
    cells = lines[row].split(",")
    column, value = rng.randrange(len(cells)), rng.choice(_CELLS)
    lines[row] = ",".join(replaced(cells, column, value))
    return "\n".join(lines).encode(), f"line {row}, cell {column} = {value[:20]!r}"


def _change_yaml(rng: random.Random, data: bytes) -> tuple[bytes, str]:
    lines = data.decode().strip("\n").split("\n")
    row = rng.randrange(len(lines))
    key = lines[row].partition(":")[0]
    if rng.random() < 0.15:
        return "\n".join(replaced(lines, row)).encode(), f"{key} dropped"
    value = rng.choice(_YAML_VALUES)
    return "\n".join(replaced(lines, row, f"{key}: {value}")).encode(), f"{key}: {value[:30]}"


def _change_png(rng: random.Random, data: bytes) -> tuple[bytes, str]:
    """Another header with a checksum that fits, a chunk that claims to be longer, other bytes."""
    kind = rng.random()
    if kind < 0.1:
        claimed = rng.choice([0, 100, 2**24, 2**31 - 1, 2**32 - 1])
        return data[:33] + struct.pack(">I", claimed) + data[37:], f"a chunk of {claimed} bytes"
    if kind < 0.5:
        change = change_bytes(rng, data)
        return change.data, change.note
    sides = rng.choice([(0, 0), (1, 1), (30_000, 30_000), (2**31 - 1, 2**31 - 1), (60_000, 4)])
    depth, colour = rng.choice([1, 8, 16, 3]), rng.choice([0, 2, 3, 4, 6])
    header = b"IHDR" + struct.pack(">IIBBBBB", *sides, depth, colour, 0, 0, rng.choice([0, 1]))
    crc = struct.pack(">I", zlib.crc32(header))
    note = f"{sides[0]} x {sides[1]} pixels of {depth} bits, kind {colour}"
    return data[:12] + header + crc + data[33:], note


def _change_words(rng: random.Random, data: bytes) -> tuple[bytes, str]:
    """A word of a line, or a line, dropped, twice or another: of trajectories and pose graphs."""
    lines = data.decode().split("\n")
    row, kind = rng.randrange(len(lines)), rng.random()
    if kind < 0.2:
        new = rng.choice([[], [lines[row]] * 2, [rng.choice(lines)]])
        return "\n".join(replaced(lines, row, *new)).encode(), f"line {row}: {len(new)} lines"
    words = lines[row].split(" ")
    place = rng.randrange(len(words))
    value = rng.choice([[], [words[place]] * 2] if kind < 0.3 else [[cell] for cell in _CELLS])
    changed = " ".join(replaced(words, place, *value))
    note = f"line {row}, word {place} = {value!r:.40}"
    return "\n".join(replaced(lines, row, changed)).encode(), note


def _change_toml(rng: random.Random, data: bytes) -> tuple[bytes, str]:
    """A value of edits.toml, or a line dropped, twice or added."""
    lines = data.decode().split("\n")
    row = rng.randrange(len(lines))
    key, equals, _ = lines[row].partition("=")
    if equals and rng.random() < 0.7:
        new = [f"{key}= {rng.choice(_TOML_VALUES)}"]
    else:
        new = rng.choice([[], [lines[row]] * 2, [lines[row], rng.choice(_TOML_LINES)]])
    return "\n".join(replaced(lines, row, *new)).encode(), f"line {row}: {new!r:.60}"


def _change_mcap(rng: random.Random, data: bytes) -> tuple[bytes, str]:
    """Records of a recording, or other bytes."""
    change = change_bytes(rng, data) if rng.random() < 0.3 else change_records(rng, data, "mcap")
    return change.data, change.note


_FAMILIES = {
    ".csv": "csv",
    ".yaml": "yaml",
    ".png": "png",
    ".mcap": "mcap",
    ".npz": "arrays",
    ".toml": "toml",
    ".g2o": "words",
    ".tum": "words",
}
_OFTEN = [*["json"] * 3, "csv", "yaml", "png", *["mcap", "toml", "words", "arrays"] * 2]
_CHANGES = {
    "json": _change_json,
    "csv": _change_csv,
    "yaml": _change_yaml,
    "png": _change_png,
    "mcap": _change_mcap,
    "toml": _change_toml,
    "words": _change_words,
    "arrays": change_arrays,
}


def _remove(path: Path) -> None:
    path.unlink()


def _empty(path: Path) -> None:
    path.write_bytes(b"")


def _directory(path: Path) -> None:
    path.unlink()
    path.mkdir()


def _loop(path: Path) -> None:
    path.unlink()
    path.symlink_to(path.name)


def _endless(path: Path) -> None:
    path.unlink()
    path.symlink_to("/dev/zero")


def _dangling(path: Path) -> None:
    path.unlink()
    path.symlink_to("nothing-here")


def _fifo(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


def _extra(path: Path) -> None:
    (path.parent / f"{path.name}~").write_bytes(b"an editor left this")


_DEEDS = {
    "remove": _remove,
    "empty": _empty,
    "directory": _directory,
    "loop": _loop,
    "endless": _endless,
    "dangling": _dangling,
    "fifo": _fifo,
    "extra": _extra,
}
