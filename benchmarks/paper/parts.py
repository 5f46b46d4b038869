"""The parts of the page in the paper's order: what the paper shows, and what makes ours."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from benchmarks.paper import (
    cost,
    figure1,
    figure2,
    figure3,
    figure6,
    room_hallway,
    table1,
    table2,
    topology,
)
from benchmarks.paper.blocks import Block
from benchmarks.paper.cases import FREIBURG, STATA
from benchmarks.paper.workshop import Workshop


@dataclass(frozen=True, slots=True, kw_only=True)
class Part:
    """A figure or a table: `said` is what the paper shows, `commands` are specmap's own for it.

    `data` names what of cases.LACKING it would show.
    """

    name: str
    title: str
    said: str
    make: Callable[[Workshop], list[Block]]
    commands: tuple[str, ...] = ()
    data: tuple[str, ...] = ()


PARTS = (
    Part(
        name="figure1",
        title="Figure 1: the steps of spectral clustering",
        said=(
            "On a map of a few rooms: nodes sampled in the free space, the graph of those that "
            "see each other, and every cell with the label of its nearest node."
        ),
        make=figure1.make,
        commands=("specmap segment MAP.yaml -o DIR --explain PICTURE.png",),
    ),
    Part(
        name="figure2",
        data=("mit_csail", "plans"),
        title="Figure 2: a finished map, segmented",
        said=(
            "The Stata Center, segmented into submaps by spectral clustering. The paper gives no "
            "figures for it."
        ),
        make=figure2.make,
        commands=(
            "specmap segment MAP.yaml -o DIR",
            "python -m benchmarks.scoreboard --only plans",
        ),
    ),
    Part(
        name="figure3",
        data=("plans",),
        title="Figure 3: segmentation while the robot moves",
        said=(
            "A sequence of maps of a robot that goes into a second room, the second eigenvalue "
            "of each: it steps up in the second map and in the fifth. The threshold is 0.8."
        ),
        make=figure3.make,
        commands=(
            "specmap build LOG -o DIR --explain PICTURES",
            "python -m benchmarks.scoreboard --only online",
        ),
    ),
    Part(
        name="figure4",
        data=("fr079", "plans"),
        title="Figure 4: closing loops, Freiburg",
        said=(
            "The way (a), the first three submaps (b), two of them once the return to the corridor "
            "is recognised (c), and the final topology (d): all three returns are closed."
        ),
        make=partial(topology.make, manner=FREIBURG),
        commands=(
            "specmap build LOG -o DIR",
            "python -m benchmarks.scoreboard --only recognition",
        ),
    ),
    Part(
        name="figure5",
        data=("mit_csail",),
        title="Figure 5a, b: closing loops, Stata",
        said=(
            "The tour of the Stata Center's third floor and its topology: the loop is closed; on a "
            "second lap new submaps are merged with old ones, and a few overlapping ones stay."
        ),
        make=partial(topology.make, manner=STATA),
        commands=(
            "specmap build LOG -o DIR",
            "python -m benchmarks.scoreboard --only recognition",
        ),
    ),
    Part(
        name="figure5c",
        data=("mit_csail", "plans"),
        title="Figure 5c: rooms and hallways do not divide a map",
        said=(
            "A classifier of rooms and hallways, learned in Freiburg and asked in Stata, “does not "
            "generalize well”. The paper gives no figures, and says that the classifier was not "
            "optimised."
        ),
        make=room_hallway.make,
        commands=("specmap evaluate LOG LOG2 --baseline room-hallway",),
    ),
    Part(
        name="table1",
        data=("fr079", "mit_csail"),
        title="Table I: what the features are worth",
        said="The twelve groups of features; the paper does not say what each is worth.",
        make=table1.make,
    ),
    Part(
        name="table2",
        data=("fr079", "mit_csail", "plans"),
        title="Table II: localisation by a single scan",
        said=(
            "Freiburg: training recall 0.9728, precision 0.9818; test 0.9089, 0.9212. Stata: "
            "training 0.9689, 0.9739; test 0.8300, 0.8458. Both by simulated scans."
        ),
        make=table2.make,
        commands=(
            "specmap evaluate LOG --protocol holdout",
            "python -m benchmarks.scoreboard --only recognition",
        ),
    ),
    Part(
        name="figure6",
        data=("plans",),
        title="Figure 6: another way through the building",
        said="The labels of single scans on a new trajectory in Freiburg, as a picture.",
        make=figure6.make,
        commands=("specmap evaluate MAP LOG2 --protocol revisit",),
    ),
    Part(
        name="cost",
        title="What training costs",
        said=(
            "A classifier is trained for each new submap against each existing one; the paper "
            "gives no times."
        ),
        make=cost.make,
        commands=("python -m benchmarks.paper --only cost",),
    ),
)
