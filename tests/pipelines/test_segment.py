"""Dividing a finished map: from a picture to a directory, and what it says of itself."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from specmap_cli import read_map, segment_map
from specmap_cli.core.config import load_config
from specmap_cli.core.errors import NoResultError, UsageError
from specmap_cli.core.records import IntArray
from specmap_cli.grids.gridmap import FREE, UNKNOWN, GridMap
from specmap_cli.grids.map_server import write_grid
from specmap_cli.pipelines.edit import edit_map
from tests.maps.conftest import edit


def test_rooms_of_the_flat_are_found_with_the_settings_given(plan: Path, tmp_path: Path) -> None:
    report = segment_map(str(plan), str(tmp_path / "rooms"))
    found = report.as_dict()
    assert found["out"] == str(tmp_path / "rooms")
    assert found["submaps"] == 4
    assert found["edges"] == 3
    stored = read_map(tmp_path / "rooms")
    assert stored.ids == [0, 1, 2, 3]
    assert [log.name for log in stored.logs] == ["flat.yaml"]
    for edge in stored.record.edges:
        assert edge.kind == "doorway"
        assert edge.width_m == pytest.approx(0.9, abs=0.1)
        assert edge.path is not None
    assert found["doors"] == len(stored.record.graph.doors) == 3
    assert all((node.anchor_clearance_m or 0.0) >= 0.3 for node in stored.record.nodes)
    area = f"{found['area_m2']:.0f} m2"
    assert report.lines()[0] == f"{tmp_path / 'rooms'}: 4 submaps, 3 edges, 3 doors, {area}"
    assert found["seen_m2"] == 0.0
    labels = cv2.imread(str(tmp_path / "rooms" / "labels.png"), cv2.IMREAD_UNCHANGED)
    grid = cv2.imread(str(plan.with_suffix(".png")), cv2.IMREAD_UNCHANGED)
    assert labels is not None
    assert grid is not None
    assert labels.dtype == np.uint16
    assert labels.shape == grid.shape
    assert set(np.unique(labels).tolist()) == {0, 1, 2, 3, 4}
    # one area everywhere: that of the free cells of the submaps, without the desk
    area_m2 = np.count_nonzero((labels > 0) & (grid == 254)) * 0.05**2
    grids = sum(stored.grids[i].free_area_m2 for i in stored.ids)
    assert [found["area_m2"], stored.record.area_m2, grids] == pytest.approx([area_m2] * 3)
    assert (labels[grid == 0] == 0).mean() > 0.9  # walls belong to nobody; the desk to its room
    config = load_config(overrides={"segmentation": {"eigenvalue_min": 0.999, "halve": False}})
    assert segment_map(plan, tmp_path / "whole", config).as_dict()["submaps"] == 1


def test_a_fan_of_rays_through_a_window_is_no_room(flat: GridMap, tmp_path: Path) -> None:
    cells = np.pad(flat.cells, ((0, 0), (0, 80)), constant_values=UNKNOWN)
    cells[69:73, 176:180] = FREE  # the window
    for column in range(180, 250):
        reach = 2 + (column - 180) // 3
        cells[71 - reach : 71 + reach, column] = FREE
    write_grid(tmp_path / "plan", GridMap(cells, 0.05))
    report = segment_map(tmp_path / "plan.yaml", tmp_path / "rooms")
    stored = read_map(tmp_path / "rooms")
    assert len(stored.ids) == 4
    (piece,) = stored.record.graph.seen
    fan_m2 = np.count_nonzero(cells[:, 180:] == FREE) * 0.05**2
    assert piece.area_m2 == pytest.approx(fan_m2, abs=0.3)
    assert report.as_dict()["seen_m2"] == pytest.approx(piece.area_m2)
    assert report.lines()[0].endswith(f" m2, and {piece.area_m2:.0f} m2 only seen")
    assert 180 * 0.05 < piece.x < 250 * 0.05
    assert piece.y == pytest.approx(71 * 0.05, abs=0.5)
    told = (tmp_path / "rooms" / "topology.json").read_text(encoding="utf-8")
    edit(tmp_path / "rooms" / "topology.json", graph__seen=[])  # as a map of an earlier version
    picture = (tmp_path / "rooms" / "overview.png").read_bytes()
    edit_map(tmp_path / "rooms")
    assert (tmp_path / "rooms" / "topology.json").read_text(encoding="utf-8") == told
    assert (tmp_path / "rooms" / "overview.png").read_bytes() == picture


TILES = np.arange(1_098) % 6 < 4
TOO_FINE = r"wider than 0\.5 m in the map \(.* free\): check the resolution"


@pytest.mark.parametrize(
    ("pixels", "resolution", "error", "words"),
    [
        (None, 0.6, UsageError, "too coarse to see a door"),
        (None, 0.004, NoResultError, TOO_FINE),
        (np.outer(TILES, TILES) * 254, 0.2, NoResultError, "more than 32,766 pieces of free space"),
        (np.full((40, 60), 0), 0.05, NoResultError, r"no free space wider than 0\.5 m"),
        (np.full((40, 60), 205), 0.05, NoResultError, r"no free space wider than 0\.5 m"),
    ],
    ids=["coarse", "fine", "more pieces than labels", "walls", "unknown"],
)
def test_what_cannot_be_divided_is_one_line_and_leaves_nothing(
    pixels: IntArray | None,
    resolution: float,
    error: type[Exception],
    words: str,
    plan: Path,
    tmp_path: Path,
) -> None:
    """The flat, or other pictures; what is no plan: tests/cli/test_cli_maps.py."""
    picture = plan.with_suffix(".png")
    if pixels is not None:
        picture = tmp_path / "plan.png"
        cv2.imwrite(str(picture), pixels.astype(np.uint8))
    with pytest.raises(error, match=words) as caught:
        segment_map(picture, tmp_path / "rooms", resolution=resolution)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "rooms").exists()
