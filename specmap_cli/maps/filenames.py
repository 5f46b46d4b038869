"""The files of a map directory, by name; docs/output_format.md says what is in each."""

from __future__ import annotations

import re

TOPOLOGY = "topology.json"
CLASSIFIERS = "classifiers.json"
FEATURES = "features.npz"
RUN = "run.json"
LABELS = "labels.csv"
KEYFRAMES = "keyframes.mcap"
TRAJECTORY = "trajectory.tum"
POSE_GRAPH = "trajectory.g2o"
EDITS = "edits.toml"
OVERVIEW = "overview.png"
LABELS_IMAGE = "labels.png"
MAP_GRID = "map"  # with the suffixes .png and .yaml: the grid of the whole map
SUBMAPS = "submaps"  # the directory of the submaps' grids
# all of them; whatever else lies in a map directory is a person's own
OF_A_MAP = frozenset(
    {
        TOPOLOGY,
        CLASSIFIERS,
        FEATURES,
        RUN,
        LABELS,
        KEYFRAMES,
        TRAJECTORY,
        POSE_GRAPH,
        OVERVIEW,
        EDITS,
        LABELS_IMAGE,
        f"{MAP_GRID}.png",
        f"{MAP_GRID}.yaml",
        SUBMAPS,
    }
)
_GRID_OF_A_SUBMAP = re.compile(re.escape(SUBMAPS) + r"/\d+\.(png|yaml)")


def is_of_a_map(path: str) -> bool:
    """Whether a path inside a map directory is one that specmap writes."""
    return path in OF_A_MAP or _GRID_OF_A_SUBMAP.fullmatch(path) is not None
