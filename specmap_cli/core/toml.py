"""TOML: a document and a model give a value, or one complaint; a value gives a document.

What a person writes is read here: settings, rules, jobs of a batch, edits of a map. A byte order
mark, which some editors set before the text, is passed over.
"""

from __future__ import annotations

import difflib
import json
import re
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, TypeVar

from pydantic import BaseModel, BeforeValidator, ValidationError
from pydantic_core import PydanticCustomError

from specmap_cli.core.errors import SpecmapError
from specmap_cli.core.shortage import reason

Model = TypeVar("Model", bound=BaseModel)
Keys = tuple[int | str, ...]  # the keys and numbers that lead to a value

_BARE = re.compile(r"[A-Za-z0-9_-]+")
_MOST_LISTED = 8  # keys that are all named to somebody who wrote another one
_SAID, _UNFIT = "said", "unfit"


def said(told: str) -> PydanticCustomError:
    """What a validator raises to have it told as `KEY: TOLD`."""
    return PydanticCustomError(_SAID, "{told}", {"told": told})


def unless(fits: Callable[[Any], bool], told: str) -> BeforeValidator:
    """A validator that has a value that does not fit told as `KEY is VALUE: TOLD`."""

    def check(value: Any) -> Any:
        if not fits(value):
            raise PydanticCustomError(_UNFIT, "{told}", {"told": told})
        return value

    return BeforeValidator(check)


@dataclass(frozen=True, slots=True, kw_only=True)
class TomlFormat(Generic[Model]):
    """A kind of document: the model of what it holds, and how what is wrong with one is told.

    `error` makes the error of a line. A key is called `noun`, and a complaint ends with `advice`,
    which begins with its colon or semicolon. `plainly` has our words for types of pydantic's
    findings. `named` gives a place as a person finds it, and the keys that may stand there; without
    it keys are dotted.
    """

    model: type[Model]
    error: Callable[[str], SpecmapError]
    noun: str = "key"
    advice: str = ""
    plainly: Mapping[str, str] = field(default_factory=dict)
    named: Callable[[Keys], tuple[str, Sequence[str]]] | None = None

    def read(self, path: Path) -> Model:
        """What a file holds. Raises the error that names the file and the place at fault."""
        return self.value(self.tables(path), f"{path}: ")

    def tables(self, path: Path) -> dict[str, Any]:
        """The tables of a file, not yet held against the model. Raises the error."""
        return self._parsed(self.text(path), f"{path}: ")

    def text(
        self,
        path: Path,
        read: Callable[[Path], bytes] = Path.read_bytes,
        missing: str | None = None,
    ) -> str:
        """The text of a file, `missing` where there is none and that is no error."""
        try:
            return read(path).decode("utf-8-sig")
        except OSError as error:
            if missing is not None and isinstance(error, FileNotFoundError):
                return missing
            raise self.error(f"{path}: cannot be read: {reason(error)}") from None
        except UnicodeDecodeError:
            raise self.error(f"{path}: not UTF-8 text: save it as UTF-8") from None

    def of_text(self, text: str, where: str = "") -> Model:
        """What a text holds; `where`, a file and a colon, stands before a complaint."""
        return self.value(self._parsed(text, where), where)

    def value(self, tables: Mapping[str, Any], where: str | Callable[[Keys], str] = "") -> Model:
        """What tables hold; `where` stands before a complaint, and may depend on the place."""
        try:
            return self.model.model_validate(tables)
        except ValidationError as error:
            finding = error.errors()[0]
        before = where if isinstance(where, str) else where(finding["loc"])
        raise self.error(f"{before}{self._complaint(finding)}{self.advice}")

    def _parsed(self, text: str, where: str) -> dict[str, Any]:
        try:
            return tomllib.loads(text)
        except tomllib.TOMLDecodeError as error:
            found = f"not valid TOML: {error}"
        except RecursionError:
            found = "nested too deeply"
        except ValueError:  # Python reads no integer of thousands of digits
            found = "a number of too many digits"
        raise self.error(f"{where}{found}{self.advice}")

    def _complaint(self, finding: Mapping[str, Any]) -> str:
        """One finding of a validation: the key, what is wrong, what was found."""
        place = tuple(part for part in finding["loc"] if part != "[key]")
        key, known = self._dotted(place) if self.named is None else self.named(place)
        kind, value, told = finding["type"], finding["input"], str(finding["msg"])
        if kind == "extra_forbidden":
            return f"{key}: no such {self.noun}{_hint(key, known)}"
        if kind == "missing":
            return f"{key}: is missing"
        if kind == _SAID:
            return f"{key}: {told}"
        if kind == _UNFIT:
            return f"{key} is {value!r:.60}: {told}"
        if kind in self.plainly:
            told = self.plainly[kind]
        elif kind in ("dict_type", "model_type"):
            return f"{key} is {value!r:.60}: expected a table [{key}]"
        of_all = kind == "value_error" and isinstance(value, Mapping)  # of no single value in it
        found = "" if of_all else f", found {value!r:.60}"
        return f"{key}: {told.removeprefix('Value error, ')}{found}"

    def _dotted(self, place: Keys) -> tuple[str, Sequence[str]]:
        return ".".join(str(part) for part in place), list(_keys(self.model))


def _keys(model: type[BaseModel]) -> Iterator[str]:
    """The keys of a document, those in its sections dotted."""
    for name, entry in model.model_fields.items():
        yield name
        if isinstance(entry.annotation, type) and issubclass(entry.annotation, BaseModel):
            yield from (f"{name}.{key}" for key in _keys(entry.annotation))


def _hint(key: str, known: Sequence[str]) -> str:
    """Which key was meant, by its dotted name or its last part; which there are, if few."""
    last = re.split(r"[.\s]", key)[-1]
    near = difflib.get_close_matches(key, known, 1) or difflib.get_close_matches(last, known, 1)
    if near:
        return f", did you mean {near[0]}?"
    return f", expected {', '.join(known)}" if len(known) <= _MOST_LISTED else ""


def value_of(text: str) -> Any:
    """A value as it stands behind a key; the text itself where it is no TOML."""
    try:
        found = tomllib.loads(f"value = {text}")
    except (ValueError, RecursionError):
        return text
    return found["value"] if len(found) == 1 else text


def to_toml(config: BaseModel) -> str:
    """A configuration as TOML with a comment a documented key; `load_config` reads it back."""
    entries = {name: getattr(config, name) for name in type(config).model_fields}
    sections = {name: entry for name, entry in entries.items() if isinstance(entry, BaseModel)}
    plain = {name: entry for name, entry in entries.items() if name not in sections}
    lines = [f"{name} = {toml_value(entry)}" for name, entry in plain.items()]
    for name, section in sections.items():
        lines += ["", f"[{name}]"]
        for key, entry in type(section).model_fields.items():
            value = getattr(section, key)
            comment = f"  # {entry.description}" if entry.description else ""
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
        inner = ", ".join(f"{_key(key)} = {toml_value(each)}" for key, each in value.items())
        return f"{{ {inner} }}"
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def _key(name: str) -> str:
    """A key as it stands in TOML, in quotes where it must be."""
    return name if _BARE.fullmatch(name) else toml_value(name)
