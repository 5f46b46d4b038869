"""The cases: which world or log, what is wrong with it, and what is asked of the result."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from benchmarks.data import data_folder, plan
from benchmarks.hard_logs import spoiling as s
from benchmarks.hard_logs.recordings import (
    Recording,
    absolute,
    own_odometry,
    recorded,
    simulated,
    two_lasers,
    without_stamps,
)
from benchmarks.hard_logs.worlds import corridors, drive_along
from specmap_cli.evaluation.trajectories import read_tum
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.grids.map_server import read_grid
from specmap_cli.simulation.lasers import OdometryErrors
from specmap_cli.simulation.simulator import SimulatedTour, simulated_tour, simulation_options

NOISY = OdometryErrors(distance_scale=0.05, turn_scale=0.05, veer_per_m=0.01)
TWO_PERCENT = OdometryErrors(distance_scale=0.02, turn_scale=0.02)
FOUR_PERCENT = OdometryErrors(distance_scale=0.04, turn_scale=0.04)
SPACINGS_M, PERIODS_S = (0.25, 0.5, 1.0), (0.5, 1.0)
TOURS = ("office", "lab_c_scan", "office_h_furnitures")


@dataclass(frozen=True, slots=True)
class Case:
    """A log to be made, and the bounds it must keep: share of lost scans and metres off."""

    name: str
    make: Callable[[Path], Recording]
    lost: float = 0.02
    error_m: float = 0.3
    settings: tuple[str, ...] = field(default=())


def cases() -> Iterator[Case]:
    """All of them, the quick ones first."""
    yield from thinned_logs("fr079", {0.25: 0.05, 0.5: 0.06, 1.0: 0.08})
    yield from thinned_logs("mit_csail", {})
    yield from thinned_tours()
    sparse = data_folder() / "logs" / "fr101_sparse.log.gz"
    yield Case("fr101_sparse", partial(of_itself, sparse), 0.0, 0.06)
    yield from spoiled_tours()
    yield from corridor_loops()
    for errors in (TWO_PERCENT, FOUR_PERCENT):
        name = f"1.5 km of corridors, odometry {errors.distance_scale:.0%} off".replace("%", " %")
        yield Case(name, partial(long_building, errors, iter), error_m=0.5)
    name = "1.5 km of corridors, carried off seven times"
    yield Case(name, partial(long_building, TWO_PERCENT, s.carried_off(1500.0, 7)), error_m=0.5)
    yield from clouds()


def thinned_logs(name: str, bounds: dict[float, float]) -> Iterator[Case]:
    """A real log thinned by way and by time, with its own odometry and without any."""
    for spacing in SPACINGS_M:
        for odometry in (True, False):
            thin = with_or_without(s.every_metres(spacing), odometry)
            yield Case(
                f"{name} every {spacing:g} m, {'own' if odometry else 'no'} odometry",
                partial(recorded, name, thin),
                error_m=bounds.get(spacing, 0.3),
            )
    for period in PERIODS_S:
        thin = s.every_seconds(period)
        yield Case(
            f"{name} at {1 / period:g} Hz, own odometry",
            partial(recorded, name, thin),
        )
    noisy = s.chained(s.noisier(NOISY), s.every_metres(0.5))
    yield Case(f"{name} every 0.5 m, noisy odometry", partial(recorded, name, noisy))


def thinned_tours() -> Iterator[Case]:
    """Simulated tours: exact odometry, 5 % off, none."""
    for world in TOURS:
        for spacing in SPACINGS_M:
            yield tour_case(world, s.every_metres(spacing), f"every {spacing:g} m, usual odometry")
        for period in PERIODS_S:
            thin = s.every_seconds(period)
            noisy = s.chained(s.noisier(NOISY), thin)
            rate = f"at {1 / period:g} Hz"
            yield tour_case(world, noisy, f"{rate}, odometry 5 % off", drift=0.0, error_m=0.25)
            yield tour_case(world, with_or_without(thin, False), f"{rate}, no odometry")


def spoiled_tours() -> Iterator[Case]:
    """What happens to good recordings."""
    for world in TOURS[:2]:
        yield tour_case(world, s.first_scans_spoiled(1), "first scan spoiled")
        yield tour_case(world, s.first_scans_spoiled(5), "first five scans spoiled")
        yield tour_case(world, s.dropped(60.0, 5.0), "5 s dropped")
        yield tour_case(world, s.slipping(60.0, 5.0, 3.0), "wheels slip for 5 s")
        yield tour_case(world, s.carried_off(400.0, 7), "carried off seven times")
        yield tour_case(world, s.accompanied(40.0, 120.0, 0.8, 0.6), "a person walks beside")
        for settings in ((), ("log.scan_frame=laser_0",)):
            chosen = ", one chosen" if settings else ""
            what = f"{world}, two lasers on one topic{chosen}"
            yield Case(what, partial(pair, world), settings=settings)
        yield Case(
            f"{world}, zero stamps",
            partial(timeless, world),
        )


def tour_case(
    world: str, spoil: s.Spoiling, what: str, *, drift: float = 1.0, error_m: float = 0.3
) -> Case:
    """A tour of a world as it is spoiled."""
    return Case(
        f"{world} {what}",
        partial(spoiled, world, drift, spoil),
        error_m=error_m,
    )


def tour_of(world: str, **options: object) -> SimulatedTour:
    """A tour of two laps."""
    chosen: dict[str, object] = {"beams": 361, "speed_mps": 0.8, "spacing_m": 3.0, "laps": 2}
    return simulated_tour(world_of(world), simulation_options(**{**chosen, "seed": 3, **options}))


def world_of(name: str) -> GridMap:
    """The plan of the sample log, or one of the data folder."""
    if name == "office":
        return read_grid(Path("sample_logs/office.yaml"))
    return plan(name)


def spoiled(world: str, drift: float, spoil: s.Spoiling, path: Path) -> Recording:
    """A tour whose odometry errs `drift` times as much as usual."""
    return simulated(tour_of(world, odometry_drift=drift), spoil, path)


def timeless(world: str, path: Path) -> Recording:
    """A tour whose stamps are all 0; a CARMEN line of 361 beams is one of 180 degrees."""
    return without_stamps(tour_of(world, field_of_view_deg=180.0), path.with_suffix(".log"))


def pair(world: str, path: Path) -> Recording:
    """One laser looks ahead, one back."""
    rear = tour_of(world, laser_x_m=-0.2, laser_yaw_deg=180.0)
    return two_lasers(tour_of(world), rear, path)


def with_or_without(spoil: s.Spoiling, odometry: bool) -> s.Spoiling:
    """The spoiling, and no odometry after it where there shall be none."""
    return spoil if odometry else s.chained(spoil, s.without_odometry)


def corridor_loops() -> Iterator[Case]:
    """A loop of 60 m that a laser of short sight sees little of, bare and with niches."""
    for what, niches in (("bare", None), ("with niches", 4.0)):
        for name, spoil in (("no", s.without_odometry), ("usual", iter)):
            make = partial(corridor_loop, niches, spoil)
            yield Case(f"corridor loop of 60 m, {what}, {name} odometry", make, error_m=0.5)


def corridor_loop(niche_every_m: float | None, spoil: s.Spoiling, path: Path) -> Recording:
    """One and a half laps."""
    corners = ((0.0, 0.0), (22.0, 0.0), (22.0, 8.0), (0.0, 8.0))
    tour = drive_along(
        corridors(tuple(zip(corners, (*corners[1:], corners[0]), strict=True)), 2.0, niche_every_m),
        (*corners, *corners[:3]),
        range_max_m=8.0,
        rate_hz=8.0,
        speed_mps=0.7,
        errors=OdometryErrors(),
    )
    return simulated(tour, spoil, path)


def long_building(errors: OdometryErrors, spoil: s.Spoiling, path: Path) -> Recording:
    """Corridors of 720 m, driven in loops for 1.5 km."""
    columns, rows = (0.0, 60.0, 140.0), (0.0, 50.0, 100.0)
    ways = [((columns[0], y), (columns[-1], y)) for y in rows]
    ways += [((x, rows[0]), (x, rows[-1])) for x in columns]
    places = [
        (0, 0), (140, 0), (140, 100), (0, 100), (0, 0), (60, 0), (60, 50), (140, 50),
        (140, 100), (60, 100), (60, 50), (0, 50), (0, 100), (60, 100), (60, 50), (140, 50),
        (140, 0), (60, 0), (60, 50), (0, 50), (0, 0),
    ]  # fmt: skip
    tour = drive_along(
        corridors(ways, 2.4, 5.0),
        [(float(x), float(y)) for x, y in places],
        range_max_m=20.0,
        rate_hz=5.0,
        speed_mps=1.0,
        errors=errors,
        field_of_view_deg=180.0,
        beams=181,
    )
    return simulated(tour, spoil, path)


def clouds() -> Iterator[Case]:
    """Logs of 3D lidars."""
    for name, settings in (("fr079_3d", ()), ("fr079_3d", ("log.use_odometry=false",))):
        yield Case(
            f"{name}{', no odometry' if settings else ''}",
            partial(of_folder, name),
            settings=settings,
        )
    yield Case("hall_livox", partial(of_folder, "hall_livox"), lost=0.05, error_m=0.5)


def of_itself(log: Path, _: Path) -> Recording:
    """A log whose odometry is right."""
    return own_odometry(log)


def of_folder(name: str, _: Path) -> Recording:
    """A log as it is, with the poses of its truth."""
    folder = data_folder()
    truth = read_tum(folder / "truth" / f"{name}_truth.tum")
    return Recording(folder / "logs" / f"{name}.mcap", absolute(truth))
