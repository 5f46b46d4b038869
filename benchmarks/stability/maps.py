"""From a recording to the division of its finished map, in two steps: the first can be kept."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.stability.recordings import Take
from specmap_cli.core.geometry import FloatArray, Pose2, nearest_motion
from specmap_cli.core.progress import Silent
from specmap_cli.core.records import IntArray, Labels, PlanarScan, PosedScan
from specmap_cli.core.settings import Config
from specmap_cli.grids.keyframes import KeyframeSelector, KeyframeStore
from specmap_cli.layout.relaxation import Layout
from specmap_cli.pipelines.build import explore
from specmap_cli.pipelines.exploration import Exploration, online_labels
from specmap_cli.pipelines.laying_out import lay_out
from specmap_cli.pipelines.learning import divide, submaps_of, whole_grid
from specmap_cli.pipelines.stopwatch import Stopwatch
from specmap_cli.registration import FrontEnd
from specmap_cli.topology.regions import Regions
from specmap_cli.topology.regions import divide as divide_cells


@dataclass(frozen=True, slots=True, kw_only=True)
class Placed:
    """The keyframes of a recording where its layout puts them.

    `sweeps` (n,) are the numbers of their sweeps in the recording, `poses` (n, 3) those of the base
    in the map, `online` (n,) the submaps found on the way; `readings` (n, 2, B) bearings and ranges
    of the scans, `base_from_laser` (3,). `apart`: the layout is in pieces.
    """

    sweeps: IntArray
    poses: FloatArray
    online: IntArray
    readings: FloatArray
    range_max: float
    full_circle: bool
    base_from_laser: FloatArray
    apart: bool

    def save(self, path: Path) -> None:
        """Keep it in a file."""
        values: dict[str, Any] = {one.name: getattr(self, one.name) for one in fields(self)}
        np.savez_compressed(path, **values)

    @classmethod
    def load(cls, path: Path) -> Placed:
        """What `save` has kept."""
        with np.load(path, allow_pickle=False) as kept:
            values = {name: kept[name] for name in kept.files}
        for name in ("range_max", "full_circle", "apart"):
            values[name] = values[name].item()
        return cls(**values)


@dataclass(frozen=True, slots=True)
class Divided:
    """A finished map: its regions, and the map's frame in that which all takes share."""

    regions: Regions
    shared_from_map: Pose2


def placed(take: Take) -> Placed:
    """Build the map of a take up to its layout."""
    config = Config(seed=take.seed)
    sweeps: list[int] = []
    selector = KeyframeSelector(config.keyframes)

    def accepts(scan: PosedScan) -> bool:
        taken = selector.accepts(scan)
        if taken:
            sweeps.append(scan.index)
        return taken

    clock, progress = Stopwatch(), Silent()
    with KeyframeStore() as store:
        exploration = Exploration(config, store, clock, None)
        explored = explore(_registered(take, config), exploration, accepts, progress)
        layout = lay_out(explored, config, store, progress, clock).layout
        scans = [store.scan(number) for number in range(len(store))]
        laser = store.base_from_laser(0)
    return Placed(
        sweeps=np.array(sweeps),
        poses=layout.poses,
        online=online_labels(explored.regions, explored.closures, len(scans)),
        readings=np.array([(scan.bearings, scan.ranges) for scan in scans]),
        range_max=scans[0].range_max,
        full_circle=scans[0].full_circle,
        base_from_laser=np.array(laser),
        apart=bool(layout.loose),
    )


def _registered(take: Take, config: Config) -> Iterator[PosedScan]:
    front_end = FrontEnd(config.registration)
    for sweep in take.sweeps:
        yield from front_end.take(sweep)
    yield from front_end.rest()


def divided(kept: Placed, shared: FloatArray) -> Divided:
    """Divide the finished map; `shared` (n, 2) are the keyframes' places in the shared frame."""
    config = Config()
    with KeyframeStore() as store:
        for scan in _scans(kept):
            store.append(scan)
        layout = Layout(poses=kept.poses, loose=(0,) if kept.apart else ())
        whole, _ = whole_grid(store, layout, config)
    regions = {label: tuple(members) for label, members in submaps_of(kept.online).items()}
    submaps = divide(whole, layout, regions, (), config)
    labels = Labels(stamps_ns=kept.sweeps, poses=layout.poses, submaps=submaps)
    return Divided(divide_cells(whole, labels), nearest_motion(layout.poses[:, :2], shared))


def _scans(kept: Placed) -> Iterable[PosedScan]:
    laser = Pose2(*kept.base_from_laser.tolist())
    for number, (pose, (bearings, ranges)) in enumerate(
        zip(kept.poses.tolist(), kept.readings, strict=True)
    ):
        yield PosedScan(
            index=number,
            stamp_ns=number,
            map_from_base=Pose2(*pose),
            planar=PlanarScan(number, bearings, ranges, kept.range_max, kept.full_circle),
            base_from_laser=laser,
        )
