"""Whether a registration result can be believed, and when a map is founded on it.

A result is judged by its score, how well the sweep's walls lie on the local map's, together with
whether it agrees with the expected motion. Neither alone will do: a robot that enters a room scores
0.35 to 0.5 at the right pose, and a wrong pose in a corridor can score 0.8.

A map is founded when a second sweep fits its first one; until then its scans are held back. A first
sweep that was spoiled, by a person before the laser or a driver that starts, would else be the
truth that all others are lost against.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.records import PlanarScan, PosedScan
from specmap_cli.core.settings import RegistrationConfig
from specmap_cli.registration.guess import MotionGuess
from specmap_cli.registration.local_map import Fit
from specmap_cli.registration.locating import (
    ENOUGH,
    FAIR_SCORE,
    GOOD_SCORE,
    MOST,
    POOR_SCORE,
    SURE_SCORE,
    Located,
)

_PROVES = 0.85  # score that proves a motion by itself: most right results have more
_BEHIND_M = 0.3  # a beam that ends farther behind a wall has looked through it: noise is less
_HOPELESS = 0.15  # below it no agreement helps: points thrown at random score as much


@dataclass(frozen=True, slots=True, kw_only=True)
class Judgement:
    """The pose of a sweep and what is thought of it.

    A `lost` sweep is at its guess. `agrees`: the result agrees with the expected motion. `certain`:
    the walls alone prove it; `proven`: they do so for any motion. `founds`: it fits what was seen
    before well enough to be one map with it; `refutes`: it does not, where it could.
    """

    fit: Fit
    agrees: bool = True
    lost: bool = False
    certain: bool = False
    proven: bool = False
    founds: bool = False
    refutes: bool = False

    def levelled(self, share: float) -> Judgement:
        """The same with `share` of the roll and pitch taken back, heading and place kept.

        A lidar of few rings says little about its own tilt, whose drift would lift the robot off.
        """
        from scipy.spatial.transform import Rotation  # slow to load, and for 3D alone

        yaw, pitch, roll = Rotation.from_matrix(self.fit.pose[:3, :3]).as_euler("ZYX")
        level, kept = self.fit.pose.copy(), 1.0 - share
        level[:3, :3] = Rotation.from_euler("ZYX", [yaw, kept * pitch, kept * roll]).as_matrix()
        return replace(self, fit=replace(self.fit, pose=level))


def judge(located: Located, guess: MotionGuess, config: RegistrationConfig) -> Judgement:
    """What is thought of the pose found from a guess; a lost sweep is put back on it.

    What agrees with odometry is lost only if the walls that could be seen contradict it.
    """
    fit, support, measured = located.fit, located.support, guess.expected.measured
    if located.agrees and measured:
        lost = support.count >= config.min_points and support.score < _HOPELESS
    elif located.agrees:
        lost = fit.score < _HOPELESS
    else:
        needed = POOR_SCORE
        if located.searched:
            needed = SURE_SCORE if measured or located.wide_searched else FAIR_SCORE
        score = fit.score if measured or support.share < MOST else support.score
        lost = score < needed
    certain = not lost and not located.unaligned and support.share >= MOST
    return Judgement(
        fit=replace(fit, pose=guess.pose) if lost else fit,
        agrees=located.agrees,
        lost=lost,
        certain=certain and support.score > GOOD_SCORE,
        proven=certain and support.score > _PROVES,
        refutes=lost or (support.share >= ENOUGH and support.score < FAIR_SCORE),
        founds=not lost and support.share >= ENOUGH and support.score >= FAIR_SCORE,
    )


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
