"""What can be wrong with a recording: each function takes the sweeps of one and gives others."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace

import numpy as np

from specmap_cli.core.geometry import IDENTITY, Pose2, compose, invert
from specmap_cli.core.records import Sweep
from specmap_cli.simulation.simulator import OdometryErrors, drifting_odometry

Sweeps = Iterable[Sweep]
Spoiling = Callable[[Sweeps], Iterator[Sweep]]


def clocked(sweeps: Sweeps) -> Iterator[tuple[float, Sweep]]:
    """Each sweep with the seconds since the first one."""
    start_ns: int | None = None
    for sweep in sweeps:
        start_ns = sweep.stamp_ns if start_ns is None else start_ns
        yield (sweep.stamp_ns - start_ns) * 1e-9, sweep


def every_metres(distance_m: float, turn_rad: float = 1.0) -> Spoiling:
    """Keep a scan each time that odometry has moved so far, or turned so much, since the last."""

    def thin(sweeps: Sweeps) -> Iterator[Sweep]:
        last: Pose2 | None = None
        for sweep in sweeps:
            here = sweep.odom_from_base or IDENTITY
            step = None if last is None else last.inverse() @ here
            if step is None or step.distance >= distance_m or abs(step.theta) >= turn_rad:
                last = here
                yield sweep

    return thin


def every_seconds(seconds: float) -> Spoiling:
    """Keep a scan each time that so much time has passed since the last."""

    def thin(sweeps: Sweeps) -> Iterator[Sweep]:
        due = -np.inf
        for sweep in sweeps:
            if sweep.stamp_ns >= due:
                due = sweep.stamp_ns + seconds * 1e9
                yield sweep

    return thin


def without_odometry(sweeps: Sweeps) -> Iterator[Sweep]:
    """The same without any odometry."""
    for sweep in sweeps:
        yield replace(sweep, odom_from_base=None)


def noisier(errors: OdometryErrors, seed: int = 5) -> Spoiling:
    """Odometry that errs besides: its motions go through the model of drift once more."""

    def spoil(sweeps: Sweeps) -> Iterator[Sweep]:
        rng = np.random.default_rng(seed)
        before: np.ndarray | None = None
        now = np.zeros(3)
        for sweep in sweeps:
            assert sweep.odom_from_base is not None
            pose = np.array(sweep.odom_from_base)
            if before is not None:
                step = compose(invert(before), pose)
                drifted = drifting_odometry(np.array([np.zeros(3), step]), errors, rng)[1]
                now = compose(now, drifted)
            before = pose
            yield replace(sweep, odom_from_base=Pose2(*now.tolist()))

    return spoil


def first_scans_spoiled(count: int, seed: int = 6) -> Spoiling:
    """The first scans hold what no wall explains: ranges at random."""

    def spoil(sweeps: Sweeps) -> Iterator[Sweep]:
        rng = np.random.default_rng(seed)
        for number, sweep in enumerate(sweeps):
            if number < count:
                ranges = rng.uniform(0.3, 3.0, len(sweep.planar.ranges))
                sweep = replace(sweep, planar=replace(sweep.planar, ranges=ranges))
            yield sweep

    return spoil


def dropped(start_s: float, seconds: float) -> Spoiling:
    """A hole in the recording of scans; the odometry goes on through it."""

    def drop(sweeps: Sweeps) -> Iterator[Sweep]:
        for after_s, sweep in clocked(sweeps):
            if not start_s <= after_s < start_s + seconds:
                yield sweep

    return drop


def slipping(start_s: float, seconds: float, factor: float) -> Spoiling:
    """Wheels that turn faster than the robot moves for a while: motions are told longer."""

    def slip(sweeps: Sweeps) -> Iterator[Sweep]:
        before: Pose2 | None = None
        now = IDENTITY
        for after_s, sweep in clocked(sweeps):
            assert sweep.odom_from_base is not None
            step = (before or sweep.odom_from_base).inverse() @ sweep.odom_from_base
            before = sweep.odom_from_base
            if start_s <= after_s < start_s + seconds:
                step = Pose2(factor * step.x, factor * step.y, step.theta)
            now = now @ step
            yield replace(sweep, odom_from_base=now)

    return slip


def accompanied(start_s: float, seconds: float, distance_m: float, width_rad: float) -> Spoiling:
    """A person walks beside the robot for a while and hides what lies behind."""

    def hide(sweeps: Sweeps) -> Iterator[Sweep]:
        rng = np.random.default_rng(8)
        for after_s, sweep in clocked(sweeps):
            if start_s <= after_s < start_s + seconds:
                middle = 1.0 + 0.15 * np.sin(1.5 * after_s)  # radians to the left
                hidden = np.abs(sweep.planar.bearings - middle) < width_rad / 2
                ranges = np.array(sweep.planar.ranges)
                body = distance_m + 0.05 * rng.standard_normal(int(hidden.sum()))
                ranges[hidden] = np.fmin(ranges[hidden], body)
                sweep = replace(sweep, planar=replace(sweep.planar, ranges=ranges))
            yield sweep

    return hide


def kidnapped(start_s: float, seconds: float) -> Spoiling:
    """Somebody carries the robot elsewhere: scans are missing, and the wheels did not turn."""

    def carry(sweeps: Sweeps) -> Iterator[Sweep]:
        last: Pose2 | None = None
        offset: Pose2 | None = None
        for after_s, sweep in clocked(sweeps):
            assert sweep.odom_from_base is not None
            if after_s < start_s:
                last = sweep.odom_from_base
                yield sweep
            elif after_s >= start_s + seconds and last is not None:
                if offset is None:
                    offset = last @ sweep.odom_from_base.inverse()
                yield replace(sweep, odom_from_base=offset @ sweep.odom_from_base)

    return carry


def carried_off(duration_s: float, times: int, seconds: float = 20.0) -> Spoiling:
    """Somebody carries the robot elsewhere several times in a log of that length."""
    starts = [duration_s * (number + 1) / (times + 1) for number in range(times)]
    return chained(*(kidnapped(start_s, seconds) for start_s in starts))


def frozen(start_s: float, seconds: float) -> Spoiling:
    """The driver of the laser hangs: the same scan again and again while the robot drives on."""

    def freeze(sweeps: Sweeps) -> Iterator[Sweep]:
        held: Sweep | None = None
        for after_s, sweep in clocked(sweeps):
            if start_s <= after_s < start_s + seconds:
                held = sweep if held is None else held
                ranges = held.planar.ranges
                sweep = replace(sweep, planar=replace(sweep.planar, ranges=ranges))
            yield sweep

    return freeze


def mirrored(sweeps: Sweeps) -> Iterator[Sweep]:
    """A laser that hangs upside down, and nobody says so."""
    for sweep in sweeps:
        yield replace(sweep, planar=replace(sweep.planar, ranges=sweep.planar.ranges[::-1]))


def stretched(factor: float) -> Spoiling:
    """An angle increment that is wrong by a factor."""

    def stretch(sweeps: Sweeps) -> Iterator[Sweep]:
        for sweep in sweeps:
            bearings = sweep.planar.bearings * factor
            yield replace(sweep, planar=replace(sweep.planar, bearings=bearings))

    return stretch


def misplaced_laser(ahead_m: float, turn_rad: float) -> Spoiling:
    """A laser that sits, or looks, elsewhere than the log says."""
    away = Pose2(ahead_m, 0.0, turn_rad)

    def turn(sweeps: Sweeps) -> Iterator[Sweep]:
        for sweep in sweeps:
            yield replace(sweep, base_from_laser=away @ sweep.base_from_laser)

    return turn


def noisy_ranges(sigma_m: float, seed: int) -> Spoiling:
    """Readings that err a little more, each by itself: a drive as it might as well have been."""

    def shake(sweeps: Sweeps) -> Iterator[Sweep]:
        rng = np.random.default_rng(seed)
        for sweep in sweeps:
            error = rng.normal(0.0, sigma_m, len(sweep.planar.ranges))
            yield replace(sweep, planar=replace(sweep.planar, ranges=sweep.planar.ranges + error))

    return shake


def narrowed(view_deg: float, reach_m: float) -> Spoiling:
    """What a depth camera in the laser's place would see: ahead alone, and not as far."""

    def narrow(sweeps: Sweeps) -> Iterator[Sweep]:
        for sweep in sweeps:
            scan = sweep.planar
            seen = np.abs(scan.bearings) <= np.radians(view_deg) / 2
            ranges = np.where(scan.ranges > reach_m, np.inf, scan.ranges)[seen]
            times_s = None if scan.beam_times_s is None else scan.beam_times_s[seen]
            scan = replace(scan, bearings=scan.bearings[seen], ranges=ranges, range_max=reach_m)
            scan = replace(scan, full_circle=False, beam_times_s=times_s)
            yield replace(sweep, planar=scan)

    return narrow


def crowded(share: float, seed: int = 9) -> Spoiling:
    """People all around: a share of the beams, in bunches, ends at them."""

    def crowd(sweeps: Sweeps) -> Iterator[Sweep]:
        rng = np.random.default_rng(seed)
        for sweep in sweeps:
            ranges = np.array(sweep.planar.ranges)
            bunches = rng.random(24) < share
            hidden = np.repeat(bunches, len(ranges) // 24 + 1)[: len(ranges)]
            ranges[hidden] = np.fmin(ranges[hidden], rng.uniform(0.5, 2.0, int(hidden.sum())))
            yield replace(sweep, planar=replace(sweep.planar, ranges=ranges))

    return crowd


def late_odometry(scans: int) -> Spoiling:
    """Odometry from another clock: each scan has that of so many scans before."""

    def delay(sweeps: Sweeps) -> Iterator[Sweep]:
        waiting: list[Pose2 | None] = []
        for sweep in sweeps:
            waiting.append(sweep.odom_from_base)
            odometry = waiting.pop(0) if len(waiting) > scans else waiting[0]
            yield replace(sweep, odom_from_base=odometry)

    return delay


def hung_odometry(every: int, scans: int) -> Spoiling:
    """Of `every` so many scans some have the odometry of the first of them; then it is right."""

    def hang(sweeps: Sweeps) -> Iterator[Sweep]:
        held: Pose2 | None = None
        for number, sweep in enumerate(sweeps):
            if number % every > scans or not number % every:
                held = sweep.odom_from_base
            yield replace(sweep, odom_from_base=held)

    return hang


def foreign_odometry(turn: float) -> Spoiling:
    """Odometry of another drive: every turn is told as its opposite, ways too long."""

    def swap(sweeps: Sweeps) -> Iterator[Sweep]:
        before, now = IDENTITY, IDENTITY
        for number, sweep in enumerate(sweeps):
            assert sweep.odom_from_base is not None
            if number:
                step = before.inverse() @ sweep.odom_from_base
                now = now @ Pose2(1.5 * step.x, 1.5 * step.y, turn * step.theta)
            before = sweep.odom_from_base
            yield replace(sweep, odom_from_base=now)

    return swap


def chained(*spoilings: Spoiling) -> Spoiling:
    """One after the other."""

    def spoil(sweeps: Sweeps) -> Iterator[Sweep]:
        for spoiling in spoilings:
            sweeps = spoiling(sweeps)
        yield from sweeps

    return spoil
