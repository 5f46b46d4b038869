"""Which submaps of two maps may be one place: how each map's classifiers claim the other's (xi).

A finished map keeps no scans. What its robot saw is cast anew in its grids, all round, from places
on its track; the classifiers of virtual scans are asked for these.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from specmap_cli.core.arrays import evenly
from specmap_cli.core.geometry import FloatArray
from specmap_cli.recognition.closure.known_map import KnownMap
from specmap_cli.recognition.features.sets import scans_features
from specmap_cli.recognition.features.virtual import VIRTUAL_BEAMS, VIRTUAL_RANGE_M, cast_circles
from specmap_cli.recognition.learning.classifiers import Recogniser

_PLACES = 16  # of a submap from which scans are cast: a mean of chances to a tenth
_DECIMALS = 6  # of a chance: the last digits of an exponential depend on the processor
_AREA_PRIOR = 0.5  # times the logarithm of a ratio of areas, where no classifier can be asked
_FAR_BEHIND = 0.1  # of the best rank: a tenth of the chance

Pair = tuple[int, int]


def likely_pairs(old: KnownMap, new: KnownMap, candidates: int) -> tuple[list[Pair], list[Pair]]:
    """Pairs (old submap, new submap) worth a match of their grids, the likeliest first.

    Of each submap the `candidates` best ranked ones of the other map. The second list is of those
    that another pair of the new submap is likelier than by far.
    """
    ranks = _ranks(old, new)
    best_new = np.argsort(-ranks, axis=1, kind="stable")[:, :candidates]
    best_old = np.argsort(-ranks, axis=0, kind="stable")[:candidates]
    chosen = {(i, j) for i, row in enumerate(best_new.tolist()) for j in row}
    chosen |= {(i, j) for row in best_old.tolist() for j, i in enumerate(row)}
    ordered = sorted(chosen, key=lambda pair: (-ranks[pair], pair))
    least = _FAR_BEHIND * ranks.max(axis=0, initial=0.0)
    first, later = list[Pair](), list[Pair]()
    for i, j in ordered:
        (first if ranks[i, j] >= least[j] else later).append((old.ids[i], new.ids[j]))
    return first, later


def _ranks(old: KnownMap, new: KnownMap) -> FloatArray:
    """(n_old, n_new) the product of the chances by which two submaps claim each other (eq. 5).

    Of a map that has no classifiers it is the chance by which the other one claims alone.
    """
    ranks = [_claimed(new, by=old), _claimed(old, by=new)]
    known = [ranks[0], None if ranks[1] is None else ranks[1].T]
    claims = [chances for chances in known if chances is not None]
    if not claims:
        return _by_area(old, new)
    return np.asarray(np.prod(claims, axis=0))


def _claimed(of: KnownMap, *, by: KnownMap) -> FloatArray | None:
    """(n_by, n_of) mean chances by which the submaps of one map claim scans of another's.

    None where the one cannot be asked, or nobody knows where the robot was in the other.
    """
    asked = None if by.classifiers is None else by.classifiers.virtual
    if asked is None or set(asked.ids) != set(by.ids):
        return None
    if not all(len(of.tracks.get(i, ())) for i in of.ids):
        return None
    return _chances(asked, by.ids, _cast(of, asked.feature_set)).T


def _cast(known: KnownMap, feature_set: str) -> list[FloatArray]:
    """Features (n, F) of virtual scans of every submap, by id."""
    features = []
    for i in known.ids:
        places = evenly(np.asarray(known.tracks[i])[:, :2], _PLACES)
        origins = known.frames[i].inverse().apply(places)
        scans = cast_circles(known.grids[i], origins, VIRTUAL_BEAMS, VIRTUAL_RANGE_M)
        features.append(np.asarray(scans_features(scans, feature_set), dtype=np.float64))
    return features


def _chances(asked: Recogniser, ids: Sequence[int], scans: Sequence[FloatArray]) -> FloatArray:
    """(len(scans), len(ids)) mean chances by which each submap claims each group of scans."""
    columns = [asked.ids.index(i) for i in ids]
    starts = np.cumsum([0, *(len(own) for own in scans)])[:-1]
    margins = asked.margins(np.concatenate(scans))[:, columns]
    counts = np.array([len(own) for own in scans], dtype=np.float64)[:, None]
    chances = np.add.reduceat(1.0 / (1.0 + np.exp(-margins)), starts) / counts
    return np.asarray(np.round(chances, _DECIMALS))


def _by_area(old: KnownMap, new: KnownMap) -> FloatArray:
    """(n_old, n_new) how alike the free areas of submaps are, in (0, 1]."""
    areas = [
        np.log([max(known.grids[i].free_area_m2, 1.0) for i in known.ids]) for known in (old, new)
    ]
    gaps = np.abs(areas[0][:, None] - areas[1][None, :])
    return np.asarray(np.round(np.exp(-_AREA_PRIOR * gaps), _DECIMALS))
