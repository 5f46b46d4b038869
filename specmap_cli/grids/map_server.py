"""Occupancy grids as files: map_server's YAML with its image, or a bare picture with a scale.

Written are a trinary PNG and a YAML beside it: 0 is occupied, 254 free and 205 unknown; the first
row of the image is the highest y.
"""

from __future__ import annotations

import errno
import math
import re
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.errors import MapError
from specmap_cli.core.files import read_bytes, write_bytes, write_text
from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.settings import LimitsConfig
from specmap_cli.core.shortage import reason
from specmap_cli.grids.gridmap import FREE, OCCUPIED, UNKNOWN, CellArray, GridMap
from specmap_cli.grids.pictures import read_picture

# What map_server and Nav2 read the greys 0, 254 and 205 back with as they are; a free threshold
# above 0.196, such as the often seen 0.25, would make the unknown 205 free.
OCCUPIED_THRESHOLD, FREE_THRESHOLD = 0.65, 0.196

# In a bare picture only white (above 250) is free: light greys are edges of lines drawn smoothly,
# or furniture and hatching in a floor plan. A YAML beside the picture can say otherwise.
PICTURE_FREE_THRESHOLD = 0.0196

_QUOTED, _COMMENT = re.compile(r"(['\"])(.*?)\1"), re.compile(r"\s#")
_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
_LARGEST_YAML_MB = 0.066  # such a file has some hundred: anything larger is something else
_DECIMALS = 6  # of lengths written: a micrometre
_FARTHEST_M = 1e8  # twice around the earth: no place of a map is farther off
_LARGEST_TURN = 1e-9  # rad; more than rounding, so meant
_MODES = ("trinary", "scale", "raw")

Entries = dict[str, str]

_GREY = np.zeros(256, dtype=np.uint8)
_GREY[[FREE, OCCUPIED, UNKNOWN]] = (254, 0, 205)
# the defaults of zlib, written down: those of OpenCV have changed between its versions
_PNG_OPTIONS = [cv2.IMWRITE_PNG_COMPRESSION, 6, cv2.IMWRITE_PNG_STRATEGY, 0]


def write_png(path: str | Path, image: NDArray[Any]) -> None:
    """Write an image, 8 or 16 bit, grey (H, W) or BGR (H, W, 3): the same bytes every time.

    The file appears complete or not at all. UsageError when it cannot be written.
    """
    write_bytes(path, png_bytes(image))


def png_bytes(image: NDArray[Any]) -> bytes:
    """The PNG of an image, 8 or 16 bit, grey (H, W) or BGR (H, W, 3)."""
    _, encoded = cv2.imencode(".png", image, _PNG_OPTIONS)
    return encoded.tobytes()


def write_grid(stem: str | Path, grid: GridMap) -> None:
    """Write `stem`.png and `stem`.yaml, the image first. UsageError when they cannot be written.

    A grid without cells becomes one unknown cell: no image is empty.
    """
    stem = Path(stem)
    image = stem.with_name(stem.name + ".png")
    cells = grid.cells if grid.cells.size else np.full((1, 1), UNKNOWN, dtype=np.uint8)
    write_png(image, _GREY[cells[::-1]])
    lines = [
        f"image: {image.name}",
        "mode: trinary",
        f"resolution: {_number(grid.resolution)}",
        f"origin: [{_number(grid.origin[0])}, {_number(grid.origin[1])}, 0.0]",
        "negate: 0",
        f"occupied_thresh: {OCCUPIED_THRESHOLD}",
        f"free_thresh: {FREE_THRESHOLD}",
    ]
    write_text(stem.with_name(stem.name + ".yaml"), "\n".join(lines) + "\n")


def _number(value: float) -> str:
    """Six decimals at the most, and a point, without which YAML reads an integer or a text."""
    return np.format_float_positional(round(float(value), _DECIMALS) + 0.0, trim="0")


def read_grid(
    path: str | Path, resolution: float | None = None, limits: LimitsConfig | None = None
) -> GridMap:
    """The grid of a map_server YAML file, or of a picture of `resolution` metres a pixel.

    The modes, thresholds and `negate` of map_server count, so that maps of other tools read right;
    cells that are transparent are unknown. Of a bare picture, white is free and dark is occupied,
    and its lower left corner is at (0, 0). Given with a YAML file, `resolution` overrides the
    file's. `limits` bound the size of the picture. Raises MapError naming the file and the key at
    fault.
    """
    path = Path(path)
    if path.suffix.lower() in (".yaml", ".yml"):
        return _read_map_server(path, resolution, limits)
    if resolution is None:
        raise MapError(f"{path}: a picture has no scale: give metres a pixel with --resolution")
    reading = _Reading("trinary", False, OCCUPIED_THRESHOLD, PICTURE_FREE_THRESHOLD)
    return GridMap(reading.cells(read_picture(path, limits)), _length(path, resolution))


def _read_map_server(path: Path, resolution: float | None, limits: LimitsConfig | None) -> GridMap:
    entries = _read_entries(path)
    image = entries.get("image")
    if not image:
        raise MapError(f"{path}: no `image` entry: expected a map_server YAML")
    mode = entries.get("mode", "trinary")
    if mode not in _MODES:
        raise MapError(f"{path}: mode is {mode!r}: expected one of {', '.join(_MODES)}")
    occupied = _share(path, entries, "occupied_thresh", OCCUPIED_THRESHOLD)
    free = _share(path, entries, "free_thresh", FREE_THRESHOLD)
    if free >= occupied:
        raise MapError(f"{path}: free_thresh {free:g} is not below occupied_thresh {occupied:g}")
    scale = _resolution(path, entries) if resolution is None else _length(path, resolution)
    origin = _origin(path, entries)
    negate = entries.get("negate", "0").lower() in ("1", "true", "yes")
    reading = _Reading(mode, negate, occupied, free)
    return GridMap(reading.cells(read_picture(path.parent / image, limits)), scale, origin)


class _Reading(NamedTuple):
    """How greys become cells."""

    mode: str
    negate: bool
    occupied: float
    free: float

    def cells(self, picture: NDArray[Any]) -> CellArray:
        """(H, W) cells of a picture (H, W, C)."""
        if picture.shape[2] == 1 and picture.dtype == np.uint8:  # the usual one, and large at times
            levels = np.arange(256, dtype=np.uint8)[:, None, None]
            return np.asarray(self._cells(levels)[:, 0][picture[..., 0]])
        return self._cells(picture)

    def _cells(self, picture: NDArray[Any]) -> CellArray:
        values = picture / (257.0 if picture.dtype == np.uint16 else 1.0)
        occupancy = _percent(values) if self.mode == "raw" else _occupancy(values, self.negate)
        cells = np.full(occupancy.shape, UNKNOWN, dtype=np.uint8)
        cells[occupancy > self.occupied] = OCCUPIED
        cells[occupancy < self.free] = FREE
        return cells


def _occupancy(picture: FloatArray, negate: bool) -> FloatArray:
    """(H, W) 0 to 1, the darker the more (`negate`: the lighter), NaN where it is transparent."""
    channels = picture.shape[2]
    transparent = channels in (2, 4)
    light = picture[..., : channels - transparent].mean(axis=2) / 255.0
    occupancy = light if negate else 1.0 - light
    return np.where(picture[..., -1] < 255.0, np.nan, occupancy) if transparent else occupancy


def _percent(picture: FloatArray) -> FloatArray:
    """(H, W) 0 to 1 of values that are percent as they stand, NaN above a hundred."""
    percent = picture[..., 0]
    return np.where(percent <= 100.0, percent / 100.0, np.nan)


def _read_entries(path: Path) -> Entries:
    """The entries of a YAML without nesting, as text; a list is the text of its lines."""
    try:
        text = read_bytes(path, _LARGEST_YAML_MB).decode("utf-8")
    except OSError as error:
        if error.errno == errno.EFBIG:
            expected = "expected a map_server YAML"
            raise MapError(
                f"{path}: larger than {_LARGEST_YAML_MB * 1000:g} kB: {expected}"
            ) from None
        raise MapError(f"{path}: cannot read the map: {reason(error)}") from None
    except UnicodeDecodeError:
        raise MapError(f"{path}: not a text file: expected a map_server YAML") from None
    entries: Entries = {}
    key = ""
    for line in text.splitlines():
        if line.lstrip().startswith("#"):
            continue
        if line[:1] in (" ", "-") and key and not line.startswith("---"):  # a list goes on
            entries[key] = f"{entries[key]} {_scalar(line)}".strip()
        elif ":" in line:
            key, _, value = line.partition(":")
            entries[key] = _scalar(value)
    return entries


def _scalar(text: str) -> str:
    """The value in the text after a key, without its quotes and without a comment behind it."""
    text = text.strip()
    quoted = _QUOTED.match(text)
    return quoted[2] if quoted else _COMMENT.split(f" {text}")[0].strip()


def _numbers(path: Path, entries: Entries, key: str) -> list[float]:
    if key not in entries:
        raise MapError(f"{path}: no `{key}` entry: expected a map_server YAML")
    return [float(text) for text in _NUMBER.findall(entries[key])]


def _resolution(path: Path, entries: Entries) -> float:
    numbers = _numbers(path, entries, "resolution")
    if len(numbers) != 1:
        raise MapError(f"{path}: resolution is {entries['resolution']!r}: expected metres a cell")
    return _length(path, numbers[0])


def _length(path: Path, resolution: float) -> float:
    if not 0.0 < resolution < math.inf:
        raise MapError(f"{path}: resolution is {resolution:g}: expected metres a cell, above 0")
    if resolution > _FARTHEST_M:
        raise MapError(f"{path}: resolution is {resolution:g}: a cell larger than the earth")
    return float(resolution)


def _origin(path: Path, entries: Entries) -> tuple[float, float]:
    if "origin" not in entries:
        return 0.0, 0.0
    numbers = _numbers(path, entries, "origin")
    if len(numbers) not in (2, 3) or not all(abs(n) <= _FARTHEST_M for n in numbers):
        raise MapError(f"{path}: origin is {entries['origin']!r}: expected [x, y, 0]")
    if len(numbers) == 3 and abs(numbers[2]) > _LARGEST_TURN:
        raise MapError(f"{path}: origin is turned by {numbers[2]:g} rad: turn the image, write 0")
    return numbers[0], numbers[1]


def _share(path: Path, entries: Entries, key: str, default: float) -> float:
    if key not in entries:
        return default
    numbers = _numbers(path, entries, key)
    if len(numbers) != 1 or not 0.0 <= numbers[0] <= 1.0:
        raise MapError(f"{path}: {key} is {entries[key]!r}: expected a number from 0 to 1")
    return numbers[0]
