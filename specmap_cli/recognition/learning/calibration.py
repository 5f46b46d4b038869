"""From margins to probabilities: what the votes on a scan say of each submap.

A margin counts as far as the classifier claims the scan: a submap's likelihood is a constant and an
exponential of its margin. So it does not matter how far below zero a margin is: by how much a scan
is refused tells only how unlike it is to what was learned. Margins of one-against-all classifiers
are half log odds of the training scans, which a new scan is less sure of. How much less differs
from map to map, as it hangs on how alike the rooms are, and on settings of the classifiers. It is
learned from scans of pieces of the way that were held out (`recognition.learning.holding_out`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from specmap_cli.core.arrays import evenly
from specmap_cli.core.geometry import FloatArray
from specmap_cli.recognition.learning.boosting import as_part

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
