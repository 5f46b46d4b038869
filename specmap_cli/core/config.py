"""Which settings are in force: flags over file over preset over default.

Flags go over the file (`--config specmap.toml`), the file over the preset, the preset over the
defaults of `core/settings.py`. Unknown keys are refused, retired ones have no effect, which is told
by a warning. `specmap config` prints what is in force.

A retired setting is a constant now, since nobody needed to turn it. `retired.toml` has the last
default of each, which is the value of the constant; `paper.toml` is the preset of that name.
"""

from __future__ import annotations

import json
import tomllib
import warnings
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from specmap_cli.core.errors import SETTING, UsageError, path_of
from specmap_cli.core.settings import Config
from specmap_cli.core.toml import TomlFormat

SETTINGS = TomlFormat(
    model=Config,
    error=UsageError,
    code=SETTING,
    noun="setting",
    advice="; run `specmap config` to see every key and its default",
    plainly={"model_type": "is a section: expected one of its keys"},
)

PRESETS = ("default", "paper")  # the second is what the paper itself did: paper.toml


def load_config(
    path: Path | str | None = None,
    preset: str | None = None,
    overrides: Mapping[str, Any] | None = None,
) -> Config:
    """The effective configuration: `overrides` over the file over the preset over the defaults.

    `overrides` and the presets are nested dictionaries of the sections above. Raises UsageError
    naming the key at fault for an unreadable file, an unknown key or a value out of range; warns of
    retired keys (`RetiredSetting`), which have no effect.
    """
    path = None if path is None else path_of(path, "path")
    from_file = {} if path is None else SETTINGS.tables(path)
    name = preset or from_file.get("preset", "default")
    where = f"{path}: " if path is not None else ""
    if name not in PRESETS:
        choices = ", ".join(sorted(PRESETS))
        found, source = f"unknown preset {name!r}", path if preset is None else None
        raise UsageError(found, f"choose from {choices}", where=source, code=SETTING)
    if from_file.get("preset", name) != name and len(from_file) > 1:
        raise UsageError(
            f"preset is {from_file['preset']!r}, but --preset {name} was given: the file's values "
            "would undo it",
            "take the line `preset` and the values you do not want to keep out of the file",
            mark=";",
            where=path,
            code=SETTING,
        )
    given = overrides or {}
    base = {} if name == "default" else tables_of(name)
    merged = _merge(_merge(base, from_file), given)
    return _validated({**merged, "preset": name}, where, given)


def with_overrides(config: Config, overrides: dict[str, Any], where: str = "") -> Config:
    """The configuration with nested `overrides` over it; UsageError as in `load_config`.

    `where` stands before the complaint: the file that the overrides are from, and a colon.
    """
    return _validated(_merge(config.model_dump(), overrides), where, {})


def known_settings(settings: Mapping[str, Any]) -> tuple[dict[str, Any], list[str]]:
    """The settings that this version has, and the dotted keys of the others.

    For settings that another version wrote down: it may have had more, or called them otherwise.
    Retired ones are among the others only with a value that is not the one they are fixed at.
    """
    left, retired = without_retired(settings)
    known: dict[str, Any] = {}
    others = [key for key, value in retired.items() if not is_fixed(key, value)]
    sections = Config().model_dump()
    for name, value in left.items():
        section = sections.get(name)
        if isinstance(section, dict) and isinstance(value, Mapping):
            known[name] = {key: entry for key, entry in value.items() if key in section}
            others += [f"{name}.{key}" for key in value if key not in section]
        elif name in sections:
            known[name] = value
        else:
            others.append(name)
    return known, others


def _validated(settings: dict[str, Any], where: str, given: Mapping[str, Any]) -> Config:
    """The configuration; warns of retired settings. `where` is to blame but for what was given."""
    left, retired = without_retired(settings)
    for key, value in retired.items():
        no_effect = f"; {json.dumps(value, default=str)} has no effect"
        told = f"{key} was retired: its value is now fixed at {json.dumps(_last_default(key))}"
        told += "" if is_fixed(key, value) else no_effect
        warnings.warn(told, RetiredSetting, stacklevel=1)
    return SETTINGS.value(left, lambda place: "" if _holds(given, place) else where)


def _holds(tree: Mapping[str, Any], keys: tuple[int | str, ...]) -> bool:
    """Whether a nested dictionary has an entry of these keys."""
    found: Any = tree
    for key in keys:
        if not isinstance(found, Mapping) or key not in found:
            return False
        found = found[key]
    return bool(keys)


def _merge(base: dict[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """A nested dictionary with the entries of `over` in place of those of `base`."""
    merged = dict(base)
    for key, value in over.items():
        both = isinstance(value, dict) and isinstance(merged.get(key), dict)
        merged[key] = _merge(merged[key], value) if both else value
    return merged


class RetiredSetting(UserWarning):
    """A setting was given that is retired: it has no effect."""


@cache
def tables_of(name: str) -> dict[str, dict[str, Any]]:
    """What `paper.toml` says, or `retired.toml`, by section and key."""
    return tomllib.loads(Path(__file__).with_name(f"{name}.toml").read_text(encoding="utf-8"))


def without_retired(settings: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Nested settings without those that are retired, and these by dotted key.

    A section in which nothing is left goes, too.
    """
    left: dict[str, Any] = {}
    retired: dict[str, Any] = {}
    for name, section in settings.items():
        gone = tables_of("retired").get(name, {})
        if gone and isinstance(section, Mapping):
            retired |= {f"{name}.{key}": section[key] for key in section if key in gone}
            section = {key: value for key, value in section.items() if key not in gone}
            if not section:
                continue
        left[name] = section
    return left, retired


def is_fixed(key: str, value: Any) -> bool:
    """Whether a value is the one at which a retired setting is fixed."""
    return bool((list(value) if isinstance(value, tuple) else value) == _last_default(key))


def _last_default(key: str) -> Any:
    section, name = key.split(".")
    return tables_of("retired")[section][name]
