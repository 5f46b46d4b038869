"""Algorithm 1 of the paper: the map while the robot drives, a scan at a time."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import replace

import numpy as np

from specmap_cli.core.config import Config
from specmap_cli.core.geometry import FloatArray, Pose2, compose, invert
from specmap_cli.core.progress import Progress, Silent
from specmap_cli.core.records import Closure, IntArray, PosedScan, Sweep
from specmap_cli.grids.keyframes import KeyframeSelector, KeyframeStore, integrate_keyframes
from specmap_cli.layout.relaxation import Constraint
from specmap_cli.pipelines.stopwatch import Stopwatch
from specmap_cli.pipelines.trajectory import TrajectoryRecorder
from specmap_cli.recognition.closure.loop_closer import LoopCloser, SubmapView
from specmap_cli.recognition.features.sets import KeyframeFeatures
from specmap_cli.registration import FrontEnd
from specmap_cli.segmentation.online import Observer, OnlineSegmenter, Region
from specmap_cli.topology.graph import RegionMerger

# the spread of verified transforms about the truth: 4 cm and half a degree
_CLOSURE_INFORMATION = np.diag(1.0 / np.array([0.04, 0.04, 0.0087]) ** 2)


class Mapper:
    """The state of a map while the robot drives.

    `add` takes one sweep of the log through Algorithm 1, as `register` and `take`: registration
    needs nothing of what comes after it and may be done ahead. `finish` closes the last submap and
    looks for duplicates. Every scan is registered; keyframes go on to `store`, except those that
    `hold_out` (told the number of keyframes so far) sends to `held_out` for evaluation.
    """

    def __init__(
        self,
        config: Config,
        store: KeyframeStore,
        progress: Progress | None = None,
        observer: Observer | None = None,
        hold_out: Callable[[int], bool] | None = None,
        held_out: KeyframeStore | None = None,
    ) -> None:
        self.config = config
        self.store = store
        self.clock = Stopwatch()
        self.front_end = FrontEnd(config.registration)
        self.trajectory = TrajectoryRecorder()
        self.segmenter = OnlineSegmenter(config.segmentation, config.grid, store, observer)
        self.closer = LoopCloser(config.recognition, np.random.default_rng(config.seed))
        self.features = KeyframeFeatures(store, config.recognition.feature_set)
        self.merger = RegionMerger()
        self.regions: dict[int, list[int]] = {}
        self.closures: list[Closure] = []
        self.breaks: list[int] = []
        self._progress = progress or Silent()
        self._selector = KeyframeSelector(config.keyframes)
        self._hold_out, self._held_out = hold_out, held_out

    def add(self, sweep: Sweep) -> None:
        """Move forward and gather a new laser scan: one turn of Algorithm 1's loop."""
        self.take(self.register(sweep))

    def register(self, sweep: Sweep) -> PosedScan:
        """Scan match the new observation; it is not part of the map yet."""
        with self.clock.stage("registration"):
            return self.front_end.register(sweep)

    def take(self, scan: PosedScan) -> None:
        """Add a registered scan to the current submap: the rest of the turn."""
        self.trajectory.append(scan)
        if scan.restarted:
            self._restart(scan.stamp_ns)
        if not self._selector.accepts(scan):
            return
        if self._held_out is not None and self._hold_out is not None:
            taken = len(self.store) + len(self._held_out)
            if self._hold_out(taken):
                self._held_out.append(scan)
                return
        keyframe = self.store.append(scan)
        with self.clock.stage("segmentation"):
            finished = self.segmenter.add(keyframe)  # every N steps: a new submap?
        self._recognise(finished)

    def finish(self) -> None:
        """The end of the log: close the current submap and look for duplicates left over."""
        with self.clock.stage("segmentation"):
            finished = self.segmenter.flush()
        self._recognise(finished)
        while True:
            with self.clock.stage("recognition"):
                leftovers = self.closer.consider_leftovers(self._adjacency())
            self._accept(leftovers)
            if not any(closure.merged for closure in leftovers):
                break

    def labels(self) -> IntArray:
        """The submap (n,) of every keyframe, numbered by its first region."""
        labels = np.full(len(self.store), -1, dtype=np.int64)
        for region, keyframes in self.regions.items():
            labels[keyframes] = self.merger.find(region)
        return labels

    def refute(self, dropped: Collection[tuple[int, int]]) -> None:
        """Take back the merges whose constraint, between two keyframes, the layout dropped."""
        for number, closure in enumerate(self.closures):
            if not closure.merged or closure.old_from_new is None:
                continue
            constraint = self._constraint(closure, closure.old_from_new)
            if (constraint.source, constraint.target) in dropped:
                reason = "contradicts the layout"
                self.closures[number] = replace(
                    closure, merged=False, verified=False, reason=reason, old_from_new=None
                )
        self.merger = RegionMerger()
        for region in self.regions:
            self.merger.add(region)
        for closure in self.closures:
            if closure.merged:
                self.merger.merge(closure.old, closure.new)

    def constraints(self) -> list[Constraint]:
        """What the merges say about the poses of pairs of keyframes.

        Grids that match while the robot's tracks do not overlap are no evidence for the layout:
        that is what look-alike rooms do, too.
        """
        return [
            self._constraint(closure, closure.old_from_new)
            for closure in self.closures
            if closure.merged and closure.old_from_new is not None
        ]

    def _restart(self, stamp_ns: int) -> None:
        """Tracking was lost and starts afresh: what comes is a new submap, loosely linked."""
        self._progress.warn(
            f"registration lost the robot before {stamp_ns * 1e-9:.3f} s: "
            "a new submap begins, linked to the last by odometry only"
        )
        self.breaks.append(len(self.store))
        with self.clock.stage("segmentation"):
            finished = self.segmenter.flush()
        self._recognise(finished)

    def _recognise(self, finished: Sequence[Region]) -> None:
        """Use learned classifiers to determine if a new submap is an existing one (III-C)."""
        for region in finished:
            if region.continues is not None:
                self.regions[region.continues].extend(region.keyframes)
                continue
            self.regions[region.number] = list(region.keyframes)
            self.merger.add(region.number)
            with self.clock.stage("recognition"):
                considered = self.closer.consider(self._view(region))
            self._accept(considered)

    def _accept(self, closures: Iterable[Closure]) -> None:
        """If recognised as a previous submap, merge with it and close the loop."""
        for closure in closures:
            self.closures.append(closure)
            if closure.merged:
                self.merger.merge(closure.old, closure.new)
                self.closer.merge(closure.old, closure.new)

    def _view(self, region: Region) -> SubmapView:
        """What recognition sees of a finished region: features, grid and track in its own frame."""
        keyframes = region.keyframes
        track = self._in_own_frame(keyframes)
        with self.clock.stage("grids"):
            grid = integrate_keyframes(self.store, keyframes, track, self.config.grid).snapshot()
        limit = self.config.recognition.samples_per_submap
        spread = np.linspace(0, len(keyframes) - 1, min(len(keyframes), limit)).astype(int)
        return SubmapView(
            region.number,
            self.features.of([keyframes[i] for i in spread.tolist()]),
            grid,
            track,
            self.store.pose(keyframes[0]),
            self._travelled_before(keyframes[0]),
        )

    def _travelled_before(self, keyframe: int) -> float:
        """Metres driven before a keyframe; infinite once tracking has been lost."""
        if self.breaks and keyframe >= self.breaks[0]:
            return math.inf
        steps = np.diff(self.store.poses_of(range(keyframe + 1))[:, :2], axis=0)
        return float(np.hypot(steps[:, 0], steps[:, 1]).sum())

    def _in_own_frame(self, keyframes: Sequence[int]) -> FloatArray:
        """Poses (n, 3) of a region's keyframes in its frame, the pose of its first keyframe."""
        poses = self.store.poses_of(keyframes)
        return compose(invert(poses[0]), poses)

    def _constraint(self, closure: Closure, old_from_new: Pose2) -> Constraint:
        """The pair of keyframes nearest to each other under a closure's transform."""
        old, new = self.regions[closure.old], self.regions[closure.new]
        old_track = self._in_own_frame(old)
        new_track = compose(np.array(old_from_new), self._in_own_frame(new))
        gaps = old_track[:, None, :2] - new_track[None, :, :2]
        i, j = np.unravel_index(int((gaps**2).sum(axis=2).argmin()), gaps.shape[:2])
        relative = compose(invert(old_track[i]), new_track[j])
        source, target = old[int(i)], new[int(j)]
        return Constraint(source, target, Pose2(*relative.tolist()), _CLOSURE_INFORMATION)

    def _adjacency(self) -> dict[int, set[int]]:
        """Which submaps the robot drove between."""
        labels = self.labels()
        neighbours: dict[int, set[int]] = {int(label): set() for label in labels}
        for a, b in zip(labels[:-1].tolist(), labels[1:].tolist(), strict=True):
            if a != b:
                neighbours[a].add(b)
                neighbours[b].add(a)
        return neighbours
