"""Figure 1: the steps of spectral clustering on a small map."""

from __future__ import annotations

from benchmarks.paper import pictures
from benchmarks.paper.blocks import Block, Found, Gallery, Picture
from benchmarks.paper.cases import FREIBURG
from benchmarks.paper.workshop import PRESETS, WORDS, Workshop
from specmap_cli.core.config import load_config
from specmap_cli.drawing.split_tests import draw_segmentation
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.segmentation.division import segment

_FOUND = Found(
    "The same steps on the plan of the sample office. Sight lines between two regions are red: "
    "the fewer there are, the better a border.",
    "The paper's choices put a node every half metre and take as many regions as there are "
    "eigenvalues above 0.9. specmap puts nodes where there is most room, so that they stand in the "
    "doors, lets sight lines keep off the walls, takes chairs and tables for free space, and "
    "looks at each region again.",
)


def make(workshop: Workshop) -> list[Block]:
    """Nodes and sight lines of a plan, and the labels of its cells, with both presets."""
    _, drawing = workshop.drawn(FREIBURG)[-1]  # the sample office: small, and always at hand
    return [_FOUND, *(Gallery(_steps(drawing.plan, preset)) for preset in PRESETS)]


def _steps(plan: GridMap, preset: str) -> list[Picture]:
    config = load_config(preset=preset).segmentation
    found = segment(plan, config)
    graph = draw_segmentation(plan, found, config.eigenvalue_min)
    return [
        Picture(graph, f"{WORDS[preset]}: nodes, sight lines between them, eigenvalues"),
        Picture(pictures.divided(plan, found.labels), f"{WORDS[preset]}: the label of every cell"),
    ]
