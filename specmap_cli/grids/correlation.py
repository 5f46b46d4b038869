"""Correlation of pictures by Fourier transform: every shift at once, and the best of them.

A target, one or more layers of cells, is compared with a picture of points at every shift in whole
cells. The result is periodic; the padding given to `Target.of` keeps opposite ends apart.

Typical use::

    target = Target.of(layers, padding)
    correlation = target.correlate(cell_counts(points, cell_m, target.shape)[None])
    for peak in peaks(correlation, target.size, cell_m, count=5):
        ...
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Target:
    """Layers of one size, transformed: what pictures of points are correlated with.

    `spectrum` (K, shape[0], shape[1] // 2 + 1) of the padded layers; `size` (H, W) without padding.
    """

    spectrum: NDArray[Any]
    shape: tuple[int, int]
    size: tuple[int, int]

    @classmethod
    def of(cls, layers: NDArray[Any], padding: tuple[int, int]) -> Target:
        """The target of `layers` (K, H, W); `padding` rows and columns, or more, are added.

        Points that reach r cells to every side need 2 r of them.
        """
        _, height, width = layers.shape
        shape = _fast(height + padding[0]), _fast(width + padding[1])
        return cls(np.fft.rfft2(layers, shape), shape, (height, width))

    def correlate(self, pictures: NDArray[Any]) -> NDArray[Any]:
        """(shape) sum over the layers of the product with `pictures` (K, *shape), at every shift.

        Row and column of the result are the shift in cells, modulo `shape`.
        """
        product = self.spectrum * np.conj(np.fft.rfft2(pictures))
        sums = np.fft.irfft2(product.sum(axis=0), self.shape, norm="forward")
        return np.asarray(sums * (1.0 / (self.shape[0] * self.shape[1])))


def _fast(length: int) -> int:
    """The next length that is a product of 2, 3 and 5: of these a transform is quick."""
    while 30**32 % length:  # no picture is so long that it had more than 32 of one of them
        length += 1
    return length


@dataclass(frozen=True, slots=True)
class Peak:
    """A good shift: `value` of the correlation; `x` and `y` metres from the target's corner.

    They say where the origin of the points comes to lie, at the centre of a cell.
    """

    value: float
    x: float
    y: float


def cell_counts(points: NDArray[Any], cell_m: float, shape: tuple[int, int]) -> NDArray[np.intp]:
    """(shape) how many points (N, 2) lie in each cell of a periodic picture.

    Cell [0, 0] is centred on the origin; what lies below or left of it comes in at the far ends.
    """
    columns, rows = np.floor(points / cell_m + 0.5).astype(np.intp).T
    cells = (rows % shape[0]) * shape[1] + columns % shape[1]
    return np.bincount(cells, minlength=shape[0] * shape[1]).reshape(shape)


def local_maxima(correlation: NDArray[Any]) -> NDArray[Any]:
    """The correlation (H, W) where no neighbour is higher in single precision, -inf elsewhere."""
    picture = correlation.astype(np.float32)
    highest = cv2.dilate(picture, np.ones((3, 3), dtype=np.uint8))
    return np.where(picture >= highest, correlation, -np.inf)


def peaks(
    correlation: NDArray[Any],
    size: tuple[int, int],
    cell_m: float,
    count: int,
    apart: int = 0,
) -> list[Peak]:
    """At most `count` of the highest cells of a correlation (H, W), highest first.

    Within `apart` rows and columns of one there is no other; cells of -inf are none. `size` is that
    of the target: shifts past it are negative ones. Ties go to the first row, then column.
    """
    left = correlation.copy()
    height, width = left.shape
    found: list[Peak] = []
    while len(found) < count:
        row, column = divmod(int(left.argmax()), width)
        value = float(left[row, column])
        if value == -np.inf:
            break
        near_rows = np.arange(row - apart, row + apart + 1) % height
        near_columns = np.arange(column - apart, column + apart + 1) % width
        left[np.ix_(near_rows, near_columns)] = -np.inf
        row -= height if row > (height + size[0]) // 2 else 0
        column -= width if column > (width + size[1]) // 2 else 0
        found.append(Peak(value, (column + 0.5) * cell_m, (row + 0.5) * cell_m))
    return found
