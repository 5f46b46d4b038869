"""Training the classifiers that localisation uses, from the keyframes of a map."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.settings import Config
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.recognition.learning.calibration import HeldOutMargins
from specmap_cli.recognition.learning.classifiers import Recogniser
from specmap_cli.recognition.learning.familiarity import Familiarity
from specmap_cli.recognition.learning.holding_out import Pieces, Samples, held_out_margins
from specmap_cli.recognition.learning.misfit import HELD_OUT_REACH_M
from specmap_cli.recognition.learning.one_vs_all import OneVsAll
from specmap_cli.recognition.learning.revisits import Revisits
from specmap_cli.recognition.learning.sensor import Sensor

_EXEMPLARS = 80  # scans kept of a submap, to tell unknown ones by


def sensor_of(store: KeyframeStore, submaps: Mapping[int, Sequence[int]]) -> Sensor:
    """The laser of the first keyframe that is in a submap."""
    return Sensor.of(store.scan(min(numbers[0] for numbers in submaps.values())))


def train_raw(
    taken: Mapping[int, Samples],
    beside: Mapping[int, Samples],
    poses: FloatArray,
    config: Config,
    rng: np.random.Generator,
    revisits: Revisits | None = None,
) -> tuple[Recogniser, HeldOutMargins]:
    """What tells the submaps apart by raw scans, and how well it tells scans that are held out.

    It is learned from `raw_samples` and from `beside_samples`. The former alone show what the map
    looks like, and are tested. With `revisits` these are scans of a recording, which the map before
    it tells.
    """
    feature_set = config.recognition.feature_set
    samples = {i: _joined(taken[i], beside[i]) for i in sorted(taken)}
    learned = train(_features(samples), feature_set, config, rng, looks=_features(taken))
    if revisits is not None:
        return learned, revisits.told(taken, revisits.classifiers.raw)
    return learned, _tested(samples, taken, poses, feature_set, config, rng)


def train_virtual(
    along: Mapping[int, Samples],
    cast: Mapping[int, Samples],
    poses: FloatArray,
    config: Config,
    rng: np.random.Generator,
    revisits: Revisits | None = None,
) -> tuple[Recogniser, HeldOutMargins]:
    """What tells the submaps apart by virtual scans, and how well it tells those held out.

    It is learned from `track_samples` and from `cast_samples`, and tested on the former, or on
    those of a recording as by `train_raw`.
    """
    feature_set = config.localization.feature_set
    samples = {i: _joined(along[i], cast[i]) for i in sorted(along)}
    learned = train(_features(samples), feature_set, config, rng)
    if revisits is not None and revisits.classifiers.virtual is not None:
        return learned, revisits.told(along, revisits.classifiers.virtual)
    return learned, _tested(samples, along, poses, feature_set, config, rng)


def _joined(taken: Samples, made: Samples) -> Samples:
    return Samples(
        np.vstack([taken.features, made.features]),
        np.concatenate([taken.keyframes, made.keyframes]),
    )


def _tested(
    samples: Mapping[int, Samples],
    asked: Mapping[int, Samples],
    poses: FloatArray,
    feature_set: str,
    config: Config,
    rng: np.random.Generator,
) -> HeldOutMargins:
    """How the samples `asked` that lie in held-out pieces are told by all other samples."""
    pieces = Pieces(poses, HELD_OUT_REACH_M)
    rest = {i: pieces.rest(own) for i, own in samples.items()}
    tested = {i: pieces.tested(own) for i, own in asked.items()}
    return held_out_margins(rest, tested, feature_set, config.recognition, rng)


def train(
    samples: Mapping[int, FloatArray],
    feature_set: str,
    config: Config,
    rng: np.random.Generator,
    looks: Mapping[int, FloatArray] | None = None,
) -> Recogniser:
    """What tells submaps apart, from the features (n, F) of every submap's scans.

    What the map looks like is known from those of `looks`, or from all of them.
    """
    localization = config.localization
    classifiers = OneVsAll(feature_set, config.recognition).fit(samples, rng)
    known = Familiarity(feature_set, localization.false_unknown, _EXEMPLARS)
    shown = samples if looks is None else looks
    return Recogniser(classifiers, known.fit(shown) if known.can_fit(shown) else None)


def _features(samples: Mapping[int, Samples]) -> dict[int, FloatArray]:
    return {i: own.features for i, own in samples.items()}
