"""The report on a map and on many copies of it side by side: bytes, and what a browser makes of it.

    python -m benchmarks.reports MAP --copies 1 22

The copies stand in a square, each with its submaps, its recordings and its scans. A browser, where
a Chromium is installed, is asked for the time until the page was drawn, and for that of a step of
a zoom.
"""

from __future__ import annotations

import argparse
import json
import math
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from specmap_cli.core.geometry import Pose2
from specmap_cli.core.progress import Silent
from specmap_cli.core.records import Labels
from specmap_cli.grids.gridmap import UNKNOWN, GridMap
from specmap_cli.grids.map_server import write_grid
from specmap_cli.maps import filenames
from specmap_cli.maps.store import StoredMap, read_map
from specmap_cli.maps.tables import labels_text
from specmap_cli.pipelines.map_evidence import evidence_of
from specmap_cli.report.evidence import Evidence, Learned, Likeness, SplitLook
from specmap_cli.report.page import render
from specmap_cli.topology.topological_map import default_name
from tests.report.browser import Browser, installed

_APART_M, _MOST_DOORS = 1.0, 10_000
_STEP_MS = """new Promise((done) => { const times = []; const step = (last) => (now) => {
  times.push(now - last); zoomBy(1.15); panBy(view.width / 50, 0);
  times.length < 20 ? requestAnimationFrame(step(now)) : done(times.slice(2)); };
  requestAnimationFrame(step(performance.now())); })"""


class Copies:
    """A map and its evidence, `count` times side by side."""

    def __init__(self, stored: StoredMap, evidence: Evidence, count: int) -> None:
        self.stored, self.evidence, self.count = stored, evidence, count
        self.side = math.ceil(math.sqrt(count))
        height, width = stored.map_grid.cells.shape
        gap = round(_APART_M / stored.map_grid.resolution)
        self.pitch = height + gap, width + gap
        self.keyframes = len(stored.labels.stamps_ns)
        self.ids = 1 + max(stored.ids)

    def shift(self, number: int) -> np.ndarray:
        """How far the copy of a number is moved, metres (2,)."""
        row, column = divmod(number, self.side)
        cells = np.array([column * self.pitch[1], row * self.pitch[0]])
        return np.asarray(cells * self.stored.map_grid.resolution)

    def write(self, out: Path) -> StoredMap:
        """The copies as a map directory without classifiers and scans."""
        document = json.loads(self.stored.record.model_dump_json(by_alias=True))
        whole = {**document, "nodes": [], "edges": []}
        graph = whole["graph"] = {**document["graph"]}
        parts: dict[str, list[Any]] = {key: [] for key in ("doors", "stays", "closures")}
        copied = {key: document["graph"][key] for key in parts}
        for number in range(self.count):
            moved = self._moved({**document, "graph": copied}, number)
            for door, same in zip(moved["graph"]["doors"], copied["doors"], strict=True):
                door["id"] = same["id"] + number * _MOST_DOORS
            whole["nodes"] += [
                {**node, "name": default_name(node["id"])} for node in moved["nodes"]
            ]
            whole["edges"] += moved["edges"]
            for key, part in parts.items():
                part += moved["graph"][key]
        graph |= {**parts, "next_id": self.ids * self.count, "logs": self._logs(document)}
        out.mkdir(parents=True)
        (out / filenames.SUBMAPS).symlink_to((self.stored.path / filenames.SUBMAPS).resolve())
        (out / filenames.TOPOLOGY).write_text(json.dumps(whole))
        (out / filenames.RUN).write_text(json.dumps(self.stored.run))
        (out / filenames.LABELS).write_text(labels_text(self._labels()))
        write_grid(out / filenames.MAP_GRID, self._grid())
        return read_map(out)

    def _logs(self, document: Any) -> list[Any]:
        (log,) = document["graph"]["logs"]
        seconds = log["end"] - log["start"] + 60.0
        return [
            {
                **log,
                "start": log["start"] + k * seconds,
                "end": log["end"] + k * seconds,
                "keyframes": [k * self.keyframes, (k + 1) * self.keyframes - 1],
            }
            for k in range(self.count)
        ]

    def _moved(self, part: Any, number: int, key: str = "") -> Any:
        """A part of topology.json with the ids, places and keyframes of a copy."""
        ids = {"id", "source", "target", "from", "to", "submap", "new_submap", "old_submap"}
        x, y = self.shift(number).tolist()
        if isinstance(part, dict):
            moved = {name: self._moved(value, number, name) for name, value in part.items()}
            placed = part.get("x") is not None
            return moved | ({"x": part["x"] + x, "y": part["y"] + y} if placed else {})
        if key in ids and part is not None:
            return part + number * self.ids
        if key == "origin":
            return part + number * self.keyframes
        if key == "between":
            return [each + number * self.ids for each in part]
        if key == "doors" and part and isinstance(part[0], int):
            return [each + number * _MOST_DOORS for each in part]
        if key in {"number", "new", "old"}:
            return part + number * 10_000
        if key in {"anchor", "centroid"} and part is not None:
            return [part[0] + x, part[1] + y]
        if key in {"polygon", "path"} and part is not None:
            return [[u + x, v + y] for u, v in part]
        if key == "keyframes" and isinstance(part, list):
            return [
                [first + number * self.keyframes, last + number * self.keyframes]
                for first, last in part
            ]
        if isinstance(part, list):
            return [self._moved(each, number) for each in part]
        return part

    def _labels(self) -> Labels:
        labels = self.stored.labels
        span = int(np.ptp(labels.stamps_ns)) + 60_000_000_000
        shifts = np.repeat(
            [[*self.shift(k), 0.0] for k in range(self.count)], self.keyframes, axis=0
        )
        numbers = np.repeat(np.arange(self.count), self.keyframes)
        return Labels(
            stamps_ns=np.tile(labels.stamps_ns, self.count) + numbers * span,
            poses=np.tile(labels.poses, (self.count, 1)) + shifts,
            submaps=np.tile(labels.submaps, self.count) + numbers * self.ids,
        )

    def _grid(self) -> GridMap:
        grid = self.stored.map_grid
        rows = math.ceil(self.count / self.side)
        shape = rows * self.pitch[0], self.side * self.pitch[1]
        cells = np.full(shape, UNKNOWN, dtype=np.uint8)
        for number in range(self.count):
            row, column = divmod(number, self.side)
            low, left = row * self.pitch[0], column * self.pitch[1]
            height, width = grid.cells.shape
            cells[low : low + height, left : left + width] = grid.cells
        return GridMap(cells, grid.resolution, grid.origin)

    def found(self) -> Evidence:
        """The evidence of all copies."""
        assert self.evidence.fit is not None
        learned: dict[int, Learned] = {}
        tests: list[SplitLook] = []
        for number in range(self.count):
            x, y = self.shift(number)
            more, move = number * self.ids, Pose2(float(x), float(y), 0.0)
            learned |= {id_ + more: _told(one, more) for id_, one in self.evidence.learned.items()}
            tests += [
                replace(
                    one,
                    keyframe=one.keyframe + number * self.keyframes,
                    nodes=move.apply(one.nodes),
                )
                for one in self.evidence.tests
            ]
        fit = np.tile(self.evidence.fit, self.count)
        return replace(self.evidence, learned=learned, tests=tuple(tests), fit=fit)


def _told(learned: Learned, more: int) -> Learned:
    alike = tuple(Likeness(one.submap + more, one.share) for one in learned.alike)
    return replace(learned, alike=alike)


def in_a_browser(page: Path) -> str:
    """What a browser makes of a page, in words."""
    program = installed()
    if program is None:
        return "no Chromium"
    with Browser(program) as browser:
        browser.size(1440, 900)
        browser.open(page)
        drawn = browser.run("new Promise((d) => requestAnimationFrame(() => d(performance.now())))")
        steps = browser.run(_STEP_MS)
        assert browser.errors == []
        return f"{drawn:6.0f} ms until drawn, {np.median(steps):5.0f} ms a step of a zoom"


def main() -> None:
    """Make the pages and print a line each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("map", type=Path)
    parser.add_argument("--copies", type=int, nargs="+", default=[1, 22])
    parser.add_argument("--keep", type=Path, help="a directory for the pages")
    given = parser.parse_args()
    stored = read_map(given.map)
    evidence = evidence_of(stored, Silent())
    for count in given.copies:
        with tempfile.TemporaryDirectory() as folder:
            copies = Copies(stored, evidence, count)
            many, found = copies.write(Path(folder) / "map"), copies.found()
            begin = time.process_time()
            text = render(many, found)
            seconds = time.process_time() - begin
            page = (given.keep or Path(folder)) / f"{count}.html"
            page.write_text(text, encoding="utf-8")
            size = len(text.encode()) / 1e6
            rooms = len(many.ids)
            print(
                f"{rooms:4} submaps: {size:5.2f} MB, {seconds:5.1f} s to make, {in_a_browser(page)}"
            )


if __name__ == "__main__":
    main()
