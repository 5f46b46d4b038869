"""The page of the paper's figures: its parts on a small building, and its frame by itself."""

import base64
import importlib.util
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import typer

from benchmarks.paper import (
    blocks,
    figure1,
    figure2,
    figure3,
    figure6,
    ring,
    room_hallway,
    table2,
    topology,
)
from benchmarks.paper.__main__ import main
from benchmarks.paper.blocks import Block, Chart, Gallery, Table, Words
from benchmarks.paper.cases import FREIBURG, LACKING, STATA, Cases, Drawing, cases, tour
from benchmarks.paper.first_return import first_return
from benchmarks.paper.page import Done, render
from benchmarks.paper.parts import PARTS
from benchmarks.paper.workshop import OURS, PAPER, Workshop
from benchmarks.real.closure_truth import judged, true_poses
from specmap_cli.cli.app import app
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.simulation.simulator import SimulationOptions
from specmap_cli.simulation.worlds import RoomTruth

QUICK = SimulationOptions(
    field_of_view_deg=360, beams=90, range_max_m=12, rate_hz=3, speed_mps=0.8, spacing_m=2.5
)


@pytest.fixture(scope="module")
def workshop(
    flat: GridMap, flat_rooms: RoomTruth, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Workshop]:
    """The flat in the manner of either building, one recording for both."""
    folder = tmp_path_factory.mktemp("paper")
    found = tour("flat, simulated", FREIBURG, Drawing(flat, flat_rooms), folder, QUICK)
    with Workshop(Cases((found, replace(found, manner=STATA, again=None)))) as shop:
        yield shop


def tables(blocks: list[Block]) -> list[Table]:
    return [block for block in blocks if isinstance(block, Table)]


def galleries(blocks: list[Block]) -> list[list[str]]:
    """The captions of the pictures of each gallery."""
    shown = (block.pictures for block in blocks if isinstance(block, Gallery))
    return [[picture.caption for picture in pictures] for pictures in shown]


def test_figure_1_shows_the_steps_with_both_presets(workshop: Workshop) -> None:
    """Each recording is registered once, and each map built once."""
    first = workshop.cases.found[0]
    assert workshop.recording(first) is workshop.recording(first)
    assert workshop.built(first, OURS) is workshop.built(first, OURS)
    assert workshop.built(first, OURS) is not workshop.built(first, PAPER)
    paper, ours = galleries(figure1.make(workshop))
    assert len(paper) == len(ours) == 2
    assert len({*paper, *ours}) == 4


def test_figure_2_divides_the_drawing_with_both_presets(workshop: Workshop) -> None:
    blocks = figure2.make(workshop)
    (table,) = tables(blocks)
    assert sum(map(len, galleries(blocks))) == 2
    assert [row.cells[1] for row in table.rows] == ["the paper's choices", "specmap's choices"]
    assert table.rows[1].cells[2] == "4"  # three rooms and the corridor
    assert float(table.rows[1].cells[3]) > 0.95


def test_figure_3_ends_with_the_test_that_split(workshop: Workshop) -> None:
    blocks = figure3.make(workshop)
    for captions in galleries(blocks):
        split = [caption.endswith("split") for caption in captions]
        assert split == [False] * (len(split) - 1) + [True]
    (chart,) = (block for block in blocks if isinstance(block, Chart))
    assert [series.level for series in chart.series] == [0.8, 0.6]
    assert len(tables(blocks)[0].rows) == 4


def test_figures_4_and_5_show_fewer_submaps_after_than_before(workshop: Workshop) -> None:
    blocks = topology.make(workshop, FREIBURG)
    (table,) = tables(blocks)
    assert {len(captions) for captions in galleries(blocks)} <= {2}
    ours = table.rows[1].cells
    assert ours[1] == "specmap's choices"
    assert int(ours[7]) < int(ours[2])


def test_the_first_return_is_shown_before_and_after(workshop: Workshop) -> None:
    case = workshop.cases.found[0]
    found = first_return(case, OURS, workshop)
    assert found is not None
    before, after = (int(re.findall(r"(\d+) submaps", p.caption)[0]) for p in found.pictures)
    assert before == after + 1
    built = workshop.built(case, OURS)
    alone = Workshop(workshop.cases)
    open_loops = replace(built.explored, closures=())
    alone._built[case.log, OURS, None] = replace(built, explored=open_loops)
    assert first_return(case, OURS, alone) is None


def test_every_merge_of_the_flat_is_right(workshop: Workshop) -> None:
    case = workshop.cases.found[0]
    built = workshop.built(case, OURS)
    base, laser = (true_poses(case.truth, built.store, of_laser=given) for given in (False, True))
    found = judged(built.explored, built.store, base)
    assert 0 < found.merges == found.right
    assert found.wrong == 0
    assert judged(built.explored, built.store, np.full_like(base, np.nan)).right == 0
    away = np.hypot(*(base - laser)[:, :2].T)  # poses of a laser are moved to the base
    assert np.allclose(away, built.store.base_from_laser(0).distance)


def test_figure_5c_sees_only_borders_of_hallways(workshop: Workshop) -> None:
    (table,) = tables(room_hallway.make(workshop))
    (row,) = table.rows
    assert row.cells[5].endswith(" %")
    (words,) = room_hallway.make(Workshop(Cases(())))
    assert isinstance(words, Words)
    assert words.warning


def test_table_2_stands_beside_the_published_figures(workshop: Workshop) -> None:
    (table,) = tables(table2.make(workshop))
    assert [row.cells[3:7] for row in table.rows if row.published] == [
        ("0.9728", "0.9818", "0.9089", "0.9212"),
        ("0.9689", "0.9739", "0.8300", "0.8458"),
    ]
    ours = [row for row in table.rows if row.cells[1] == "specmap's choices"]
    assert len(ours) == 2
    assert all(float(row.cells[5]) > 0.8 for row in ours)


def test_figure_6_labels_another_way(workshop: Workshop) -> None:
    blocks = figure6.make(workshop)
    (table,) = tables(blocks)
    assert sum(map(len, galleries(blocks))) == 2
    filtered = [r.cells for r in table.rows if r.cells[1:3] == ("specmap's choices", "filtered")]
    assert all(float(cells[6]) > 0.8 for cells in filtered)


def test_without_data_all_is_simulated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SPECMAP_DATA", str(tmp_path / "nowhere"))
    found = cases(tmp_path)
    assert {case.manner for case in found.found} == {FREIBURG, STATA}
    assert all(case.drawing is not None and case.again is not None for case in found.found)
    assert found.missing == tuple(LACKING)
    (tmp_path / "data" / "logs").mkdir(parents=True)
    monkeypatch.setenv("SPECMAP_DATA", str(tmp_path / "data"))
    assert cases(tmp_path).missing == ("fr079", "mit_csail", "plans")
    for folder, name in (("logs", "fr079.mcap"), ("truth", "fr079_corrected.tum")):
        (tmp_path / "data" / folder).mkdir(exist_ok=True)
        (tmp_path / "data" / folder / name).touch()
    with_one = cases(tmp_path)
    assert with_one.missing == ("mit_csail", "plans")
    assert with_one.found[0].name == "fr079, real"


def test_one_can_walk_from_every_room_of_the_ring_to_every_other() -> None:
    plan, rooms = ring.plan(), ring.rooms()
    wide = (plan.clearance() > 0.3).astype(np.uint8)
    _, part = cv2.connectedComponents(wide)
    inside = ((rooms.labels == number) & (wide > 0) for number in range(1, rooms.count + 1))
    reached = [set(part[cells].tolist()) for cells in inside]
    assert rooms.count == len(ring.ROOMS) + 1
    assert set.intersection(*reached)


BLOCKS: list[blocks.Block] = [
    blocks.Found("three of <four>.", "because of this"),
    blocks.Words("plain <words>"),
    blocks.Words("a warning", warning=True),
    blocks.Table(
        ("map", "recall"),
        [blocks.Row(("a & b", "0.900")), blocks.Row(("paper", "0.8"), published=True)],
    ),
    blocks.Gallery([blocks.Picture(np.full((4, 6, 3), 7, dtype=np.uint8), "a picture")], across=3),
    blocks.Chart(
        [blocks.Series("one", [(0.0, 0.1), (2.0, 0.9)], frozenset({1}), 0.8)], "s", "value", top=1.0
    ),
]


@pytest.fixture(scope="module")
def page() -> str:
    done = [Done(PARTS[1], BLOCKS, 12.3), Done(PARTS[2], [], 0.0)]
    return render(done, Cases((), missing=("plans", "fr079")), "python -m this")


def test_every_kind_of_block_is_shown_and_what_is_missing_and_how_it_was_made(page: str) -> None:
    assert "plain &lt;words&gt;" in page
    assert '<p class="warning">a warning</p>' in page
    assert '<tr class="published"><td>paper</td><td class="n">0.8</td></tr>' in page
    assert "a &amp; b" in page
    assert 'three of &lt;four&gt;. <span class="why">because of this</span>' in page
    assert page.count('class="filled"') == 1
    assert "SPECMAP_DATA names no folder with the plans" in page
    assert page.count("Missing here: the plans drawn by hand (rooms/).") == 2
    assert "<code>python -m this</code>" in page
    assert "<code>python -m benchmarks.paper --only figure2</code>" in page
    assert "12 s of processor time" in page
    assert page.count("<section") == 2


def test_a_picture_is_in_the_page_itself_and_nothing_is_loaded_from_elsewhere(page: str) -> None:
    assert not re.search(r"https?:|<script|<link|@import|url\(", page)
    (data,) = re.findall(r'src="data:image/png;base64,([^"]+)"', page)
    decoded = cv2.imdecode(np.frombuffer(base64.b64decode(data), dtype=np.uint8), cv2.IMREAD_COLOR)
    assert decoded is not None
    assert (decoded.min(), decoded.max()) == (7, 7)


def test_every_part_of_the_paper_is_there_and_its_commands_exist(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", ["paper", "--only", "figure9"])
    with pytest.raises(SystemExit):
        main()
    assert "figure9" in capsys.readouterr().err
    names = "figure1 figure2 figure3 figure4 figure5 figure5c table1 table2 figure6 cost"
    assert [part.name for part in PARTS] == names.split()
    assert len({part.title for part in PARTS}) == len(PARTS)
    commands = [command for part in PARTS for command in part.commands]
    known = typer.main.get_command(app).commands  # type: ignore[attr-defined]
    for command in commands:
        words = command.split()
        if words[0] == "specmap":
            options = {option for p in known[words[1]].params for option in p.opts}
            assert {word for word in words if word.startswith("-")} <= options, command
        else:
            assert importlib.util.find_spec(words[2]) is not None, command
