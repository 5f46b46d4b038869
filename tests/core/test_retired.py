"""Settings that are retired: told once, without effect, and no harm to maps that have them."""

from __future__ import annotations

from pathlib import Path

import pytest

from specmap_cli.core.config import (
    RetiredSetting,
    is_fixed,
    known_settings,
    last_defaults,
    load_config,
    with_overrides,
    without_retired,
)
from specmap_cli.core.errors import UsageError
from specmap_cli.core.settings import Config

RETIRED = {
    f"{section}.{key}": value
    for section, keys in last_defaults().items()
    for key, value in keys.items()
}


def test_no_setting_is_retired() -> None:
    now = Config().model_dump()
    for key in RETIRED:
        section, name = key.split(".")
        assert name not in now.get(section, {}), key


def test_a_retired_setting_is_told_with_its_last_default(tmp_path: Path) -> None:
    path = tmp_path / "specmap.toml"
    path.write_text("[relaxation]\nnode_m = 0.3\n[grid]\nresolution_m = 0.1\n", encoding="utf-8")
    fixed = r"^relaxation\.node_m was retired: its value is now fixed at 0\.3$"
    with pytest.warns(RetiredSetting, match=fixed):
        assert load_config(path).grid.resolution_m == 0.1
    other = fixed.replace("$", r"; 0\.5 has no effect$")
    with pytest.warns(RetiredSetting, match=other) as told:
        assert with_overrides(Config(), {"relaxation": {"node_m": 0.5}}) == Config()
    assert len(told) == 1


def test_a_section_that_is_gone_may_be_empty_and_an_unknown_key_in_it_is_refused() -> None:
    assert load_config(overrides={"audit": {}}) == Config()
    with (
        pytest.warns(RetiredSetting),
        pytest.raises(UsageError, match=r"audit.*no such setting"),
    ):
        load_config(overrides={"audit": {"wall_m": 1.2, "walls": 3}})


def test_settings_that_an_older_version_wrote_down_are_read() -> None:
    """Retired ones at their last default are what the constants are: there is nothing to say."""
    old = Config().model_dump()
    for key, value in RETIRED.items():
        section, name = key.split(".")
        old.setdefault(section, {})[name] = value
    known, others = known_settings(old)
    assert others == []
    assert is_fixed("registration.kernel_voxels", (2.0, 1.0, 0.5, 0.25))
    assert Config.model_validate(known) == Config()
    old["relaxation"]["node_m"] = 0.5
    assert known_settings(old)[1] == ["relaxation.node_m"]


def test_what_is_no_table_is_left_to_be_refused() -> None:
    assert without_retired({"relaxation": 3, "seed": 1}) == ({"relaxation": 3, "seed": 1}, {})
