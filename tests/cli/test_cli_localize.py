"""`specmap localize`: whose settings hold, and offline labels; and `specmap evaluate`."""

from itertools import count
from pathlib import Path

import cv2
import numpy as np
import pytest

from specmap_cli.core.config import load_config
from specmap_cli.core.settings import Config, LogConfig
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.maps.store import Map, read_map
from specmap_cli.pipelines.localizer import settings_for
from tests.cli.conftest import QUICK, Run
from tests.conftest import SAMPLE_LOGS
from tests.flats import record_tour, rows


@pytest.fixture
def stored(tiny_map: Path) -> Map:
    """The tiny map, which was built with settings of its own."""
    found = read_map(tiny_map)
    assert found.config != Config()
    return found


@pytest.fixture(scope="module")
def elsewhere(office: GridMap, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The first seconds of a tour through another building."""
    return record_tour(office, tmp_path_factory.mktemp("office") / "log.mcap", max_duration_s=20)


def settings_file(folder: Path, text: str) -> Path:
    """A file of settings."""
    path = folder / "specmap.toml"
    path.write_text(text, encoding="utf-8")
    return path


class TestWhoseSettings:
    """Those of the map, unless something else is said."""

    def test_the_map_s_but_for_topics_and_frames(self, stored: Map) -> None:
        found = settings_for(stored, {})
        assert found.log == LogConfig()
        assert found == stored.config.model_copy(update={"log": LogConfig()})

    def test_a_file_changes_some_of_them(self, stored: Map, tmp_path: Path) -> None:
        text = "[localization]\nstay = 0.9\nunknown = false\n[log]\nbase_frame = 'b'"
        path = settings_file(tmp_path, text)
        found = settings_for(stored, {}, path)
        assert (found.localization.stay, found.log.base_frame) == (0.9, "b")
        assert found.recognition == stored.config.recognition
        assert found.localization.augmentation == stored.config.localization.augmentation
        over = settings_for(stored, {"localization": {"stay": 0.8}}, path).localization
        assert (over.stay, over.unknown) == (0.8, False), "assignments go over the file"

    @pytest.mark.parametrize("preset", ["default", "paper"])
    def test_a_preset_replaces_all(self, preset: str, stored: Map, tmp_path: Path) -> None:
        assert settings_for(stored, {}, preset=preset) == load_config(preset=preset)
        path = settings_file(tmp_path, f"preset = '{preset}'\n[localization]\nstay = 0.9\n")
        found = settings_for(stored, {"seed": 3}, path)
        assert found == load_config(path, None, {"seed": 3})
        assert found.recognition.rounds != stored.config.recognition.rounds

    @pytest.mark.parametrize(
        ("text", "options", "told"),
        [
            ("[grid]\nfoo = 1", (), "specmap.toml: grid.foo: no such setting"),
            ("preset = 'mine'", (), "specmap.toml: unknown preset 'mine'"),
            ("seed = -1", (), "specmap.toml: seed: must be 0 or more"),
            ("", ("--preset", "papre"), "unknown preset 'papre': choose from default, paper"),
            ("seed = 1", ("--set", "seed=-1"), "seed: must be 0 or more"),
        ],
    )
    def test_what_is_wrong_is_named_with_where_it_stands(
        self,
        text: str,
        options: tuple[str, ...],
        told: str,
        tiny_map: Path,
        tmp_path: Path,
        run: Run,
    ) -> None:
        path = settings_file(tmp_path, text)
        said = run("localize", "x.mcap", "--map", tiny_map, "--config", path, *options)
        said.fails(2)
        assert said.error.removeprefix(f"{path.parent}/").startswith(told)

    def test_a_setting_changes_the_labels_however_it_is_given(
        self, tiny_log: Path, tiny_map: Path, tmp_path: Path, run: Run
    ) -> None:
        known = settings_file(tmp_path, "[localization]\nunknown = false\n")
        written: list[bytes] = []
        for options in ((), ("--set", "localization.unknown=false"), ("--config", known)):
            out = tmp_path / f"{len(written)}.csv"
            assert run("localize", tiny_log, "--map", tiny_map, "-q", "-o", out, *options).code == 0
            written.append(out.read_bytes())
        assert written[0] != written[1] == written[2]


def test_offline_labels_know_all(tiny_log: Path, tiny_map: Path, tmp_path: Path, run: Run) -> None:
    line = ("localize", tiny_log, "--map", tiny_map, "-q", "--metric")
    assert run(*line, "-o", tmp_path / "online.csv").code == 0
    assert run(*line, "-o", tmp_path / "offline.csv", "--offline").code == 0
    online, offline = rows(tmp_path / "online.csv"), rows(tmp_path / "offline.csv")
    pairs = list(zip(online, offline, strict=True))
    changed = {key for before, after in pairs for key in before if before[key] != after[key]}
    assert changed <= {"filtered_submap", "name", "filtered_probability"}, "a single scan's stay"
    assert "filtered_probability" in changed
    assert online[-1] == offline[-1], "the last scan has no future"
    # in a map of one submap the robot never was elsewhere: hindsight makes the first scans surer
    doubted, still = (
        sum(row["filtered_submap"] != "0" for row in table[:10]) for table in (online, offline)
    )
    assert still <= doubted


def test_a_log_of_another_place_says_so_in_its_first_line_and_by_its_code(
    tiny_log: Path, elsewhere: Path, tiny_map: Path, run: Run
) -> None:
    line = ("--map", tiny_map, "-q", "--fail-on", "unknown")
    assert run("localize", tiny_log, *line).code == 0
    lost = run("localize", elsewhere, *line)
    assert lost.code == 5
    assert lost.out.splitlines()[0].endswith("none of them known: the map does not show this place")


def test_while_the_place_is_not_known_a_line_says_so_every_ten_seconds(
    tiny_log: Path, elsewhere: Path, tiny_map: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By a clock that goes on by 2.5 s each time that it is asked."""
    told = "so far, the place is not known now"
    for log, known in ((tiny_log, True), (elsewhere, False)):
        ticks = (2.5 * k for k in count())
        monkeypatch.setattr("specmap_cli.pipelines.localize.monotonic", lambda t=ticks: next(t))
        err = run("localize", log, "--map", tiny_map).err
        lines = [line for line in err.splitlines() if told in line]
        if known:
            assert len(lines) <= 1, "at its start it knows nothing"
        else:
            numbers = [int(line.split()[1].replace(",", "")) for line in lines]
            assert len(numbers) > 5
            assert min(np.diff(numbers)) >= 3
            assert float(np.median(np.diff(numbers))) <= 5


def test_a_hold_out_is_one_object_and_a_picture(tiny_log: Path, tmp_path: Path, run: Run) -> None:
    picture = tmp_path / "confusion.png"
    line = ("evaluate", tiny_log, "--protocol", "holdout", "--share", "0.3", *QUICK)
    found = run(*line, "--json", "--confusion", picture, "-q").result
    for part in ("train", "test"):
        assert found[part].keys() >= {"recall", "precision", "scans"}
        assert found[part]["scans"] > 0
        assert 0.0 <= found[part]["recall"] <= 1.0
    assert sum(row["scans"] for row in found["submaps"]) == found["test"]["scans"]
    assert cv2.imread(str(picture)) is not None
    lines = run(*line, "-q").out.splitlines()
    assert [text.split()[0] for text in lines[:4]][1:] == ["training", "held-out", "held-out,"]
    assert len(lines) > 6


def test_a_trajectory_against_a_reference(run: Run) -> None:
    truth = SAMPLE_LOGS / "office_again.tum"
    found = run("evaluate", "--trajectory", truth, "--reference", truth, "--json").result
    assert found["matched"] == found["total"] > 2000
    assert found["ate_m"] == pytest.approx(0.0, abs=1e-6)
    assert set(found["relative"]) == {"1", "5", "20"}


def test_a_trajectory_against_relations(tmp_path: Path, run: Run) -> None:
    tum, relations = tmp_path / "a.tum", tmp_path / "a.relations"
    tum.write_text("1 0 0 0 0 0 0 1\n2 1 0 0 0 0 0 1\n")
    relations.write_text("1 2 1.5 0 0 0 0 0\n")
    line = ("evaluate", "--trajectory", tum, "--relations", relations)
    assert run(*line, "--json").result["translation_m"]["mean"] == pytest.approx(0.5)
    assert "1 of 1 relations" in run(*line).out


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("a.mcap", "--protocol", "holdout", "--trajectory", "a.tum"), "one thing only"),
        (("--protocol", "holdout"), "needs one log"),
        (("a.mcap", "b.mcap", "--protocol", "revisit"), "--reference twice"),
        (("a.mcap", "b.mcap", "--baseline", "room-hallway"), "--rooms once"),
        (("--trajectory", "a.tum"), "one of --relations"),
    ],
)
def test_what_is_not_clear_is_asked(arguments: tuple[str, ...], told: str, run: Run) -> None:
    run("evaluate", *arguments).fails(2, told)
