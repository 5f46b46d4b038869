"""Table II of the paper on real logs: a fifth of the keyframes held out of whole builds.

One draw of this fifth says little: the recall is the mean over submaps, and of a small one a few
scans are drawn. So after the first draw comes the mean of several, with the standard deviation of
one of them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from benchmarks.data import log_file
from specmap_cli.core.config import load_config
from specmap_cli.evaluation.protocols import HoldOut, HoldOutResult, Split, hold_out

LOGS = ("fr079", "mit_csail")
PAPER = {"fr079": (0.9728, 0.9818, 0.9089, 0.9212), "mit_csail": (0.9689, 0.9739, 0.83, 0.8458)}


def table2(quick: bool, draws: int = 1) -> None:
    print("Table II         | training recall precision | test recall precision | filtered")
    for name in LOGS[1:] if quick else LOGS:
        row = PAPER[name]
        print(f"{name:<9} paper  | {row[0]:.3f} {row[1]:.3f} | {row[2]:.3f} {row[3]:.3f} |")
        _show_draws(name, "default", "random", 1 if quick else draws)
        _show_draws(name, "default", "blocks", 1 if quick else draws)
        if not quick:
            _show_draws(name, "paper", "random", 1)


def _show_draws(name: str, preset: str, split: Split, draws: int) -> None:
    """The row of the first draw, then the mean of all."""
    results = []
    for seed in range(draws):
        options = HoldOut(split, seed=seed)
        results.append(hold_out([log_file(name)], load_config(preset=preset), options))
        if seed == 0:
            print(f"{name:<9} {preset} {split} | {one_draw(results[0])}", flush=True)
    if draws > 1:
        print(f"{name:<9} {preset} {split}, {draws} draws | {mean_of(results)}", flush=True)


def one_draw(result: HoldOutResult) -> str:
    """Table II of one draw, for reading."""
    return (
        f"{result.train.recall:.3f} {result.train.precision:.3f} | "
        f"{result.test.recall:.3f} {result.test.precision:.3f} | {result.filtered.accuracy:.3f} "
        f"({len(result.test.ids)} submaps, {result.test.scans} scans)"
    )


def mean_of(results: Sequence[HoldOutResult]) -> str:
    """The mean of several draws, and the standard deviation of one of them."""
    rows = [
        (
            *(r.train.recall, r.train.precision, r.test.recall, r.test.precision),
            r.filtered.accuracy,
        )
        for r in results
    ]
    mean, off = np.mean(rows, axis=0), np.std(rows, axis=0, ddof=1)
    told = [f"{value:.3f}" for value in mean]
    tested = [f"{told[k]} (one draw +- {off[k]:.3f})" for k in (2, 3, 4)]
    return f"{told[0]} {told[1]} | {tested[0]} {tested[1]} | {tested[2]}"
