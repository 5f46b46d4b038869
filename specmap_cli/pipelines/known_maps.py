"""Map directories as what the alignment of two maps needs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from specmap_cli.core.process import one_blas_thread
from specmap_cli.core.settings import Config
from specmap_cli.maps.filenames import CLASSIFIERS
from specmap_cli.maps.store import StoredMap, read_map
from specmap_cli.pipelines.localize import classifiers_of
from specmap_cli.recognition.closure.alignment import Alignment, align
from specmap_cli.recognition.closure.known_map import KnownMap


def align_maps(old: StoredMap, new: StoredMap, config: Config) -> Alignment:
    """Where a stored map lies in another one. Raises MapError for a damaged map."""
    return align(known_map(old), known_map(new), config)


@dataclass(frozen=True, slots=True)
class PairOfMaps:
    """Two map directories, and the settings to align them with; it can be handed to a worker."""

    old: Path
    new: Path
    config: Config


@one_blas_thread()
def align_pair(pair: PairOfMaps) -> Alignment:
    """The same of two directories. Raises MapError for a damaged map."""
    old, new = (read_map(path, pair.config.limits) for path in (pair.old, pair.new))
    return align_maps(old, new, pair.config)


def known_map(stored: StoredMap) -> KnownMap:
    """A stored map as the alignment needs it. Raises MapError for a damaged one."""
    submaps, labels = stored.topology.submaps, stored.labels
    learned = (stored.path / CLASSIFIERS).exists()
    return KnownMap(
        whole=stored.map_grid,
        grids=stored.grids,
        frames={i: submap.map_from_submap for i, submap in submaps.items()},
        tracks={i: labels.poses[labels.submaps == i] for i in submaps},
        classifiers=classifiers_of(stored) if learned else None,
    )
