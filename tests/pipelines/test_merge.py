"""Maps made one, in any order; and a fresh map in the frame and with the ids of another."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from specmap_cli import read_map
from specmap_cli.core.errors import InputError, NoResultError, UsageError
from specmap_cli.evaluation.trajectories import reference_errors
from specmap_cli.grids.gridmap import FREE, OCCUPIED, GridMap
from specmap_cli.maps.store import Map
from specmap_cli.maps.text_files import read_tum
from specmap_cli.pipelines.merge import merge_maps
from specmap_cli.pipelines.overlaps import PairOfMaps
from specmap_cli.pipelines.reports import MergeReport
from specmap_cli.pipelines.simulate import SimulationResult
from specmap_cli.pipelines.update import build_like
from specmap_cli.recognition.closure.alignment import Alignment
from specmap_cli.simulation.simulator import SimulationOptions
from tests.flats import QUICK, Mapped, mapped
from tests.maps.conftest import edit

# bottom, top, left and right cell of an L of corridor and rooms off it, none like another
ROOMS = (
    (4, 38, 4, 196), (38, 180, 4, 38), (42, 110, 42, 96),
    (42, 90, 100, 140), (42, 130, 144, 196), (114, 180, 42, 120),
)  # fmt: skip
DOORS = {"third": np.s_[38:42, 160:178], "second": np.s_[38:42, 112:130]}
DOORS |= {"first": np.s_[38:42, 60:78], "upper": np.s_[140:158, 38:42]}


def building(closed: str) -> GridMap:
    cells = np.full((184, 200), OCCUPIED, dtype=np.uint8)
    for bottom, top, left, right in ROOMS:
        cells[bottom:top, left:right] = FREE
    cells[60:76, 60:80] = OCCUPIED  # a table
    cells[120:132, 100:112] = OCCUPIED
    for name, door in DOORS.items():
        cells[door] = OCCUPIED if name == closed else FREE
    return GridMap(cells, 0.05)


@dataclass(frozen=True)
class Parts:
    """Maps of the building with one of two rooms closed, of another building, and their logs."""

    third_closed: Map
    first_closed: Map
    other: Map
    logs: dict[str, SimulationResult]


@pytest.fixture(scope="module")
def parts(
    flat_options: SimulationOptions, other: Mapped, tmp_path_factory: pytest.TempPathFactory
) -> Parts:
    folder = tmp_path_factory.mktemp("merge")
    made = {}
    for seed, closed in enumerate(("third", "first")):
        (folder / closed).mkdir()
        options = flat_options.model_copy(update={"laps": 1, "seed": seed})
        made[closed] = mapped(building(closed), options, folder / closed)
    last = len(made["first"].stored.ids) - 1
    edit(made["first"].map / "topology.json", **{f"nodes__{last}__name": "Named"})
    logs = {name: one.log for name, one in (*made.items(), ("other", other))}
    return Parts(made["third"].stored, made["first"].stored, other.stored, logs)


@pytest.fixture(scope="module")
def both(parts: Parts, tmp_path_factory: pytest.TempPathFactory) -> MergeReport:
    out = tmp_path_factory.mktemp("both") / "map"
    return merge_maps([parts.third_closed, parts.first_closed], out, QUICK)


def test_maps_that_meet_become_one_with_names_and_ids(parts: Parts, both: MergeReport) -> None:
    merged = read_map(both.out)
    assert both.parts == (("first", "third"),) or both.parts == (("third", "first"),)
    scans = sum(parts.logs[name].scans for name in ("third", "first"))
    counts = both.run["counts"]
    assert counts["scans"] == scans
    assert counts["doors"] == len(merged.record.graph.doors)
    assert both.quality.verdict == "good"
    areas = [parts.third_closed.map_grid.free_area_m2, parts.first_closed.map_grid.free_area_m2]
    assert merged.map_grid.free_area_m2 > max(areas) + 5.0, "each map knew a room more"
    assert len(merged.ids) >= 4
    starts = [0, *(log.scans for log in merged.record.graph.logs)]
    lines = (both.out / "trajectory.tum").read_text(encoding="utf-8").splitlines()
    for log, start in zip(merged.record.graph.logs, np.cumsum(starts), strict=False):
        piece = both.out.parent / "piece.tum"
        piece.write_text("\n".join(lines[start : start + log.scans]) + "\n", encoding="utf-8")
        truth = read_tum(parts.logs[log.name.removesuffix(".mcap")].truth)
        assert reference_errors(read_tum(piece), truth).ate_m < 0.06
    named = both.ids["first"][max(parts.first_closed.ids)]
    assert merged.topology.submaps[named].name == "Named"
    for name, stored in (("third", parts.third_closed), ("first", parts.first_closed)):
        assert set(both.ids[name]) == set(stored.ids)
        assert set(both.ids[name].values()) <= set(merged.ids)


def test_order_and_place_do_not_matter(parts: Parts, both: MergeReport, tmp_path: Path) -> None:
    def elsewhere(
        align: Callable[[PairOfMaps], Alignment], pairs: Sequence[PairOfMaps]
    ) -> Iterable[Alignment]:
        """As on a worker: all that goes there and comes back is pickled."""
        sent_align, sent_pairs = pickle.loads(pickle.dumps((align, pairs)))
        assert len(sent_pairs) == 1
        return [pickle.loads(pickle.dumps(sent_align(pair))) for pair in sent_pairs]

    maps = [parts.first_closed, parts.third_closed]
    again = merge_maps(maps, tmp_path / "map", QUICK, spread=elsewhere)
    assert again.ids == both.ids
    for file in ("topology.json", "labels.csv", "trajectory.tum", "classifiers.json", "map.png"):
        assert (again.out / file).read_bytes() == (both.out / file).read_bytes()


def test_maps_that_do_not_meet_stay_apart_and_are_named(parts: Parts, tmp_path: Path) -> None:
    report = merge_maps([parts.other, parts.third_closed], tmp_path / "map", QUICK)
    assert sorted(report.parts) == [("other",), ("third",)]
    assert any("2 parts that do not meet: " in line for line in report.lines())
    assert report.quality.verdict == "doubtful"
    assert not set(report.ids["other"].values()) & set(report.ids["third"].values())
    merged = read_map(tmp_path / "map")
    one = set(report.ids["other"].values())
    assert not any((edge.source in one) != (edge.target in one) for edge in merged.record.edges)


def test_what_cannot_be_merged(parts: Parts, both: MergeReport, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="1 map to merge: give two or more"):
        merge_maps([parts.other], tmp_path / "map", QUICK)
    with pytest.raises(InputError, match=r"holds (first|third)\.mcap, and so does"):
        merge_maps([parts.third_closed, parts.first_closed, both.out], tmp_path / "map", QUICK)
    assert not (tmp_path / "map").exists()


def test_a_fresh_map_takes_ids_and_names(parts: Parts, both: MergeReport, tmp_path: Path) -> None:
    like = read_map(both.out)
    log = parts.logs["first"]
    fresh = read_map(build_like(log.log, like, tmp_path / "map", QUICK).out)
    assert set(fresh.ids) <= set(like.ids)
    assert all(like.rooms[id_].name == room.name for id_, room in fresh.rooms.items())
    for id_ in fresh.ids:
        cells = np.argwhere(fresh.regions.owner == id_)
        found = like.regions.owners(fresh.regions.grid.centres_of(cells))
        assert (found == id_).mean() > 0.9, "same place, same id, same border"
    assert fresh.record.graph.logs[0].scans == log.scans
    assert len(fresh.record.graph.logs) == 1
    with pytest.raises(NoResultError, match=r"other\.mcap: fits nowhere .* without --like"):
        build_like(parts.logs["other"].log, like, tmp_path / "no", QUICK)
    assert not (tmp_path / "no").exists()
