"""TOML: a document and a model give a value, or one complaint; a value gives a document.

What a person writes is read here: settings, rules, jobs of a batch, edits of a map. A byte order
mark, which some editors set before the text, is passed over.
"""

from __future__ import annotations

import difflib
import json
import re
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, TypeVar

from pydantic import BaseModel, BeforeValidator, ValidationError

from specmap_cli.core.errors import SpecmapError
from specmap_cli.core.schemas import meanings
from specmap_cli.core.text import quoted, said

Model = TypeVar("Model", bound=BaseModel)
Keys = tuple[int | str, ...]  # the keys and numbers that lead to a value

_BARE = re.compile(r"[A-Za-z0-9_-]+")
_MOST_LISTED = 8  # keys that are all named to somebody who wrote another one


class UnfitError(ValueError):
    """What a validator raises: `KEY: FOUND: HINT` is told, without `found` `KEY is VALUE: HINT`."""

    def __init__(self, hint: str, found: str = "") -> None:
        super().__init__(hint)
        self.hint, self.found = hint, found


def unless(fits: Callable[[Any], bool], hint: str) -> BeforeValidator:
    """A validator that refuses what does not fit: `KEY is VALUE: HINT`."""

    def check(value: Any) -> Any:
        if not fits(value):
            raise UnfitError(hint)
        return value

    return BeforeValidator(check)


@dataclass(frozen=True, slots=True, kw_only=True)
class TomlFormat(Generic[Model]):
    """A kind of document: the model of what it holds, and how what is wrong with one is told.

    `error` is the class of the errors, `code` theirs, by default that of the class. A key is called
    `noun`, and a complaint ends with `advice`, which begins with its colon or semicolon. `plainly`
    has our words for types of pydantic's findings. `named` gives a place as a person finds it, and
    the keys that may stand there; without it keys are dotted.
    """

    model: type[Model]
    error: type[SpecmapError]
    code: str | None = None
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
            raise self.error.of_system(
                error, "cannot be read", where=path, code=self.code
            ) from None
        except UnicodeDecodeError:
            raise self._error(f"{path}: ", "not UTF-8 text", ": save it as UTF-8") from None

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
        key, found, hint = self._complaint(finding)
        raise self._error(before, f"{key}{found}", f"{hint}{self.advice}", key)

    def meant(self, key: str) -> str:
        """The key that somebody meant by another one; empty where none is near."""
        return _meant(key, list(_keys(self.model)))

    def _parsed(self, text: str, where: str) -> dict[str, Any]:
        try:
            return tomllib.loads(text)
        except tomllib.TOMLDecodeError as error:
            found = f"not valid TOML: {error}"
        except RecursionError:
            found = "nested too deeply"
        except ValueError:  # Python reads no integer of thousands of digits
            found = "a number of too many digits"
        raise self._error(where, found, self.advice)

    def _error(self, where: str, found: str, hint: str, key: str | None = None) -> SpecmapError:
        """The error of a line; `hint` begins with what parts it from what was found."""
        file, _, place = where.partition(": ")
        mark, advice = hint[:1], hint[1:].strip() or None
        error = self.error(f"{place}{found}", advice, mark=mark, where=file or None, code=self.code)
        error.where = file or key  # a key stands within what was found
        return error

    def _complaint(self, finding: Mapping[str, Any]) -> tuple[str, str, str]:
        """One finding of a validation: the key, what is wrong with it, and what to do."""
        place = tuple(part for part in finding["loc"] if part != "[key]")
        if self.named is not None:
            key, known = self.named(place)
        else:
            key, known = ".".join(str(part) for part in place), list(_keys(self.model))
        kind, value = finding["type"], finding["input"]
        if kind == "extra_forbidden":
            # which key was meant; which there are, if few
            near = _meant(key, known)
            hint = near and f", did you mean {near}?"
            if not near and len(known) <= _MOST_LISTED:
                hint = f", expected {', '.join(known)}"
            return key, f": no such {self.noun}", hint
        if kind == "missing":
            return key, ": is missing", ""
        unfit = finding.get("ctx", {}).get("error")
        if isinstance(unfit, UnfitError):
            found = f": {unfit.found}" if unfit.found else f" is {quoted(value)}"
            return key, found, f": {unfit.hint}"
        told = self.plainly.get(kind, said(finding))
        if kind not in self.plainly and kind in ("dict_type", "model_type"):
            return key, f" is {quoted(value)}", f": expected a table [{key}]"
        of_all = kind == "value_error" and isinstance(value, Mapping)  # of no single value in it
        found = "" if of_all else f", found {quoted(value)}"
        return key, f": {told}{found}", ""


def _keys(model: type[BaseModel]) -> Iterator[str]:
    """The keys of a document, those in its sections dotted."""
    for name, entry in model.model_fields.items():
        yield name
        if isinstance(entry.annotation, type) and issubclass(entry.annotation, BaseModel):
            yield from (f"{name}.{key}" for key in _keys(entry.annotation))


def flat(table: Any) -> Any:
    """The entries of nested tables by dotted key; what is no table as it is."""
    if not isinstance(table, Mapping):
        return table
    found: dict[str, Any] = {}
    for key, value in table.items():
        inner = flat(value)
        below = isinstance(value, Mapping)
        found |= {f"{key}.{name}": each for name, each in inner.items()} if below else {key: inner}
    return found


def choice(name: str, known: Iterable[str]) -> str:
    """What to do about a name that is none of those known."""
    near = _nearest(name, known)
    return f"did you mean {near}?" if near else f"choose from {', '.join(known)}"


def _meant(key: str, known: Iterable[str]) -> str:
    """The key that was meant, by its dotted name or its last part; empty where none is near."""
    return _nearest(key, known) or _nearest(re.split(r"[.\s]", key)[-1], known)


def _nearest(name: str, known: Iterable[str]) -> str:
    """The name that was meant; empty where none is near."""
    return "".join(difflib.get_close_matches(name, list(known), 1))


def value_of(text: str) -> Any:
    """A value as it stands behind a key; the text itself where it is no TOML."""
    try:
        found = tomllib.loads(f"value = {text}")
    except (ValueError, RecursionError):
        return text
    return found["value"] if len(found) == 1 else text


def to_toml(config: BaseModel) -> str:
    """A configuration as TOML with a comment a documented key; `load_config` reads it back."""
    sections = {name: entry for name, entry in config if isinstance(entry, BaseModel)}
    lines = [f"{name} = {toml_value(entry)}" for name, entry in config if name not in sections]
    for name, section in sections.items():
        lines += ["", f"[{name}]"]
        for key, meaning in meanings(type(section)).items():
            value = getattr(section, key)
            comment = f"  # {meaning}" if meaning else ""
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
        inner = [
            f"{key if _BARE.fullmatch(key) else toml_value(key)} = {toml_value(each)}"
            for key, each in value.items()
        ]
        return f"{{ {', '.join(inner)} }}"
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
