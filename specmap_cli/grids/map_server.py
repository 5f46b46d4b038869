"""Occupancy grids as files: map_server's YAML with its image, or a bare picture with a scale.

Written are a trinary PNG and a YAML beside it: 0 is occupied, 254 free and 205 unknown; the first
row of the image is the highest y.
"""

from __future__ import annotations

import errno
import os
import re
import struct
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Annotated, Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from specmap_cli.core.errors import TOO_LARGE, MapError
from specmap_cli.core.files import read_bytes, write_bytes, write_text
from specmap_cli.core.progress import Progress
from specmap_cli.core.settings import LimitsConfig
from specmap_cli.core.yaml import read_yaml
from specmap_cli.grids.gridmap import FREE, OCCUPIED, UNKNOWN, CellArray, GridMap

# What map_server and Nav2 read the greys 0, 254 and 205 back with as they are; a free threshold
# above 0.196 makes the unknown 205 free. Until 2025 Nav2 wrote 0.25, also for slam_toolbox.
OCCUPIED_THRESHOLD, FREE_THRESHOLD = 0.65, 0.196
_UNKNOWN_GREY, _FREE_GREYS = 205, (254, 255)  # 255 is what people paint over a map
_SAVED_SHARE = 0.99  # of a saved map has its greys: the rest is what a brush left at its edges

# In a bare picture only white (above 250) is free: light greys are edges of lines drawn smoothly,
# or furniture and hatching in a floor plan. A YAML beside the picture can say otherwise.
PICTURE_FREE_THRESHOLD = 0.0196

_EXPECTED = "expected a map_server YAML"
_LARGEST_YAML_MB = 0.066  # such a file has some hundred: anything larger is something else
_YAMLS = (".yaml", ".yml")
_DECIMALS = 6  # of lengths written: a micrometre
_FARTHEST_M = 1e8  # twice around the earth: no place of a map is farther off
_FINEST_M, _COARSEST_M = 0.002, 10.0  # a cell; matching scans in finer ones takes forever
_LARGEST_TURN = 1e-9  # rad; more than rounding, so meant

_GREY = np.zeros(256, dtype=np.uint8)
_GREY[[FREE, OCCUPIED, UNKNOWN]] = (254, 0, 205)
# runs of one value are all that a map has to pack: quicker and smaller than zlib's default
_PNG_OPTIONS = [cv2.IMWRITE_PNG_COMPRESSION, 6]
_PNG_OPTIONS += [cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE]
# one filter for all rows, 19: "up", and "paeth" for colours; OpenCV 4.10 tries all for each row
_PNG_GREY_OPTIONS, _PNG_COLOUR_OPTIONS = [*_PNG_OPTIONS, 19, 32], [*_PNG_OPTIONS, 19, 128]

_PICTURE_MAX_MB = 268.0  # a picture of a map or a plan, even one without compression
_PIXELS_PER_MPIXEL = 1_000_000
# Where width and height stand in the formats that maps come in, by the definition of each.
_PNG_MAGIC, _AROUND_A_CHUNK = b"\x89PNG\r\n\x1a\n", 12  # bytes: its length, kind and checksum
_PNG = re.compile(rb"\x89PNG\r\n\x1a\n.{4}IHDR(.{8})", re.DOTALL)
_BMP = re.compile(rb"BM.{16}(.{8})", re.DOTALL)
_PNM = re.compile(rb"P[1-6]\s+(?:#[^\n]*\n\s*)*(\d+)\s+(?:#[^\n]*\n\s*)*(\d+)")


def write_png(path: str | Path, image: NDArray[Any]) -> None:
    """Write an image, 8 or 16 bit, grey (H, W) or BGR (H, W, 3): the same bytes every time.

    The file appears complete or not at all. UsageError when it cannot be written.
    """
    write_bytes(path, png_bytes(image))


def png_bytes(image: NDArray[Any]) -> bytes:
    """The PNG of an image, 8 or 16 bit, grey (H, W) or BGR (H, W, 3)."""
    options = _PNG_GREY_OPTIONS if image.ndim == 2 else _PNG_COLOUR_OPTIONS
    _, encoded = cv2.imencode(".png", image, options)
    return encoded.tobytes()


def write_grid(stem: str | Path, grid: GridMap) -> None:
    """Write `stem`.png and `stem`.yaml, the image first. UsageError when they cannot be written.

    A grid without cells becomes one unknown cell: no image is empty.
    """
    stem = Path(stem)
    image = stem.with_name(stem.name + ".png")
    cells = grid.cells if grid.cells.size else np.full((1, 1), UNKNOWN, dtype=np.uint8)
    write_png(image, cv2.LUT(np.ascontiguousarray(cells[::-1]), _GREY))
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
    path: str | Path,
    resolution: float | None = None,
    limits: LimitsConfig | None = None,
    progress: Progress | None = None,
) -> GridMap:
    """The grid of a map_server YAML file, or of a picture of `resolution` metres a pixel.

    The modes, thresholds and `negate` of map_server count, so that maps of other tools read right;
    cells that are transparent are unknown. So is the grey 205 of a map that a map_saver wrote, also
    where the threshold beside it makes it free: `progress` has a note then. Of a bare picture,
    white is free, what is dark or borders on white is occupied, and its lower left corner is at
    (0, 0). Given with a YAML
    file, `resolution` overrides the file's. `limits` bound the size of the picture. Raises MapError
    naming the file and the key at fault.
    """
    path = Path(path)
    bare = path.suffix.lower() not in _YAMLS
    scale = {} if resolution is None else {"resolution": resolution}
    if not bare:
        entries = _entries(path)
        with suppress(TypeError, ValueError):  # of a file that says none
            own = float(entries.get("resolution", "none"))
            if progress is not None and resolution not in (None, own):
                told = f"{resolution:g} m a pixel, as you say; the file says {own:g}"
                progress.note(f"{path}: {told}")
        entries |= scale
    elif path.is_dir():
        raise MapError("is a directory", "name the .yaml or the picture in it", where=path)
    elif resolution is None:
        read_picture(path, limits)  # what is no picture is told first
        raise MapError(
            "a picture has no scale", "give metres a pixel with --resolution", where=path
        )
    else:
        entries = {"image": path.name, "free_thresh": PICTURE_FREE_THRESHOLD} | scale
    try:
        about = _MapYaml.model_validate(entries)
    except ValidationError as error:
        raise MapError(*_complaint(error, entries), where=path) from None
    picture = read_picture(path.parent / about.image, limits)
    if about.frees_unknown(picture):
        if progress is not None:
            progress.note(
                f"{path}: the grey {_UNKNOWN_GREY} is read as unknown, as map_saver writes it, "
                f"though free_thresh {about.free_thresh:g} would make it free: "
                "if it is free, write `mode: scale`"
            )
        about = about.model_copy(update={"free_thresh": FREE_THRESHOLD})
    cells = about.cells(picture)
    if bare:
        cells = _with_outlines(cells, picture)
    return GridMap(cells, about.resolution, (about.origin[0], about.origin[1]))


def files_of_grid(path: Path) -> tuple[Path, ...]:
    """The files that `read_grid` reads: a YAML and the picture that it names, or a bare picture.

    Raises MapError.
    """
    if path.suffix.lower() not in _YAMLS:
        return (path,)
    image = _entries(path).get("image")
    if not isinstance(image, str) or "\0" in image:
        return (path,)
    return path, path.parent / image


def _entries(path: Path) -> dict[str, Any]:
    """What a YAML file of map_server says. Raises MapError."""
    try:
        found = read_yaml(read_bytes(path, _LARGEST_YAML_MB))
    except ValueError as error:
        raise MapError(error, _EXPECTED, where=path) from None
    except OSError as error:
        if error.errno == errno.EFBIG:
            size = f"larger than {_LARGEST_YAML_MB * 1000:g} kB"
            raise MapError(size, _EXPECTED, where=path) from None
        raise MapError.of_system(error, "cannot read the map", where=path) from None
    return found if isinstance(found, dict) else {}


def _with_outlines(cells: CellArray, picture: NDArray[Any]) -> CellArray:
    """The cells (H, W) of a drawing whose white ends at walls, however light they are drawn."""
    beside = cv2.dilate((cells == FREE).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    unsure = beside & (cells == UNKNOWN)
    channels, unit = picture.shape[2], 257 if picture.dtype == np.uint16 else 1
    transparent = channels in (2, 4)
    shown = picture[unsure]
    drawn = (shown[:, : channels - transparent] != _UNKNOWN_GREY * unit).any(axis=1)
    drawn &= (shown[:, -1] == 255 * unit) | (not transparent)
    outlined = cells.copy()
    outlined[unsure] = np.where(drawn, np.uint8(OCCUPIED), np.uint8(UNKNOWN))
    return outlined


def _complaint(error: ValidationError, entries: dict[str, Any]) -> tuple[str, ...]:
    """What is wrong first: the key and what stands there; and, in most cases, what should."""
    first = error.errors()[0]
    if first["type"] == "value_error":
        parts: tuple[str, ...] = first["ctx"]["error"].args
        return parts
    key = str(first["loc"][0])
    if first["type"] == "missing":
        return f"no `{key}` entry", _EXPECTED
    found, expected = entries[key], _MapYaml.model_fields[key].description
    shown = f"{found:g}" if isinstance(found, float | int) else repr(_written(found))
    return f"{key} is {shown}", f"expected {expected}"


def _written(value: Any) -> str:
    """A value as it stands in the file, about."""
    return f"[{', '.join(map(_written, value))}]" if isinstance(value, list) else str(value)


_Metres = Annotated[float, Field(ge=-_FARTHEST_M, le=_FARTHEST_M)]
_Share = Annotated[float, Field(ge=0.0, le=1.0, description="a number from 0 to 1")]


class _MapYaml(BaseModel):
    """The entries of a map_server YAML; the description of each says what was expected."""

    model_config = ConfigDict(frozen=True, allow_inf_nan=False)

    image: str = Field(min_length=1, description="the name of a picture")
    mode: Literal["trinary", "scale", "raw"] = Field(
        "trinary", description="one of trinary, scale, raw"
    )
    resolution: float = Field(
        ge=_FINEST_M, le=_COARSEST_M, description=f"{_FINEST_M:g} to {_COARSEST_M:g} metres a cell"
    )
    origin: list[_Metres] = Field(
        [0.0, 0.0, 0.0], min_length=2, max_length=3, description="[x, y, 0]"
    )
    negate: bool = Field(False, description="0 or 1")
    occupied_thresh: _Share = OCCUPIED_THRESHOLD
    free_thresh: _Share = FREE_THRESHOLD

    @field_validator("origin")
    @classmethod
    def _stands_straight(cls, origin: list[float]) -> list[float]:
        if len(origin) == 3 and abs(origin[2]) > _LARGEST_TURN:
            raise ValueError(f"origin is turned by {origin[2]:g} rad", "turn the image, write 0")
        return origin

    @model_validator(mode="after")
    def _leaves_room_for_unknown(self) -> _MapYaml:
        free, occupied = self.free_thresh, self.occupied_thresh
        if free >= occupied:
            raise ValueError(f"free_thresh {free:g} is not below occupied_thresh {occupied:g}")
        return self

    def frees_unknown(self, picture: NDArray[Any]) -> bool:
        """Whether a picture (H, W, C) is of a map_saver, whose grey for unknown would be free."""
        if self.mode != "trinary" or self.negate:
            return False
        if self.free_thresh <= (255 - _UNKNOWN_GREY) / 255.0:
            return False
        greys, unit = picture[..., 0], 257 if picture.dtype == np.uint16 else 1
        unknown, occupied, *free = (
            int(np.count_nonzero(greys == grey * unit)) for grey in (_UNKNOWN_GREY, 0, *_FREE_GREYS)
        )
        saved = unknown + occupied + sum(free) >= _SAVED_SHARE * greys.size
        return saved and unknown > 0 and sum(free) > 0

    def cells(self, picture: NDArray[Any]) -> CellArray:
        """(H, W) cells of a picture (H, W, C): the darker the pixel, the surer the obstacle.

        With `negate` it is the lighter; mode raw has percent. Transparent is unknown.
        """
        channels = picture.shape[2]
        plain = channels == 1 and picture.dtype == np.uint8  # the usual one, and large at times
        values = np.arange(256.0)[:, None, None] if plain else picture.astype(np.float64)
        if picture.dtype == np.uint16:
            values /= 257.0
        transparent = channels in (2, 4)
        greys = values[..., : channels - transparent].mean(axis=2)
        if self.mode == "raw":
            percent = np.rint(greys)
            occupancy = np.where(percent <= 100.0, percent / 100.0, np.nan)
        else:
            occupancy = (greys if self.negate else 255.0 - greys) / 255.0
        if transparent:
            occupancy[values[..., -1] < 255.0] = np.nan
        cells = np.full(occupancy.shape, UNKNOWN, dtype=np.uint8)
        cells[occupancy > self.occupied_thresh] = OCCUPIED
        cells[occupancy < self.free_thresh] = FREE
        return np.asarray(cv2.LUT(picture[..., 0], cells)) if plain else cells


def read_picture(path: Path, limits: LimitsConfig | None = None) -> NDArray[Any]:
    """(H, W, C) 8 or 16 bit, lowest row first.

    Raises MapError for what is no such picture or beyond the limits, MemoryError for one that does
    not fit into memory.
    """
    limits = LimitsConfig() if limits is None else limits
    try:
        data = read_bytes(path, _PICTURE_MAX_MB)
    except OSError as error:
        raise MapError.of_system(error, "cannot read the image", where=path) from None
    width, height = _size(data)
    if width * height > limits.picture_max_mpixel * _PIXELS_PER_MPIXEL:
        raise MapError(
            f"{width} x {height} pixels are more than {limits.picture_max_mpixel:g} million",
            "scale it down, or raise limits.picture_max_mpixel",
            where=path,
            code=TOO_LARGE,
        )
    picture: NDArray[Any] | None = None
    try:
        with _silence():
            if _is_whole(data):
                picture = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:  # no bytes at all, or more pixels than OpenCV takes
        if error.code == cv2.Error.StsNoMem:
            raise MemoryError(f"for the {width} x {height} pixels of {path}") from None
    if picture is None:
        raise MapError(
            "not an image that can be read", "expected a YAML, PNG, PGM or BMP", where=path
        )
    return np.atleast_3d(picture)[::-1]


def _is_whole(data: bytes) -> bool:
    """Whether a PNG holds all bytes that its chunks claim, which decoders ask memory for."""
    place = len(_PNG_MAGIC)
    while data.startswith(_PNG_MAGIC) and place < len(data):
        length = int.from_bytes(data[place : place + 4])
        if length > len(data) - place - _AROUND_A_CHUNK:
            return False
        place += length + _AROUND_A_CHUNK
    return True


def _size(data: bytes) -> tuple[int, int]:
    """Width and height as the header says; 0, 0 when it is of another format."""
    head = data[:4096]
    if (found := _PNG.match(head)) is not None:
        width, height = struct.unpack(">II", found[1])
    elif (found := _BMP.match(head)) is not None:
        width, height = struct.unpack("<ii", found[1])
    elif (found := _PNM.match(head)) is not None:
        width, height = (int(digits[:20]) for digits in found.groups())
    else:
        return 0, 0
    return abs(width), abs(height)


@contextmanager
def _silence() -> Iterator[None]:
    """Keep C libraries from writing to stderr in the block: errors are told by one line of ours."""
    try:
        kept = os.dup(2)
    except OSError as error:
        if error.errno != errno.EBADF:  # with stderr closed nothing is to be kept from it
            raise
        yield
        return
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(kept, 2)
        for descriptor in (kept, nowhere):
            with suppress(OSError):
                os.close(descriptor)
