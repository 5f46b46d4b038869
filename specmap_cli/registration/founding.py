"""A map is founded when a second sweep fits its first one; until then its scans are held back.

A first sweep that was spoiled, by a person before the laser or a driver that starts, would else be
the truth that all others are lost against.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.records import PlanarScan, PosedScan

_BEHIND_M = 0.3  # a beam that ends farther behind a wall has looked through it: noise is less


class Founding:
    """Holds back the scans of a map that is not founded yet, at most `most` of them."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._held: list[PosedScan] = []
        self._refuted: tuple[PosedScan, ...] = ()
        self._restarts = False

    def refute(self) -> int:
        """The map of the scans held is given up: they are lost. Returns how many were not before.

        Where they restarted the map after a break, the next one does.
        """
        believed = sum(not scan.lost for scan in self._held)
        self._restarts = self._restarts or any(scan.restarted for scan in self._held)
        lost = (replace(scan, lost=True, restarted=False) for scan in self._held)
        self._refuted, self._held = (*self._refuted, *lost), []
        return believed

    def handed_on(self, scan: PosedScan, *, founded: bool) -> tuple[PosedScan, ...]:
        """The scans that are settled now that this one was registered, in their order."""
        if self._restarts and not scan.lost:
            scan, self._restarts = replace(scan, restarted=True), False
        self._held.append(scan)
        settled, self._refuted = self._refuted, ()
        if founded or len(self._held) >= self._most:
            settled = (*settled, *self.rest())
        return settled

    def rest(self) -> tuple[PosedScan, ...]:
        """The scans that are held, which no later one will settle."""
        held, self._held = tuple(self._held), []
        return held


def looked_through(walls: FloatArray, scan: PlanarScan, map_from_laser: Pose2) -> float:
    """Share in [0, 1] of the walls (N, 2) of a map that a scan looks through, of those in its view.

    Two neighbouring beams must end well behind a wall. A beam without a return says nothing.
    """
    seen = map_from_laser.inverse().apply(walls)
    first = float(scan.bearings[0])
    bearings = first + np.mod(np.arctan2(seen[:, 1], seen[:, 0]) - first, 2 * np.pi)
    ranges = np.where(np.isfinite(scan.ranges), scan.ranges, 0.0)
    after = np.searchsorted(scan.bearings, bearings)
    if scan.full_circle:
        between = after > 0
        after = after % len(ranges)
    else:
        between = (after > 0) & (after < len(ranges))
        after = np.minimum(after, len(ranges) - 1)
    reach = np.minimum(ranges[after - 1], ranges[after])
    in_view = between & (reach > 0.0)
    if not in_view.any():
        return 0.0
    through = np.hypot(seen[:, 0], seen[:, 1]) + _BEHIND_M < reach
    return float(np.count_nonzero(through & in_view) / np.count_nonzero(in_view))
