"""The scoreboard: rows and their bars, sections that are measured once, pages and what changed."""

import json
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

from benchmarks.scoreboard import page
from benchmarks.scoreboard.__main__ import main
from benchmarks.scoreboard.bench import Bench
from benchmarks.scoreboard.digest import digest
from benchmarks.scoreboard.rows import Figure, Figures, Row, Section
from benchmarks.scoreboard.running import Done, folder_of, measure, read, rows_of, run
from benchmarks.scoreboard.sections import SECTIONS

WALLS = Row("walls", "walls that agree", 0.9, 1.0)
SECONDS = Row("seconds", "the time", 4.0, None, "less", ".1f", "s", "KISS-ICP | 2.0 s")
TOLD = Row("told", "what is told", better="none")
MODULE = "tests.benchmarks.measured"
SECTION = Section("made", "What was made", MODULE)


@pytest.fixture
def measured() -> Iterator[list[Figures]]:
    """A section whose `measure` gives the first of these figures, and the next when asked again."""
    figures: list[Figures] = []
    module = ModuleType(MODULE)
    module.ROWS = (WALLS, SECONDS, TOLD)  # type: ignore[attr-defined]
    module.measure = lambda _: figures.pop(0)  # type: ignore[attr-defined]
    sys.modules[MODULE] = module
    yield figures
    del sys.modules[MODULE]


def made(walls: float, seconds: list[float], **more: Figure) -> dict[str, Figure]:
    return {"walls": Figure(walls), "seconds": Figure.of(seconds), "told": Figure(3.0), **more}


def page_of(figures: dict[str, Figure], before: page.Page | None = None) -> page.Page:
    return page.page_of([SECTION], {"made": Done(figures, 12.3)}, before)


class TestRows:
    def test_a_figure_is_held_against_its_bar_as_it_is_printed(self) -> None:
        assert WALLS.reaches(0.8996, 0.9)
        assert not WALLS.reaches(0.8994, 0.9)
        assert SECONDS.reaches(4.04, 4.0)
        assert not SECONDS.reaches(4.06, 4.0)
        assert SECONDS.text(4.06) == "4.1 s"
        assert Row("lines", "lines", 47_000, form=",.0f", better="less").reaches(46_999.6, 47_000)
        assert WALLS.text(None) == WALLS.text(float("nan")) == "-"
        # the median of repeats, with the least and the largest
        assert Figure.of([3.0, 1.0, 2.0]) == Figure(2.0, 1.0, 3.0)
        assert Figure.of([1.0, 2.0]).value == 1.5

    def test_every_section_has_rows_of_its_own_and_names_them_once(self) -> None:
        names = [section.name for section in SECTIONS]
        assert len(set(names)) == len(names)
        for section in SECTIONS:
            rows = rows_of(section)
            assert len({row.key for row in rows}) == len(rows) > 0, section.name
            assert all(row.better != "none" or row.must is None for row in rows), section.name
            assert callable(getattr(sys.modules[section.module], "measure", None)), section.name


class TestRunning:
    def test_nothing_is_measured_twice(self, measured: list[Figures], tmp_path: Path) -> None:
        measured.append({"walls": 0.5, "seconds": Figure.of([1.0, 3.0]), "told": 2})
        folder = tmp_path / digest()
        done = measure(SECTION, folder)
        assert done.figures["walls"] == Figure(0.5)
        kept = read(SECTION, folder)
        assert kept is not None
        assert kept.figures == done.figures
        (tmp_path / "another tree").mkdir()
        assert run([SECTION], folder_of(tmp_path))["made"].figures == done.figures
        assert not (tmp_path / "another tree").exists()

    def test_rows_of_no_data_say_so(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setenv("SPECMAP_DATA", str(tmp_path / "nowhere"))
        lacking = Section("cold", "Rooms", "benchmarks.real.cold", ("cold", "rooms"))
        assert run([lacking], folder_of(tmp_path))["cold"].why == "no data: cold, rooms"

    def test_a_tree_that_is_changed_meanwhile_has_no_page(self, tmp_path: Path) -> None:
        with pytest.raises(RuntimeError, match="changed while they were measured"):
            run([], tmp_path / "another tree")

    @pytest.mark.parametrize("wrong", [{"walls": 1.0}, made(1.0, [1.0], more=Figure(1.0))])
    def test_figures_of_other_rows_are_a_mistake(
        self, measured: list[Figures], tmp_path: Path, wrong: Figures
    ) -> None:
        measured.append(wrong)
        with pytest.raises(RuntimeError, match="made: rows"):
            measure(SECTION, tmp_path)
        assert read(SECTION, tmp_path) is None

    def test_a_map_is_made_once(self, tmp_path: Path) -> None:
        bench, source = Bench(tmp_path), tmp_path / "source"
        source.mkdir()
        bench.adopt("fr079", source)
        (source / "later").touch()
        bench.adopt("fr079", source)
        assert list((tmp_path / "maps" / "fr079").iterdir()) == []
        assert bench.recorded("fr079") == tmp_path / "maps" / "fr079"


@pytest.mark.usefixtures("measured")
class TestPage:
    def test_it_is_read_as_it_was_written(self) -> None:
        one = page_of(made(0.95, [3.9, 4.5, 4.1]))
        assert json.loads(page.json_text(one)) == one
        figures = {"made.walls": 0.95, "made.seconds": 4.1, "made.told": 3.0}
        assert dict(page.figures_in(one)) == figures

    def test_the_text_has_bars_spreads_and_peers(self) -> None:
        text = page.markdown(page_of(made(0.95, [3.9, 4.5, 4.1])))
        assert f"`{digest()}`" in text
        assert "## What was made\n`python -m benchmarks.scoreboard --only made`" in text
        assert "| walls that agree | **0.950** | 0.900 | 1.000 |  |  |" in text
        assert "| the time | 4.1 s (3.9 to 4.5) | 4.0 s |  |  | KISS-ICP \\| 2.0 s |" in text

    def test_a_section_that_is_not_there_says_why(self) -> None:
        lacking = page.page_of([SECTION], {"made": Done({}, why="no data: rooms")}, None)
        assert "--only made` (no data: rooms)" in page.markdown(lacking)
        assert "| walls that agree | - | 0.900 | 1.000 |  |  |" in page.markdown(lacking)

    def test_the_figure_before_is_that_of_another_tree(self) -> None:
        first = page_of(made(0.8, [5.0]))
        first["digest"] = "another tree"
        second = page_of(made(0.9, [4.0]), first)
        assert second["sections"][0]["rows"][0]["before"] == 0.8
        assert page_of(made(0.91, [4.0]), second)["sections"][0]["rows"][0]["before"] == 0.8

    def test_changes_are_those_beyond_what_repeats_show(self) -> None:
        old = page_of(made(0.90, [4.0, 4.4, 5.0]))
        assert page.compared(old, page_of(made(0.9004, [4.9, 5.1, 5.2]))) == []
        told = page.compared(old, page_of(made(0.88, [3.0, 3.1])))
        heads = [line.split()[0] for line in told]
        assert heads == ["worse:", "made.walls", "better:", "made.seconds"]
        assert "0.900 -> 0.880" in told[1]
        assert page.compared(old, page_of({}))[0] == "gone:"
        assert page.compared(page_of({}), old)[0] == "new:"

    def test_another_tree_is_told(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(page, "JSON", tmp_path / "scoreboard.json")
        assert "no page yet" in page.state()
        mine = page_of(made(0.9, [4.0]))
        page.JSON.write_text(page.json_text(mine), encoding="utf-8")
        assert "is of this tree" in page.state()
        page.JSON.write_text(page.json_text({**mine, "digest": "012345678901"}), encoding="utf-8")
        assert "is of another tree (012345678901, " in page.state()
        assert "\n" not in page.state()


def test_the_command_lists_what_can_be_asked_for_and_refuses_an_unknown_row(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "argv", ["scoreboard", "--list"])
    assert main() == 0
    listed = capsys.readouterr().out
    assert "cold: Rooms of real maps" in listed
    assert re.search(r"cold\.iou +IoU", listed)
    asked = ["scoreboard", "--work", str(tmp_path), "--only", "cold.walls"]
    monkeypatch.setattr(sys, "argv", asked)
    assert main() == 2
    assert capsys.readouterr().err == "no section or row cold.walls: see --list\n"
