"""Occupancy grids as files: the convention of map_server, and pictures within bounds."""

import os
import re
import struct
import zlib
from contextlib import suppress
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import cv2
import numpy as np
import pytest
import ruamel.yaml
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from specmap_cli.core.errors import MapError, UsageError
from specmap_cli.core.progress import Silent
from specmap_cli.core.settings import LimitsConfig
from specmap_cli.grids.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap
from specmap_cli.grids.map_server import read_grid, read_picture, write_grid, write_png
from tests.strategies import few, seeds
from tests.turning import turn

YAML = "image: m.png\nresolution: 0.1\norigin: [-1.0, 2.5, 0.0]\nnegate: 0\n"


def write_image(directory: Path, image: NDArray[Any], yaml: str = YAML) -> Path:
    assert cv2.imwrite(str(directory / "m.png"), image)
    (directory / "m.yaml").write_text(yaml)
    return directory / "m.yaml"


def grey_png(directory: Path) -> Path:
    assert cv2.imwrite(str(directory / "m.png"), np.arange(12, dtype=np.uint8).reshape(3, 4))
    return directory / "m.png"


@given(
    st.tuples(st.integers(1, 9), st.integers(1, 9)),
    st.floats(0.002, 10.0).map(lambda v: round(v, 6)),
    st.one_of(st.sampled_from([0.0, -0.0, 1e-5, -3e-6, 4e-7, 1e6]), st.floats(-1e5, 1e5)),
    seeds,
)
def test_there_and_back_and_another_reader_finds_the_same_numbers(
    tmp_path_factory: pytest.TempPathFactory,
    shape: tuple[int, int],
    resolution: float,
    x: float,
    seed: int,
) -> None:
    cells = np.random.default_rng(seed).integers(0, 3, shape).astype(np.uint8)
    stem = tmp_path_factory.mktemp("grid") / "000"
    write_grid(stem, GridMap(cells, resolution, (x, -x)))
    back = read_grid(stem.with_suffix(".yaml"))
    assert (back.cells == cells).all()
    assert back.resolution == resolution
    assert back.origin == pytest.approx((x, -x), abs=1e-6)
    text = stem.with_suffix(".yaml").read_text()
    found = ruamel.yaml.YAML(typ="safe", pure=True).load(text)
    assert found["resolution"] == resolution
    assert found["origin"] == pytest.approx([x, -x, 0.0], abs=6e-7)
    assert {type(value) for value in (found["resolution"], *found["origin"])} == {float}
    assert not re.search(r"\de|-0\.0\b", text)  # neither exponents, which YAML 1.1 reads as text


def test_the_convention_of_map_server(tmp_path: Path) -> None:
    """Grey values, thresholds and orientation, read with nothing of ours."""
    cells = np.array([[FREE, OCCUPIED], [UNKNOWN, FREE], [UNKNOWN, UNKNOWN]], dtype=np.uint8)
    write_grid(tmp_path / "m", GridMap(cells, 0.05, (-1.0, 2.0)))
    image = cv2.imread(str(tmp_path / "m.png"), cv2.IMREAD_UNCHANGED)
    assert image is not None
    assert image.tolist() == [[205, 205], [205, 254], [254, 0]]
    assert (tmp_path / "m.yaml").read_text() == (
        "image: m.png\nmode: trinary\nresolution: 0.05\norigin: [-1.0, 2.0, 0.0]\nnegate: 0\n"
        "occupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )
    assert (255 - 205) / 255 > 0.196  # unknown does not load as free
    write_grid(tmp_path / "m", GridMap(cells[:0], 0.05))  # no picture is empty
    assert read_grid(tmp_path / "m.yaml").cells.tolist() == [[UNKNOWN]]


NAV2 = YAML + "mode: trinary\noccupied_thresh: 0.65\nfree_thresh: 0.25\n"
SAVED = np.repeat(np.repeat(np.array([[254, 205], [0, 254]], dtype=np.uint8), 20, 0), 20, 1)
CELLS = [[OCCUPIED, FREE], [FREE, UNKNOWN]]  # the lowest row first


def heard(path: Path) -> tuple[GridMap, list[str]]:
    """A map as it is read, and the notes on the way."""
    progress = Mock(Silent)
    grid = read_grid(path, progress=progress)
    return grid, [call.args[0] for call in progress.note.call_args_list]


def brushed(greys: tuple[int, ...], strokes: int) -> NDArray[np.uint8]:
    """A saved map of which somebody painted some pixels of an occupied corner."""
    picture = SAVED.copy()
    picture[39, :strokes] = np.resize(greys, strokes)
    return picture


@pytest.mark.parametrize(
    "picture",
    [
        SAVED,
        np.dstack([SAVED] * 3),
        np.dstack([*[SAVED] * 3, np.full_like(SAVED, 255)]),  # where map_server reads 205 as free
        SAVED.astype(np.uint16) * 257,
        np.where(SAVED == 254, 255, SAVED),
        brushed((0, 254, 255), 20),
        brushed((40, 90, 230), 15),
    ],
    ids=["grey", "colour", "alpha", "16 bit", "white", "painted over", "by a soft brush"],
)
def test_the_grey_of_map_savers_is_unknown_and_noted(tmp_path: Path, picture: NDArray[Any]) -> None:
    """Nav2 and slam_toolbox give a threshold that makes it free."""
    path = write_image(tmp_path, picture, NAV2)
    if picture.ndim == 2:
        assert cv2.imwrite(str(tmp_path / "m.pgm"), picture)
        path.write_text(NAV2.replace(".png", ".pgm"))
    grid, notes = heard(path)
    assert grid.cells[10::20, 30::-20][:, ::-1].tolist() == CELLS
    assert notes == [
        f"{path}: the grey 205 is read as unknown, as map_saver writes it, though free_thresh 0.25 "
        "would make it free: if it is free, write `mode: scale`"
    ]
    assert (read_grid(path).cells == grid.cells).all()  # whether or not anybody listens
    path.write_text(path.read_text().replace("trinary", "scale"))
    grid, notes = heard(path)
    assert grid.cells[30, 30] == FREE
    assert notes == []


@pytest.mark.parametrize(
    ("picture", "yaml", "corner"),
    [
        (SAVED, NAV2.replace("0.25", "0.196"), UNKNOWN),
        (SAVED, NAV2.replace("negate: 0", "negate: 1"), OCCUPIED),
        (brushed((40, 90, 230), 17), NAV2, FREE),  # a drawing in many greys
        (np.where(SAVED == 254, 0, SAVED), NAV2, FREE),  # nothing else is free
        (np.where(SAVED == 205, 204, SAVED), NAV2, FREE),
    ],
    ids=["ROS 1", "negated", "drawn", "the only light grey", "another grey"],
)
def test_greys_of_other_maps_are_what_their_thresholds_say(
    tmp_path: Path, picture: NDArray[Any], yaml: str, corner: int
) -> None:
    grid, notes = heard(write_image(tmp_path, picture, yaml))
    assert grid.cells[30, 30] == corner
    assert notes == []


@pytest.mark.parametrize("depth", [np.uint8, np.uint16])
@pytest.mark.parametrize("channels", [1, 3, 4])
def test_white_of_a_drawing_ends_at_walls_and_205_stays_unknown(
    tmp_path: Path, depth: type[np.uint8 | np.uint16], channels: int
) -> None:
    """A light grey line, hatching, a saved map's unknown, and a place that may be transparent."""
    greys = np.array([[255, 230, 255, 230, 230, 230, 255, 205, 255, 240, 255]], dtype=depth)
    picture = np.dstack([greys] * channels)
    if channels == 4:
        picture[..., 3] = np.where(greys == 240, 0, 255)
    write_image(tmp_path, picture * depth(257 if depth is np.uint16 else 1))
    line, hatched = [OCCUPIED], [OCCUPIED, UNKNOWN, OCCUPIED]
    clear = UNKNOWN if channels == 4 else OCCUPIED
    expected = [FREE, *line, FREE, *hatched, FREE, UNKNOWN, FREE, clear, FREE]
    assert read_grid(tmp_path / "m.png", 0.05).cells.tolist() == [expected]


@pytest.mark.parametrize("depth", [np.uint8, np.uint16])
@pytest.mark.parametrize("mode", ["scale", "raw"])
def test_maps_of_probabilities_are_read_as_nav2_writes_them(
    tmp_path: Path, mode: str, depth: type[np.uint8 | np.uint16]
) -> None:
    """Every percentage, then unknown: transparent grey in the mode scale, white in raw."""
    percent = np.arange(101)
    greys = np.rint((100 - percent) * 2.55) if mode == "scale" else percent
    picture = np.append(greys, 128 if mode == "scale" else 255)[None]
    if mode == "scale":
        opaque = np.where(np.arange(102) < 101, 255, 0)[None]
        picture = np.dstack([*[picture] * 3, opaque])
    unit = 1 if depth is np.uint8 else 257
    yaml = NAV2.replace("trinary", mode)
    cells = read_grid(write_image(tmp_path, (picture * unit).astype(depth), yaml)).cells[0]
    expected = np.where(percent < 25, FREE, np.where(percent > 65, OCCUPIED, UNKNOWN))
    told = percent != 65  # in 8 bits its grey is a little darker than the threshold
    np.testing.assert_array_equal(cells[:101][told], expected[told])
    assert cells[101] == UNKNOWN


def test_a_given_resolution_wins_and_paths_may_be_text(tmp_path: Path) -> None:
    write_grid(f"{tmp_path}/m", GridMap(np.zeros((2, 2), dtype=np.uint8), 0.05))
    path = tmp_path / "m.yaml"
    for each in (path, str(path), f"{tmp_path}/m.png"):
        assert read_grid(each, 0.25).resolution == 0.25
    with pytest.raises(MapError, match=r"0\.002 to 10 metres"):
        read_grid(path, -1.0)
    with pytest.raises(MapError, match="--resolution"):
        read_grid(tmp_path / "m.png")


def test_unreadable_files_pipes_and_devices_are_one_line(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.png")
    (tmp_path / "endless.png").symlink_to("/dev/zero")
    (tmp_path / "empty.png").write_bytes(b"")
    (tmp_path / "binary.yaml").write_bytes(b"\xff\xfe\x00")
    for name, picture in (("other", "gone.png"), ("itself", "itself.yaml")):
        (tmp_path / f"{name}.yaml").write_text(YAML.replace("m.png", picture))
    for name, resolution, said in (
        ("pipe.png", 0.1, "cannot read the image: not a regular file"),
        ("endless.png", 0.1, "cannot read the image: not a regular file"),
        ("empty.png", 0.1, "not an image"),
        ("gone.yaml", None, "No such file"),
        ("binary.yaml", None, "not a text file"),
        ("other.yaml", None, "No such file"),
        ("itself.yaml", None, "not an image"),
    ):
        with pytest.raises(MapError, match=said):
            read_grid(tmp_path / name, resolution)


@given(st.integers(0, 255), st.integers(1, 99), st.integers(1, 99), st.booleans())
@few(30)
def test_any_thresholds_count_and_so_does_negate(
    tmp_path_factory: pytest.TempPathFactory, grey: int, one: int, other: int, negate: bool
) -> None:
    free, occupied = min(one, other) / 100, (max(one, other) + 0.5) / 100
    yaml = f"image: m.png\nresolution: 0.1\nnegate: {int(negate)}\n"
    yaml += f"occupied_thresh: {occupied}\nfree_thresh: {free}\n"
    image = np.full((1, 1), grey, dtype=np.uint8)
    grid = read_grid(write_image(tmp_path_factory.mktemp("grid"), image, yaml))
    darkness = grey / 255 if negate else (255 - grey) / 255
    expected = OCCUPIED if darkness > occupied else FREE if darkness < free else UNKNOWN
    assert grid.cells.tolist() == [[expected]]
    assert grid.origin == (0.0, 0.0)


@pytest.mark.parametrize("name", ["floor2.png", "floor #2.png", "it's: 2.png"])
@pytest.mark.parametrize("absolute", [False, True])
def test_a_picture_lies_anywhere_under_any_name(tmp_path: Path, name: str, absolute: bool) -> None:
    (tmp_path / "pictures").mkdir()
    picture = tmp_path / "pictures" / name
    write_png(picture, np.zeros((1, 1), dtype=np.uint8))
    said = picture if absolute else f"pictures/{name}"
    (tmp_path / "m.yaml").write_text(YAML.replace("m.png", f'"{said}"  # the "floor"'))
    assert read_grid(tmp_path / "m.yaml").cells.tolist() == [[OCCUPIED]]


STYLES = [
    "{image: m.png, resolution: 0.1, origin: [-1, 2.5, 0], negate: 0}",
    "image:\n  m.png\nresolution: 1e-1\norigin:\n- -1.0\n- 2.5\n- 0.0\n",
    "\ufeff" + YAML,
    "%YAML 1.1\n---\n" + YAML + "...\n",
    "# by hand\n---\n" + YAML.replace("0.1", "0.1\t# metres") + "mode: trinary # as usual\n",
    YAML + "   \n  # indented\nfloor: 3\nnote: 'a: b'\nempty:\n",
]
NEGATED = [YAML.replace("e: 0", f"e: {yes}") for yes in ("true", "True", "1", "YES", "on", "'y'")]


@pytest.mark.parametrize("text", [*STYLES, *NEGATED])
def test_any_style_of_yaml_is_read_and_negate_may_be_a_word(tmp_path: Path, text: str) -> None:
    grid = read_grid(write_image(tmp_path, np.full((1, 1), 255, dtype=np.uint8), text))
    assert (grid.resolution, grid.origin) == (0.1, (-1.0, 2.5))
    assert grid.cells.tolist() == [[OCCUPIED if text in NEGATED else FREE]]


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("shape", [(5, 7), (5, 7, 3)])
def test_pictures_are_the_same_bytes_every_time_and_come_back(
    tmp_path: Path, dtype: type[np.uint8 | np.uint16], shape: tuple[int, ...]
) -> None:
    most = np.iinfo(dtype).max
    image = np.random.default_rng(0).integers(0, most, shape, dtype=dtype, endpoint=True)
    for name in ("one.png", "two.png"):
        write_png(tmp_path / name, image)
    assert (tmp_path / "one.png").read_bytes() == (tmp_path / "two.png").read_bytes()
    back = cv2.imread(str(tmp_path / "one.png"), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(back, image)
    assert [path.name for path in sorted(tmp_path.iterdir())] == ["one.png", "two.png"]


def test_a_place_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    grid = GridMap(np.zeros((1, 1), dtype=np.uint8), 0.05)
    with pytest.raises(UsageError, match=r"gone/m\.png: cannot be written: No such file"):
        write_grid(tmp_path / "gone" / "m", grid)
    (tmp_path / "m.yaml").mkdir()
    with pytest.raises(UsageError, match=r"m\.yaml: is no regular file"):
        write_grid(tmp_path / "m", grid)


METRES, MAP = "expected 0.002 to 10 metres a cell", "expected a map_server YAML"


@pytest.mark.parametrize(
    ("yaml", "said"),
    [
        ("", f"no `image` entry: {MAP}"),
        ("- 1\n", f"no `image` entry: {MAP}"),
        ("a: b: c", f"line 1: mapping values are not allowed in this context: {MAP}"),
        (YAML.replace("m.png", ""), "image is '': expected the name of a picture"),
        (YAML + "x: " + "y" * 67_000, f"larger than 66 kB: {MAP}"),
        (YAML.replace("resolution", "x"), f"no `resolution` entry: {MAP}"),
        (YAML.replace("0.1", "[1, 2]"), f"resolution is '[1, 2]': {METRES}"),
        (YAML.replace("0.1", "-1"), f"resolution is '-1': {METRES}"),
        (YAML.replace("0.1", "5 cm"), f"resolution is '5 cm': {METRES}"),
        (YAML.replace("0.1", "1e9"), f"resolution is '1e9': {METRES}"),
        (YAML.replace("0.1", "1.0e-300"), f"resolution is '1.0e-300': {METRES}"),
        (YAML.replace("-1.0", "nan"), "origin is '[nan, 2.5, 0.0]': expected [x, y, 0]"),
        (YAML.replace("-1.0", "1:30"), "origin is '[1:30, 2.5, 0.0]': expected [x, y, 0]"),
        (YAML.replace("-1.0", "1e999"), "origin is '[1e999, 2.5, 0.0]': expected [x, y, 0]"),
        (YAML.replace("-1.0, 2.5, 0.0", "1"), "origin is '[1]': expected [x, y, 0]"),
        (YAML.replace("0.0]", "1.57]"), "origin is turned by 1.57 rad: turn the image, write 0"),
        (YAML.replace("negate: 0", "negate: 2"), "negate is '2': expected 0 or 1"),
        (YAML + "mode: cost\n", "mode is 'cost': expected one of trinary, scale, raw"),
        (YAML + "free_thresh: -0.1\n", "free_thresh is '-0.1': expected a number from 0 to 1"),
        (YAML + "occupied_thresh: 65\n", "occupied_thresh is '65': expected a number from 0 to 1"),
        (YAML + "free_thresh: 0.7\n", "free_thresh 0.7 is not below occupied_thresh 0.65"),
    ],
)
def test_what_is_said_of_a_damaged_map(tmp_path: Path, yaml: str, said: str) -> None:
    path = write_image(tmp_path, np.zeros((2, 2), dtype=np.uint8), yaml)
    with pytest.raises(MapError) as caught:
        read_grid(path)
    assert str(caught.value) == f"{path}: {said}"
    found, *advice = said.rsplit(": ", 1)
    assert (caught.value.found, caught.value.hint) == (found, advice[0] if advice else None)


def with_size(png: bytes, width: int, height: int) -> bytes:
    """A PNG whose header tells another size, with the checksum that fits."""
    header = b"IHDR" + struct.pack(">II", width, height) + png[24:29]
    return png[:12] + header + struct.pack(">I", zlib.crc32(header)) + png[33:]


@pytest.mark.parametrize(
    ("name", "head"),
    [
        ("m.pgm", b"P5 20000 20000 255\n"),
        ("m.pgm", b"P5\n# drawn by hand\n20000\n20000\n255\n"),
        ("m.bmp", b"BM" + bytes(16) + struct.pack("<ii", 20_000, -20_000) + bytes(28)),
        ("m.png", b""),
    ],
)
def test_too_many_pixels_are_refused(tmp_path: Path, name: str, head: bytes) -> None:
    head = head or with_size(grey_png(tmp_path).read_bytes(), 20_000, 20_000)
    (tmp_path / name).write_bytes(head)
    with pytest.raises(MapError) as caught:
        read_picture(tmp_path / name)
    assert str(caught.value) == (
        f"{tmp_path / name}: 20000 x 20000 pixels are more than 100 million: scale it down, "
        "or raise limits.picture_max_mpixel"
    )


def test_the_bounds_are_settings(tmp_path: Path) -> None:
    path = grey_png(tmp_path)
    assert read_picture(path, LimitsConfig(picture_max_mpixel=12e-6)).shape == (3, 4, 1)
    with pytest.raises(MapError, match=r"4 x 3 pixels are more than 1\.1e-05 million: scale it"):
        read_picture(path, LimitsConfig(picture_max_mpixel=11e-6))
    turn("grids", picture_max_mb=5e-5)
    with pytest.raises(MapError) as caught:
        read_picture(path)
    assert str(caught.value) == f"{path}: cannot read the image: larger than 5e-05 MB"


def test_want_of_memory_is_told_as_such(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = grey_png(tmp_path)
    error = cv2.error("Insufficient memory")
    error.code = cv2.Error.StsNoMem
    monkeypatch.setattr(cv2, "imdecode", Mock(side_effect=error))
    with pytest.raises(MemoryError, match=r"for the 4 x 3 pixels of .*m\.png"):
        read_picture(path)


@pytest.mark.parametrize("claimed", [0x7E097849, 0x00FFFFFF, 12])
def test_a_picture_that_claims_more_than_it_holds_reaches_no_decoder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, claimed: int
) -> None:
    """OpenCV would take gigabytes for a file of 52 bytes."""
    path, decode = tmp_path / "m.png", Mock()
    head = (13).to_bytes(4) + b"IHDR" + (428).to_bytes(4) + (268).to_bytes(4) + bytes(9)
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + head + claimed.to_bytes(4) + b"IDATx\x9c\xed\x9d")
    monkeypatch.setattr(cv2, "imdecode", decode)
    with pytest.raises(MapError, match="not an image that can be read"):
        read_picture(path)
    decode.assert_not_called()


@pytest.mark.parametrize("place", [20, 45, 55, -6, -1])
def test_libraries_say_nothing(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], place: int
) -> None:
    """libpng and OpenCV would write to stderr by themselves."""
    path = grey_png(tmp_path)
    encoded = bytearray(path.read_bytes())
    encoded[place] ^= 0xFF
    path.write_bytes(encoded)
    with suppress(MapError):  # some damage shows only in the colours
        read_picture(path)
    os.write(2, b"heard again\n")
    assert capfd.readouterr().err == "heard again\n"


def test_thresholds_are_those_of_map_server(tmp_path: Path) -> None:
    path = write_image(tmp_path, np.array([[0, 89, 90, 205, 206, 250, 254]], dtype=np.uint8))
    dark, unsure = [OCCUPIED] * 2, [UNKNOWN] * 2
    assert read_grid(path).cells.tolist() == [[*dark, *unsure, *[FREE] * 3]]
    bare = read_grid(tmp_path / "m.png", 0.1)  # light greys are edges of lines there
    assert bare.cells.tolist() == [[*dark, *unsure, UNKNOWN, OCCUPIED, FREE]]
