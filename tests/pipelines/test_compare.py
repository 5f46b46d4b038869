"""Two maps of one building against each other: what changed is told, and nothing else."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import jsonschema
import numpy as np
import pytest

from specmap_cli.cli import main
from specmap_cli.core.errors import NoResultError, UsageError
from specmap_cli.core.schemas import read_schema
from specmap_cli.grids.gridmap import FREE
from specmap_cli.pipelines.compare import (
    COMPARISON,
    PICTURE,
    SUMMARY,
    Comparison,
    compare_maps,
    lines_of,
    write_comparison,
)
from tests.flats import Mapped


@pytest.fixture
def before(week: Path) -> Path:
    """The map of the flat."""
    return week / "monday"


@pytest.fixture
def changed(week: Path) -> Path:
    """The map of the flat with a closed door, a cabinet more, and a hole in a wall."""
    return week / "wednesday"


@pytest.fixture(scope="module")
def told(week: Path) -> Comparison:
    return compare_maps(week / "monday", week / "wednesday")


def test_what_changed_is_told_with_its_place_in_the_old_map(told: Comparison) -> None:
    found, grid = told.differences, told.old.map_grid
    assert [round(way.width_m, 1) for way in found.closed] == [pytest.approx(0.9, abs=0.15)]
    assert len(found.opened) == 1
    (cabinet,) = found.appeared
    assert not found.vanished
    assert cabinet.length_m == pytest.approx(0.8, abs=0.2)
    assert 0.05 < cabinet.length_m * cabinet.width_m < 0.5
    assert cabinet.old_submap is not None
    assert len(told.record.submaps.same) >= 3
    for place in (cabinet.centre, found.closed[0].place):
        assert (grid.values_at(place[None]) == FREE).all()


def test_names_that_a_person_gave_are_told(told: Comparison) -> None:
    names = {**told.record.old.names, told.differences.closed[0].between[0]: "Kitchen"}
    old = told.record.old.model_copy(update={"names": names})
    lines = lines_of(told.record.model_copy(update={"old": old}))
    assert any(line.startswith("way closed: ") and "(Kitchen)" in line for line in lines)
    assert not any("(submap" in line for line in lines)


def test_the_other_way_round_things_vanish(before: Path, changed: Path) -> None:
    back = compare_maps(changed, before).differences
    assert len(back.vanished) == 1
    assert not back.appeared
    assert (len(back.closed), len(back.opened)) == (1, 1)


def test_two_recordings_of_one_building_differ_in_nothing(
    before: Path, second_tour: Mapped
) -> None:
    """Of two lasers: one sees three quarters of the circle, the other all of it."""
    found = compare_maps(before, second_tour.map)
    assert "the building: no change found" in found.lines()


def test_a_map_is_identical_to_itself_and_not_replaced_by_its_comparison(before: Path) -> None:
    found = compare_maps(before, before)
    assert found.identical
    assert found.lines() == [f"{before}: identical to {before}"]
    assert main(["compare", str(before), str(before), "-o", str(before), "-q"]) == 2


def test_a_map_of_another_building_is_refused_with_the_reason(
    before: Path, house: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (house / "classifiers.json").unlink()
    with pytest.raises(NoResultError, match="not aligned with"):
        compare_maps(before, house)
    assert main(["compare", str(before), str(house), "-q"]) == 4
    assert f"{house}: not aligned with {before}: " in capsys.readouterr().err


def test_the_command_writes_all_of_it(
    before: Path, changed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "changes"
    assert main(["compare", str(before), str(changed), "-o", str(out), "--json", "-q"]) == 0
    printed = json.loads(capsys.readouterr().out)
    jsonschema.validate(printed, read_schema("comparison"))
    assert json.loads((out / COMPARISON).read_text(encoding="utf-8")) == printed
    assert "way closed: " in (out / SUMMARY).read_text(encoding="utf-8")
    assert (out / PICTURE).read_bytes().startswith(b"\x89PNG")
    assert sorted(path.name for path in out.iterdir()) == sorted([COMPARISON, PICTURE, SUMMARY])


def test_the_same_maps_give_the_same_bytes_and_only_an_earlier_result_is_replaced(
    told: Comparison, before: Path, tmp_path: Path
) -> None:
    write_comparison(told, tmp_path / "out")
    files = [tmp_path / "out" / file for file in (COMPARISON, PICTURE, SUMMARY)]
    written = [file.read_bytes() for file in files]
    with pytest.raises(UsageError, match="already holds a result"):
        write_comparison(told, tmp_path / "out")
    write_comparison(told, tmp_path / "out", overwrite=True)
    assert [file.read_bytes() for file in files] == written
    with pytest.raises(UsageError, match=f"no {COMPARISON} in it"):
        write_comparison(told, before, overwrite=True)


def test_a_map_without_classifiers_is_compared_by_its_grids(
    before: Path, changed: Path, tmp_path: Path
) -> None:
    bare = tmp_path / "bare"
    shutil.copytree(changed, bare)
    (bare / "classifiers.json").unlink()
    assert np.isfinite(compare_maps(before, bare).alignment.rival)
