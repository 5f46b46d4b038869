"""Pictures read from files, within bounds and without a word on stderr."""

from __future__ import annotations

import errno
import os
import re
import struct
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.errors import TOO_LARGE, MapError
from specmap_cli.core.files import read_bytes
from specmap_cli.core.settings import LimitsConfig

_PICTURE_MAX_MB = 268.0  # a picture of a map or a plan, even one without compression
_PIXELS_PER_MPIXEL = 1_000_000
# Where width and height stand in the formats that maps come in, by the definition of each.
_PNG = re.compile(rb"\x89PNG\r\n\x1a\n.{4}IHDR(.{8})", re.DOTALL)
_BMP = re.compile(rb"BM.{16}(.{8})", re.DOTALL)
_PNM = re.compile(rb"P[1-6]\s+(?:#[^\n]*\n\s*)*(\d+)\s+(?:#[^\n]*\n\s*)*(\d+)")


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
    try:
        with _silence():
            picture: NDArray[Any] | None = cv2.imdecode(
                np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_UNCHANGED
            )
    except cv2.error as error:  # no bytes at all, or more pixels than OpenCV takes
        if error.code == cv2.Error.StsNoMem:
            raise MemoryError(f"for the {width} x {height} pixels of {path}") from None
        picture = None
    if picture is None:
        raise MapError("not an image that can be read", "expected PNG, PGM or BMP", where=path)
    return np.atleast_3d(picture)[::-1]


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
