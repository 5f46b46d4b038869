"""The error tree: everything the tool tells a user in one line.

    SpecmapError            exit code
    ├── UsageError          2   the command, an option or the configuration is wrong
    ├── InputError          3   the input cannot be used
    │   ├── LogError            a recording: missing, damaged, without scans
    │   └── MapError            a map directory or an occupancy grid
    └── NoResultError       4   the run finished and there is nothing to show for it

An error is made of its parts: what was found, what to do about it (`hint`), and where (a file, an
option, a setting). Its line is `WHERE: FOUND: HINT`, with another `mark` than the last colon where
the error asks for it. Programs get the parts, and a `code` that stays the same over versions: one
of `CODES`.
Nothing in the packages prints or exits: `specmap_cli.cli` holds the one handler. What a
machine runs out of is told as what it is, with what to do about it (`reason`). Arguments of public
functions are checked before the work: a wrong type is a TypeError at once.
"""

from __future__ import annotations

import errno
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Self, TypeVar

from specmap_cli.core.text import quoted

# The exit code of a run that finished, but whose result breaks a rule that was asked for.
BROKEN_RULE = 5

BUG, INTERRUPTED = "bug", "interrupted"
USAGE, SETTING, CHOICE = "usage", "setting", "choice-needed"
OUTPUT_EXISTS, OUTPUT, PACKAGE = "output-exists", "output-unwritable", "package-missing"
MACHINE, MEMORY, TOO_LARGE = "machine", "memory", "too-large"
INPUT, LOG, LOG_MISSING, LOG_DAMAGED = "input", "log-unusable", "log-missing", "log-damaged"
MAP, MAP_MISSING = "map-unusable", "map-missing"
NO_RESULT, NOT_ALIGNED = "no-result", "not-aligned"

# Every code, with its exit code and what it means.
CODES: Mapping[str, tuple[int, str]] = {
    BUG: (1, "a bug in specmap, with its traceback on stderr"),
    USAGE: (2, "the command line is wrong"),
    SETTING: (2, "a setting, or a file of settings or rules, is wrong"),
    CHOICE: (2, "several topics, frames or lasers fit: one must be named"),
    OUTPUT_EXISTS: (2, "the output exists and is not replaced without --overwrite"),
    OUTPUT: (2, "the output cannot be written there"),
    PACKAGE: (2, "a package is missing, or one that was installed does not fit"),
    MACHINE: (2, "the machine has too little room, too few files, or refuses to write"),
    MEMORY: (3, "memory was not enough"),
    TOO_LARGE: (3, "an input is larger than a setting allows"),
    INPUT: (3, "an input does not fit, such as true poses, or another laser than the map's"),
    LOG: (3, "a recording cannot be read, or has no scans"),
    LOG_MISSING: (3, "there is no recording of that name"),
    LOG_DAMAGED: (3, "of a recording nothing is left that can be read"),
    MAP: (3, "a map or a plan is damaged, or lacks what the command needs"),
    MAP_MISSING: (3, "there is no map of that name"),
    NO_RESULT: (4, "done, with nothing to show, such as no scan that could be registered"),
    NOT_ALIGNED: (4, "two maps, or a map and a recording, do not fit in one way only"),
    INTERRUPTED: (130, "ended by Ctrl-C; by SIGTERM with exit code 143"),
}


class SpecmapError(Exception):
    """Base of every error meant for the user; `exit_code` is the process's exit status.

    `found` is what is wrong, `hint` what to do, `where` the file, the option or the setting at
    fault, `code` one of `CODES`, by default that of the class. `mark` stands before the hint.
    """

    exit_code = 1
    code = BUG

    def __init__(
        self,
        found: object = "",
        hint: str | None = None,
        *,
        mark: str = ":",
        where: object = None,
        code: str | None = None,
    ) -> None:
        self.found, self.hint, self.mark = str(found), hint, mark
        self.where = None if where is None else str(where)
        if code is not None:
            self.code = code
        # What is told before the hint.
        self.told = ": ".join(str(part) for part in (where, found) if part not in (None, ""))
        before = f"{self.told}{mark} " if self.told and hint is not None else self.told
        super().__init__(f"{before}{hint or ''}")

    def within(self, place: object) -> Self:
        """The same error, told of a larger place, such as a file of jobs."""
        return type(self)(self.told, self.hint, mark=self.mark, where=place, code=self.code)

    @classmethod
    def of_system(
        cls,
        error: OSError,
        found: str,
        advice: str = "",
        *,
        where: object = None,
        code: str | None = None,
    ) -> Self:
        """The error that the system's makes: `advice` where another place helps."""
        said, hint = reason(error, advice)
        return cls(f"{found}: {said}", hint or None, mark=";", where=where, code=code)


class UsageError(SpecmapError):
    """The command, an option or the configuration is wrong."""

    exit_code = 2
    code = USAGE


class InputError(SpecmapError):
    """The input cannot be used."""

    exit_code = 3
    code = INPUT


class LogError(InputError):
    """A recording cannot be read or holds nothing usable."""

    code = LOG


class MapError(InputError):
    """A map directory or an occupancy grid cannot be read."""

    code = MAP

    @classmethod
    def damaged(cls, found: object, path: object) -> Self:
        """A file of a map is not as it was written."""
        return cls(found, "build the map again", where=path)


class NoResultError(SpecmapError):
    """The run finished without a result."""

    exit_code = 4
    code = NO_RESULT


# Another place helps against these,
_OF_THE_PLACE = {
    errno.ENOSPC: "free some space, or ",
    errno.EDQUOT: "your quota is used up: remove some files, or ",
    errno.EROFS: "",
    errno.EFBIG: "see `ulimit -f`, or ",
    errno.EIO: "the disk fails: check it, or ",
}
# and nothing but this against these.
_OF_THE_MACHINE = {
    errno.EMFILE: "give fewer files at once, or raise the limit with `ulimit -n`",
    errno.ENFILE: "this machine has too many of them open: end other programs",
    errno.ENOMEM: "end other programs, or give less at once",
}


def is_of_the_place(error: OSError) -> bool:
    """Whether the system refused to write at one place: a full disk, a quota, and the like."""
    return error.errno in _OF_THE_PLACE and _is_of_the_system(error)


def is_of_the_machine(error: OSError) -> bool:
    """Whether the process or the machine has too little of something, wherever files are."""
    return error.errno in _OF_THE_MACHINE and _is_of_the_system(error)


def reason(error: OSError, advice: str = "") -> tuple[str, str]:
    """What the system says of an error, and what to do: `advice` where another place helps.

    >>> reason(OSError(errno.ENOSPC, "No space left on device"), "choose another place")
    ('No space left on device', 'free some space, or choose another place')
    """
    said, number = error.strerror or str(error), error.errno or 0
    if is_of_the_machine(error):
        return said, _OF_THE_MACHINE[number]
    if is_of_the_place(error) and advice:
        return said, f"{_OF_THE_PLACE[number]}{advice}"
    return said, advice


def _is_of_the_system(error: OSError) -> bool:
    """Whether the words are the system's: errors of our own have their own."""
    return error.strerror == os.strerror(error.errno or 0)


Wanted = TypeVar("Wanted")

Paths = Sequence[Path | str] | Path | str


def path_of(value: Any, name: str) -> Path:
    """`value` as a path. Raises TypeError naming the argument `name` when it is none."""
    if not isinstance(value, str | os.PathLike):
        raise TypeError(f"{name}: expected a path (str or Path), found {quoted(value)}")
    return Path(value)


def paths_of(value: Any, name: str) -> list[Path]:
    """`value`, one path or several, as a list. Raises TypeError as `path_of` does."""
    if isinstance(value, str | os.PathLike):
        return [Path(value)]
    if not isinstance(value, Sequence):
        raise TypeError(f"{name}: expected a path or a sequence of paths, found {quoted(value)}")
    return [path_of(each, name) for each in value]


def instance_of(value: Any, kind: type[Wanted], name: str) -> Wanted:
    """`value` if it is of the kind. Raises TypeError naming the argument `name` otherwise."""
    if not isinstance(value, kind):
        raise TypeError(f"{name}: expected {kind.__name__}, found {quoted(value)}")
    return value
