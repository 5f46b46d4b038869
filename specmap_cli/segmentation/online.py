"""Splitting the current submap as the robot moves (section II-C of the paper)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from specmap_cli.core.settings import GridConfig, SegmentationConfig
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.segmentation.splitting import CoarseSubmap, SplitTest, examine, way_driven

_TEST_METRES = 1.0  # travelled between two tests

Observer = Callable[[SplitTest, bool, "Occasion"], None]

# Of the least part that a test can split off a long way: so much later may a test find it.
_LATER = 0.25


@dataclass(frozen=True, slots=True)
class Region:
    """A finished region: the keyframes, ascending, that belong to the submap just left.

    `continues` is the number of the earlier region that this one is a piece of, because the robot
    came straight back to it; None for a submap of its own.
    """

    number: int
    keyframes: tuple[int, ...]
    continues: int | None


@dataclass(frozen=True, slots=True)
class Occasion:
    """When a submap was tested: its first and latest keyframe, and the time since the log began."""

    first: int
    latest: int
    seconds: float


class OnlineSegmenter:
    """Takes keyframes into the current submap and says which regions were left.

    `observer` is called after every test with the test, whether the submap was split, and when.
    """

    def __init__(
        self,
        config: SegmentationConfig,
        grid_config: GridConfig,
        store: KeyframeStore,
        observer: Observer | None = None,
    ) -> None:
        self.config = config
        self.observer = observer
        self._store, self._grid_config = store, grid_config
        self._current = CoarseSubmap(config, grid_config, store)
        self._since_test = 0.0  # metres or keyframes, as `test_every` says
        self._way_m = 0.0  # driven in the current submap
        # the last two that were left; none from before a loss of track
        self._recent: list[tuple[Region, CoarseSubmap]] = []
        self._finished = 0

    def add(self, keyframe: int) -> list[Region]:
        """Take one keyframe into the current submap; the regions left with it, oldest first.

        What decides on a split, in this order:

        1. whether it is time for a test;
        2. which keyframes free space does not join with the robot: these go in any case;
        3. whether the eigenvector that divides the way (`examine`) has an eigenvalue above the
           threshold, and both sides of the way are long enough;
        4. whether what was left continues an earlier region (`_finish`).
        """
        driven = self._current.add(keyframe)
        if self.config.test_every == "keyframes":
            self._since_test += 1
            due: float = self.config.test_keyframes
        else:
            self._since_test += driven
            self._way_m += driven
            # A test costs what the submap has grown to. In a long one, where only a part of many
            # metres can be split off, it is made more seldom.
            due = max(_TEST_METRES, _LATER * (self.config.split_share * self._way_m))
        if self._since_test < due:
            return []
        self._since_test = 0.0
        test = examine(self._current.grid(), self._current.poses, self.config)
        apart = self._current.apart(test.reached)
        # Left there, what lies apart would make the map of every test as large as the way from it.
        lost = []
        if apart.any():
            self._current, left = self._current.split(~apart)
            lost = [Region(self._finished, left.keyframes, None)]
            self._finished += 1
        keyframes, stays = np.array(self._current.keyframes), test.stays[~apart]
        split = test.eigenvalue > self.config.split_eigenvalue and all(
            len(side) and way_driven(self._store, side.tolist()) >= self.config.region_min_m
            for side in (keyframes[~stays], keyframes[stays])
        )
        if self.observer is not None:
            first, latest = keyframes[[0, -1]].tolist()
            stamps_ns = self._store.stamps_ns
            seconds = (stamps_ns[latest] - stamps_ns[0]) / 1e9
            self.observer(test, split, Occasion(first, latest, seconds))
        if split:
            self._current, left = self._current.split(stays)
            lost.append(self._finish(left))
        if lost:
            self._way_m = way_driven(self._store, self._current.keyframes)
        return lost

    def flush(self) -> list[Region]:
        """End the current submap, at the end of a log or after a loss of track."""
        last = self._current
        if not last.keyframes:
            return []
        region = self._finish(last)
        self._current = CoarseSubmap(self.config, self._grid_config, self._store)
        self._recent = []
        self._since_test = self._way_m = 0.0
        return [region]

    def _finish(self, left: CoarseSubmap) -> Region:
        """The next finished region, a piece of an earlier one where the robot came back to it.

        It came back to the region left before the last one, if that and what was `left` now are
        one region: no eigenvector divides their keyframes.
        """
        continues = None
        if self.config.regrow and len(self._recent) == 2:
            earlier, before = self._recent[0]
            if before.near(left):
                union = before.joined(left)
                test = examine(union.grid(), union.poses, self.config)
                if test.reached.all() and test.eigenvalue <= self.config.split_eigenvalue:
                    continues = earlier.number if earlier.continues is None else earlier.continues
        region = Region(self._finished, left.keyframes, continues)
        self._finished += 1
        self._recent = [*self._recent[-1:], (region, left)]
        return region
