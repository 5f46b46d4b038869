"""`python -m fuzz.pairs --count 200`: two commands on one map at random moments.

Each must end as its documents say, and nothing of what one of two successful commands did may be
gone. Whoever reads meanwhile sees one whole map. A person's notes beside the map stay.
"""

from __future__ import annotations

import argparse
import json
import random
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from specmap_cli.core.errors import SpecmapError
from specmap_cli.maps.store import read_map

PROGRAM = (sys.executable, "-m", "specmap_cli")
FINE = {0, 2, 3, 5}  # done, refused, replaced while it was read, a rule that is broken
_NOTES, _WORDS = "notes.txt", "a person's own"
_LONGEST_S = 300.0
_TOLD_EVERY = 20


@dataclass(frozen=True, slots=True)
class Bench:
    """A map, a recording of the same place, and a folder to try pairs in."""

    map: Path
    log: Path
    folder: Path

    def command(self, kind: str, name: str) -> list[str]:
        """A command on the copy of the map; an edit gives submap 0 that name."""
        target = str(self.folder / "map")
        return {
            "edit": ["edit", target, "--rename", "0", name],
            "property": ["edit", target, "--set-property", "0", f"{name}=1"],
            "update": ["update", target, str(self.log), "-o", target, "--overwrite"],
            "merge": ["merge", target, str(self.map), "-o", target, "--overwrite"],
            "build": ["build", str(self.log), "-o", target, "--overwrite"],
            "like": ["build", str(self.log), "--like", target, "-o", target, "--overwrite"],
            "check": ["check", target],
            "report": ["report", target, "-o", str(self.folder / f"{name}.html"), "--overwrite"],
        }[kind]


KINDS = ("edit", "property", "update", "merge", "build", "like", "check", "report")


def try_pair(bench: Bench, kinds: tuple[str, str], after_s: float) -> tuple[list[str], list[int]]:
    """Run two commands, the second so long after the first; what went wrong, and how they ended."""
    target, names = bench.folder / "map", ("Kitchen", "Pantry")
    shutil.rmtree(target, ignore_errors=True)
    shutil.copytree(bench.map, target)
    (target / _NOTES).write_text(_WORDS, encoding="utf-8")
    running, faults = [], []
    for kind, name, wait_s in zip(kinds, names, (after_s, 0.0), strict=True):
        command = [*PROGRAM, *bench.command(kind, name), "--quiet"]
        running.append(
            subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        )
        time.sleep(wait_s)
    while any(each.poll() is None for each in running):
        faults += _torn(target)
        time.sleep(0.02)
    ends = []
    for kind, process in zip(kinds, running, strict=True):
        said = process.communicate(timeout=_LONGEST_S)[1]
        ends.append(process.returncode)
        if process.returncode not in FINE or "Traceback" in said:
            faults.append(f"{kind} ended with {process.returncode}: {said.strip()[-200:]}")
    faults += _torn(target)
    if not faults:
        faults += _lost(target, kinds, names, ends)
    left = [path.name for path in bench.folder.iterdir() if path.name.startswith(".")]
    return [*faults, *(f"left behind: {name}" for name in left)], ends


def _torn(target: Path) -> list[str]:
    """What a reader sees that is no whole map."""
    try:
        map_ = read_map(target)
        _ = map_.topology, map_.labels, map_.regions, map_.run
    except SpecmapError as error:
        return [] if "was replaced meanwhile" in str(error) else [f"torn: {error}"]
    return []


def _lost(
    target: Path, kinds: tuple[str, str], names: tuple[str, str], ends: Sequence[int]
) -> list[str]:
    """What a command that ended well had done and that is gone."""
    record = read_map(target).record
    nodes = {node.id: node for node in record.nodes}
    lost = []
    for kind, name, end in zip(kinds, names, ends, strict=True):
        if end != 0:
            continue
        if kind == "edit" and nodes[0].name not in names:
            lost.append(f"the name {name}")
        if kind == "property" and name not in nodes[0].properties:
            lost.append(f"the property {name}")
        alone = not {"like", "build"} & set(kinds)  # which make the map of one recording
        if kind == "update" and alone and len(record.graph.logs) < 2:
            lost.append("the recording")
    if (target / _NOTES).read_text(encoding="utf-8") != _WORDS:
        lost.append(_NOTES)
    return [f"lost: {what}" for what in lost]


def main(arguments: Sequence[str] | None = None) -> int:
    """Try pairs; 0 when nothing was lost or torn."""
    parser = argparse.ArgumentParser(prog="python -m fuzz.pairs", description=__doc__)
    parser.add_argument("map", type=Path, help="a small map")
    parser.add_argument("log", type=Path, help="another recording of its place")
    parser.add_argument("--count", type=int, default=20, help="how many (%(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="which (%(default)s)")
    options = parser.parse_args(arguments)
    rng, ended, failed = random.Random(options.seed), Counter[str](), 0
    with tempfile.TemporaryDirectory(prefix="fuzz-pairs-") as folder:
        bench = Bench(options.map.resolve(), options.log.resolve(), Path(folder))
        for number in range(options.count):
            kinds = (rng.choice(KINDS), rng.choice(KINDS))
            after_s = rng.choice([0.0, rng.uniform(0.0, 1.0), rng.uniform(0.0, 5.0)])
            faults, ends = try_pair(bench, kinds, after_s)
            ended.update(map(str, ends))
            failed += bool(faults)
            for fault in faults:
                told = f"pair {number}, {kinds[1]} {after_s:.2f} s after {kinds[0]}: {fault}"
                print(told, flush=True)
            if (number + 1) % _TOLD_EVERY == 0:
                print(f"{number + 1} pairs, {failed} failed", file=sys.stderr, flush=True)
    print(json.dumps({"pairs": options.count, "failed": failed, "exit codes": dict(ended)}))
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
