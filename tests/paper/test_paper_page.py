"""The frame of the page: what is on it, and that it needs nothing beside itself."""

from __future__ import annotations

import base64
import importlib.util
import re

import cv2
import numpy as np
import pytest
import typer

from benchmarks.paper import blocks
from benchmarks.paper.__main__ import main
from benchmarks.paper.blocks import figure
from benchmarks.paper.cases import Cases
from benchmarks.paper.charts import drawn, ticks
from benchmarks.paper.page import Done, render
from benchmarks.paper.parts import PARTS
from specmap_cli.cli.app import app

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


def test_a_chart_is_drawn_to_scale_with_round_ticks_and_no_figure_is_a_dash() -> None:
    at = drawn(blocks.Chart([blocks.Series("one", [(0.0, 0.0), (5.0, 2.0)])], "x", "y"))
    (line,) = at.lines
    assert line.points.split() == [f"{at.left}.0,{at.bottom}.0", f"{at.right}.0,{at.top}.0"]
    assert line.level is None
    assert [tick.text for tick in at.up] == ["0", "0.5", "1", "1.5", "2"]
    assert at.across[-1].at == at.right
    assert ticks(1.0) == [0.0, 0.2, 0.4, 0.6, 0.8, 1.0]
    assert ticks(160) == [0.0, 50.0, 100.0, 150.0]
    assert figure(float("nan")) == "–"
    assert figure(0.12345) == "0.123"
