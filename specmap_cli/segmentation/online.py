"""Splitting the current submap as the robot moves (section II-C of the paper)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from specmap_cli.core.records import BoolArray
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
        """Take one keyframe into the current submap; the regions left with it, oldest first."""
        if self._test_is_due(keyframe):
            self._since_test = 0.0
            return self._test()
        return []

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

    def _test_is_due(self, keyframe: int) -> bool:
        """Add `keyframe` and tell whether the way since the last test is long enough.

        A test costs what the submap has grown to. In a long one, where only a part of many metres
        can be split off, it is made more seldom.
        """
        driven = self._current.add(keyframe)
        if self.config.test_every == "keyframes":
            self._since_test += 1
            return self._since_test >= self.config.test_keyframes
        self._since_test += driven
        self._way_m += driven
        least_m = self.config.split_share * self._way_m
        return self._since_test >= max(_TEST_METRES, _LATER * least_m)

    def _test(self) -> list[Region]:
        """Test the current submap; the regions that were split off, oldest first."""
        test = examine(self._current.grid(), self._current.poses, self.config)
        apart = self._current.apart(test.reached)
        lost = self._without(apart)
        keyframes, stays = np.array(self._current.keyframes), test.stays[~apart]
        split = test.eigenvalue > self.config.split_eigenvalue and all(
            len(side) and way_driven(self._store, side.tolist()) >= self.config.region_min_m
            for side in (keyframes[~stays], keyframes[stays])
        )
        if self.observer is not None:
            self.observer(test, split, self._occasion())
        if not split:
            return lost
        return [*lost, self._finish(self._split(stays))]

    def _occasion(self) -> Occasion:
        first, latest = self._current.keyframes[0], self._current.keyframes[-1]
        stamps_ns = self._store.stamps_ns
        return Occasion(first, latest, (stamps_ns[latest] - stamps_ns[0]) / 1e9)

    def _split(self, stays: BoolArray) -> CoarseSubmap:
        """Keep the keyframes (p,) that stay in the current submap; the others, which were left."""
        self._current, left = self._current.split(stays)
        self._way_m = way_driven(self._store, self._current.keyframes)
        return left

    def _without(self, apart: BoolArray) -> list[Region]:
        """Take keyframes (p,) out of the current submap: a region that the robot is long gone from.

        Left there, it would make the map of every test as large as the way from there.
        """
        if not apart.any():
            return []
        region = Region(self._finished, self._split(~apart).keyframes, None)
        self._finished += 1
        return [region]

    def _finish(self, left: CoarseSubmap) -> Region:
        """The next finished region, a piece of an earlier one where the robot came back to it."""
        earlier = self._came_back_to(left)
        continues = None
        if earlier is not None:
            continues = earlier.number if earlier.continues is None else earlier.continues
        region = Region(self._finished, left.keyframes, continues)
        self._finished += 1
        self._recent = [*self._recent[-1:], (region, left)]
        return region

    def _came_back_to(self, left: CoarseSubmap) -> Region | None:
        """The region left before the last one, if it and what was `left` now are one region."""
        if not self.config.regrow or len(self._recent) < 2:
            return None
        region, before = self._recent[0]
        if not before.near(left):
            return None
        union = before.joined(left)
        test = examine(union.grid(), union.poses, self.config)
        whole = bool(test.reached.all()) and test.eigenvalue <= self.config.split_eigenvalue
        return region if whole else None
