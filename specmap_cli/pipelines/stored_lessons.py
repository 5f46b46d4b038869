"""What the classifiers of a map learned from, as its directory keeps it, and as it holds later."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from specmap_cli import __version__
from specmap_cli.core.geometry import FloatArray, compose, nearest_motion
from specmap_cli.core.records import IntArray, Labels
from specmap_cli.core.settings import Config
from specmap_cli.maps.features_file import KEYFRAMES_OF, KINDS
from specmap_cli.maps.store import StoredMap
from specmap_cli.recognition.features.sets import feature_names
from specmap_cli.recognition.learning.classifiers import ClassifierSet
from specmap_cli.recognition.learning.training_data import (
    NO_SAMPLES,
    NO_TRAINING_DATA,
    Samples,
    TrainingData,
)

_MOST = float(np.finfo(np.float16).max)


def arrays_of(lessons: TrainingData) -> dict[str, NDArray[Any]]:
    """Training data as arrays of a file: in half precision, which moves few of them to another bin.

    A column a scan: one feature of all scans after the other takes less room.
    """
    arrays: dict[str, NDArray[Any]] = {}
    for kind in KINDS:
        samples: Samples = getattr(lessons, kind)
        features = np.clip(samples.features.T, -_MOST, _MOST).astype(np.float16)
        arrays[kind] = np.ascontiguousarray(features)
        arrays[kind + KEYFRAMES_OF] = samples.keyframes.astype(np.int32)
    return arrays


def lessons_of_stored(stored: StoredMap, config: Config) -> TrainingData:
    """The lessons of a map directory; none where they would not be the same by these settings.

    Nor are there any of another version, which may find other features. Scans that were cast in
    other grids are left out. Raises MapError for a damaged file.
    """
    arrays = stored.features
    if arrays is None or _version(stored) != __version__ or stored.foreign_settings:
        return NO_TRAINING_DATA
    before = stored.config
    same = before.recognition.feature_set == config.recognition.feature_set
    if not same or before.localization != config.localization:
        return NO_TRAINING_DATA
    found = TrainingData(*(_samples(arrays, kind) for kind in KINDS))
    sets = [config.recognition.feature_set] * 2 + [config.localization.feature_set] * 2
    if not all(map(_are_of, found.kinds, sets)):
        return NO_TRAINING_DATA
    return found if before.grid == config.grid else replace(found, cast=NO_SAMPLES)


def _are_of(samples: Samples, feature_set: str) -> bool:
    """Whether samples, if there are any, have as many features as a set."""
    columns = samples.features.shape[1]
    return not len(samples.keyframes) or columns == len(feature_names(feature_set))


def comparable(
    classifiers: ClassifierSet | None, stored: StoredMap, config: Config
) -> ClassifierSet | None:
    """The classifiers of a map where they are of the kind that these settings make, else None.

    Those of another version are not: it may have found other features.
    """
    if classifiers is None or _version(stored) != __version__:
        return None
    if stored.config.recognition != config.recognition:
        return None
    virtual = classifiers.virtual is not None
    same = stored.config.localization.feature_set == config.localization.feature_set
    return classifiers if same and virtual == config.localization.virtual else None


def lessons_left(
    lessons: TrainingData,
    before: Labels,
    now: Labels,
    left: IntArray,
    apart_m: float,
    first: int = 0,
) -> TrainingData:
    """What of the lessons of a map holds for one that it became.

    `left` (k,) are the keyframes of the map that are those from number `first` on of `now`. What
    was cast in the grid of a submap holds where the submap has the keyframes that it had, and where
    these lie to each other as they did, to `apart_m`.
    """
    own = slice(first, first + len(left))
    unchanged = np.zeros(len(left), dtype=bool)
    for submap in np.unique(now.submaps[own]).tolist():
        rows = np.flatnonzero(now.submaps[own] == submap)
        was, is_ = before.poses[left[rows]], now.poses[own][rows]
        there = {np.count_nonzero(now.submaps == submap)}
        there |= {
            np.count_nonzero(before.submaps == id_) for id_ in set(before.submaps[left[rows]])
        }
        unchanged[rows] = there == {len(rows)} and _bent_m(was, is_) <= apart_m
    return lessons.left(left).cast_near(unchanged).numbered_from(first)


def _bent_m(was: FloatArray, is_: FloatArray) -> float:
    """How far places (n, 3) moved besides a motion that they made together."""
    motion = nearest_motion(was[:, :2], is_[:, :2])
    away = compose(np.array(motion), was)[:, :2] - is_[:, :2]
    return float(np.hypot(away[:, 0], away[:, 1]).max())


def _samples(arrays: Mapping[str, NDArray[Any]], kind: str) -> Samples:
    features = np.ascontiguousarray(arrays[kind].T, dtype=np.float32)
    return Samples(features, arrays[kind + KEYFRAMES_OF].astype(np.intp))


def _version(stored: StoredMap) -> str | None:
    """The version of specmap that made the map, as far as it says so."""
    versions = stored.run.get("versions")
    version = versions.get("specmap") if isinstance(versions, dict) else None
    return version if isinstance(version, str) else None
