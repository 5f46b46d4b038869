"""After Algorithm 1's loop: the layout, the topology, the grids and the classifiers of the map."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from specmap_cli.core.config import Config
from specmap_cli.core.errors import NoResultError
from specmap_cli.core.geometry import FloatArray, compose, invert
from specmap_cli.core.progress import Progress
from specmap_cli.core.records import IntArray, Labels, Trajectory
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.grids.keyframes import KeyframeStore, integrate_keyframes
from specmap_cli.layout.relaxation import Layout, corrected, relax
from specmap_cli.pipelines.mapper import Mapper
from specmap_cli.pipelines.worker import ahead
from specmap_cli.recognition.learning.classifiers import ClassifierSet
from specmap_cli.recognition.learning.training import train_raw, train_virtual
from specmap_cli.segmentation.refinement import regions_of
from specmap_cli.topology.graph import build_topology, first_visit_order, settle_labels
from specmap_cli.topology.topological_map import TopologicalMap


@dataclass(frozen=True, slots=True)
class FinishedMap:
    """A map ready to be written: row i of `labels` is keyframe number i."""

    topology: TopologicalMap
    labels: Labels
    trajectory: Trajectory
    grid: GridMap
    classifiers: str
    layout: Layout

    @property
    def path_m(self) -> float:
        """Length of the trajectory over its keyframes."""
        steps = np.diff(self.labels.poses[:, :2], axis=0)
        return float(np.hypot(steps[:, 0], steps[:, 1]).sum())


def finish_map(mapper: Mapper, progress: Progress) -> FinishedMap:
    """Lay the submaps out, derive the topology, rebuild the grids, train the classifiers.

    Raises NoResultError when the log left no keyframe, or none that fits the grid.
    """
    config, store, clock = mapper.config, mapper.store, mapper.clock
    if not len(store):
        raise NoResultError(
            "no scan could be registered: nothing to map; look at the scans with `specmap info`"
        )
    progress.start("layout", None)
    with clock.stage("layout"):
        layout = relax(store, mapper.constraints(), mapper.breaks, config.relaxation)
        trajectory = corrected(mapper.trajectory.trajectory(), store, layout)
    mapper.refute({(link.source, link.target) for link in layout.dropped if link.kind == "closure"})
    with clock.stage("grids"):
        whole = integrate_keyframes(store, range(len(store)), layout.poses, config.grid).snapshot()
    if not whole.cells.size:
        raise NoResultError(
            "no scan fits into the largest grid allowed: nothing to map; raise grid.max_extent_m "
            "or grid.max_area_m2, or lower grid.max_range_m"
        )
    with clock.stage("segmentation"):
        labels = _final_labels(mapper, layout, whole)
    topology, classifiers = _learned(mapper, layout, labels, progress)
    table = Labels(np.array(store.stamps_ns, dtype=np.int64), layout.poses, labels)
    return FinishedMap(topology, table, trajectory, whole, classifiers.to_json(), layout)


def _learned(
    mapper: Mapper, layout: Layout, labels: IntArray, progress: Progress
) -> tuple[TopologicalMap, ClassifierSet]:
    """The submaps with their grids, and the classifiers: those of raw scans need no grids and are
    trained ahead.
    """
    config, store, clock = mapper.config, mapper.store, mapper.clock
    submaps = {int(i): np.flatnonzero(labels == i).tolist() for i in np.unique(labels)}
    raw_rng, virtual_rng = np.random.default_rng(config.seed).spawn(2)

    def train() -> Iterator[ClassifierSet]:
        yield train_raw(store, submaps, config, raw_rng, mapper.features)

    with ahead(train) as trained:
        progress.start("grids", len(store))
        with clock.stage("grids"):
            grids = _submap_grids(store, submaps, layout.poses, config, progress)
        regions = {i: _commonest(labels[keyframes]) for i, keyframes in mapper.regions.items()}
        topology = build_topology(
            labels,
            layout.poses,
            store.stamps_ns,
            mapper.breaks,
            mapper.closures,
            regions,
            grids,
        )
        progress.start("training", None)
        with clock.stage("training"):
            virtual = train_virtual(store, submaps, layout.poses, grids, config, virtual_rng)
            classifiers = next(trained)
            classifiers.virtual, classifiers.virtual_known = virtual
    return topology, classifiers


def _final_labels(mapper: Mapper, layout: Layout, whole: GridMap) -> IntArray:
    """The submap id (n,) of each keyframe, in order of first visit."""
    labels = mapper.labels()
    if _is_consistent(mapper, layout) and mapper.config.segmentation.final_regions:
        labels = regions_of(whole, layout.poses, mapper.config.segmentation)
    settled = settle_labels(labels, layout.poses, mapper.config.segmentation.region_min_m)
    order = first_visit_order(settled.tolist())
    return np.array([order[int(label)] for label in settled], dtype=np.int64)


def _is_consistent(mapper: Mapper, layout: Layout) -> bool:
    """Whether one place of the building is one place of the layout."""
    return mapper.config.relaxation.enabled and not layout.loose


def _commonest(labels: IntArray) -> int:
    return int(np.bincount(labels).argmax())


def _submap_grids(
    store: KeyframeStore,
    submaps: Mapping[int, Sequence[int]],
    poses: FloatArray,
    config: Config,
    progress: Progress,
) -> dict[int, GridMap]:
    """The grid of each submap from all its keyframes, in the frame of its first."""
    grids = {}
    for id_, keyframes in submaps.items():
        track = compose(invert(poses[keyframes[0]]), poses[keyframes])
        grids[id_] = integrate_keyframes(store, keyframes, track, config.grid).snapshot()
        progress.advance(len(keyframes))
    return grids
