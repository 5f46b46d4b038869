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
OF_LABELS = "labels_sha256"  # in run.json: the digest of labels.csv, by which it knows its map
SUBMAPS = "submaps"  # the directory of the submaps' grids
# what no digest holds to the others: it tells the digests, or how long a run took, or may be edited
_BY_ITSELF = frozenset({TOPOLOGY, RUN, EDITS, OVERVIEW, SUBMAPS})
_GRIDS = (LABELS_IMAGE, f"{MAP_GRID}.png", f"{MAP_GRID}.yaml")
# all of them; whatever else lies in a map directory is a person's own
OF_A_MAP = _BY_ITSELF.union(
    _GRIDS, (CLASSIFIERS, FEATURES, LABELS, KEYFRAMES, TRAJECTORY, POSE_GRAPH)
)
_GRID_OF_A_SUBMAP = re.compile(re.escape(SUBMAPS) + r"/\d+\.(png|yaml)")


def is_of_a_map(path: str) -> bool:
    """Whether a path inside a map directory is one that specmap writes."""
    return path in OF_A_MAP or _GRID_OF_A_SUBMAP.fullmatch(path) is not None


def has_digest(path: str) -> bool:
    """Whether topology.json tells the digest of that file of a map."""
    return is_of_a_map(path) and path not in _BY_ITSELF
