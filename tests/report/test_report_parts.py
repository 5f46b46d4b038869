"""What the page is made of: places, outlines, the way, colours, html."""

from __future__ import annotations

import itertools
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.records import Labels
from specmap_cli.drawing.palette import FILLS, Colour
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.recognition.features.sets import feature_names
from specmap_cli.report import html
from specmap_cli.report.evidence import MOST_POINTS, Track
from specmap_cli.report.html import Frame, outlines, path_data, tones
from tests.drawing.seeing import contrast, least_difference, seen_lab

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
    assert html.shown("  a\n\tb\x1b[31m ") == "a b\\x1b[31m"
    assert [name for name in feature_names("full") if not html.feature_words(name)] == []
    assert html.feature_words("somebody_else_s") == ""
