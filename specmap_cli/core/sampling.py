"""Thinning: fewer items, evenly spread, always the same ones."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def evenly(items: NDArray[Any], most: int) -> NDArray[Any]:
    """At most `most` of the items (n, ...), evenly spread, in their order."""
    if len(items) <= most:
        return items
    return items[np.linspace(0, len(items) - 1, most).astype(np.intp)]
