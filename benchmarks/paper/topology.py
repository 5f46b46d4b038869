"""Figures 4, 5a and 5b: the topology before and after closing loops."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from benchmarks.paper import pictures
from benchmarks.paper.blocks import Block, Found, Picture, Row, Table, gallery
from benchmarks.paper.cases import Case
from benchmarks.paper.first_return import first_return
from benchmarks.paper.workshop import OURS, PRESETS, WORDS, Built, Workshop, beside
from benchmarks.real.closure_truth import STEADY, Judged, judged, true_poses
from specmap_cli.core.records import Labels
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


_CAPTION = (
    "A merge is right when the two regions share ground; a revisit is found when a region is "
    "merged with an earlier one of the same place, as it is where everything is merged. A "
    "constraint is wrong when its transform is off by more than 0.6 m or 7 degrees. Truth: full "
    "SLAM by others, or the simulation. In the pictures the way begins at the square and ends at "
    "the dot; blue lines join submaps between which the robot drove."
)


def make(workshop: Workshop, manner: str) -> list[Block]:
    """Every building of one manner, with both presets: pictures before and after, and figures."""
    cases = workshop.of_manner(manner)
    returns = [first_return(cases[0], preset, workshop) for preset in PRESETS]
    galleries = [found for found in returns if found is not None]
    rows = []
    closed: dict[str, list[Judged]] = {preset: [] for preset in PRESETS}
    for case in cases:
        for preset in PRESETS:
            built = workshop.built(case, preset)
            found = _judged(case, built)
            closed[preset].append(found)
            rows.append(_row(case, preset, built, found))
            galleries.append(gallery(_pictures(case, preset, workshop)))
    return [_found(closed), *galleries, Table(_HEAD, rows, _CAPTION)]


def _found(closed: Mapping[str, Sequence[Judged]]) -> Found:
    told = {
        preset: f"{sum(one.right for one in all_)} of {sum(one.merges for one in all_)} merges "
        f"are right, {sum(one.found for one in all_)} of {sum(one.revisits for one in all_)} "
        "revisits are found"
        for preset, all_ in closed.items()
    }
    return Found(
        beside(told),
        "The paper merges by xi alone. The classifiers of two submaps share out all scans between "
        "them, so one of them claims whatever comes third, and after the merge there are two "
        "again; where there are many submaps, xi drops and returns are missed. In specmap the "
        "claims only rank the old submaps, and a merge needs grids that match and tracks that "
        "overlap.",
    )


def _pictures(case: Case, preset: str, workshop: Workshop) -> list[Picture]:
    """Before and after, on the layout of our own map: the paper lays nothing out."""
    built, ours = workshop.built(case, preset), workshop.built(case, OURS).finished.laid
    explored, count = built.explored, len(built.store)
    before = online_labels(explored.regions, (), count)
    after = built.finished.laid.labels.submaps
    return [
        Picture(
            pictures.topology(
                ours.regions.grid, replace(ours.labels, submaps=labels), pictures.links(labels)
            ),
            f"{case.name}, {WORDS[preset]}: {words}",
        )
        for labels, words in (
            (before, "regions as they were left on the way, before loops are closed"),
            (after, "the final topology"),
        )
    ]


def _judged(case: Case, built: Built) -> Judged:
    poses = true_poses(case.truth, built.store, of_laser=case.drawing is None)
    return judged(built.explored, built.store, poses, STEADY if case.drawing is None else 0)


def _row(case: Case, preset: str, built: Built, found: Judged) -> Row:
    labels: Labels = built.finished.laid.labels
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
            str(len(pictures.links(labels.submaps))),
        )
    )
