"""A finished map as a value: what Algorithm 1 and the stages after it hand on to the files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from specmap_cli.core.findings import Quality
from specmap_cli.core.geometry import path_length
from specmap_cli.core.records import IntArray, Labels, Trajectory
from specmap_cli.core.text import legible
from specmap_cli.drawing.overview import render_overview
from specmap_cli.layout.g2o import write_g2o
from specmap_cli.layout.relaxation import Layout
from specmap_cli.maps.writing import MapResult, PictureArray
from specmap_cli.pipelines.stored_lessons import arrays_of
from specmap_cli.recognition.learning.classifiers import ClassifierSet
from specmap_cli.recognition.learning.lessons import Lessons
from specmap_cli.topology.regions import Regions
from specmap_cli.topology.topological_map import LogInfo, TopologicalMap


@dataclass(frozen=True, slots=True, kw_only=True)
class FinishedMap:
    """A map ready to be written: row i of `labels` is keyframe number i of the store.

    `regions` divide the grid of the whole map. `lessons` are what the classifiers learned from.
    `counts` are of messages and scans. `limits`
    say how often a setting of that name cut the work short. `quality` is what is thought of the
    map, `seconds` are those of each stage, `wall_s` those from the first to the last. `starts` are
    the rows of the trajectory with which further recordings begin, `driven_m` how far the robot
    drove in each recording, where this is known from before. `edits` is the text of
    edits.toml, `unapplied` tells what of it does not apply.
    """

    topology: TopologicalMap
    labels: Labels
    trajectory: Trajectory
    regions: Regions
    classifiers: ClassifierSet
    lessons: Lessons
    layout: Layout
    counts: Mapping[str, int]
    limits: Mapping[str, int]
    quality: Quality
    seconds: Mapping[str, float]
    wall_s: float = 0.0
    starts: tuple[int, ...] = ()
    driven_m: tuple[float | None, ...] = ()
    edits: str = ""
    unapplied: tuple[str, ...] = ()

    @property
    def path_m(self) -> float:
        """Metres driven, as far as known: over keyframes, and over scans that were lost."""
        ways = ways_m(self.trajectory, self.labels.stamps_ns, self.starts)
        known = self.driven_m or (None,) * len(ways)
        pairs = zip(ways, known, strict=True)
        return sum(way if driven is None else driven for way, driven in pairs)

    def overview(self, logs: tuple[LogInfo, ...]) -> PictureArray:
        """The picture of the map. It takes memory: run.json counts it when it is drawn before."""
        return render_overview(
            self.topology, self.regions, self.trajectory, self.labels, logs, self.quality
        )

    def result(
        self, logs: tuple[LogInfo, ...], run: Mapping[str, Any], overview: PictureArray
    ) -> MapResult:
        """What the map directory is written from: the map, its picture, and `run` for run.json."""
        return MapResult(
            topology=self.topology,
            regions=self.regions,
            trajectory=self.trajectory,
            labels=self.labels,
            classifiers=self.classifiers.to_json(),
            features=arrays_of(self.lessons),
            logs=logs,
            run=run,
            quality=self.quality,
            pose_graph=write_g2o(self.layout),
            edits=self.edits,
            overview=overview,
        )


def ways_m(trajectory: Trajectory, stamps_ns: IntArray, starts: Sequence[int]) -> list[float]:
    """Metres driven in each recording, over the keyframes of these stamps and over lost scans.

    Between keyframes a robot at rest would seem to move: its poses shiver. `starts` are the rows
    with which further recordings begin.
    """
    counted = np.isin(trajectory.stamps_ns, stamps_ns)
    if trajectory.lost is not None:
        counted |= trajectory.lost
    ways = np.split(np.arange(len(counted)), starts)
    return [path_length(trajectory.poses[way][counted[way]]) for way in ways]


def recording(name: str, trajectory: Trajectory, keyframes: int) -> LogInfo:
    """The recording of a file `name`, which gave a trajectory and some keyframes."""
    stamps = trajectory.stamps_ns
    return LogInfo(
        name=legible(Path(name).name),
        start_ns=int(stamps.min()),
        end_ns=int(stamps.max()),
        scans=len(stamps),
        keyframes=(0, keyframes - 1),
    )
