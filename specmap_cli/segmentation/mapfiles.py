"""Reading occupancy grids: map_server's YAML, or a picture whose resolution is given."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from specmap_cli.errors import MapError
from specmap_cli.geometry import FloatArray
from specmap_cli.gridmap import FREE, OCCUPIED, UNKNOWN, CellArray, GridMap

_OCCUPIED_THRESH, _FREE_THRESH = 0.65, 0.196
_LARGEST_YAML = 1 << 16


def load_floorplan(path: Path, resolution: float | None = None) -> GridMap:
    """The grid of a map_server YAML file, or of a picture of `resolution` metres a pixel.

    A picture is read with map_server's usual thresholds: light is free, dark is occupied. Given
    with a YAML file, `resolution` overrides the file's. Raises MapError for what cannot be read.
    """
    if path.suffix.lower() in (".yaml", ".yml"):
        return _load_map_server(path, resolution)
    if resolution is None:
        raise MapError(f"{path}: a picture has no scale: give metres a pixel with --resolution")
    occupancy = _occupancy(_read_picture(path), negate=False)
    cells = _trinary(occupancy, _OCCUPIED_THRESH, _FREE_THRESH)
    return GridMap(cells, _positive(path, "resolution", resolution))


def _load_map_server(path: Path, resolution: float | None) -> GridMap:
    keys = _read_yaml(path)
    image = keys.get("image")
    if not isinstance(image, str) or not image:
        raise MapError(f"{path}: no `image` key: is this a map_server YAML file?")
    scale = resolution if resolution is not None else keys.get("resolution")
    occupied = _number(path, "occupied_thresh", keys.get("occupied_thresh", _OCCUPIED_THRESH))
    free = _number(path, "free_thresh", keys.get("free_thresh", _FREE_THRESH))
    if not 0.0 <= free < occupied <= 1.0:
        raise MapError(
            f"{path}: free_thresh {free:g} and occupied_thresh {occupied:g}: "
            "want 0 <= free_thresh < occupied_thresh <= 1"
        )
    mode = str(keys.get("mode", "trinary"))
    if mode not in ("trinary", "scale", "raw"):
        raise MapError(f"{path}: mode {mode!r}: want trinary, scale or raw")
    picture = _read_picture(path.parent / image)
    if mode == "raw":
        occupancy = picture[..., :1].mean(axis=2) / 100.0
        occupancy[occupancy > 1.0] = np.nan
    else:
        occupancy = _occupancy(picture, negate=bool(keys.get("negate", 0)))
    return GridMap(
        _trinary(occupancy, occupied, free),
        _positive(path, "resolution", scale),
        _origin(path, keys),
    )


def _read_yaml(path: Path) -> dict[str, Any]:
    """The keys of a small YAML file; nothing in it can construct anything but plain values."""
    try:
        with path.open("rb") as file:
            text = file.read(_LARGEST_YAML + 1)
    except OSError as error:
        raise MapError(f"{path}: cannot be read: {error.strerror}") from None
    if len(text) > _LARGEST_YAML:
        raise MapError(f"{path}: larger than {_LARGEST_YAML} bytes: not a map_server YAML file")
    try:
        keys = YAML(typ="safe", pure=True).load(text.decode("utf-8"))
    except (YAMLError, UnicodeDecodeError, ValueError) as error:
        line = str(error).splitlines()[0]
        raise MapError(f"{path}: not valid YAML: {line}") from None
    if not isinstance(keys, dict):
        raise MapError(f"{path}: no map_server keys (image, resolution, origin) in it")
    return keys


def _read_picture(path: Path) -> NDArray[Any]:
    """(H, W, C) the picture's values 0 to 255, row 0 at the bottom."""
    if not path.is_file():
        raise MapError(f"{path}: no such picture")
    try:
        picture = cv2.imdecode(np.fromfile(path, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
    except (cv2.error, OSError):
        picture = None
    if picture is None or not picture.size:
        raise MapError(f"{path}: not a picture that can be read: want PNG, PGM or BMP")
    scale = 257.0 if picture.dtype == np.uint16 else 1.0
    return np.asarray(np.atleast_3d(picture)[::-1] / scale, dtype=np.float64)


def _occupancy(picture: NDArray[Any], negate: bool) -> FloatArray:
    """(H, W) occupancy 0 to 1 of a picture, NaN where it is transparent."""
    channels = picture.shape[2]
    has_alpha = channels in (2, 4)
    light = picture[..., : channels - has_alpha].mean(axis=2) / 255.0
    occupancy = light if negate else 1.0 - light
    if has_alpha:
        occupancy = np.where(picture[..., -1] < 255.0, np.nan, occupancy)
    return np.asarray(occupancy)


def _trinary(occupancy: FloatArray, occupied: float, free: float) -> CellArray:
    cells = np.full(occupancy.shape, UNKNOWN, dtype=np.uint8)
    cells[occupancy > occupied] = OCCUPIED
    cells[occupancy < free] = FREE
    return cells


def _origin(path: Path, keys: dict[str, Any]) -> tuple[float, float]:
    origin = keys.get("origin", [0.0, 0.0, 0.0])
    if not isinstance(origin, list) or len(origin) not in (2, 3):
        raise MapError(f"{path}: origin {origin!r}: want [x, y, yaw]")
    x, y, *yaw = (_number(path, "origin", value) for value in origin)
    if yaw and abs(yaw[0]) > 1e-9:
        raise MapError(
            f"{path}: origin with yaw {yaw[0]:g}: only maps that are not turned are read"
        )
    return x, y


def _positive(path: Path, key: str, value: object) -> float:
    number = _number(path, key, value)
    if number <= 0.0:
        raise MapError(f"{path}: {key} {number:g}: want metres a pixel, above 0")
    return number


def _number(path: Path, key: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise MapError(f"{path}: {key} {value!r}: want a number")
    return float(value)
