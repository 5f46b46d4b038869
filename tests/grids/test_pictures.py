"""Pictures from files: nothing endless, nothing that swells, no word of a library."""

from __future__ import annotations

import os
import struct
import zlib
from contextlib import suppress
from pathlib import Path

import cv2
import numpy as np
import pytest

from specmap_cli.core.errors import MapError
from specmap_cli.core.settings import LimitsConfig
from specmap_cli.grids.map_server import read_picture
from tests.turning import turn

GREY = np.arange(12, dtype=np.uint8).reshape(3, 4)


def with_size(png: bytes, width: int, height: int) -> bytes:
    """A PNG whose header tells another size, with the checksum that fits."""
    header = b"IHDR" + struct.pack(">II", width, height) + png[24:29]
    return png[:12] + header + struct.pack(">I", zlib.crc32(header)) + png[33:]


@pytest.mark.parametrize("suffix", [".png", ".pgm", ".bmp", ".tiff"])
def test_pictures_of_every_format_come_back(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"m{suffix}"
    assert cv2.imwrite(str(path), GREY)
    np.testing.assert_array_equal(read_picture(path)[::-1, :, 0], GREY)


@pytest.mark.parametrize(
    ("name", "head"),
    [
        ("m.pgm", b"P5 20000 20000 255\n"),
        ("m.pgm", b"P5\n# drawn by hand\n20000\n20000\n255\n"),
        ("m.bmp", b"BM" + bytes(16) + struct.pack("<ii", 20_000, -20_000) + bytes(28)),
        ("m.png", b""),
    ],
)
def test_more_pixels_than_a_building_needs_are_refused(
    tmp_path: Path, name: str, head: bytes
) -> None:
    encoded = cv2.imencode(".png", GREY)[1].tobytes()
    (tmp_path / name).write_bytes(head or with_size(encoded, 20_000, 20_000))
    with pytest.raises(MapError) as caught:
        read_picture(tmp_path / name)
    assert str(caught.value) == (
        f"{tmp_path / name}: 20000 x 20000 pixels are more than 100 million: scale it down, "
        "or raise limits.picture_max_mpixel"
    )


def test_the_bounds_are_settings(tmp_path: Path) -> None:
    path = tmp_path / "m.png"
    path.write_bytes(cv2.imencode(".png", GREY)[1].tobytes())
    assert read_picture(path, LimitsConfig(picture_max_mpixel=12e-6)).shape == (3, 4, 1)
    with pytest.raises(MapError, match=r"4 x 3 pixels are more than 1\.1e-05 million: scale it"):
        read_picture(path, LimitsConfig(picture_max_mpixel=11e-6))
    turn("grids", picture_max_mb=5e-5)
    with pytest.raises(MapError) as caught:
        read_picture(path)
    assert str(caught.value) == f"{path}: cannot read the image: larger than 5e-05 MB"


def test_want_of_memory_is_told_as_what_it_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "m.png"
    path.write_bytes(cv2.imencode(".png", GREY)[1].tobytes())
    error = cv2.error("Insufficient memory")
    error.code = cv2.Error.StsNoMem

    def full(*_: object) -> None:
        raise error

    monkeypatch.setattr(cv2, "imdecode", full)
    with pytest.raises(MemoryError, match=r"for the 4 x 3 pixels of .*m\.png"):
        read_picture(path)


@pytest.mark.parametrize("place", [20, 45, 55, -6, -1])
def test_libraries_keep_silent_about_damage(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], place: int
) -> None:
    """libpng and OpenCV would write to stderr by themselves."""
    encoded = bytearray(cv2.imencode(".png", GREY)[1].tobytes())
    encoded[place] ^= 0xFF
    (tmp_path / "m.png").write_bytes(encoded)
    with suppress(MapError):  # some damage shows only in the colours
        read_picture(tmp_path / "m.png")
    os.write(2, b"heard again\n")
    assert capfd.readouterr().err == "heard again\n"


def test_a_pipe_and_a_device_are_refused_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.png")
    (tmp_path / "endless.png").symlink_to("/dev/zero")
    for name in ("pipe.png", "endless.png"):
        with pytest.raises(MapError, match="cannot read the image: not a regular file"):
            read_picture(tmp_path / name)
