"""Runs, windows and neighbours of labels, even and gridded samples, arrays in less memory."""

from __future__ import annotations

import math
import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray

Neighbours = Mapping[int, frozenset[int]]
Window = tuple[slice, slice]  # rows and columns


def runs(labels: Sequence[Any] | NDArray[Any]) -> list[tuple[int, int]]:
    """Half-open ranges (start, end) of equal successive labels (n,), in order; [] of none."""
    values = np.asarray(labels)
    if not len(values):
        return []
    cuts = np.flatnonzero(values[1:] != values[:-1]) + 1
    return list(pairwise([0, *cuts.tolist(), len(values)]))


def carried_on(labels: NDArray[Any], stays: NDArray[np.bool_]) -> NDArray[Any]:
    """Labels (n,) of which each that does not stay is as the last one before it that does.

    Those before all that stay are as the first of these; one stays at the least.
    """
    source = np.where(stays, np.arange(len(labels)), int(np.argmax(stays)))
    return np.asarray(labels[np.maximum.accumulate(source)])


def windows_of(labels: NDArray[np.integer[Any]]) -> dict[int, Window]:
    """The rows and columns that hold each label of an image (H, W), by label; none for negatives.

    What `scipy.ndimage.find_objects` does, which takes a quarter of a second to load.
    """
    new = np.ones(labels.shape, dtype=bool)  # where a stretch of one label begins in its row
    np.not_equal(labels[:, 1:], labels[:, :-1], out=new[:, 1:])
    row, start = np.nonzero(new)
    owner = labels[row, start].astype(np.intp)
    end = np.append(start[1:], 0)[: len(start)]
    end[end == 0] = labels.shape[1]  # the next one begins the next row
    mine = owner >= 0
    owner, row, start, end = owner[mine], row[mine], start[mine], end[mine]
    count = int(owner.max(initial=-1)) + 1
    bounds = np.full((4, count), -1)
    bounds[:2] = max(labels.shape)
    for low, high, first, past in ((0, 2, row, row + 1), (1, 3, start, end)):
        np.minimum.at(bounds[low], owner, first)
        np.maximum.at(bounds[high], owner, past)
    return {
        label: (slice(top, bottom), slice(left, right))
        for label, (top, left, bottom, right) in enumerate(bounds.T.tolist())
        if bottom > 0
    }


def neighbours(ids: Iterable[int], pairs: Iterable[tuple[int, int]]) -> Neighbours:
    """The ids that share a pair with each id, which may be none; a pair of equals counts nothing.

    Raises KeyError for a pair with an end that is no id.
    """
    found: dict[int, set[int]] = {id_: set() for id_ in ids}
    for a, b in pairs:
        if a != b:
            found[a].add(b)
            found[b].add(a)
    return {id_: frozenset(near) for id_, near in found.items()}


def unchanging(*arrays: NDArray[Any]) -> None:
    """Let nobody write to these arrays any more."""
    for values in arrays:
        values.setflags(write=False)


@dataclass(frozen=True, slots=True)
class Packed:
    """An array that waits until it is asked for; labels of cells take a twentieth of the memory."""

    data: bytes
    shape: tuple[int, ...]
    dtype: np.dtype[Any]

    @classmethod
    def of(cls, values: NDArray[Any]) -> Packed:
        """Pack an array; `array` gives it back."""
        return cls(zlib.compress(values.tobytes(), level=1), values.shape, values.dtype)

    @property
    def array(self) -> NDArray[Any]:
        """The array that was packed, which nobody can write to."""
        return np.frombuffer(zlib.decompress(self.data), dtype=self.dtype).reshape(self.shape)


def evenly(items: NDArray[Any], most: int) -> NDArray[Any]:
    """At most `most` of the items (n, ...), evenly spread, in their order."""
    if len(items) <= most:
        return items
    return items[np.linspace(0, len(items) - 1, most).astype(np.intp)]


_EXACT_BITS = 53  # of whole numbers in float64
_SORTED_BITS = 63  # of whole numbers in int64


def first_in_cells(points: FloatArray, cell_m: float) -> NDArray[np.intp]:
    """Which of points (N, 2) or (N, 3) is the first in its cell of side `cell_m`, in order."""
    count = len(points)
    if count < 2:
        return np.arange(count)
    columns = [np.floor(points[:, axis] / cell_m) for axis in range(points.shape[1])]
    lowest = [float(column.min()) for column in columns]
    widths = [int(column.max() - low) + 1 for column, low in zip(columns, lowest, strict=True)]
    size, bits = math.prod(widths).bit_length(), count.bit_length()
    if size > _EXACT_BITS or size + bits > _SORTED_BITS:  # kilometres away, in tiny cells
        _, first = np.unique(np.column_stack(columns), axis=0, return_index=True)
        return np.sort(first)
    cells = np.zeros(count)
    for column, low, width in zip(columns, lowest, widths, strict=True):
        cells *= width
        cells += column - low
    # number of cell and of point in one: sorting them is much quicker than sorting an index
    both = (cells.astype(np.int64) << bits) | np.arange(count)
    both.sort()
    cell = both >> bits
    new = np.concatenate([[True], cell[1:] != cell[:-1]])
    return np.sort(both[new] & ((1 << bits) - 1))
