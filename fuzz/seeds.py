"""What is damaged: the intact recordings in every variant, and a map of a longer drive."""

from __future__ import annotations

import multiprocessing
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from fuzz.containers import Variant, variants
from fuzz.drives import Drive, drives, planar_drive
from fuzz.map_changes import write_map
from fuzz.running import run_command

# What a person decides about that map: so it has edits of every kind.
EDITS = (
    ("--split", "0", "1,-0.5,3,-0.5", "--rename", "0", "Hall", "--set-property", "0", "floor=2"),
    ("--kind", "1", "room", "--forbid-door", "0", "1"),
)
# A map good enough to be read and localised in, from settings that cost little.
QUICK_SETTINGS = (
    "grid.resolution_m=0.1",
    "recognition.rounds=5",
    "localization.track_samples=20",
    "localization.augmentation=20",
)
_MAP_DRIVE_S, _OTHER_DRIVE_S, _MAP_BEAMS = 20.0, 18.0, 60
_LOCALIZED_S = 2.0
LOCALIZED, INTACT = "localized", "intact"  # what `write_intact` writes


@dataclass(frozen=True, slots=True, kw_only=True)
class Seeds:
    """Everything intact: drives by name, their files by variant and drive, a map's files.

    `localized` is the tiny log that is localised in damaged maps. The map has edits of a person;
    `other_files` are those of another map.
    """

    drives: Mapping[str, Drive]
    variants: Mapping[str, Variant]
    files: Mapping[tuple[str, str], bytes]
    map_files: Mapping[str, bytes]
    other_files: Mapping[str, bytes]
    localized: bytes


def make_seeds(*, with_map: bool = True) -> Seeds:
    """Make the intact inputs; the same bytes every time, but for the seconds in the map's run.json.

    The map is built in a process of its own: this one must stay without threads, as it is forked.
    """
    known, made = variants(), {drive.name: drive for drive in drives()}
    files = {
        (variant.name, name): variant.encode(made[name].messages)
        for variant in known.values()
        for name in variant.drives
    }
    tiny = planar_drive(_LOCALIZED_S, _MAP_BEAMS)
    map_files, other_files = _map_files() if with_map else ({}, {})
    return Seeds(
        drives=made,
        variants=known,
        files=files,
        map_files=map_files,
        other_files=other_files,
        localized=known["mcap-zstd"].encode(tiny.messages),
    )


def write_intact(seeds: Seeds, folder: Path) -> None:
    """Write what the commands take beside the damaged input: a log, and the intact map."""
    (folder / LOCALIZED).write_bytes(seeds.localized)
    write_map(folder / INTACT, seeds.map_files, [])


def _map_files() -> tuple[dict[str, bytes], dict[str, bytes]]:
    """The files of the map with a person's edits, and of another map."""
    with tempfile.TemporaryDirectory(prefix="fuzz-") as folder:
        context = multiprocessing.get_context("fork")
        child = context.Process(target=_build, args=(Path(folder),), daemon=True)
        child.start()
        child.join()
        if child.exitcode != 0:
            raise RuntimeError("the maps to damage could not be built")
        return _files_of(Path(folder) / "map"), _files_of(Path(folder) / "other")


def _files_of(folder: Path) -> dict[str, bytes]:
    paths = sorted(path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): path.read_bytes() for path in paths}


def _build(folder: Path) -> None:
    runs = []
    for name, seconds in (("map", _MAP_DRIVE_S), ("other", _OTHER_DRIVE_S)):
        log = folder / f"{name}.mcap"
        log.write_bytes(variants()["mcap-zstd"].encode(planar_drive(seconds, _MAP_BEAMS).messages))
        out = str(folder / name)
        runs.append(run_command(["build", str(log), "-o", out, "--quiet", *settings()]))
    runs += [run_command(["edit", str(folder / "map"), *words, "--quiet"]) for words in EDITS]
    raise SystemExit(max(run.code for run in runs))


def settings() -> list[str]:
    """The quick settings as options of a command."""
    return [word for setting in QUICK_SETTINGS for word in ("--set", setting)]
