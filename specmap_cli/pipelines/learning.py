"""From a layout to what is known of each submap: whose keyframes, its grid, its classifiers."""

from __future__ import annotations

from collections.abc import Collection, Generator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from specmap_cli.core.arrays import order_of_appearance
from specmap_cli.core.errors import NoResultError
from specmap_cli.core.geometry import FloatArray, compose, invert
from specmap_cli.core.progress import Progress
from specmap_cli.core.records import Closure, IntArray, Labels
from specmap_cli.core.settings import Config
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.grids.keyframes import KeyframeStore, integrate_keyframes
from specmap_cli.layout.motion_edges import Bridge
from specmap_cli.layout.relaxation import Layout
from specmap_cli.pipelines.exploration import Regions, online_labels
from specmap_cli.pipelines.stopwatch import Stopwatch
from specmap_cli.pipelines.worker import ahead
from specmap_cli.recognition.features.sets import KeyframeFeatures
from specmap_cli.recognition.learning.beside import beside_samples
from specmap_cli.recognition.learning.calibration import Calibration, HeldOutMargins, calibrated
from specmap_cli.recognition.learning.classifiers import ClassifierSet, Recogniser
from specmap_cli.recognition.learning.holding_out import Samples
from specmap_cli.recognition.learning.lessons import NO_LESSONS, Lessons
from specmap_cli.recognition.learning.misfit import HELD_OUT_REACH_M, HeldOutMisfit, held_out_misfit
from specmap_cli.recognition.learning.revisits import Revisits
from specmap_cli.recognition.learning.sampling import cast_samples, raw_samples, track_samples
from specmap_cli.recognition.learning.training import sensor_of, train_raw, train_virtual
from specmap_cli.segmentation.division import regions_of
from specmap_cli.topology.graph import build_topology, settle_labels, stays_of
from specmap_cli.topology.topological_map import Break, TopologicalMap

Submaps = Mapping[int, Sequence[int]]
OfSubmaps = Mapping[int, Samples]


def whole_grid(store: KeyframeStore, layout: Layout, config: Config) -> tuple[GridMap, int]:
    """The grid of all keyframes at their poses in the layout, and how many were beyond its limits.

    Raises NoResultError when no keyframe fits into the largest grid allowed.
    """
    counts = integrate_keyframes(store, range(len(store)), layout.poses, config.grid)
    whole = counts.snapshot()
    if not whole.cells.size:
        raise NoResultError(
            "no scan fits into the largest grid allowed: nothing to map; raise grid.max_extent_m "
            "or grid.max_area_m2, or lower grid.max_range_m"
        )
    return whole, counts.refused


def divide(
    whole: GridMap,
    layout: Layout,
    regions: Regions,
    closures: Sequence[Closure],
    config: Config,
) -> IntArray:
    """The submap id (n,) of each keyframe, in order of first visit.

    The regions of the finished map say where submaps end, if one place of the building is one place
    of the layout. Otherwise the regions that were left on the way, and their merges, say it.
    """
    if divides_whole(layout, config):
        labels = regions_of(whole, layout.poses, config.segmentation)
    else:
        labels = online_labels(regions, closures, len(layout.poses))
    settled = settle_labels(labels, layout.poses, config.segmentation.region_min_m)
    order = order_of_appearance(settled.tolist())
    return np.array([order[int(label)] for label in settled], dtype=np.int64)


def divides_whole(layout: Layout, config: Config) -> bool:
    """Whether the finished map says where submaps end."""
    consistent = config.relaxation.enabled and not layout.loose
    return consistent and config.segmentation.final_regions


def submaps_of(labels: IntArray) -> dict[int, list[int]]:
    """The keyframes of each submap, ascending, from the submap (n,) of each keyframe."""
    return {int(id_): np.flatnonzero(labels == id_).tolist() for id_ in np.unique(labels)}


def linked(
    labels: Labels,
    regions: Regions,
    breaks: Mapping[int, Bridge | None],
    closures: Sequence[Closure],
    grids: Mapping[int, GridMap],
    starts: Collection[int] = (),
) -> TopologicalMap:
    """The submaps linked where the robot drove across and where closures show that they meet.

    `starts` are the keyframes with which other recordings begin.
    """
    stamps_ns = labels.stamps_ns.tolist()
    return build_topology(
        labels=labels.submaps,
        poses=labels.poses,
        stamps_ns=stamps_ns,
        breaks=[
            Break(keyframe, *((bridge.position_m, bridge.heading_rad) if bridge else ()))
            for keyframe, bridge in sorted(breaks.items())
            if keyframe < len(stamps_ns)  # none came after the last of them
            and keyframe not in starts
        ],
        closures=closures,
        stays=stays_of(regions, labels.submaps, stamps_ns),
        grids=grids,
        starts=starts,
    )


@dataclass(frozen=True, slots=True)
class Learned:
    """The grid of each submap in the frame of its first keyframe, and the classifiers of all.

    `lessons` are what these were learned from.
    """

    grids: Mapping[int, GridMap]
    classifiers: ClassifierSet
    lessons: Lessons


@dataclass(frozen=True, slots=True)
class Known:
    """What is known before a map is learned.

    `features` of its keyframes, and the `lessons` that hold for it still. Its recordings after the
    first one begin at `starts`. `before` are the classifiers that it had before the last of them.
    """

    features: KeyframeFeatures
    lessons: Lessons = NO_LESSONS
    starts: tuple[int, ...] = ()
    before: ClassifierSet | None = None

    def revisits(self, labels: IntArray, poses: FloatArray) -> Revisits | None:
        """How the classifiers before the last recording tell its scans, where there are any."""
        if self.before is None:
            return None
        return Revisits(self.before, self.starts[-1], poses, labels, HELD_OUT_REACH_M)


def known_of(
    store: KeyframeStore, lessons: Lessons, starts: tuple[int, ...], config: Config
) -> Known:
    """What is known of a map's keyframes by the lessons that hold for them, and nothing else."""
    features = KeyframeFeatures(store, config.recognition.feature_set)
    raw = lessons.raw
    return Known(features.knowing(raw.keyframes, raw.features), lessons, starts)


def learn(
    store: KeyframeStore,
    known: Known,
    labels: IntArray,
    poses: FloatArray,
    config: Config,
    progress: Progress,
    clock: Stopwatch,
) -> Learned:
    """What can be learned of the submaps (n,) of keyframes at `poses` (n, 3).

    What needs no grids is done beside the drawing of these, and beside what needs them.
    """
    submaps, revisits = submaps_of(labels), known.revisits(labels, poses)
    raw_rng, virtual_rng = np.random.default_rng(config.seed).spawn(2)
    with ahead(
        lambda: _without_grids(store, known, submaps, poses, config, raw_rng, revisits)
    ) as meanwhile:
        progress.start("grids", len(store))
        with clock.stage("grids"):
            grids = submap_grids(store, submaps, poses, config, progress)
        progress.start("training", None)
        with clock.stage("training"):
            virtual = _NO_VIRTUAL
            if config.localization.virtual:
                cast = cast_samples(
                    submaps, poses, grids, config.localization, virtual_rng, known.lessons.cast
                )
                along = next(meanwhile)
                learned = train_virtual(along, cast, poses, config, virtual_rng, revisits)
                virtual = _Virtual(along, cast, *learned)
            taught = meanwhile.result
            classifiers = ClassifierSet(
                sensor=sensor_of(store, submaps),
                raw=taught.raw,
                virtual=virtual.learned,
                misfit=taught.misfit,
                calibration=_calibrated(taught.held_out, virtual.held_out, known.before),
            )
    lessons = Lessons.of(taught.samples, taught.beside, virtual.along, virtual.cast)
    return Learned(grids, classifiers, lessons)


class _Virtual(NamedTuple):
    """The virtual scans of submaps, what they taught, and how held-out ones are told."""

    along: OfSubmaps
    cast: OfSubmaps
    learned: Recogniser | None
    held_out: HeldOutMargins | None


_NO_VIRTUAL = _Virtual({}, {}, None, None)


def _calibrated(
    of_raw: HeldOutMargins, of_virtual: HeldOutMargins | None, before: ClassifierSet | None
) -> Calibration:
    """How sure the classifiers are; as those before, where the last recording tells nothing."""
    if before is not None and before.calibration is not None and not len(of_raw.column):
        return before.calibration
    return calibrated(of_raw, of_virtual, another_log=before is not None)


class _Taught(NamedTuple):
    """What raw scans taught, which these were, how held-out ones are told, and the misfit.

    `beside` are those that were made up.
    """

    raw: Recogniser
    samples: OfSubmaps
    beside: OfSubmaps
    held_out: HeldOutMargins
    misfit: HeldOutMisfit


def _without_grids(
    store: KeyframeStore,
    known: Known,
    submaps: Submaps,
    poses: FloatArray,
    config: Config,
    rng: np.random.Generator,
    revisits: Revisits | None,
) -> Generator[OfSubmaps, None, _Taught]:
    """The virtual scans along the track, if wanted; then what raw scans teach."""
    if config.localization.virtual:
        yield _single(
            track_samples(
                store, submaps, poses, config.localization, known.lessons.along, known.starts
            )
        )
    samples = raw_samples(store, submaps, config, known.features, known.starts)
    beside = beside_samples(store, submaps, poses, config, rng, known.lessons.beside)
    raw, held_out = train_raw(samples, beside, poses, config, rng, revisits)
    misfit = held_out_misfit(store, submaps, poses)
    return _Taught(raw, _single(samples), _single(beside), held_out, misfit)


def _single(samples: OfSubmaps) -> OfSubmaps:
    """Samples in single precision, which they are of: so they fit into the pipe."""
    return {
        i: Samples(own.features.astype(np.float32), own.keyframes) for i, own in samples.items()
    }


def submap_grids(
    store: KeyframeStore,
    submaps: Submaps,
    poses: FloatArray,
    config: Config,
    progress: Progress | None = None,
) -> dict[int, GridMap]:
    """The grid of each submap from all its keyframes, in the frame of its first."""
    grids = {}
    for id_, keyframes in submaps.items():
        track = compose(invert(poses[keyframes[0]]), poses[keyframes])
        grids[id_] = integrate_keyframes(store, keyframes, track, config.grid).snapshot()
        if progress is not None:
            progress.advance(len(keyframes))
    return grids
