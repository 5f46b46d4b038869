"""What the classifiers of a map learn from, and what of that a map directory keeps."""

from __future__ import annotations

from collections.abc import Generator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from specmap_cli import __version__
from specmap_cli.core.geometry import compose, invert, nearest_motion
from specmap_cli.core.progress import Progress
from specmap_cli.core.records import IntArray, Labels
from specmap_cli.core.settings import Config, GridConfig
from specmap_cli.core.worker import ahead
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.grids.keyframes import integrate_keyframes
from specmap_cli.maps.features_file import KEYFRAMES_OF, KINDS, Arrays
from specmap_cli.maps.store import Map
from specmap_cli.pipelines.session import Session
from specmap_cli.recognition.features.sets import KeyframeFeatures, feature_names
from specmap_cli.recognition.learning.calibration import (
    HeldOutMargins,
    HeldOutMisfit,
    calibrated,
    held_out_misfit,
)
from specmap_cli.recognition.learning.classifiers import ClassifierSet, Recogniser, Sensor
from specmap_cli.recognition.learning.sampling import (
    NO_SAMPLES,
    NO_TRAINING_DATA,
    Samples,
    Track,
    TrainingData,
    augmented_samples,
    cast_samples,
    raw_samples,
    track_samples,
)
from specmap_cli.recognition.learning.training import Revisits, train_and_test

_MOST = float(np.finfo(np.float16).max)

OfSubmaps = Mapping[int, Samples]
# By raw scans: the classifiers, how they told held-out scans, their misfit; the scans that were
# seen, and those that were made up.
Taught = tuple[Recogniser, HeldOutMargins, HeldOutMisfit, OfSubmaps, OfSubmaps]


@dataclass(frozen=True, slots=True)
class Learned:
    """The grid of each submap in the frame of its first keyframe, and the classifiers of all.

    `features` are what these were learned from, as `arrays_of` has it.
    """

    grids: Mapping[int, GridMap]
    classifiers: ClassifierSet
    features: Arrays


@dataclass(frozen=True, slots=True)
class Prior:
    """What there is before a map is learned: features of keyframes, data that can be used again.

    `classifiers` are those that the map had before its last recording was added.
    """

    features: KeyframeFeatures
    training_data: TrainingData = NO_TRAINING_DATA
    classifiers: ClassifierSet | None = None

    @classmethod
    def of(cls, session: Session, data: TrainingData = NO_TRAINING_DATA) -> Prior:
        """What training data that holds for the keyframes of a session tells, and nothing else."""
        features = KeyframeFeatures(session.store, session.config.recognition.feature_set)
        return cls(features.knowing(data.raw.keyframes, data.raw.features), data)


def learn(session: Session, labels: Labels, prior: Prior, starts: tuple[int, ...] = ()) -> Learned:
    """What can be learned of the submaps of keyframes.

    Recordings after the first one begin with the keyframes `starts`. What raw scans teach needs no
    grids: it is learned beside the drawing of these, and beside what virtual scans teach.
    """
    config, store, poses = session.config, session.store, labels.poses
    track = Track.of(store, labels, starts)
    revisits = None
    if prior.classifiers is not None:  # they tell the scans of the last recording
        revisits = Revisits(prior.classifiers, starts[-1], labels)
    raw_rng, virtual_rng = np.random.default_rng(config.seed).spawn(2)
    along: OfSubmaps = {}
    cast: OfSubmaps = {}
    virtual, of_virtual = None, None
    with ahead(lambda: _of_raw_scans(track, config, prior, raw_rng, revisits)) as meanwhile:
        session.progress.start("grids", len(store))
        with session.clock.stage("grids"):
            grids = submap_grids(track, config.grid, session.progress)
        session.progress.start("training", None)
        with session.clock.stage("training"):
            if config.localization.virtual:
                data, virtually = prior.training_data, config.localization
                cast = cast_samples(track, grids, virtually, virtual_rng, data.cast)
                along = track_samples(track, virtually, data.along)
                virtual, of_virtual = train_and_test(
                    along, cast, poses, config, virtual_rng, revisits, virtual=True
                )
            raw, of_raw, misfit, samples, beside = meanwhile.result
            before = prior.classifiers
            # as before, where the last recording tells nothing of how sure they are
            calibration = None if before is None or len(of_raw.column) else before.calibration
            first = min(own[0] for own in track.submaps.values())
            classifiers = ClassifierSet(
                sensor=Sensor.of(store.scan(first)),
                raw=raw,
                virtual=virtual,
                misfit=misfit,
                calibration=calibration
                or calibrated(of_raw, of_virtual, another_log=before is not None),
            )
    return Learned(grids, classifiers, arrays_of(TrainingData.of(samples, beside, along, cast)))


def submap_grids(
    track: Track, config: GridConfig, progress: Progress | None = None
) -> dict[int, GridMap]:
    """The grid of each submap from all its keyframes, in the frame of its first."""
    grids = {}
    for id_, keyframes in track.submaps.items():
        poses = compose(invert(track.poses[keyframes[0]]), track.poses[keyframes])
        counts = integrate_keyframes(track.store, keyframes, poses, config, track.starts)
        grids[id_] = counts.snapshot()
        if progress is not None:
            progress.advance(len(keyframes))
    return grids


def _of_raw_scans(
    track: Track,
    config: Config,
    prior: Prior,
    rng: np.random.Generator,
    revisits: Revisits | None,
) -> Generator[None, None, Taught]:
    """What raw scans teach; nothing is told on the way."""
    yield from ()
    poses, samples = track.poses, raw_samples(track, config, prior.features)
    beside = augmented_samples(track, config, rng, prior.training_data.beside)
    raw, held_out = train_and_test(samples, beside, poses, config, rng, revisits, virtual=False)
    misfit = held_out_misfit(track.store, track.submaps, poses)
    return raw, held_out, misfit, samples, beside


def arrays_of(data: TrainingData) -> Arrays:
    """Training data as arrays of a file: in half precision, which moves few of them to another bin.

    A column a scan: one feature of all scans after the other takes less room.
    """
    arrays: dict[str, NDArray[Any]] = {}
    for kind in KINDS:
        samples: Samples = getattr(data, kind)
        features = np.clip(samples.features.T, -_MOST, _MOST).astype(np.float16)
        arrays[kind] = np.ascontiguousarray(features)
        arrays[kind + KEYFRAMES_OF] = samples.keyframes.astype(np.int32)
    return arrays


def training_data_of_stored(stored: Map, config: Config) -> TrainingData:
    """The training data of a map directory; none where it would not be the same by these settings.

    Nor are there any of another version, which may find other features. Scans that were cast in
    other grids are left out. Raises MapError for a damaged file.
    """
    arrays = stored.features
    if arrays is None or not _of_this_version(stored) or stored.foreign_settings:
        return NO_TRAINING_DATA
    before = stored.config
    same = before.recognition.feature_set == config.recognition.feature_set
    if not same or before.localization != config.localization:
        return NO_TRAINING_DATA
    found = TrainingData(
        *(
            Samples(
                np.ascontiguousarray(arrays[kind].T, dtype=np.float32),
                arrays[kind + KEYFRAMES_OF].astype(np.intp),
            )
            for kind in KINDS
        )
    )
    sets = [config.recognition.feature_set] * 2 + [config.localization.feature_set] * 2
    for samples, feature_set in zip(found.kinds, sets, strict=True):
        fits = samples.features.shape[1] == len(feature_names(feature_set))
        if len(samples.keyframes) and not fits:
            return NO_TRAINING_DATA
    return found if before.grid == config.grid else replace(found, cast=NO_SAMPLES)


def comparable(classifiers: ClassifierSet, stored: Map, config: Config) -> ClassifierSet | None:
    """The classifiers of a map where they are of the kind that these settings make, else None.

    Those of another version are not: it may have found other features.
    """
    if not _of_this_version(stored) or stored.config.recognition != config.recognition:
        return None
    virtual = classifiers.virtual is not None
    same = stored.config.localization.feature_set == config.localization.feature_set
    return classifiers if same and virtual == config.localization.virtual else None


def valid_training_data(
    training_data: TrainingData,
    before: Labels,
    now: Labels,
    left: IntArray,
    apart_m: float,
    first: int = 0,
) -> TrainingData:
    """What of the training data of a map holds for one that it became.

    `left` (k,) are the keyframes of the map that are those from number `first` on of `now`. What
    was cast in the grid of a submap holds where the submap has the keyframes that it had, and where
    these lie to each other as they did, to `apart_m`.
    """
    own = slice(first, first + len(left))
    unchanged = np.zeros(len(left), dtype=bool)
    for submap in np.unique(now.submaps[own]).tolist():
        rows = np.flatnonzero(now.submaps[own] == submap)
        was, is_ = before.poses[left[rows]], now.poses[own][rows]
        together = np.array(nearest_motion(was[:, :2], is_[:, :2]))
        away = compose(together, was)[:, :2] - is_[:, :2]
        bent_m = float(np.hypot(away[:, 0], away[:, 1]).max())
        there = {np.count_nonzero(now.submaps == submap)}
        there |= {
            np.count_nonzero(before.submaps == id_) for id_ in set(before.submaps[left[rows]])
        }
        unchanged[rows] = there == {len(rows)} and bent_m <= apart_m
    kept = training_data.left(left, first)
    return replace(kept, cast=kept.cast.rows(unchanged[kept.cast.keyframes - first]))


def _of_this_version(stored: Map) -> bool:
    """Whether this version of specmap made the map, as far as it says so."""
    versions = stored.run.get("versions")
    return isinstance(versions, dict) and versions.get("specmap") == __version__
