"""Figures 4, 5a and 5b: the topology before and after closing loops."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

from benchmarks.closure_truth import STEADY, judged, true_poses
from benchmarks.paper import pictures
from benchmarks.paper.blocks import Block, Gallery, Picture, Row, Table
from benchmarks.paper.cases import Case
from benchmarks.paper.workshop import OURS, PRESETS, WORDS, Built, Workshop
from specmap_cli.core.records import IntArray, Labels
from specmap_cli.pipelines.exploration import online_labels

_HEAD = (
    "recording",
    "choices",
    "submaps before",
    "merges, right",
    "revisits found",
    "constraints, wrong",
    "median error",
    "submaps after",
    "links",
)


def make(workshop: Workshop, manner: str) -> list[Block]:
    """Every building of one manner, with both presets: pictures before and after, and figures."""
    galleries, rows = [], []
    for case in workshop.of_manner(manner):
        for preset in PRESETS:
            galleries.append(Gallery(_pictures(case, preset, workshop)))
            rows.append(_row(case, preset, workshop.built(case, preset)))
    caption = (
        "A merge is right when the two regions share ground; a revisit is found when a region is "
        "merged with an earlier one of the same place. A constraint is wrong when its transform "
        "is off by more than 0.6 m or 7 degrees. Truth: full SLAM by others, or the simulation."
    )
    return [*galleries, Table(_HEAD, rows, caption)]


def _pictures(case: Case, preset: str, workshop: Workshop) -> list[Picture]:
    """Before and after, on the layout of our own map: the paper lays nothing out."""
    built, ours = workshop.built(case, preset), workshop.built(case, OURS).finished
    explored, count = built.explored, len(built.store)
    before = online_labels(explored.regions, (), count)
    after = built.finished.labels.submaps
    return [
        Picture(
            pictures.topology(
                ours.regions.grid, replace(ours.labels, submaps=labels), sorted(_links(labels))
            ),
            f"{case.name}, {WORDS[preset]}: {words}",
        )
        for labels, words in (
            (before, "regions as they were left on the way, before loops are closed"),
            (after, "the final topology"),
        )
    ]


def _links(labels: IntArray) -> set[tuple[int, int]]:
    """Which submaps the robot drove between."""
    driven = pairwise(labels[labels >= 0].tolist())
    return {(min(pair), max(pair)) for pair in driven if pair[0] != pair[1]}


def _row(case: Case, preset: str, built: Built) -> Row:
    poses = true_poses(case.truth, built.store, of_laser=case.drawing is None)
    found = judged(built.explored, built.store, poses, STEADY if case.drawing is None else 0)
    labels: Labels = built.finished.labels
    metres, degrees = found.median
    error = "–" if not len(found.errors) else f"{100.0 * metres:.1f} cm, {degrees:.2f}°"
    return Row(
        (
            case.name,
            WORDS[preset],
            str(found.regions),
            f"{found.merges}, {found.right}",
            f"{found.found} of {found.revisits}",
            f"{len(found.errors)}, {found.wrong}",
            error,
            str(len(built.finished.topology.submaps)),
            str(len(_links(labels.submaps))),
        )
    )
