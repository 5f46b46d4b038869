"""How far to trust what was learned: votes, walls, and whether a place is known at all.

A margin counts as far as the classifier claims the scan: a submap's likelihood is a constant and an
exponential of its margin. So it does not matter how far below zero a margin is: by how much a scan
is refused tells only how unlike it is to what was learned. Margins of one-against-all classifiers
are half log odds of the training scans, which a new scan is less sure of. How much less differs
from map to map, as it hangs on how alike the rooms are, and on settings of the classifiers. It is
learned from scans of pieces of the way that were held out (`recognition.learning.training`).

The misfit of a scan is the share of its returns, more or less, that lie off the walls: what is
usual is learned from keyframes that are matched with the rest of their submap. Margins say which
submap fits best, not whether any does; the distance of histograms to the nearest exemplar does.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from specmap_cli.core.arrays import evenly
from specmap_cli.core.geometry import FloatArray, Pose2, travelled
from specmap_cli.core.records import PlanarScan
from specmap_cli.core.settings import LocalizationConfig
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.grids.matching import REFINE_SHIFT_M, refine
from specmap_cli.grids.score_field import ScoreField
from specmap_cli.recognition.features.sets import histogram_columns
from specmap_cli.recognition.learning.boosting import WrongPartError, as_part

_BLUNDERS = 0.01  # share of scans that say nothing: people all around, a door shut before the laser
MOST_VIEWS = 400  # held out, of either kind
_LEAST_RATIO, _MOST_RATIO = 1.0 / 32.0, 32.0  # of a fit
_Ratio = Annotated[float, Field(ge=_LEAST_RATIO, le=_MOST_RATIO)]
_STEPS_AN_OCTAVE = 16  # of the search, which is over a grid: the same on every processor
_DECIMALS = 6  # of what is compared there
# A fit is drawn to what is usual: by this standard deviation, in natural logarithms, and as if one
# of so many views were independent. Neighbouring views err together.
_USUAL_SPREAD, _VIEWS_ALIKE = 0.35, 10.0
# A view that leaves N submaps open goes on to say the same for N times this motion: in places of
# which little is known, scan after scan errs the same way.
_STEADY = 0.3
# Scans that are held out of a map together with the pieces of the way around them are surer by
# these factors than those of another log: so much more do they lack.
_HELD_OUT, _ANOTHER_LOG = (0.48, 0.59), (1.0, 1.0)


@dataclass(frozen=True, slots=True)
class Claim:
    """A submap's likelihood by one kind of scans: exp(-floor) + exp(gain * margin)."""

    gain: float
    floor: float

    def log(self, margins: NDArray[Any], ratio: float = 1.0) -> FloatArray:
        """The logarithm for margins (..., m), with the gain times `ratio`."""
        return np.asarray(np.logaddexp(self.gain * ratio * margins, -self.floor))


# Usual values, fitted by the likelihood of the truth on simulated tours of other ways through
# furnished plans, on single scans and blocks of scans held out of real logs: see `benchmarks/real/
# reliability.py`. Alone a scan says more than beside the virtual scan that it is part of.
RAW_ALONE, VIRTUAL_ALONE = Claim(0.284, 3.49), Claim(0.217, 4.71)
RAW, VIRTUAL = Claim(0.247, 0.41), Claim(0.202, 3.0)


@dataclass(frozen=True, slots=True)
class HeldOutMargins:
    """Margins (n, m) of scans that were held out, and the column (n,) of the true submap."""

    margins: FloatArray
    column: NDArray[np.intp]


@as_part
@dataclass(frozen=True, slots=True)
class Calibration:
    """How sure a map's classifiers of raw and of virtual scans are, over what is usual.

    `views` scans that were held out say so; without any it is as usual.
    """

    raw: _Ratio = 1.0
    virtual: _Ratio = 1.0
    views: Annotated[int, Field(ge=0, le=2 * MOST_VIEWS)] = 0

    def alone(self, raw: NDArray[Any]) -> FloatArray:
        """(n, m) log probabilities of the submaps by single scans of margins `raw` (n, m)."""
        return _probabilities(RAW_ALONE.log(raw, self.raw))

    def together(self, raw: NDArray[Any], virtual: NDArray[Any] | None) -> FloatArray:
        """(n, m) the same by scans and the virtual scans they are part of, where these are."""
        if virtual is None:
            return self.alone(raw)
        claims = RAW.log(raw, self.raw) + VIRTUAL.log(virtual, self.virtual)
        return _probabilities(claims)


def calibrated(
    raw: HeldOutMargins, virtual: HeldOutMargins | None, *, another_log: bool = False
) -> Calibration:
    """What margins of held-out scans say of a map's classifiers; as usual where there are none.

    With `another_log` they are not of pieces that were held out, but of another recording.
    """
    views = min(len(raw.column), MOST_VIEWS)
    held_out_raw, held_out_virtual = _ANOTHER_LOG if another_log else _HELD_OUT
    of_raw = _ratio(raw, RAW_ALONE, held_out_raw)
    if virtual is None:
        return Calibration(raw=of_raw, views=views)
    return Calibration(
        raw=of_raw,
        virtual=_ratio(virtual, VIRTUAL_ALONE, held_out_virtual),
        views=views + min(len(virtual.column), MOST_VIEWS),
    )


def steadiness(log_probabilities: NDArray[Any]) -> float:
    """How far a view of log probabilities (m,) goes on to say the same: in independent motions.

    The submaps that it leaves open are counted by its entropy.
    """
    entropy = -float(np.sum(np.exp(log_probabilities) * log_probabilities))
    return _STEADY * math.exp(entropy)


def _ratio(held_out: HeldOutMargins, claim: Claim, usual: float) -> float:
    """The gain that makes the truth likeliest, over the `usual` one of held-out scans."""
    rows = evenly(np.arange(len(held_out.column)), MOST_VIEWS)
    margins, column = held_out.margins[rows], held_out.column[rows]
    octaves = math.log2(_MOST_RATIO)
    tried = 2.0 ** np.linspace(-octaves, octaves, 2 * round(octaves) * _STEPS_AN_OCTAVE + 1)
    told = [_probabilities(claim.log(margins, usual * ratio)) for ratio in tried.tolist()]
    likelihoods = [float(one[np.arange(len(column)), column].sum()) for one in told]
    worth = np.array(likelihoods) / _VIEWS_ALIKE - 0.5 * (np.log(tried) / _USUAL_SPREAD) ** 2
    return round(float(tried[int(np.argmax(np.round(worth, _DECIMALS)))]), _DECIMALS)


def _probabilities(claims: FloatArray) -> FloatArray:
    """(..., m) log probabilities that are as the claims, but for blunders; all are finite."""
    raised = np.exp(claims - claims.max(axis=-1, keepdims=True))
    shares = raised / raised.sum(axis=-1, keepdims=True)
    return np.asarray(np.log((1.0 - _BLUNDERS) * shares + _BLUNDERS / claims.shape[-1]))


FIT_RANGE_M = 8.0  # returns matched with walls: farther ones are seen through doors
_HELD_OUT_M = 1.0  # path before and after a view that is held out with it
HELD_OUT_REACH_M = 1.5  # the rest of the map comes so near to a view held out, or it is a new place
_USUAL_MISFIT = 0.1  # mean share of returns off the walls, for a map that has none
_USUAL_MISFIT_VIEWS = 5  # weight of that mean, in views that the map held out
_MOST_MATCHED = 60  # held out: enough for a median, and quick
_MOST_OTHERS = 40  # keyframes that make the walls of a submap: half a metre apart in 20 m
_MOST_POINTS = 180  # of a scan, one every other degree: what a match costs grows with them
_MATCH_DECIMALS = 4  # the last digits of a match differ from processor to processor


@as_part
@dataclass(frozen=True, slots=True)
class HeldOutMisfit:
    """The median misfit in [0, 1] of `views` scans that were held out of the walls they fit."""

    typical: Annotated[float, Field(ge=0.0, le=1.0)]
    views: Annotated[int, Field(ge=0, le=_MOST_MATCHED)]


def held_out_misfit(
    store: KeyframeStore, submaps: Mapping[int, Sequence[int]], poses: NDArray[Any]
) -> HeldOutMisfit:
    """The misfit of keyframes with the rest of their submaps; of no view where there is no rest.

    `submaps` lists the keyframes of each submap, ascending; `poses` (n, 3) are those of all.
    """
    way = travelled(poses)
    owner = {k: i for i, numbers in submaps.items() for k in numbers}
    found = []
    for k in evenly(np.array(sorted(owner), dtype=np.intp), _MOST_MATCHED).tolist():
        numbers = np.asarray(submaps[owner[k]], dtype=np.intp)
        others = numbers[np.abs(way[numbers] - way[k]) > _HELD_OUT_M]
        away = np.hypot(*(poses[others] - poses[k])[:, :2].T)
        if float(away.min(initial=math.inf)) >= HELD_OUT_REACH_M:  # it is no place of the map
            continue
        points = near_returns(store.scan(k), FIT_RANGE_M)
        if not len(points):
            found.append(1.0)
            continue
        map_from_laser = Pose2(*poses[k].tolist()) @ store.base_from_laser(k)
        reach = float(np.hypot(points[:, 0], points[:, 1]).max()) + REFINE_SHIFT_M
        walls = []  # that others saw, as far as the returns could meet them
        for other in evenly(others, _MOST_OTHERS).tolist():
            placed = Pose2(*poses[other].tolist()) @ store.base_from_laser(other)
            seen = placed.apply(store.scan(other).hits())
            away = seen - np.array([map_from_laser.x, map_from_laser.y])
            walls.append(seen[np.hypot(away[:, 0], away[:, 1]) <= reach])
        field = ScoreField.from_points(np.vstack(walls))
        found.append(1.0 - refine(field, points, map_from_laser).score)
    if not found:
        return HeldOutMisfit(0.0, 0)
    return HeldOutMisfit(round(float(np.median(found)), _MATCH_DECIMALS), len(found))


def near_returns(scan: PlanarScan, near_m: float) -> FloatArray:
    """(N, 2) a choice of the scan's returns within `near_m`, or of the nearer half if that is more.

    Far ones are seen through doors, from where they hardly show again.
    """
    hits = scan.hits()
    ranges = np.hypot(hits[:, 0], hits[:, 1])
    reach = max(near_m, float(np.median(ranges))) if len(ranges) else near_m
    return np.asarray(evenly(hits[ranges <= reach], _MOST_POINTS))


def pooled(held_out: HeldOutMisfit | None, config: LocalizationConfig) -> float:
    """Mean misfit of known places: that of the map's own views, drawn to what is usual anywhere.

    The fewer views were held out, the nearer it is to `_USUAL_MISFIT`, which is wide. The mean is
    that of an exponential distribution with the median found.
    """
    views, typical = (held_out.views, held_out.typical) if held_out is not None else (0, 0.0)
    pseudo = _USUAL_MISFIT_VIEWS
    mean = (views * typical / math.log(2.0) + pseudo * _USUAL_MISFIT) / (views + pseudo)
    return max(config.least_misfit, mean)


_STEPS = 255  # square roots of shares are stored as whole numbers of 1 / 255
_MOST_LEFT = 600  # samples that the limit is taken from: enough for a quantile, and quick
_LEAST_LEFT = 20  # fewer of them say nothing about a quantile
_STRETCH_SHARE = 0.1  # of a submap's samples, before and after one that is held out
_TINY = 1e-9  # keeps a limit of nought, when all samples are alike, from dividing


class Familiarity:
    """Exemplars of a map's places; distance is the L1 distance of the square roots of histograms.

    `fit` keeps at most `per_submap` samples of a submap as exemplars. It learns `exemplars_`
    (k, D), whole numbers from 0 to 255, and `limit_`, the distance past which a scan looks like no
    place of the map: all but a share of `false_unknown` of the other samples lie within it. These
    are held out by stretches: exemplars taken just before or after one do not count for it. The
    fewer they are, the wider is the limit: by a standard error of the share.
    """

    def __init__(self, feature_set: str, false_unknown: float = 0.05, per_submap: int = 80) -> None:
        self.feature_set = feature_set
        self.false_unknown = false_unknown
        self.per_submap = per_submap
        self.exemplars_: NDArray[np.uint8] = np.zeros((0, 0), dtype=np.uint8)
        self.limit_ = math.nan
        self._columns = histogram_columns(feature_set)
        self._places: NDArray[np.float32] = np.zeros((0, 0), dtype=np.float32)

    def can_fit(self, samples: Mapping[int, NDArray[Any]]) -> bool:
        """Whether the feature set holds histograms, and enough samples are left for a limit."""
        left = sum(len(X) - len(self._chosen(len(X))) for X in samples.values())
        return bool(self._columns) and left >= _LEAST_LEFT

    def fit(self, samples: Mapping[int, NDArray[Any]]) -> Familiarity:
        """Learn from the features (n, F) of every submap's samples in turn; returns self."""
        chosen = {i: self._chosen(len(X)) for i, X in sorted(samples.items())}
        kept = np.vstack([samples[i][rows] for i, rows in chosen.items()]).astype(np.float64)
        self._keep(np.round(self._roots(kept) * _STEPS).astype(np.uint8))
        # of samples that are no exemplars: how far the nearest one of another stretch is
        owners = np.concatenate([np.full(len(rows), i) for i, rows in chosen.items()])
        numbers = np.concatenate(list(chosen.values()))
        left = [
            (i, k)
            for i, X in sorted(samples.items())
            for k in np.setdiff1d(np.arange(len(X)), chosen[i])
        ]
        found = []
        for i, k in evenly(np.array(left), _MOST_LEFT).tolist():
            stretch = _STRETCH_SHARE * len(samples[i])
            other = (owners != i) | (np.abs(numbers - k) > stretch)
            if other.any():
                row = self._roots(np.asarray(samples[i][k : k + 1], dtype=np.float32))
                found.append(np.abs(self._places[other] - row).sum(axis=1).min())
        share = self.false_unknown
        error = math.sqrt(share * (1.0 - share) / len(found))  # of a share that n samples show
        within = np.quantile(np.array(found, dtype=np.float64), min(1.0, 1.0 - share + error))
        self.limit_ = round(float(within), 6)
        return self

    def strangeness(self, X: NDArray[Any]) -> FloatArray:
        """(n,) distance of features X (n, F) over the limit: above one where nothing fits."""
        roots = self._roots(np.asarray(X, dtype=np.float32))
        nearest = [np.abs(self._places - row).sum(axis=1).min() for row in roots]
        return np.array(nearest, dtype=np.float64) / max(self.limit_, _TINY)

    def to_dict(self) -> dict[str, Any]:
        """Limit and exemplars, ready for JSON."""
        return {"limit": self.limit_, "rows": [row.tobytes().hex() for row in self.exemplars_]}

    @classmethod
    def of(cls, feature_set: str, limit: float, rows: Sequence[str], where: str) -> Familiarity:
        """What `to_dict` described. Raises WrongPartError for rows that are not of the set."""
        known = cls(feature_set)
        width = len(known._columns)
        if not width or any(len(row) != 2 * width for row in rows):
            raise WrongPartError(f"{where}: rows are not of {width} values")
        coded = np.frombuffer(bytes.fromhex("".join(rows)), dtype=np.uint8)
        known._keep(coded.reshape(-1, width))
        known.limit_ = limit
        return known

    def _keep(self, exemplars: NDArray[np.uint8]) -> None:
        # column by column in memory, learned or from a file: sums are the same to the last bit
        self.exemplars_ = np.asfortranarray(exemplars)
        self._places = self.exemplars_.astype(np.float32) / np.float32(_STEPS)

    def _chosen(self, count: int) -> NDArray[np.intp]:
        """Which of `count` samples become exemplars: evenly spread, at most half of them."""
        return evenly(np.arange(count), min(self.per_submap, (count + 1) // 2))

    def _roots(self, X: NDArray[Any]) -> NDArray[Any]:
        """(n, D) square roots of the histograms of features X (n, F)."""
        return np.asarray(np.sqrt(np.clip(X[:, self._columns], 0.0, 1.0)))
