"""Poses of `specmap localize --metric` against true ones: another tour, and a robot carried away.

    OMP_NUM_THREADS=1 python -m benchmarks.metric [--only tours carried] [--quick]

Tours: a map from one simulated tour at true poses, whose submaps are the rooms of the plan; another
tour by another way is registered as a log is, with its drifting odometry, and localised. A pose is
right within 0.1 m and 1 degree, wrong beyond 0.5 m. Carried: the same tour, of which the middle is
cut out, so that the robot is elsewhere from one scan to the next; the wheels tell nothing of it, or
registration begins afresh there.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.data import plan, rooms_of
from benchmarks.recognition import localizer_of_tour, tour_of, tour_options
from specmap_cli.core.config import load_config
from specmap_cli.core.geometry import Pose2
from specmap_cli.core.records import PosedScan, Sweep
from specmap_cli.core.settings import Config
from specmap_cli.core.tracks import path_length
from specmap_cli.recognition.localization.localizer import Localizer
from specmap_cli.recognition.localization.metric import Fix
from specmap_cli.registration.frontend import FrontEnd
from specmap_cli.simulation.simulator import simulate_sweeps

CASES = (
    ("Freiburg79_scan_furnitures", 180.0),
    ("Freiburg79_scan_furnitures", 360.0),
    ("Freiburg52_scan_furnitures", 180.0),
    ("lab_c_scan_furnitures", 180.0),
    ("lab_intel_furnitures", 180.0),
    ("lab_a_scan_furnitures", 180.0),
    ("office_a_furnitures", 180.0),
)
RIGHT_M, RIGHT_RAD, WRONG_M = 0.1, math.radians(1.0), 0.5
INSIDE = 7.81  # chi-square of three degrees of freedom: 95 % of right covariances are below


@dataclass(frozen=True, slots=True)
class Seen:
    """A scan as it was localised: its filtered label is right or not, its pose and the true one."""

    labelled: bool
    fix: Fix | None
    truth: Pose2 | None  # in the submap of the fix
    place: Pose2  # in the world

    def off(self) -> Pose2:
        """What the pose is off by."""
        assert self.fix is not None
        assert self.truth is not None
        return self.truth.inverse() @ self.fix.pose

    @property
    def right(self) -> bool:
        """Whether a pose was given, and is good."""
        if self.fix is None:
            return False
        off = self.off()
        return off.distance <= RIGHT_M and abs(off.theta) <= RIGHT_RAD

    @property
    def wrong(self) -> bool:
        """Whether a pose was given that is of another place."""
        return self.fix is not None and self.off().distance > WRONG_M


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    sections = {"tours": tours, "carried": carried}
    parser.add_argument("--only", nargs="+", choices=sorted(sections), default=list(sections))
    parser.add_argument("--quick", action="store_true", help="the first plan only")
    arguments = parser.parse_args()
    for name, run in sections.items():
        if name in arguments.only:
            run(CASES[:1] if arguments.quick else CASES)
            print()


def tours(cases: Sequence[tuple[str, float]]) -> None:
    print(
        "tours, new way              | filtered | given, right of these, right of all, wrong | in"
    )
    for name, view in cases:
        world = Simulated(name, view)
        print(f"{name:<26} {view:4.0f} | {_row(world.localised(world.scans()))}", flush=True)


def _row(seen: Sequence[Seen]) -> str:
    given = [each for each in seen if each.fix is not None]
    inside = np.mean([_surprise(each) < INSIDE for each in given if not each.wrong])
    return (
        f"{np.mean([each.labelled for each in seen]):.3f} | {len(given) / len(seen):.3f} "
        f"{np.mean([each.right for each in given]):.3f} "
        f"{np.mean([each.right for each in seen]):.3f} "
        f"{sum(each.wrong for each in seen)} of {len(seen)} | {inside:.3f}"
    )


def _surprise(each: Seen) -> float:
    """Squared Mahalanobis distance of the error of a pose."""
    assert each.fix is not None
    assert each.truth is not None
    turn = math.remainder(each.fix.pose.theta - each.truth.theta, 2 * math.pi)
    x, y = each.fix.pose.x - each.truth.x, each.fix.pose.y - each.truth.y
    off = np.array([x, y, turn])
    return float(off @ np.linalg.solve(each.fix.covariance, off))


def carried(cases: Sequence[tuple[str, float]]) -> None:
    print("carried away                | unnoticed: metres until right, wrong | noticed: the same")
    for name, view in cases:
        world = Simulated(name, view)
        texts = []
        for noticed in (False, True):
            cuts = [world.carried(k / 8, noticed) for k in (1, 2, 3)]
            metres = [_metres_until_right(seen) for seen in cuts]
            wrong = sum(each.wrong for seen in cuts for each in seen)
            late = " ".join(f"{way:.1f}" for way in metres)
            texts.append(f"{late}, {wrong} of {sum(map(len, cuts))}")
        print(f"{name:<26} {view:4.0f} | {' | '.join(texts)}", flush=True)


def _metres_until_right(seen: Sequence[Seen]) -> float:
    """Metres driven until the first right pose; nan when there is none."""
    first = next((k for k, each in enumerate(seen) if each.right), None)
    if first is None:
        return math.nan
    return path_length(np.array([each.place for each in seen[: first + 1]]))


class Simulated:
    """A map of one tour through a plan, and another tour through it."""

    def __init__(self, name: str, view: float) -> None:
        self.config: Config = load_config()
        self.rooms = rooms_of(name)
        world = plan(name)
        fresh = localizer_of_tour(tour_of(world, view, 0), self.rooms, self.config)
        self.fresh = fresh
        self.sweeps = list(simulate_sweeps(world, tour_options(view, 11, spacing_m=2.6)))

    def scans(self) -> Iterator[tuple[PosedScan, Pose2]]:
        """The other tour as it is registered, with true poses."""
        return self._registered(self.sweeps)

    def carried(self, at: float, noticed: bool) -> list[Seen]:
        """What comes after the robot was carried half a tour on, at a share of the tour."""
        count = len(self.sweeps)
        first, half = int(at * count), count // 2
        before, after = self.sweeps[max(0, first - 300) : first], self.sweeps[first + half :][:300]
        if not noticed:
            after = list(_pushed(before[-1][0], after))
        scans = list(self._registered([*before, *after]))
        if noticed:
            k = len(before)
            scans[k] = (replace(scans[k][0], restarted=True), scans[k][1])
        return self.localised(scans)[len(before) :]

    def _registered(
        self, sweeps: Iterable[tuple[Sweep, Pose2]]
    ) -> Iterator[tuple[PosedScan, Pose2]]:
        front_end = FrontEnd(self.config.registration)
        for sweep, pose in sweeps:
            yield front_end.register(sweep), pose

    def localised(self, scans: Iterable[tuple[PosedScan, Pose2]]) -> list[Seen]:
        """The scans with what localisation says of them."""
        localizer: Localizer = self.fresh()
        seen = []
        for posed, pose in scans:
            label = localizer.update(posed)
            lead = localizer.places.lead
            place = None if lead is None else lead.place
            fix = localizer.tracker.locate(posed, place, label.filtered_submap)
            truth = None if fix is None else localizer.tracker.frames[fix.submap].inverse() @ pose
            room = int(self.rooms.at(np.array([pose]))[0])
            seen.append(Seen(label.filtered_submap == room, fix, truth, pose))
        return seen


def _pushed(last: Sweep, sweeps: Sequence[tuple[Sweep, Pose2]]) -> Iterator[tuple[Sweep, Pose2]]:
    """The sweeps as if the wheels had not turned since the last one, nor time passed."""
    assert last.odom_from_base is not None
    first = sweeps[0][0]
    assert first.odom_from_base is not None
    back = last.odom_from_base @ first.odom_from_base.inverse()
    for sweep, pose in sweeps:
        assert sweep.odom_from_base is not None
        yield replace(sweep, odom_from_base=back @ sweep.odom_from_base), pose


if __name__ == "__main__":
    main()
