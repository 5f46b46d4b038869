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
_MAP_DRIVE_S, _MAP_BEAMS = 20.0, 60
_LOCALIZED_S = 2.0
LOCALIZED, INTACT = "localized", "intact"  # what `write_intact` writes


@dataclass(frozen=True, slots=True, kw_only=True)
class Seeds:
    """Everything intact: drives by name, their files by variant and drive, a map's files.

    `localized` is the tiny log that is localised in damaged maps. The map has edits of a person.
    """

    drives: Mapping[str, Drive]
    variants: Mapping[str, Variant]
    files: Mapping[tuple[str, str], bytes]
    map_files: Mapping[str, bytes]
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
    return Seeds(
        drives=made,
        variants=known,
        files=files,
        map_files=_map_files() if with_map else {},
        localized=known["mcap-zstd"].encode(tiny.messages),
    )


def write_intact(seeds: Seeds, folder: Path) -> None:
    """Write what the commands take beside the damaged input: a log, and the intact map."""
    (folder / LOCALIZED).write_bytes(seeds.localized)
    write_map(folder / INTACT, seeds.map_files, [])


def _map_files() -> dict[str, bytes]:
    log = variants()["mcap-zstd"].encode(planar_drive(_MAP_DRIVE_S, _MAP_BEAMS).messages)
    with tempfile.TemporaryDirectory(prefix="fuzz-") as folder:
        (Path(folder) / "log").write_bytes(log)
        out = Path(folder) / "map"
        context = multiprocessing.get_context("fork")
        child = context.Process(target=_build, args=(Path(folder) / "log", out), daemon=True)
        child.start()
        child.join()
        if child.exitcode != 0:
            raise RuntimeError("the map to damage could not be built")
        paths = sorted(path for path in out.rglob("*") if path.is_file())
        return {str(path.relative_to(out)): path.read_bytes() for path in paths}


def _build(log: Path, out: Path) -> None:
    built = run_command(["build", str(log), "-o", str(out), "--quiet", *settings()])
    edited = [run_command(["edit", str(out), *words, "--quiet"]) for words in EDITS]
    raise SystemExit(max(run.code for run in (built, *edited)))


def settings() -> list[str]:
    """The quick settings as options of a command."""
    return [word for setting in QUICK_SETTINGS for word in ("--set", setting)]
