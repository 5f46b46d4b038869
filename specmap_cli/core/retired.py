"""Settings that there were once: nobody needed to turn them, and they are constants now.

`retired.toml` has the last default of each, which is the value of the constant.
"""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

_TABLE = Path(__file__).with_suffix(".toml")


class RetiredSetting(UserWarning):
    """A setting was given that is retired: it has no effect."""


@cache
def last_defaults() -> Mapping[str, Mapping[str, Any]]:
    """The last default of each retired setting, by section and key."""
    return tomllib.loads(_TABLE.read_text(encoding="utf-8"))


def without_retired(settings: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Nested settings without those that are retired, and these by dotted key.

    A section in which nothing is left goes, too.
    """
    left: dict[str, Any] = {}
    retired: dict[str, Any] = {}
    for name, section in settings.items():
        gone = last_defaults().get(name, {})
        if gone and isinstance(section, Mapping):
            retired |= {f"{name}.{key}": section[key] for key in section if key in gone}
            section = {key: value for key, value in section.items() if key not in gone}
            if not section:
                continue
        left[name] = section
    return left, retired


def last_default(key: str) -> Any:
    """The last default of a retired setting, by its dotted key."""
    section, name = key.split(".")
    return last_defaults()[section][name]


def sentence(key: str, value: Any) -> str:
    """What to say of a retired setting that was given a value."""
    last = last_default(key)
    no_effect = "" if value == last else f"; {json.dumps(value, default=str)} has no effect"
    return f"{key} was retired: its value is now fixed at {json.dumps(last)}{no_effect}"
