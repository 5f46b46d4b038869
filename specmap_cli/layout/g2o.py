"""The pose graph as text in the format of g2o (Kuemmerle et al., ICRA 2011): VERTEX_SE2, EDGE_SE2.

Read by g2o, Ceres' and GTSAM's examples and other solvers, so that a layout can be checked there.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from specmap_cli.core.errors import InputError
from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.layout.pose_graph import Link, LinkKind
from specmap_cli.layout.relaxation import Layout

_UPPER = np.triu_indices(3)


def write_g2o(layout: Layout) -> str:
    """The graph of a layout; vertices carry keyframe numbers, dropped edges are left out."""
    nodes = layout.nodes.tolist()
    poses = {number: layout.poses[number] for number in nodes}
    return graph_text(poses, [*layout.odometry, *layout.kept], nodes[:1])


def graph_text(poses: Mapping[int, FloatArray], links: Iterable[Link], fixed: Iterable[int]) -> str:
    """A graph of poses (3,) by vertex number; the `fixed` ones do not move.

    The fixed ones stand last. GTSAM reads two numbers behind every tag while it looks for edges,
    and stops where there is only one.
    """
    lines = [f"VERTEX_SE2 {number} {_numbers(pose)}" for number, pose in poses.items()]
    for link in links:
        measured, weights = np.array(link.source_from_target), link.information[_UPPER]
        numbers = _numbers(np.concatenate([measured, weights]))
        lines.append(f"EDGE_SE2 {link.source} {link.target} {numbers}")
    lines += [f"FIX {number}" for number in fixed]
    return "".join(line + "\n" for line in lines)


def read_g2o(text: str) -> tuple[dict[int, FloatArray], list[Link]]:
    """Poses (3,) by vertex number, and the edges, of a planar graph in g2o's format.

    Other tags than VERTEX_SE2 and EDGE_SE2 are passed over. Raises InputError for a line that
    cannot be read.
    """
    poses: dict[int, FloatArray] = {}
    links: list[Link] = []
    for number, line in enumerate(text.splitlines(), start=1):
        tag, *words = line.split() or [""]
        try:
            if tag == "VERTEX_SE2":
                poses[int(words[0])] = np.array(_floats(words[1:], 3))
            elif tag == "EDGE_SE2":
                links.append(_edge(words))
        except (ValueError, IndexError):
            raise InputError(
                f"g2o, line {number}: {line!r} is no {tag};", "mend the line"
            ) from None
    return poses, links


def _edge(words: Sequence[str]) -> Link:
    x, y, theta, *upper = _floats(words[2:], 9)
    information = np.zeros((3, 3))
    information[_UPPER] = upper
    information += np.triu(information, 1).T
    source, target = int(words[0]), int(words[1])
    kind: LinkKind = "odometry" if target == source + 1 else "closure"
    return Link(
        source=source,
        target=target,
        source_from_target=Pose2(x, y, theta),
        information=information,
        kind=kind,
    )


def _floats(words: Sequence[str], count: int) -> list[float]:
    values = [float(word) for word in words]
    if len(values) != count or not all(math.isfinite(value) for value in values):
        raise ValueError(words)
    return values


def _numbers(values: FloatArray) -> str:
    return " ".join(f"{value:.9g}" for value in values)
