"""What training and closing loops cost, against the number of submaps."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence

import numpy as np

from benchmarks.paper.blocks import Block, Chart, Found, Row, Series, Table, figure
from benchmarks.paper.samples import Samples, fitted, the_papers
from benchmarks.paper.workshop import OURS, PAPER, PRESETS, WORDS, Workshop, beside
from specmap_cli.core.config import load_config
from specmap_cli.core.settings import Config, RecognitionConfig
from specmap_cli.grids.gridmap import GridMap, PackedGrid
from specmap_cli.recognition.closure.loop_closer import LoopCloser, Stay
from specmap_cli.recognition.features.sets import feature_names

MOST = {PAPER: 40, OURS: 160}
LIMIT_S = 30.0  # of closing with one preset: what takes longer ends there
_TRAINED = {PAPER: (5, 10, 20), OURS: (5, 10, 20, 40)}
_SCANS = 150  # of a submap


def make(workshop: Workshop) -> list[Block]:
    """Closing, submap by submap, and the final classifiers; the recordings do not matter."""
    del workshop
    return blocks(MOST, _TRAINED)


def blocks(most: Mapping[str, int], trained: Mapping[str, Sequence[int]]) -> list[Block]:
    """The same for up to so many submaps, and for final classifiers of so many."""
    marks = {p: closing_seconds(most[p], load_config(preset=p), LIMIT_S) for p in PRESETS}
    closing = [_series(preset, marks[preset]) for preset in PRESETS]
    configs = {PAPER: the_papers(), OURS: load_config().recognition}
    rows = [
        Row((WORDS[preset], str(count), figure(_training_s(configs[preset], count), 2)))
        for preset in PRESETS
        for count in trained[preset]
    ]
    return [
        _found(marks),
        Chart(
            closing,
            "submaps so far",
            "seconds in all",
            f"Recognising each new submap among all before it, classifiers trained for it "
            f"included: synthetic submaps of {_SCANS} scans, processor seconds, a measurement "
            f"ends after {LIMIT_S:.0f} s.",
        ),
        Table(
            ("choices", "submaps", "seconds"),
            rows,
            "The final classifiers of a map, one a submap against all others.",
        ),
    ]


def _found(marks: Mapping[str, Sequence[float]]) -> Found:
    told = {p: f"{len(seconds)} submaps in {seconds[-1]:.1f} s" for p, seconds in marks.items()}
    return Found(
        f"Recognised one after the other. {beside(told)}",
        "The paper's classifiers learn from all scans of all other submaps, and there is one more "
        "of each for every pair: the time grows faster than the square of the submaps. specmap "
        "learns from a fixed number of scans, and leaves old submaps out by groups.",
    )


def _series(preset: str, marks: Sequence[float]) -> Series:
    return Series(WORDS[preset], [(k + 1.0, second) for k, second in enumerate(marks)])


def _training_s(config: RecognitionConfig, submaps: int) -> float:
    """Processor seconds of the final classifiers of so many submaps."""
    rng = np.random.default_rng(0)
    width = len(feature_names(config.feature_set))
    own = [rng.normal(rng.normal(0.0, 1.0, width), 0.7, (_SCANS, width)) for _ in range(submaps)]
    samples = Samples(np.vstack(own), np.repeat(np.arange(submaps), _SCANS))
    started = time.process_time()
    fitted(samples, config)
    return time.process_time() - started


def closing_seconds(count: int, config: Config, limit_s: float = math.inf) -> list[float]:
    """Processor seconds up to each of `count` submaps, of closing alone; at most some `limit_s`.

    They are synthetic, of 150 scans with features around their own centres.
    """
    rng = np.random.default_rng(0)
    width = len(feature_names(config.recognition.feature_set))
    loop = LoopCloser(config.recognition, rng)
    empty = PackedGrid.of(GridMap(np.full((4, 4), 2, dtype=np.uint8), 0.05))
    started, marks = time.process_time(), []
    for number in range(count):
        features = rng.normal(rng.normal(0.0, 1.0, width), 0.7, (_SCANS, width))
        loop.consider(Stay(number=number, features=features, packed=empty, track=np.zeros((5, 3))))
        marks.append(time.process_time() - started)
        if marks[-1] > limit_s:
            break
    return marks
