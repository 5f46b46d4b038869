"""`specmap localize`: whose settings hold, and labels that know the whole log."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest

from specmap_cli.core.config import load_config
from specmap_cli.core.settings import Config, LogConfig
from specmap_cli.maps.store import StoredMap, read_map
from specmap_cli.pipelines.localize import settings_for
from tests.cli.conftest import Run


@pytest.fixture
def stored(tiny_map: Path) -> StoredMap:
    """The tiny map, which was built with settings of its own."""
    found = read_map(tiny_map)
    assert found.config != Config()
    return found


def settings_file(folder: Path, text: str) -> Path:
    """A file of settings."""
    path = folder / "specmap.toml"
    path.write_text(text, encoding="utf-8")
    return path


class TestWhoseSettings:
    """Those of the map, unless something else is said."""

    def test_the_map_s_but_for_topics_and_frames(self, stored: StoredMap) -> None:
        found = settings_for(stored, {})
        assert found.log == LogConfig()
        assert found == stored.config.model_copy(update={"log": LogConfig()})

    def test_a_file_changes_some_of_them(self, stored: StoredMap, tmp_path: Path) -> None:
        text = "[localization]\nstay = 0.9\nunknown = false\n[log]\nbase_frame = 'b'"
        path = settings_file(tmp_path, text)
        found = settings_for(stored, {}, path)
        assert (found.localization.stay, found.log.base_frame) == (0.9, "b")
        assert found.recognition == stored.config.recognition
        assert found.localization.augmentation == stored.config.localization.augmentation
        over = settings_for(stored, {"localization": {"stay": 0.8}}, path).localization
        assert (over.stay, over.unknown) == (0.8, False), "assignments go over the file"

    @pytest.mark.parametrize("preset", ["default", "paper"])
    def test_a_preset_takes_the_place_of_all(
        self, preset: str, stored: StoredMap, tmp_path: Path
    ) -> None:
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
            ("seed = -1", (), "specmap.toml: seed: Input should be"),
            ("", ("--preset", "papre"), "unknown preset 'papre': choose from default, paper"),
            ("seed = 1", ("--set", "seed=-1"), "seed: Input should be greater than or equal to 0"),
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


def rows(path: Path) -> list[dict[str, str]]:
    """The lines of a CSV."""
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_offline_labels_know_the_whole_log(
    tiny_log: Path, tiny_map: Path, tmp_path: Path, run: Run
) -> None:
    line = ("localize", tiny_log, "--map", tiny_map, "-q", "--metric")
    assert run(*line, "-o", tmp_path / "online.csv").code == 0
    assert run(*line, "-o", tmp_path / "offline.csv", "--offline").code == 0
    online, offline = rows(tmp_path / "online.csv"), rows(tmp_path / "offline.csv")
    filtered = {"filtered_submap", "name", "filtered_probability"}
    for before, after in zip(online, offline, strict=True):  # what a single scan tells stays
        assert all(before[key] == after[key] for key in before.keys() - filtered)
    # the last scan has no future: its smoothed belief is its filtered one
    assert {key: online[-1][key] for key in filtered} == {key: offline[-1][key] for key in filtered}
    assert [row["filtered_probability"] for row in online] != [
        row["filtered_probability"] for row in offline
    ]
    # in a map of one submap the robot never was elsewhere: hindsight makes the first scans surer
    doubted = [row for row in online[:10] if row["filtered_submap"] != "0"]
    hindsight = [row for row in offline[:10] if row["filtered_submap"] != "0"]
    assert len(hindsight) <= len(doubted)
