"""What the page is made of: places, outlines, way, colours, html; and what is found out for it."""

import itertools
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.errors import MapError
from specmap_cli.core.progress import Silent
from specmap_cli.core.records import Labels
from specmap_cli.drawing.palette import FILLS, Colour
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.maps.store import Map, read_map
from specmap_cli.pipelines.report import evidence_of, report_map
from specmap_cli.pipelines.segment import segment_map
from specmap_cli.recognition.features.sets import feature_names
from specmap_cli.recognition.learning.boosting import StumpBoost, TreeBoost, feature_shares
from specmap_cli.recognition.learning.trees import Forest
from specmap_cli.report import html
from specmap_cli.report.html import Frame, outlines, path_data, tones
from specmap_cli.report.layers import MOST_POINTS, Evidence, Track
from tests.drawing.looking import contrast, least_difference, seen_lab
from tests.flats import Explained
from tests.maps.conftest import edit

FRAME = Frame(-2.0, 8.0, 1000, 1000)
TEXT = ("ink", "quiet", "way", "loose", "wrong")  # what words are written in


def drawn(data: str) -> list[list[tuple[int, int]]]:
    """The points of path data, read the way a browser does."""
    lines: list[list[tuple[int, int]]] = []
    for start, steps in re.findall(r"M(-?\d+ -?\d+)l?([-\d ]*)", data):
        moves = [int(each) for each in re.findall(r"-?\d+", f"{start} {steps}")]
        points = np.cumsum(np.reshape(moves, (-1, 2)), axis=0)
        lines.append([(x, y) for x, y in points.tolist()])
    return lines


@given(st.lists(st.tuples(st.integers(-9999, 9999), st.integers(-9999, 9999)), min_size=2))
def test_a_line_comes_back_as_it_was_but_for_repeated_points(points: list[tuple[int, int]]) -> None:
    line = np.array(points)
    moved = np.any(np.diff(line, axis=0) != 0, axis=1)
    kept = line[np.concatenate([[True], moved])]
    if moved.any():
        assert drawn(path_data([line])) == [[tuple(point) for point in kept.tolist()]]
    else:
        assert path_data([line]) == f"M{points[0][0]} {points[0][1]}h0"


def test_cells_keep_their_outline_and_their_holes_and_slanted_stairs_become_a_line() -> None:
    cells = np.zeros((40, 60), dtype=bool)
    cells[5:35, 10:50] = True
    cells[15:25, 20:30] = False
    rings = outlines(cells, GridMap(cells.astype(np.uint8), 0.1, (1.0, 2.0)))
    rim, hole = sorted(rings, key=lambda ring: -np.ptp(ring[:, 0]))
    # a quarter of a cell inside of the cells
    assert rim.min(axis=0) == pytest.approx((1.0 + 1.025, 2.0 + 0.525))
    assert rim.max(axis=0) == pytest.approx((1.0 + 4.975, 2.0 + 3.475))
    assert np.ptp(hole, axis=0) == pytest.approx((1.05, 1.05))
    cells = np.tril(np.ones((50, 50), dtype=bool))
    (ring,) = outlines(cells, GridMap(cells.astype(np.uint8), 0.1))
    assert len(ring) < 8


def labels_of(count: int) -> Labels:
    """A way along x, a keyframe a second, in submaps 3, then 7."""
    seconds = np.arange(count)
    return Labels(
        stamps_ns=1_700_000_000_000_000_000 + seconds * 1_000_000_000,
        poses=np.column_stack([0.1 * seconds, np.zeros(count), np.zeros(count)]),
        submaps=np.where(seconds < count // 2, 3, 7),
    )


def test_the_table_of_the_way_adds_up_with_up_in_the_map_up_in_the_drawing() -> None:
    track = Track.of(labels_of(10), (), np.linspace(0.1, 1.0, 10))
    table = track.table(FRAME)
    assert np.cumsum(table["t"]).tolist() == list(range(0, 100, 10))
    assert np.cumsum(table["x"]).tolist() == list(range(200, 300, 10))
    assert set(np.cumsum(table["y"])) == {800}
    assert table["s"] == [[3, 5], [7, 5]]
    assert table["fit"] == list(range(10, 110, 10))
    assert track.visits() == [(0.0, 5.0, 3), (5.0, 9.0, 7)]
    frame = Frame.around(track.poses[:, :2])  # with a margin of half a metre
    assert (frame.width, frame.height, frame.place((0.0, 0.0))) == (190, 100, (50, 50))


def test_no_line_is_drawn_between_recordings_and_a_long_way_is_thinned() -> None:
    count = 3 * MOST_POINTS
    labels, whole = labels_of(40), Track.of(labels_of(count), (), None)
    labels.stamps_ns[20:] += 86_400 * 10**9
    labels.poses[20:, 1] += 7.0
    track = Track.of(labels, (20,), None)
    assert (track.duration_s, track.starts) == (38.0, (0.0, 19.0)), "no time passes between them"
    broken, thinned = (
        [line for _, data in each.by_time(FRAME) for line in drawn(data)] for each in (track, whole)
    )
    assert all(len({y for _, y in line}) == 1 for line in broken)
    assert (len(whole.seconds), whole.total) == (MOST_POINTS, count)
    assert whole.seconds[-1] == count - 1
    assert max(line[-1] for line in thinned)[0] == FRAME.place((0.1 * (count - 1), 0.0))[0]


def bgr(css: str) -> Colour:
    blue, green, red = (int(css[k : k + 2], 16) for k in (5, 3, 1))
    return blue, green, red


@pytest.mark.parametrize("which", ["day", "night"])
def test_words_and_lines_are_legible_and_what_was_only_seen_differs(which: str) -> None:
    colours = {name: bgr(getattr(tone, which)) for name, tone in tones(FILLS).items()}
    for name, colour in colours.items():
        if name.startswith("fill"):
            assert contrast(colours["ink"], colour) >= 3.0, f"walls on {name}"
            assert least_difference(colours["seen"], colour) > 7.0, name
        elif name not in ("paper", "shade", "seen", "hair"):
            # lines have a rim of paper wherever they run; words stand on paper
            assert contrast(colour, colours["paper"]) >= (4.5 if name in TEXT else 3.0), name
    assert least_difference(colours["seen"], colours["paper"]) > 7.0


def test_regions_that_differ_by_day_differ_by_night() -> None:
    fills = [tone for name, tone in tones(FILLS).items() if name.startswith("fill")]
    for pair in itertools.combinations(fills, 2):
        day, night = (
            np.linalg.norm(np.subtract(*seen_lab([bgr(code) for code in codes], "usual")))
            for codes in ([one.day for one in pair], [one.night for one in pair])
        )
        assert night >= 0.5 * day


def test_figures_texts_and_features_read_as_people_write_them() -> None:
    assert [html.clock(s) for s in (7, 65, 3700)] == ["0:07", "1:05", "1:01:40"]
    assert [html.lasting(s) for s in (65, 600, 3700)] == ["65 s", "10 min", "1 h 2 min"]
    assert html.moment(1211.52) == "1211.5 s", "counts from no day"
    assert html.moment(1_700_000_000.0) == "2023-11-14 22:13:20 UTC"
    assert [name for name in feature_names("full") if not html.feature_words(name)] == []
    assert html.feature_words("somebody_else_s") == ""


@pytest.fixture(scope="module")
def found(flat_map: Map) -> Evidence:
    return evidence_of(flat_map, Silent())


def test_scans_fit_their_walls_and_submaps_are_likened(found: Evidence, flat_map: Map) -> None:
    assert found.fit is not None
    assert len(found.fit) == len(flat_map.labels.stamps_ns)
    assert np.nanmedian(found.fit) > 0.9
    assert np.nanmax(found.fit) <= 1.0
    assert sorted(found.learned) == flat_map.ids
    for id_, learned in found.learned.items():
        assert learned.right > 0.8
        assert 0 < learned.scans <= 60
        assert id_ not in {submap for submap, _ in learned.alike}
        shares = [share for _, share in learned.alike]
        assert shares == sorted(shares, reverse=True)
        assert sum(shares) == pytest.approx(1.0, abs=0.05)
        assert sum(share for _, share in learned.features) <= 1.0 + 1e-9


def test_tests_are_the_build_s(found: Evidence, flat_map: Map, flat_built: Explained) -> None:
    assert len(found.tests) == len(list(flat_built.pictures.iterdir()))
    assert any(one.split for one in found.tests)
    grid = flat_map.map_grid
    for one in found.tests:
        assert one.split <= (one.eigenvalue > found.threshold)
        assert len(one.nodes) == len(one.sides)
        assert grid.inside(grid.cells_of(one.nodes)).all()  # in the map, not as registered


def test_a_map_without_scans_says_so(flat_map: Map, tmp_path: Path) -> None:
    own = Path(shutil.copytree(flat_map.path, tmp_path / "own"))
    (own / "keyframes.mcap").unlink()
    found = evidence_of(read_map(own), Silent())
    assert found.tests == ()
    assert found.fit is None
    assert found.learned[0].features
    assert found.learned[0].scans == 0
    (note,) = found.notes
    assert "keeps no scans" in note


def test_a_divided_plan_has_a_page_unless_it_is_torn_apart(plan: Path, tmp_path: Path) -> None:
    rooms = segment_map(plan, tmp_path / "rooms").out
    page = report_map(rooms)
    assert page.count('class="region"') == len(read_map(rooms).ids) > 2
    assert 'id="time"' not in page
    assert "No classifiers" in page
    (rooms / "map.yaml").unlink()
    edit(rooms / "topology.json", graph__files={})  # as by earlier versions, which did not write it
    assert report_map(rooms).count('class="region"') == page.count('class="region"')
    edit(rooms / "topology.json", nodes__0__x=1e8)
    with pytest.raises(MapError, match="its submaps lie so far apart"):
        report_map(rooms)


def test_the_older_map_is_drawn(flat_map: Map) -> None:
    page = report_map(flat_map, flat_map)
    assert 'class="old-walls"' in page
    assert "map: identical to map" in page
    assert str(flat_map.path) not in page


def test_features_share_by_how_far_apart_the_votes_lie() -> None:
    X = np.array([[0.0, 5.0], [1.0, 5.0], [2.0, 5.0], [3.0, 5.0]])
    y = np.array([-1, -1, 1, 1])
    assert feature_shares(StumpBoost(("a", "b")).fit(X, y)).tolist() == [1.0, 0.0]
    assert feature_shares(StumpBoost(("a", "b"))).tolist() == [0.0, 0.0]
    forest = Forest(np.array([[0, 1, 2]]), np.full((1, 3), 0.5), np.array([[-1.0, -1.0, 1.0, 3.0]]))
    shares = feature_shares(TreeBoost(("a", "b", "c", "d"), forest))
    # the root parts -1 from 2, on average; the node above parts 1 from 3 for every second scan
    assert shares == pytest.approx([0.75, 0.0, 0.25, 0.0])
