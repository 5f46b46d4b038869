from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from specmap_cli.core.errors import MapError
from specmap_cli.core.geometry import Pose2
from specmap_cli.grids.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap
from specmap_cli.grids.map_server import read_grid, write_grid
from specmap_cli.topology.topological_map import Submap

YAML = "image: m.png\nresolution: 0.1\norigin: [-1.0, 2.5, 0.0]\nnegate: 0\n"


def submap(id_: int, frame: Pose2, grid: GridMap) -> Submap:
    return Submap(id_, frame, [], [], grid)


def write_image(directory: Path, image: NDArray[Any], yaml: str = YAML) -> Path:
    assert cv2.imwrite(str(directory / "m.png"), image)
    (directory / "m.yaml").write_text(yaml)
    return directory / "m.yaml"


@settings(max_examples=25, derandomize=True)
@given(
    st.integers(1, 9),
    st.integers(1, 9),
    st.sampled_from([0.05, 0.1, 0.025]),
    st.floats(-500, 500),
    st.integers(0, 1000),
)
def test_there_and_back(
    tmp_path_factory: pytest.TempPathFactory,
    height: int,
    width: int,
    res: float,
    x: float,
    seed: int,
) -> None:
    cells = np.random.default_rng(seed).integers(0, 3, (height, width)).astype(np.uint8)
    stem = tmp_path_factory.mktemp("grid") / "000"
    write_grid(stem, GridMap(cells, res, (x, -x)))
    back = read_grid(stem.with_suffix(".yaml"))
    assert (back.cells == cells).all()
    assert back.resolution == res
    assert back.origin == pytest.approx((x, -x), abs=1e-6)


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


def test_an_empty_grid_is_one_unknown_cell(tmp_path: Path) -> None:
    write_grid(tmp_path / "m", GridMap(np.zeros((0, 0), dtype=np.uint8), 0.05))
    assert read_grid(tmp_path / "m.yaml").cells.tolist() == [[UNKNOWN]]


def test_maps_of_other_tools(tmp_path: Path) -> None:
    image = np.array([[255, 0], [205, 120]], dtype=np.uint8)
    block = "image: 'm.png'  # ours\nresolution: 1e-1\norigin:\n- -1.0\n- 2.5\n- 0\n"
    grid = read_grid(write_image(tmp_path, image, block))
    assert grid.cells.tolist() == [
        [FREE if 50 / 255 < 0.196 else UNKNOWN, UNKNOWN],
        [FREE, OCCUPIED],
    ]
    assert (grid.resolution, grid.origin) == (0.1, (-1.0, 2.5))
    negated = read_grid(write_image(tmp_path, image, YAML.replace("negate: 0", "negate: 1")))
    assert negated.cells[1].tolist() == [OCCUPIED, FREE]


def test_colours_and_transparency(tmp_path: Path) -> None:
    image = np.full((1, 2, 4), 255, dtype=np.uint8)
    image[0, 1, 3] = 0
    assert read_grid(write_image(tmp_path, image)).cells.tolist() == [[FREE, UNKNOWN]]
    deep = np.array([[0, 65535]], dtype=np.uint16)
    assert read_grid(write_image(tmp_path, deep)).cells.tolist() == [[OCCUPIED, FREE]]
    assert read_grid(tmp_path / "m.png", 0.2).resolution == 0.2


def test_percent_as_they_stand(tmp_path: Path) -> None:
    image = np.array([[0, 100, 50, 255]], dtype=np.uint8)
    grid = read_grid(write_image(tmp_path, image, YAML + "mode: raw\n"))
    assert grid.cells.tolist() == [[FREE, OCCUPIED, UNKNOWN, UNKNOWN]]


def test_a_given_resolution_wins(tmp_path: Path) -> None:
    path = write_image(tmp_path, np.zeros((2, 2), dtype=np.uint8))
    assert read_grid(path, 0.25).resolution == 0.25
    with pytest.raises(MapError, match="above 0"):
        read_grid(path, -1.0)
    with pytest.raises(MapError, match="--resolution"):
        read_grid(tmp_path / "m.png")


@pytest.mark.parametrize(
    ("yaml", "complaint"),
    [
        ("resolution: 0.1\norigin: [0, 0, 0]\n", "no `image`"),
        (YAML.replace("0.1", "0"), "resolution is 0"),
        (YAML.replace("0.1", "fine"), "resolution is 'fine'"),
        (YAML.replace("resolution", "scale"), "no `resolution`"),
        (YAML.replace("[-1.0, 2.5, 0.0]", "[1]"), "origin"),
        (YAML.replace("0.0]", "0.7]"), "turned by 0.7"),
        (YAML + "occupied_thresh: 65\n", "occupied_thresh"),
        (YAML + "mode: cubic\n", "mode is 'cubic'"),
        (YAML + "free_thresh: 0.7\n", "free_thresh 0.7 is not below"),
        (YAML.replace("m.png", "gone.png"), "gone.png"),
        (YAML.replace("m.png", "m.yaml"), "not an image"),
    ],
)
def test_damaged_yaml_is_one_line(tmp_path: Path, yaml: str, complaint: str) -> None:
    path = write_image(tmp_path, np.zeros((2, 2), dtype=np.uint8), yaml)
    with pytest.raises(MapError, match=complaint) as caught:
        read_grid(path)
    assert "\n" not in str(caught.value)
    assert str(tmp_path) in str(caught.value)


def test_unreadable_files_are_one_line(tmp_path: Path) -> None:
    (tmp_path / "empty.png").write_bytes(b"")
    (tmp_path / "binary.yaml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(MapError, match="not an image"):
        read_grid(tmp_path / "empty.png", 0.1)
    with pytest.raises(MapError, match="No such file"):
        read_grid(tmp_path / "gone.yaml")
    with pytest.raises(MapError, match="not a text file"):
        read_grid(tmp_path / "binary.yaml")
