"""The error tree: everything the tool tells a user in one line.

    SpecmapError            exit code
    ├── UsageError          2   the command, an option or the configuration is wrong
    ├── InputError          3   the input cannot be used
    │   ├── LogError            a recording: missing, damaged, without scans
    │   └── MapError            a map directory or an occupancy grid
    └── NoResultError       4   the run finished and there is nothing to show for it

A message says what, where (file, topic, byte or message), what was found, and what to do, in the
form `WHERE: WHAT WAS FOUND: WHAT TO DO`, or with a semicolon before what to do. Programs get the
fields `where` and `hint` (what to do), and a `code` that stays the same over versions: one of
`CODES`.
Nothing in the packages prints or exits: `specmap_cli.cli` holds the one handler. What a
machine runs out of is told as what it is, with what to do about it (`reason`).
"""

from __future__ import annotations

import errno
import os
import re
from collections.abc import Mapping

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

# What advice begins with; a last part of a message that begins otherwise is what was found.
_ADVICE = re.compile(
    r"(?:: |; )(?=(?:"
    r"append|bring|build|check|choose|copy|end|expected|free|give|if|"
    r"install|keep|leave|look|lower|make|mend|move|name(?! is\b|:)|pip|put|raise|"
    r"remove|rename|run|save|say|scale|see|set|take|turn|unpack|use|write"
    r")\b)"
)
_OF_USAGE = re.compile(  # how Typer begins
    r"(?:No such option:?|Missing option|Missing argument|Invalid value for) '?([^\s':;.]+)"
)
_FILE = re.compile(r"[^\n]*(?:/[^/]*|\.[A-Za-z]\w{0,8})")


class SpecmapError(Exception):
    """Base of every error meant for the user; `exit_code` is the process's exit status.

    `code` is one of `CODES`, by default that of the class. `where` is the file, the option or the
    setting at fault, `hint` what to do; where they are not given they are looked for in the
    message, and None where it does not say.
    """

    exit_code = 1
    code = BUG

    def __init__(
        self,
        message: str = "",
        *,
        code: str | None = None,
        where: str | None = None,
        hint: str | None = None,
    ) -> None:
        super().__init__(message)
        if code is not None:
            self.code = code
        line = " ".join(message.split())
        self.where = _where_in(line) if where is None else where
        self.hint = _hint_in(line) if hint is None else hint


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


class NoResultError(SpecmapError):
    """The run finished without a result."""

    exit_code = 4
    code = NO_RESULT


def _where_in(line: str) -> str | None:
    """The place that a message begins with: one word, an option, or the name of a file.

    Typer's own messages name an option or an argument behind their first words.
    """
    of_usage = _OF_USAGE.match(line)
    if of_usage is not None:
        return of_usage[1]
    head, colon, _ = line.partition(": ")
    named = " " not in head or head.startswith("-") or _FILE.fullmatch(head)
    return head if colon and named else None


def _hint_in(line: str) -> str | None:
    """The advice that a message ends with, from the first colon or semicolon that leads to it."""
    found = _ADVICE.search(line)
    return None if found is None else line[found.end() :]


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


def reason(error: OSError, advice: str = "") -> str:
    """What the system says of an error, and what to do: `advice` where another place helps.

    >>> reason(OSError(errno.ENOSPC, "No space left on device"), "choose another place")
    'No space left on device; free some space, or choose another place'
    """
    said = error.strerror or str(error)
    number = error.errno or 0
    if is_of_the_machine(error):
        return f"{said}; {_OF_THE_MACHINE[number]}"
    if is_of_the_place(error) and advice:
        return f"{said}; {_OF_THE_PLACE[number]}{advice}"
    return f"{said}; {advice}" if advice else said


def _is_of_the_system(error: OSError) -> bool:
    """Whether the words are the system's: errors of our own have their own."""
    return error.strerror == os.strerror(error.errno or 0)
