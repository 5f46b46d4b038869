"""Where scans are taken in a finished map, one after another as they come. (Section IV-B)"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from operator import index
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.arrays import neighbours
from specmap_cli.core.config import SETTINGS, load_config, with_overrides
from specmap_cli.core.errors import InputError, MapError, instance_of, path_of
from specmap_cli.core.geometry import IDENTITY, FloatArray, Pose2, product
from specmap_cli.core.records import PosedScan, Sweep
from specmap_cli.core.settings import Config, LogConfig
from specmap_cli.core.text import counted, quoted
from specmap_cli.logs.messages import BadMessageError, ScanLayout, ScanRecord
from specmap_cli.logs.planar import HUNG, Repeats, ScanLeveller
from specmap_cli.maps.filenames import CLASSIFIERS, KEYFRAMES
from specmap_cli.maps.store import Map, opened_map
from specmap_cli.recognition.features.sets import check_feature_sets
from specmap_cli.recognition.learning.classifiers import ClassifierSet
from specmap_cli.recognition.localization.localizer import Fix, Label, Where
from specmap_cli.recognition.localization.localizer import Localizer as Guide
from specmap_cli.recognition.localization.walls import MapWalls, along_way, placed
from specmap_cli.registration.frontend import FrontEnd

_MOST_BEAMS = 100_000  # of a scan; the densest lasers have some thousands
_MOST_TURNS = 2.0  # of a scan; some lasers see a little more than one
_NO_CALIBRATION = (
    "an older map, which does not say how sure its classifiers are: probabilities are those that "
    "are usual elsewhere; build it again"
)


@dataclass(frozen=True, slots=True)
class Scan:
    """What a planar laser saw at one moment, from `stamp_ns` on, in nanoseconds.

    `ranges` (B,) are metres along `angles` (B,) in radians, counter-clockwise from the x axis of
    the laser, ascending or descending, at even steps: readings at others go to the nearest step.
    Infinite, 0 and `range_max` mean that nothing was met; NaN and less than `range_min` that
    nothing is known. From beam to beam it takes `beam_s` seconds. `laser` is the pose of the laser
    on the robot, and `odometry` that of the robot by its wheels, in a frame that stays: x and y in
    metres, angle in radians.
    """

    stamp_ns: int
    ranges: Sequence[float] | NDArray[Any]
    angles: Sequence[float] | NDArray[Any]
    range_min: float = 0.0
    range_max: float = math.inf
    beam_s: float = 0.0
    laser: tuple[float, float, float] = IDENTITY
    odometry: tuple[float, float, float] | None = None

    def record(self) -> ScanRecord:
        """The scan as a recording has it. Raises InputError for one that cannot be used."""
        try:
            stamp_ns, both = index(self.stamp_ns), (self.ranges, self.angles)
            if any(map(np.iscomplexobj, both)):
                raise TypeError
            ranges, angles = (np.asarray(each, dtype=np.float64) for each in both)
        except (TypeError, ValueError):
            what = "a scan whose stamp, ranges or angles are not numbers"
            raise InputError(what, "expected whole nanoseconds, metres and radians") from None
        if not 0 <= stamp_ns < 1 << 63:
            raise InputError(f"a scan stamped {stamp_ns} ns", "expected nanoseconds since 1970")
        if not self.range_min <= self.range_max:
            what = f"a scan of a laser from {self.range_min:g} to {self.range_max:g} m"
            raise InputError(what, "expected a range_min that is no more than range_max")
        usable = ranges.ndim == 1 and ranges.shape == angles.shape and len(angles) > 1
        if not (usable and np.isfinite(angles).all() and (step := np.median(np.diff(angles)))):
            what = f"a scan of {ranges.size} ranges at {angles.size} angles"
            raise InputError(what, "expected as many of both, two or more, angles in order")
        if (turns := np.ptp(angles) / math.tau) > _MOST_TURNS:
            raise InputError(f"angles over {turns:.0f} turns", "expected radians")
        places = np.rint((angles - angles[0]) / step).astype(np.int64)
        first = places.min()
        places -= first
        even = np.full(min(int(places.max()), _MOST_BEAMS) + 1, np.nan)
        even[np.minimum(places, _MOST_BEAMS)] = ranges
        layout = ScanLayout(
            angle_min=float(angles[0] + first * step),
            angle_max=float(angles[0] + (first + len(even) - 1) * step),
            angle_increment=float(step),
            time_increment=self.beam_s,
            beams=len(even),
        )
        return ScanRecord(
            stamp_ns=stamp_ns,
            frame="laser",
            layout=layout,
            range_min=self.range_min,
            range_max=self.range_max,
            ranges=even.astype(np.float32),
        )


class Localizer:
    """Tells where scans were taken in a map, one after another as they come.

    `map_` is a map directory, or one that was read. The settings are those that it was built with,
    or `config`. Without `metric` it need not find poses, only rooms. One localizer is for one robot
    with one laser. Raises MapError for a map without classifiers.
    """

    def __init__(
        self, map_: Map | Path | str, config: Config | None = None, *, metric: bool = True
    ) -> None:
        stored = opened_map(map_, "map_", config)
        self.config = config or settings_for(stored, {})
        check_feature_sets(self.config)
        classifiers, settings = classifiers_of(stored), self.config.localization
        walls = MapWalls(*stored.division, classifiers.misfit, settings, lambda: _own(stored))
        adjacency = neighbours(stored.ids, stored.topology.joined)
        self._guide = Guide(classifiers, adjacency, walls, settings, with_walls=metric)
        self._front_end = FrontEnd(self.config.registration)
        self._metric, self._path = metric, stored.path
        self.knows_its_walls = classifiers.misfit is not None  # how well its own scans fit them
        self._frames = {id_: room.map_from_room for id_, room in stored.rooms.items()}
        self._leveller: ScanLeveller | None = None
        self._repeats, self._stale = Repeats(), 0
        self._scans = self._ahead_ns = 0

    def add(self, scan: Scan) -> LocalizedScan:
        """Where the next scan was taken. Raises InputError for one that cannot be used."""
        record = instance_of(scan, Scan, "scan").record()
        if record.stamp_ns < self._ahead_ns:
            what = (
                f"a scan stamped {self._ahead_ns - record.stamp_ns} ns before the one ahead of it"
            )
            raise InputError(
                what, "expected scans in their order, those of each drive by one Localizer"
            )
        self._ahead_ns = record.stamp_ns
        if self._leveller is None:
            self._leveller = ScanLeveller(_pose(scan.laser, "laser").matrix())
        try:
            planar = self._leveller.level(record, record.stamp_ns)
        except BadMessageError as error:
            raise InputError(error) from None
        sweep = Sweep(
            index=self._scans,
            stamp_ns=record.stamp_ns,
            planar=planar,
            base_from_laser=self._leveller.mount,
            odom_from_base=None if scan.odometry is None else _pose(scan.odometry, "odometry"),
        )
        self._scans += 1
        return self.told([self._guide.add(self._registered(sweep))])[0]

    def located(self, sweeps: Iterable[Sweep]) -> Iterator[Where]:
        """Where the sweeps of a recording were taken, some of them read ahead."""
        return self._guide.located(map(self._registered, sweeps))

    def _registered(self, sweep: Sweep) -> PosedScan:
        """A sweep with its pose in the way. What a hanging driver repeats has no returns."""
        if self._repeats.stale(sweep):
            self._stale += 1
            blank = replace(sweep.planar, ranges=np.full_like(sweep.planar.ranges, np.inf))
            cloud, times_s = sweep.cloud, sweep.cloud_times_s
            sweep = replace(
                sweep,
                planar=blank,
                cloud=None if cloud is None else cloud[:0],
                cloud_times_s=None if times_s is None else times_s[:0],
            )
        return self._front_end.register(sweep)

    def told(self, found: Sequence[Where], *, offline: bool = False) -> tuple[LocalizedScan, ...]:
        """What is known of scans; `offline` looks at all that were located, in hindsight."""
        found = self._guide.smoothed(found) if offline else found
        return tuple(
            LocalizedScan(
                label=where.label,
                track_from_base=where.track_from_base,
                fix=where.fix if self._metric and submap is not None else None,
                map_from_submap=IDENTITY if submap is None else self._frames[submap],
            )
            for where in found
            for submap in [where.label.filtered_submap]
        )

    @property
    def warnings(self) -> tuple[str, ...]:
        """What to know of the scans so far, and of the map."""
        notes = [HUNG.format(counted(self._stale, "scan"))] if self._stale else []
        notes += [*self._front_end.warnings, *([self._guide.note] if self._guide.note else ())]
        if self._guide.classifiers.calibration is None:
            notes.append(f"{self._path}: {_NO_CALIBRATION}")
        return tuple(notes)


def _pose(given: Sequence[float], name: str) -> Pose2:
    values = np.asarray(given, dtype=np.float64)
    if values.shape != (3,) or not np.isfinite(values).all():
        raise InputError(f"{name} is {quoted(given)}", "expected x, y and theta, all finite")
    return Pose2(*values.tolist())


def _own(stored: Map) -> Iterator[PosedScan]:
    """The scans of a map along its way, at their poses in it; an older map keeps none."""
    if (stored.path / KEYFRAMES).exists():
        poses = stored.labels.poses
        numbers = along_way(poses)
        with stored.scans(numbers) as store:
            yield from placed(store, range(len(store)), poses[numbers])


@dataclass(frozen=True, slots=True, kw_only=True)
class LocalizedScan:
    """The label of one scan, its place as registered, and within the map where one is known.

    `map_from_submap` is the frame of the submap of the filtered label.
    """

    label: Label
    track_from_base: Pose2
    fix: Fix | None = None
    map_from_submap: Pose2 = IDENTITY

    @property
    def room(self) -> int | None:
        """The id of the room that it was taken in, by all scans so far; None where none fits."""
        return self.label.filtered_submap

    @property
    def map_from_base(self) -> Pose2 | None:
        """The pose in the map, None where it is not known."""
        return None if self.fix is None else self.fix.pose

    @property
    def submap_from_base(self) -> Pose2 | None:
        """The pose in the submap of the filtered label, None where it is not known."""
        return None if self.fix is None else self.map_from_submap.inverse() @ self.fix.pose

    @property
    def covariance(self) -> FloatArray | None:
        """(3, 3) of x, y and angle of the pose in the submap: square metres and radians."""
        if self.fix is None:
            return None
        turn = np.eye(3)
        turn[:2, :2] = self.map_from_submap.rotation().T
        return product(product(turn, self.fix.covariance), turn.T)


def settings_for(
    stored: Map,
    overrides: dict[str, Any],
    file: Path | str | None = None,
    preset: str | None = None,
) -> Config:
    """The settings for a log: `overrides` over those of `file` (TOML) over those of the map.

    A `preset`, or one that the file names, takes the place of the map's settings. Topics and frames
    are never the map's: they are the log's own. Raises UsageError as `load_config` does.
    """
    from_file = {} if file is None else SETTINGS.tables(path_of(file, "file"))
    if preset is not None or "preset" in from_file:
        return load_config(file, preset, overrides)
    built_with = Config(**{**dict(stored.config), "log": LogConfig()})
    config = with_overrides(built_with, from_file, f"{file}: ")
    return with_overrides(config, overrides)


def classifiers_of(stored: Map) -> ClassifierSet:
    """The classifiers of a stored map, one a submap; MapError naming the file otherwise."""
    path, text = stored.path / CLASSIFIERS, stored.classifiers
    try:
        classifiers = ClassifierSet.from_json(text)
    except MapError as error:
        raise MapError(
            error.found, error.hint, mark=error.mark, where=path, code=error.code
        ) from None
    if classifiers.ids != stored.ids:
        raise MapError(
            f"classifiers of the submaps {classifiers.ids}, but the map has {stored.ids}",
            "build the map again",
            where=path,
        )
    return classifiers
