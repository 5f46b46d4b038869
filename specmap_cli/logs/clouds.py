"""Clouds: points and times out of any layout, levelled by their floor, made planar."""

from __future__ import annotations

import math
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.arrays import first_in_cells
from specmap_cli.core.geometry import FloatArray, Pose2, inverse3, product
from specmap_cli.core.records import BoolArray, PlanarScan
from specmap_cli.core.settings import LogConfig
from specmap_cli.logs.messages import BadMessageError, CloudRecord
from specmap_cli.logs.planar import MOST_BEAMS, OwnBody
from specmap_cli.logs.readers.encoding import NS_PER_S

_CLOUD_TIME_MAX_S = 10.0  # times of points farther from the stamp are of no use
CLOUD_RANGE_MAX_M = 100.0  # a 3D cloud is cut here

# Velodyne, LSLidar: time; Ouster: t; Hesai, RoboSense, Livox: timestamp; Livox: offset_time;
# Autoware: time_stamp; Aeva: time_offset_ns; Blickfeld: point_time_offset; Cepton: the last one.
TIME_FIELDS = (
    *("t", "time", "timestamp", "time_stamp", "offset_time", "time_offset", "time_offset_ns"),
    *("point_time_offset", "relative_timestamp"),
)
_FLOAT_UNITS_NS = (1_000_000_000, 1_000_000, 1_000, 1)  # seconds, and thousandths of the one before
_INTEGER_UNITS_NS = (1_000, 1)
_SHORTEST_NS, _LONGEST_NS = 2_000_000, 2_000_000_000  # of a sweep: one unit fits, as each is 1,000
_ENOUGH_POINTS = 100  # a sweep of fewer may be a sliver, whose span misleads


class CloudPoints(NamedTuple):
    """Points (N, 3) in the lidar's frame and seconds (N,) after the stamp, or None.

    `far_times` says that there were times, but farther from the stamp than `_CLOUD_TIME_MAX_S`.
    """

    points: FloatArray
    times_s: FloatArray | None
    far_times: bool


class PointClock:
    """What the point times of a lidar are: their unit, and whether its clock is that of the stamps.

    The unit is the one by which a sweep takes between 2 ms and 2 s; the first full sweep settles
    it. `foreign` counts the sweeps whose times are of another clock than their stamps.
    """

    def __init__(self) -> None:
        self.foreign = 0
        self._unit_ns: int | None = None

    def unit_ns(self, span: float, count: int, *, integers: bool) -> int:
        """Nanoseconds in one unit of `count` times that span so many units."""
        if self._unit_ns is not None:
            return self._unit_ns
        units = _INTEGER_UNITS_NS if integers else _FLOAT_UNITS_NS
        fits = [unit for unit in units if _SHORTEST_NS <= span * unit < _LONGEST_NS]
        if fits and count >= _ENOUGH_POINTS:
            self._unit_ns = fits[0]
        brief = not integers and span * NS_PER_S < _LONGEST_NS
        return fits[0] if fits else NS_PER_S if brief else 1


@np.errstate(all="ignore")  # damaged messages hold any bits
def cloud_points(
    record: CloudRecord, stamp_ns: int, clock: PointClock | None = None
) -> CloudPoints:
    """The points of a cloud, with their times where de-skewing can rely on them.

    Points that are not finite, at the very origin (how some drivers say "no return") or beyond
    `CLOUD_RANGE_MAX_M` are left out, with their times. Times are None unless they are all finite,
    differ, and lie within `_CLOUD_TIME_MAX_S` of the stamp. Times of another clock, far from the
    stamp but near to each other, count from the earliest. `clock` keeps what is known of the lidar.
    Raises BadMessageError where no point is left.
    """
    clock = PointClock() if clock is None else clock
    table = record.points.reshape(-1)
    points = np.empty((len(table), 3))
    for column, axis in enumerate("xyz"):
        points[:, column] = table[axis]
    squared = np.einsum("ij,ij->i", points, points)
    usable = (squared > 0.0) & (squared <= CLOUD_RANGE_MAX_M**2)  # false for NaN as well
    if not usable.any():
        raise BadMessageError("a cloud without points")
    kept = slice(None) if usable.all() else np.flatnonzero(usable)
    recorded = _times(table, stamp_ns, clock)
    times = recorded[kept] if recorded is not None else np.zeros(0)
    span = float(np.ptp(times)) if len(times) and np.isfinite(times).all() else 0.0
    told = span > 0.0
    far = told and float(np.abs(times).max()) > _CLOUD_TIME_MAX_S
    if far and span <= min(_CLOUD_TIME_MAX_S, _LONGEST_NS / NS_PER_S):
        clock.foreign += 1
        times, far = times - times.min(), False
    return CloudPoints(
        points=points[kept], times_s=times if told and not far else None, far_times=far
    )


def _times(table: NDArray[np.void], stamp_ns: int, clock: PointClock) -> FloatArray | None:
    """Seconds (N,) after the stamp, None without such a field; as recorded, absolute or not."""
    name = next((field for field in table.dtype.names or () if field.lower() in TIME_FIELDS), None)
    if name is None or not len(table):
        return None
    raw = table[name]
    if raw.dtype.kind in "iu":
        counts = raw.astype(np.int64)
        span = float(counts.max()) - float(counts.min())
        counts = counts * clock.unit_ns(span, len(counts), integers=True)
        absolute = abs(int(counts[0]) - stamp_ns) < abs(int(counts[0]))
        return np.asarray((counts - stamp_ns if absolute else counts) / NS_PER_S)
    values = raw.astype(np.float64)
    finite = values[np.isfinite(values)]
    if not len(finite):
        return None
    span = float(finite.max() - finite.min())
    unit = clock.unit_ns(span, len(values), integers=False) / NS_PER_S
    stamp = stamp_ns / (NS_PER_S * unit)
    absolute = abs(finite[0] - stamp) < abs(finite[0])
    return np.asarray((values - stamp if absolute else values) * unit)


FLOOR_RADIUS_M = 10.0  # a floor of unknown height is sought among the returns this near
# Floors are sought up to this tilt of the lidar: 45 degrees, as carried by hand.
_FLOOR_TILT_MAX_RAD = 0.785
_FLOOR_SHARE = 0.1  # share of the returns within FLOOR_RADIUS_M that must show a floor
_CELL_M = 0.4  # returns are thinned to it: floors near the lidar have thousands
_STEP_RAD = math.radians(5.0)  # between the tilts tried: 0.2 m off at 5 m
_BENEATH_SHARE = 0.05  # returns below a clear floor, of those on it: reflections, a stray one
_LAYER_M = 0.2  # in which returns at one tilt are counted: what such a step displaces
_LOWER_WEIGHT = 2.0  # of a return below a floor, against one on it
_WIDTHS_M = (0.4, 0.2, 0.1, 0.05)  # returns this near a plane fix it anew, coarse to fine
_SPREAD_M = 0.4  # standard deviation of a floor's returns across it: less is a kerb or a board
_FEWEST = 30  # returns that fix a plane well: a tilt of 0.05 m / 10 m / sqrt(30)


class Level(NamedTuple):
    """A cloud's rotation (3, 3) into a level frame, and the floor's height there.

    The level frame looks where the lidar's x axis looks, and has its origin. `seen_m` is the mean
    height of the floor's returns in the frame of the cloud. The floor is `clear` if hardly a return
    lies beneath it: rows of returns on walls pass for one, too, but have other rows below them.
    """

    rotation: FloatArray
    floor_m: float
    seen_m: float
    clear: bool


def floor_of(cloud: FloatArray) -> Level | None:
    """The floor in a cloud (N, 3), None when it shows none.

    It is the plane below the lidar with the most returns near it, those still lower counted against
    it: under a table top or a shelf there are returns. Without a base frame nothing in a log says
    which way is up: a lidar may be tilted, or carried by hand. The floor says so in every cloud.
    """
    squares = np.einsum("ij,ij->i", cloud, cloud)
    near = cloud[np.flatnonzero(squares <= FLOOR_RADIUS_M**2)]
    near = near[first_in_cells(near, _CELL_M)]
    if len(near) < _FEWEST:
        return None
    tilts = _tilts(_FLOOR_TILT_MAX_RAD)
    number, height = _best_layer(near, tilts)
    rotation = tilts[number]
    for width_m in _WIDTHS_M:
        turned = product(near, rotation.T)
        of_floor = np.abs(turned[:, 2] - height) < width_m
        plane = _plane(turned[of_floor])
        if plane is None:
            return None
        normal, height = plane
        rotation = _upright(product(normal[None], rotation)[0])
    found = int(np.count_nonzero(of_floor))
    beneath = int(np.count_nonzero(turned[:, 2] < height - 2.0 * width_m))
    upright = float(rotation[2, 2]) >= math.cos(_FLOOR_TILT_MAX_RAD)
    if not (found >= _FLOOR_SHARE * len(near) and upright and height < 0.0):
        return None
    clear = beneath <= _BENEATH_SHARE * found
    return Level(rotation, height, float(near[of_floor, 2].mean()), clear)


@cache
def _tilts(most_rad: float) -> FloatArray:
    """Rotations (T, 3, 3) to level frames whose vertical is within an angle of the lidar's z."""
    steps = math.floor(most_rad / _STEP_RAD)
    angles = [_STEP_RAD * step for step in range(-steps, steps + 1)]
    normals = [
        (math.sin(a) * math.cos(b), math.sin(b), math.cos(a) * math.cos(b))
        for a in angles
        for b in angles
    ]
    lowest = math.cos(most_rad)
    return np.stack([_upright(np.array(n)) for n in normals if n[2] >= lowest])


def _upright(normal: FloatArray) -> FloatArray:
    """The rotation (3, 3) that turns a unit vector up and leaves the heading of the x axis."""
    x, y, z = normal.tolist()
    slope = math.hypot(y, z)
    cr, sr, cp, sp = z / slope, y / slope, slope, -x
    return np.array([[cp, sp * sr, sp * cr], [0.0, cr, -sr], [-sp, cp * sr, cp * cr]])


def _best_layer(points: FloatArray, tilts: FloatArray) -> tuple[int, float]:
    """Which tilt shows the fullest layer of points (N, 3) below the lidar, and its middle."""
    depths = np.floor(product(tilts[:, 2, :], -points.T) / _LAYER_M).astype(np.intp)
    count = max(1, int(depths.max()) + 1)
    depths[depths < 0] = count  # above the lidar
    rows = np.arange(len(tilts))[:, None] * (count + 1)
    counts = np.bincount((depths + rows).ravel(), minlength=(count + 1) * len(tilts))
    filled = counts.reshape(len(tilts), -1)[:, :count]
    lower = filled[:, ::-1].cumsum(axis=1)[:, ::-1]
    lower = np.pad(lower, ((0, 0), (0, 2)))[:, 2:]  # the next layer may be of the same floor
    worth = filled - _LOWER_WEIGHT * lower
    number, depth = divmod(int(worth.argmax()), count)
    return number, -(depth + 0.5) * _LAYER_M


def _plane(points: FloatArray) -> tuple[FloatArray, float] | None:
    """The normal and height along it of a plane through points (N, 3); None of no clear one."""
    if len(points) < _FEWEST:
        return None
    x, y = (points[:, :2] - points[:, :2].mean(axis=0)).T
    xx, xy, yy = float((x * x).mean()), float((x * y).mean()), float((y * y).mean())
    if (xx + yy) / 2 - math.hypot((xx - yy) / 2, xy) < _SPREAD_M**2:
        return None
    ground = np.column_stack([points[:, :2], np.ones(len(points))])
    slopes = product(ground.T, points[:, 2:])
    a, b, c = product(inverse3(product(ground.T, ground)), slopes)[:, 0].tolist()
    length = math.sqrt(1.0 + a * a + b * b)
    return np.array([-a, -b, 1.0]) / length, c / length


def span_of(seen: BoolArray) -> tuple[int, int]:
    """The first of the fewest bearings (B,) of a circle that hold all that were seen; how many."""
    at = np.flatnonzero(seen)
    if not len(at):
        return 0, 1
    gaps = np.diff(at, append=at[0] + len(seen))
    widest = int(gaps.argmax())
    return int(at[(widest + 1) % len(at)]), len(seen) + 1 - int(gaps[widest])


_HOUSING_M = 0.1  # what is nearer is no return: drivers give points at or near the origin for none
_FLOOR_PERCENTILE = 2.0  # of the heights of returns is the floor: a few stray ones lie below it
_CLOUD_BEAMS = 720  # bearings of the planar scan of a 3D cloud
_CLOUD_FILLED_SHARE = 0.9  # share of the bearings that must have returns, or they are halved
_MAX_HALVINGS = 2  # a planar scan has no fewer bearings than a quarter of those asked for
_FEWEST_BEAMS = 36  # of a planar laser, ten degrees each: fewer are returns that are far apart
_LONGEST_GAP = 4  # bearings without a return from one to the next where the lidar is coarser
_SAME_BEAM = 1e-5  # turns by which directions of one beam of a planar laser differ


class CloudFlattener:
    """Turns clouds in the base frame into planar scans: the nearest return per bearing in a band.

    The band lies between two heights above the floor. A bearing with nothing in the band is +inf
    where the lidar has had a return at any height in this or an earlier cloud, so that it looked
    there, and NaN where it never had one. The number of bearings is `_CLOUD_BEAMS`, that of its
    beams for a planar laser, halved until the lidar's resolution fills them. A floor of unknown
    height (None) is taken to be where the lowest returns of the first cloud are that has enough of
    them to tell; so are the bearings. The clouds of a `planar` laser have one height, whichever it
    is; other scans end where the view does, unless it is all round. Beams have the times of their
    points.
    """

    def __init__(
        self,
        base_from_laser: FloatArray,
        floor_m: float | None,
        config: LogConfig,
        own_body: OwnBody | None = None,
        *,
        planar: bool = False,
    ) -> None:
        self.own_body = OwnBody() if own_body is None else own_body
        self.mount = Pose2(float(base_from_laser[0, 3]), float(base_from_laser[1, 3]), 0.0)
        self.config = config
        self._floor = floor_m
        self._planar, self._shift, self._settled = planar, 0.0, False
        self._bearings: FloatArray = np.zeros(0)
        self._seen = np.zeros(0, dtype=bool)

    def flatten(
        self,
        cloud: FloatArray,
        stamp_ns: int,
        floor_m: float | None = None,
        times_s: FloatArray | None = None,
    ) -> PlanarScan:
        """The planar scan, seen from the lidar's place, of points (N, 3) in the base frame.

        `floor_m` is the height of the floor in this cloud, if it was found, `times_s` (N,) seconds
        after the stamp.
        """
        dx, dy = cloud[:, 0] - self.mount.x, cloud[:, 1] - self.mount.y
        distance = np.hypot(dx, dy)
        turn = np.arctan2(dy, dx) / math.tau + 0.5  # [0, 1] from -pi to pi
        outside = distance >= _HOUSING_M
        if not self._settled:
            self._choose_bearings(turn[outside])
        beams = len(self._seen)
        bins = _bins(turn, beams, self._shift)
        self._seen[bins[outside]] = True
        inside = outside & (distance <= CLOUD_RANGE_MAX_M)
        if not self._planar:
            floor_m = self._floor if floor_m is None else floor_m
            if floor_m is None:
                heights = cloud[distance <= FLOOR_RADIUS_M, 2]
                some = len(heights) > 0
                floor_m = float(np.percentile(heights, _FLOOR_PERCENTILE)) if some else 0.0
                self._floor = floor_m if len(heights) >= _FEWEST else None
            height = cloud[:, 2] - floor_m
            inside &= (height >= self.config.band_min_m) & (height <= self.config.band_max_m)
        ranges = np.where(self._seen, np.inf, np.nan)
        used = np.flatnonzero(inside)
        used = used[np.argsort(-distance[used], kind="stable")]  # the last one of a bearing stays
        ranges[bins[used]] = distance[used]
        full_circle = bool(self._seen.mean() >= _CLOUD_FILLED_SHARE)
        bearings, times = self._bearings, None
        if times_s is not None and len(used):  # of the other beams by those beside them
            times = np.full(beams, np.nan)
            times[bins[used]] = times_s[used]
            known = np.flatnonzero(np.isfinite(times))
            times = np.interp(np.arange(beams), known, times[known])
        if not (self._planar or full_circle):
            first, count = span_of(self._seen)
            ranges = np.roll(ranges, -first)[:count]
            times = None if times is None else np.roll(times, -first)[:count]
            bearings = bearings[first] + math.tau / beams * np.arange(count)
        self.own_body.clear(ranges)
        return PlanarScan(
            stamp_ns=stamp_ns,
            bearings=bearings,
            ranges=ranges,
            range_max=CLOUD_RANGE_MAX_M,
            full_circle=full_circle,
            beam_times_s=times,
        )

    def _choose_bearings(self, turn: FloatArray) -> None:
        """Settle on the bearings: those of the beams of a planar laser, none on a border of theirs.

        Where nothing came back for `_LONGEST_GAP` bearings, nothing was met: it counts for nothing.
        A cloud that fills none of the choices settles nothing: it has the fewest bearings. Nor does
        one of fewer returns than `_FEWEST`.
        """
        finest, shift = _CLOUD_BEAMS, 0.0
        if self._planar:
            gaps = np.diff(np.unique(turn), prepend=-np.inf, append=np.inf)
            count = round(1.0 / float(np.median(gaps[gaps > _SAME_BEAM])))
            finest = min(MOST_BEAMS, count) if count >= _FEWEST_BEAMS else finest
        for halvings in range(_MAX_HALVINGS + 1):
            beams = finest >> halvings
            if self._planar:
                angles = math.tau * (turn * beams - 0.5)
                sines, cosines = float(np.sin(angles).sum()), float(np.cos(angles).sum())
                shift = math.atan2(sines, cosines) / math.tau
            steps = np.diff(np.unique(_bins(turn, beams, shift)))
            steps = steps[steps <= _LONGEST_GAP]
            if len(steps) >= max(1.0, _CLOUD_FILLED_SHARE * steps.sum()):
                self._settled = len(turn) >= _FEWEST
                break
        if not self._settled and beams == len(self._seen):
            return
        bearings: FloatArray = (np.arange(beams, dtype=np.float64) + 0.5 + shift) * (
            math.tau / beams
        ) - math.pi
        bearings.setflags(write=False)
        self._bearings, self._seen = bearings, np.zeros(beams, dtype=bool)
        self._shift = shift


def _bins(turn: FloatArray, beams: int, shift: float) -> NDArray[np.intp]:
    """Of directions (N,) in [0, 1] of a turn, the numbers of the bearings nearest to them."""
    if shift:
        return np.floor(turn * beams - shift).astype(np.intp) % beams
    return np.minimum((turn * beams).astype(np.intp), beams - 1)
