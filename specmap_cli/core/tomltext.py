"""Settings as TOML: reading a file of them, writing all of them with what they are for."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from specmap_cli.core.errors import SETTING, UsageError

_BARE = re.compile(r"[A-Za-z0-9_-]+")


def read_toml(path: Path) -> dict[str, Any]:
    """The tables of a TOML file; UsageError when it cannot be read or is none."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "not UTF-8 text"
        raise UsageError(f"{path}: cannot be read: {reason}", code=SETTING) from None
    except tomllib.TOMLDecodeError as error:
        raise UsageError(f"{path}: not valid TOML: {error}", code=SETTING) from None


def to_toml(config: BaseModel) -> str:
    """A configuration as TOML with a comment a documented key; `load_config` reads it back."""
    entries = {name: getattr(config, name) for name in type(config).model_fields}
    sections = {name: entry for name, entry in entries.items() if isinstance(entry, BaseModel)}
    plain = {name: entry for name, entry in entries.items() if name not in sections}
    lines = [f"{name} = {toml_value(entry)}" for name, entry in plain.items()]
    for name, section in sections.items():
        lines += ["", f"[{name}]"]
        for key, field in type(section).model_fields.items():
            value = getattr(section, key)
            comment = f"  # {field.description}" if field.description else ""
            if value is None:  # TOML has no null: an absent key is the default
                lines.append(f"# {key} ={comment or ' unset'}")
            else:
                lines.append(f"{key} = {toml_value(value)}{comment}")
    return "\n".join(lines) + "\n"


def toml_value(value: Any) -> str:
    """A plain value as it stands in TOML; tables inline."""
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(toml_value(each) for each in value) + "]"
    if isinstance(value, Mapping):
        inner = ", ".join(f"{toml_key(key)} = {toml_value(each)}" for key, each in value.items())
        return f"{{ {inner} }}"
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def toml_key(name: str) -> str:
    """A key as it stands in TOML, in quotes where it must be."""
    return name if _BARE.fullmatch(name) else str(toml_value(name))
