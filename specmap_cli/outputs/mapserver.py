"""Reading occupancy grids of the map_server convention, ours and those of other tools."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from specmap_cli.errors import MapError
from specmap_cli.gridmap import FREE, OCCUPIED, UNKNOWN, CellArray, GridMap
from specmap_cli.outputs.grids import FREE_THRESHOLD, OCCUPIED_THRESHOLD

_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")


def read_grid(path: Path) -> GridMap:
    """The grid described by a map_server YAML; its image is looked for beside it.

    Thresholds and `negate` are honoured, so that maps of other tools read right; fully transparent
    cells are unknown. Raises MapError naming the file and the key at fault.
    """
    entries = _read_entries(path)
    image = entries.get("image")
    if not image:
        raise MapError(f"{path}: no `image` entry: expected a map_server YAML")
    if entries.get("mode", "trinary") not in ("trinary", "scale"):
        raise MapError(
            f"{path}: mode {entries['mode']!r} cannot be read: expected trinary or scale"
        )
    resolution, origin = _resolution(path, entries), _origin(path, entries)
    cells = _trinary(
        _read_image(path.parent / image),
        _share(path, entries, "occupied_thresh", OCCUPIED_THRESHOLD),
        _share(path, entries, "free_thresh", FREE_THRESHOLD),
        negate=entries.get("negate", "0").lower() in ("1", "true"),
    )
    return GridMap(cells, resolution, origin)


def read_image_grid(path: Path, resolution: float) -> GridMap:
    """The grid in a bare PNG or PGM, `resolution` metres a pixel, lower left corner at (0, 0)."""
    return GridMap(_trinary(_read_image(path), OCCUPIED_THRESHOLD, FREE_THRESHOLD), resolution)


def _trinary(
    image: NDArray[np.uint8], occupied: float, free: float, negate: bool = False
) -> CellArray:
    """Cells of an image, lowest row first: dark is occupied, or light with `negate`."""
    colours = 1 if image.ndim == 2 or image.shape[2] == 2 else 3
    grey = image.reshape(*image.shape[:2], -1)[..., :colours].mean(axis=2) / 255.0
    share = grey if negate else 1.0 - grey
    cells = np.full(share.shape, UNKNOWN, dtype=np.uint8)
    cells[share < free] = FREE
    cells[share > occupied] = OCCUPIED
    if image.ndim == 3 and image.shape[2] in (2, 4):
        cells[image[..., -1] == 0] = UNKNOWN
    return np.ascontiguousarray(cells[::-1])


def _read_image(path: Path) -> NDArray[np.uint8]:
    try:
        data = np.frombuffer(path.read_bytes(), dtype=np.uint8)
    except OSError as error:
        raise MapError(f"{path}: cannot read the image: {error.strerror}") from None
    try:
        image: NDArray[Any] | None = cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
    except cv2.error:  # no bytes at all, or more pixels than OpenCV takes
        image = None
    if image is None:
        raise MapError(f"{path}: not an image that can be read: expected PNG or PGM")
    if image.dtype == np.uint16:
        return (image >> 8).astype(np.uint8)
    return image.astype(np.uint8, copy=False)


def _read_entries(path: Path) -> dict[str, str]:
    """The entries of a flat YAML as text; a list is the text of its lines."""
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise MapError(f"{path}: cannot read the map: {error.strerror}") from None
    except UnicodeDecodeError:
        raise MapError(f"{path}: not a text file: expected a map_server YAML") from None
    entries: dict[str, str] = {}
    key = ""
    for line in text.splitlines():
        content = "" if line.lstrip().startswith("#") else line.split(" #")[0].rstrip()
        if content[:1] in (" ", "-") and key:  # the list goes on
            entries[key] += " " + content.strip()
        elif ":" in content:
            key, _, value = content.partition(":")
            entries[key] = value.strip().strip("\"'")
    return entries


def _numbers(path: Path, entries: dict[str, str], key: str) -> list[float]:
    if key not in entries:
        raise MapError(f"{path}: no `{key}` entry: expected a map_server YAML")
    return [float(text) for text in _NUMBER.findall(entries[key])]


def _resolution(path: Path, entries: dict[str, str]) -> float:
    numbers = _numbers(path, entries, "resolution")
    if len(numbers) != 1 or not 0.0 < numbers[0] < math.inf:
        found = entries["resolution"]
        raise MapError(f"{path}: resolution is {found!r}: expected metres a cell, above zero")
    return numbers[0]


def _origin(path: Path, entries: dict[str, str]) -> tuple[float, float]:
    numbers = _numbers(path, entries, "origin")
    if len(numbers) not in (2, 3) or not all(math.isfinite(number) for number in numbers):
        raise MapError(f"{path}: origin is {entries['origin']!r}: expected [x, y, 0]")
    if len(numbers) == 3 and abs(numbers[2]) > 1e-9:
        raise MapError(f"{path}: origin is turned by {numbers[2]:g} rad: turn the image, write 0")
    return numbers[0], numbers[1]


def _share(path: Path, entries: dict[str, str], key: str, default: float) -> float:
    if key not in entries:
        return default
    numbers = _numbers(path, entries, key)
    if len(numbers) != 1 or not 0.0 <= numbers[0] <= 1.0:
        raise MapError(f"{path}: {key} is {entries[key]!r}: expected a number from 0 to 1")
    return numbers[0]
