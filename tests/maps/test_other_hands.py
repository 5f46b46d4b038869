"""Maps that other hands touch meanwhile: other commands, people, neighbours, a power cut."""

import os
import re
import shutil
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest

from specmap_cli.core import files
from specmap_cli.core.errors import MapError, UsageError
from specmap_cli.core.files import write_text
from specmap_cli.maps import directory as module
from specmap_cli.maps.directory import OutputDirectory, put_right
from specmap_cli.maps.filenames import EDITS, TOPOLOGY
from specmap_cli.maps.store import Map, read_map
from specmap_cli.maps.writing import MapResult, write_map
from specmap_cli.pipelines.map_in_making import laid_out_of_stored
from tests.maps.conftest import edit


@pytest.fixture
def out(house: Path) -> Path:
    """A map, which is called so."""
    return house.rename(house.with_name("map"))


def anew(out: Path, result: MapResult, frame: str, **options: Any) -> None:
    with OutputDirectory(out, overwrite=True, **options) as partial:
        write_map(partial, replace(result, frame=frame))


def frame_of(out: Path) -> str:
    return read_map(out).record.graph.frame


def test_a_map_that_is_being_replaced_is_refused_to_others(out: Path, result: MapResult) -> None:
    with OutputDirectory(out, overwrite=True) as partial:
        told = rf"map: process {os.getpid()} is about to replace it: wait until that has ended"
        with pytest.raises(UsageError, match=told):
            anew(out, result, "second")
        write_map(partial, replace(result, frame="first"))
    assert frame_of(out) == "first"
    anew(out, result, "third")
    assert frame_of(out) == "third"
    assert os.listdir(out.parent) == ["map"]


@pytest.mark.parametrize("there", [True, False])
def test_what_people_do_stays(there: bool, tmp_path: Path, out: Path, result: MapResult) -> None:
    target = out if there else tmp_path / "new"
    name = EDITS if there else TOPOLOGY
    read = [read_map(out)] * there

    def write() -> None:
        with OutputDirectory(target, overwrite=True, made_of=read) as partial:
            write_map(partial, replace(result, frame="new"))
            target.mkdir(exist_ok=True)
            (target / name).write_text('# [submaps.0]\n"schema_version"')

    with pytest.raises(UsageError, match=f"was changed meanwhile: {name}"):
        write()
    assert "# [submaps.0]" in (target / name).read_text()
    assert frame_of(out) == "map"


def test_who_read_a_map_that_was_replaced_hears_of_it(out: Path, result: MapResult) -> None:
    """Also where what is found of the new map makes no sense with what was read of the old one."""
    read, told = read_map(out), "was replaced meanwhile: run the command again"
    anew(out, result, "newer")
    with pytest.raises(MapError, match=told):
        anew(out, result, "older", made_of=[read])
    assert frame_of(out) == "newer"
    (out / "labels.png").write_bytes(b"of submaps that the old one did not have")
    with pytest.raises(MapError, match=told):
        _ = read.regions


def test_decisions_are_lost_in_no_other_map(tmp_path: Path, out: Path, result: MapResult) -> None:
    other, said = tmp_path / "other", replace(result, edits="# decided\n")
    other.mkdir()
    write_map(other, said)
    of_new = f"`build --like {re.escape(str(other))}` keeps them; or "
    for made_of, keep in ([], of_new), ([read_map(out)], ""):  # an edit of one keeps no other's
        told = f"holds a person's decisions, which a new map would lose: {keep}choose another --out"
        with pytest.raises(UsageError, match=told):
            anew(other, result, "new", made_of=made_of)
    assert frame_of(other) == "map"
    anew(other, said, "same words", made_of=[read_map(out)])
    anew(other, result, "its own", made_of=[read_map(other)])
    assert frame_of(other) == "its own"


@pytest.mark.parametrize("linked", [True, False])
def test_what_is_not_ours_goes_on_to_the_next_map(
    linked: bool, out: Path, result: MapResult, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not linked:
        monkeypatch.setattr(os, "link", Mock(side_effect=OSError(1, "Operation not permitted")))
    (out / "photos" / "none yet").mkdir(parents=True)
    mine = [out / "notes.txt", out / "photos" / "1.jpg", out / "submaps" / "why.txt"]
    for path in mine:
        path.write_text(path.name)
    (out / "link").symlink_to("nowhere")
    (out / "submaps" / "007.png").write_text("of a submap that is gone")
    anew(out, result, "new")
    assert frame_of(out) == "new"
    assert [path.read_text() for path in mine] == [path.name for path in mine]
    assert (out / "photos" / "none yet").is_dir()
    assert os.readlink(out / "link") == "nowhere"
    assert not (out / "submaps" / "007.png").exists()


class ForgetfulDisk:
    """A file system of which only that survives a power cut which was waited for, since written."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.safe: dict[int, int] = {}
        fsync = os.fsync

        def waited(descriptor: int) -> None:
            fsync(descriptor)
            about = os.fstat(descriptor)
            self.safe[about.st_ino] = about.st_mtime_ns

        monkeypatch.setattr(os, "fsync", waited)

    def lost(self, path: Path) -> list[str]:
        """What of a file or a directory a power cut would take."""
        each = [path, *path.rglob("*")]
        return [p.name for p in each if self.safe.get(p.stat().st_ino) != p.stat().st_mtime_ns]


@pytest.mark.parametrize(("at_once", "threads"), [(True, True), (False, True), (True, False)])
def test_a_power_cut_leaves_a_whole_map(
    at_once: bool, threads: bool, out: Path, result: MapResult, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not threads:  # where the process may have no more of them
        refused = Mock(side_effect=RuntimeError("can't start new thread"))
        monkeypatch.setattr(threading.Thread, "start", refused)
    disk, lost = ForgetfulDisk(monkeypatch), list[str]()
    rename, exchanged = os.rename, module.exchanged

    def renamed(source: Path, target: Path) -> None:
        lost.extend(disk.lost(Path(source)) if ".partial-" in source.name else [])
        rename(source, target)

    def exchanging(one: Path, other: Path) -> bool:
        lost.extend(disk.lost(one))
        return at_once and exchanged(one, other)

    monkeypatch.setattr(os, "rename", renamed)
    monkeypatch.setattr(module, "exchanged", exchanging)
    anew(out, result, "new")
    assert lost == []
    assert disk.lost(out) == []
    # the new name of the directory itself; when the old one goes it changes once more
    assert out.parent.stat().st_ino in disk.safe


def test_a_power_cut_leaves_a_whole_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    disk, lost, replace_ = ForgetfulDisk(monkeypatch), list[str](), os.replace

    def replaced(source: Path, target: Path) -> None:
        lost.extend(disk.lost(source))
        replace_(source, target)

    monkeypatch.setattr(os, "replace", replaced)
    write_text(tmp_path / "table.csv", "a,b\n")
    assert lost == []
    assert disk.lost(tmp_path) == []


def test_no_neighbour_s_link_is_followed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where he could guess the name, and elsewhere he cannot."""
    assert len({files.partial_of(tmp_path / "table.csv").name for _ in range(3)}) == 3
    (tmp_path / "precious").write_text("precious")
    monkeypatch.setattr(os, "urandom", lambda count: b"\xab" * count)
    files.partial_of(tmp_path / "table.csv").symlink_to(tmp_path / "precious")
    with pytest.raises(UsageError, match="File exists"):
        write_text(tmp_path / "table.csv", "a,b\n")
    assert (tmp_path / "precious").read_text() == "precious"


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give files away")
def test_a_neighbour_s_directory_is_no_map_that_was_moved_away(tmp_path: Path, out: Path) -> None:
    for role in ("replaced", "partial"):
        planted = tmp_path / f".new.{role}-01234567"
        planted.mkdir()
        (planted / TOPOLOGY).write_bytes((out / TOPOLOGY).read_bytes())
        os.chown(planted, 12345, 12345)
    assert put_right(tmp_path / "new") == []
    assert not (tmp_path / "new").exists()


READERS: dict[str, Callable[[Map], object]] = {
    "map.png": lambda map_: map_.map_grid,
    "map.yaml": lambda map_: map_.map_grid,
    "labels.png": lambda map_: map_.regions,
    "labels.csv": lambda map_: map_.labels,
    "classifiers.json": lambda map_: map_.classifiers,
    "features.npz": lambda map_: map_.features,
    "keyframes.mcap": lambda map_: map_.scans().close(),
    "run.json": lambda map_: map_.run,
    "submaps/000.png": lambda map_: map_.grids[0],
    "submaps/000.yaml": lambda map_: map_.topology,
    "trajectory.tum": laid_out_of_stored,
    "trajectory.g2o": laid_out_of_stored,
}


@pytest.mark.parametrize("name", READERS)
def test_files_of_another_map_are_refused(name: str, flat_map: Map, tmp_path: Path) -> None:
    """They would be read well, and teach wrong classifiers in silence."""
    mine = Path(shutil.copytree(flat_map.path, tmp_path / "mine"))
    READERS[name](read_map(mine))
    if name == "run.json":
        edit(mine / name, labels_sha256="0" * 64)
    else:
        edit(mine / TOPOLOGY, **{f"graph__files__{name}": "0" * 64})
    told = f"{re.escape(str(mine / name))}: is not the file that topology.json was written with"
    with pytest.raises(MapError, match=told):
        READERS[name](read_map(mine))
