"""Whether a registration result can be believed.

A result is judged by its score, how well the sweep's walls lie on the local map's, together with
whether it agrees with the expected motion. Neither alone will do: a robot that enters a room scores
0.35 to 0.5 at the right pose, and a wrong pose in a corridor can score 0.8.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.settings import RegistrationConfig
from specmap_cli.registration.locating import (
    ENOUGH,
    FAIR_SCORE,
    GOOD_SCORE,
    MOST,
    POOR_SCORE,
    SURE_SCORE,
    Located,
)
from specmap_cli.registration.scene import Fit

_BEYOND_DOUBT = 0.85  # score that proves a motion by itself: most right results have more
_HOPELESS = 0.15  # below it no agreement helps: points thrown at random score as much


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
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

    def levelled(self, share: float) -> Verdict:
        """The same with `share` of the roll and pitch taken back, heading and place kept.

        A lidar of few rings says little about its own tilt, whose drift would lift the robot off.
        """
        from scipy.spatial.transform import Rotation  # slow to load, and for 3D alone

        yaw, pitch, roll = Rotation.from_matrix(self.fit.pose[:3, :3]).as_euler("ZYX")
        level, kept = self.fit.pose.copy(), 1.0 - share
        level[:3, :3] = Rotation.from_euler("ZYX", [yaw, kept * pitch, kept * roll]).as_matrix()
        return replace(self, fit=replace(self.fit, pose=level))


def judge(
    located: Located, guess: FloatArray, config: RegistrationConfig, *, measured: bool
) -> Verdict:
    """What is thought of the pose found from a guess (4, 4); a lost sweep is put back on it.

    `measured`: the guess is odometry's. What agrees with the motion expected is lost only if the
    walls that could be seen contradict it.
    """
    fit, support = located.fit, located.support
    if located.agrees and measured:
        lost = support.count >= config.min_points and support.score < _HOPELESS
    elif located.agrees:
        lost = fit.score < _HOPELESS
    else:
        far = measured or located.wide_searched
        needed = needed_score(searched=located.searched, far=far)
        score = fit.score if measured or support.share < MOST else support.score
        lost = score < max(needed, _HOPELESS)
    certain = not lost and not located.unaligned and support.share >= MOST
    return Verdict(
        fit=replace(fit, pose=guess) if lost else fit,
        agrees=located.agrees,
        lost=lost,
        certain=certain and support.score > GOOD_SCORE,
        proven=certain and support.score > _BEYOND_DOUBT,
        refutes=lost or (support.share >= ENOUGH and support.score < FAIR_SCORE),
        founds=not lost and support.share >= ENOUGH and support.score >= FAIR_SCORE,
    )


def needed_score(*, searched: bool, far: bool) -> float:
    """The score that a result contradicting the expected motion must have.

    `searched`: a search had to be called; `far`: that motion was odometry's, or the search a wide
    one.
    """
    if not searched:
        return POOR_SCORE
    return SURE_SCORE if far else FAIR_SCORE
