"""Settings: what goes over what, and one clear line for what cannot be."""

from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import BaseModel

from specmap_cli.core.config import (
    PRESETS,
    RetiredSetting,
    is_fixed,
    known_settings,
    load_config,
    tables_of,
    with_overrides,
    without_retired,
)
from specmap_cli.core.errors import UsageError
from specmap_cli.core.schemas import meanings
from specmap_cli.core.settings import Config
from specmap_cli.core.toml import to_toml

SECTIONS = {name: section for name, section in Config() if isinstance(section, BaseModel)}


def write(folder: Path, text: str) -> Path:
    path = folder / "specmap.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_flags_go_over_files_files_over_presets_and_these_over_defaults(tmp_path: Path) -> None:
    path = write(tmp_path, "[segmentation]\nneighbours = 9\nsight_m = 4.0\n")
    config = load_config(path, "paper", {"segmentation": {"sight_m": 3.0}})
    assert config.preset == "paper"
    assert config.segmentation.sight_m == 3.0  # the flag
    assert config.segmentation.neighbours == 9  # the file
    assert config.segmentation.labels == "nearest" != Config().segmentation.labels  # the preset
    assert config.segmentation.test_keyframes == Config().segmentation.test_keyframes  # the default


def test_the_preset_may_stand_in_the_file_and_a_flag_goes_over_it(tmp_path: Path) -> None:
    path = write(tmp_path, 'preset = "paper"\n')
    assert load_config(path) == load_config(None, "paper")
    assert load_config(path, "default") == load_config() == Config()
    path = write(tmp_path, to_toml(Config()))
    with pytest.raises(UsageError, match="--preset paper was given"):  # or it would undo it unsaid
        load_config(path, "paper")


@pytest.mark.parametrize("preset", PRESETS)
def test_every_preset_is_valid_and_survives_toml(preset: str, tmp_path: Path) -> None:
    config = load_config(None, preset, {"log": {"scan_topic": "/front/scan"}})
    assert load_config(write(tmp_path, to_toml(config))) == config


def test_toml_names_every_setting() -> None:
    text = to_toml(Config())
    for name, section in SECTIONS.items():
        assert f"[{name}]" in text
        for key in type(section).model_fields:
            assert f"\n{key} = " in text or f"\n# {key} =" in text


@given(st.text(st.characters(categories=["L", "N", "P", "S", "Zs"]), max_size=12))
def test_any_text_survives_toml(tmp_path_factory: pytest.TempPathFactory, topic: str) -> None:
    config = load_config(None, None, {"log": {"scan_topic": topic}})
    path = write(tmp_path_factory.getbasetemp(), to_toml(config))
    assert load_config(path).log.scan_topic == topic


BROKEN = {
    "an unknown key": ("[grid]\nresolution = 0.1\n", "grid.resolution"),
    "an unknown section": ("[gird]\n", "gird"),
    "a value out of range": ("[grid]\nresolution_m = -1\n", "grid.resolution_m"),
    "a value of another type": ('[grid]\nresolution_m = "fine"\n', "grid.resolution_m"),
    "no number": ("[grid]\nresolution_m = nan\n", "grid.resolution_m"),
    "an endless number": ("[grid]\nmax_range_m = inf\n", "grid.max_range_m"),
    "a section that is a number": ("grid = 3\n", "grid"),
    "a negative seed": ("seed = -1\n", "seed"),
    "an unknown preset": ('preset = "papre"\n', "papre"),
    "a preset that is a list": ("preset = [1]\n", "preset"),
    "no TOML": ("[grid\n", "not valid TOML"),
    "a deep list": ("x = " + "[" * 3000, "nested too deeply"),
    "a long number": ("x = " + "9" * 5000, "a number of too many digits"),
    "bounds reversed": ("[log]\nband_min_m = 3.0\n", "log: band_min_m must be below band_max_m"),
}


@pytest.mark.parametrize("case", BROKEN)
def test_a_broken_file_is_one_line_that_names_the_key(tmp_path: Path, case: str) -> None:
    text, named = BROKEN[case]
    with pytest.raises(UsageError) as caught:
        load_config(write(tmp_path, text))
    assert named in str(caught.value)
    assert "\n" not in str(caught.value)
    assert caught.value.exit_code == 2


def test_a_file_that_cannot_be_read_is_one_line(tmp_path: Path) -> None:
    path = tmp_path / "specmap.toml"
    with pytest.raises(UsageError, match=r"specmap\.toml: cannot be read: No such file"):
        load_config(path)
    path.write_bytes(b"\xff\xfe seed")
    with pytest.raises(UsageError, match=r"specmap\.toml: not UTF-8 text: save it as UTF-8"):
        load_config(path)
    path.write_text("seed = 3\n", encoding="utf-8-sig")
    assert load_config(path).seed == 3, "a byte order mark is passed over"


def test_programs_are_told_where_and_which_key_was_meant(tmp_path: Path) -> None:
    path = write(tmp_path, "[grid]\nresolutoin_m = 0.1\n")
    with pytest.raises(UsageError) as caught:
        load_config(path)
    hint = "did you mean grid.resolution_m?; run `specmap config` to see every key and its default"
    assert (caught.value.where, caught.value.hint) == (str(path), hint)
    assert str(caught.value) == f"{path}: grid.resolutoin_m: no such setting, {hint}"
    with pytest.raises(UsageError) as caught:
        load_config(None, None, {"grid": {"resolutoin_m": 0.1}})
    assert (caught.value.where, caught.value.hint) == ("grid.resolutoin_m", hint)


@pytest.mark.parametrize(
    "overrides", [{"grid": {"resolution": 0.1}}, {"grid": {"resolution_m": 0}}, {"seeds": 1}]
)
def test_overrides_are_checked_like_a_file(overrides: dict[str, Any]) -> None:
    with pytest.raises(UsageError, match=r"specmap config"):
        load_config(None, None, overrides)
    with pytest.raises(UsageError, match=r"specmap config"):
        with_overrides(Config(), overrides)


def test_every_description_can_be_read_alone() -> None:
    found = {key: text for key, text in meanings(Config).items() if key not in SECTIONS}
    for name, section in SECTIONS.items():
        found |= {f"{name}.{key}": text for key, text in meanings(type(section)).items()}
    print("\n".join(f"{key}: {text}" for key, text in found.items()))  # for eyes: pytest -rP
    pronouns = ("It ", "They ", "Its ", "Their ", "This ", "These ", "The same", "Of them", "Or ")
    for key, text in found.items():
        assert text[:1].isupper(), key
        assert text.endswith("."), key
        assert len(text.split()) >= 4, key
        assert not text.startswith((*pronouns, "And ", "As ")), key


def test_no_setting_is_retired() -> None:
    now = Config().model_dump()
    for section, keys in tables_of("retired").items():
        assert not keys.keys() & now.get(section, {}).keys(), section


def test_a_retired_setting_is_told_with_its_last_default(tmp_path: Path) -> None:
    path = write(tmp_path, "[relaxation]\nnode_m = 0.3\n[grid]\nresolution_m = 0.1\n")
    fixed = r"^relaxation\.node_m was retired: its value is now fixed at 0\.3$"
    with pytest.warns(RetiredSetting, match=fixed):
        assert load_config(path).grid.resolution_m == 0.1
    with pytest.warns(RetiredSetting, match=fixed.replace("$", r"; 0\.5 has no effect$")) as told:
        assert with_overrides(Config(), {"relaxation": {"node_m": 0.5}}) == Config()
    assert len(told) == 1


def test_a_section_that_is_gone_may_be_empty_and_an_unknown_key_in_it_is_refused() -> None:
    assert load_config(overrides={"audit": {}}) == Config()
    with pytest.warns(RetiredSetting), pytest.raises(UsageError, match=r"audit.*no such setting"):
        load_config(overrides={"audit": {"wall_m": 1.2, "walls": 3}})


def test_settings_that_an_older_version_wrote_down_are_read() -> None:
    """Retired ones at their last default are what the constants are: there is nothing to say."""
    old = Config().model_dump()
    for section, keys in tables_of("retired").items():
        old[section] = old.get(section, {}) | keys
    known, others = known_settings(old)
    assert others == []
    assert is_fixed("registration.kernel_voxels", (2.0, 1.0, 0.5, 0.25))
    assert Config.model_validate(known) == Config()
    old["relaxation"]["node_m"] = 0.5
    assert known_settings(old)[1] == ["relaxation.node_m"]


def test_what_is_no_table_is_left_to_be_refused() -> None:
    assert without_retired({"relaxation": 3, "seed": 1}) == ({"relaxation": 3, "seed": 1}, {})
