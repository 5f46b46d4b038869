"""What a long computation tells about itself; the command line decides how it looks."""

from __future__ import annotations

from enum import StrEnum
from typing import Protocol


class Level(StrEnum):
    """How much of it is shown, from least to most; each shows what those before it show."""

    ERROR = "error"  # nothing but an error
    WARNING = "warning"  # what is wrong with the input or the result
    INFO = "info"  # notes, and how far it is: a bar, or lines where nobody watches
    DEBUG = "debug"  # each stage with its time

    def shows(self, other: Level) -> bool:
        """Whether a line of the `other` level is shown."""
        levels = list(Level)
        return levels.index(other) <= levels.index(self)


class Progress(Protocol):
    """Receives the advance of a run. All methods are cheap enough to call once a scan."""

    def start(self, stage: str, total: int | None) -> None:
        """A stage of `total` steps (None: unknown) begins."""

    def advance(self, steps: int = 1) -> None:
        """`steps` of the current stage are done."""

    def note(self, message: str) -> None:
        """A line worth reading now, such as the topics chosen."""

    def warn(self, message: str) -> None:
        """Something is wrong with the input or the result but the run goes on."""


class Silent:
    """A progress that shows nothing and remembers its warnings."""

    def __init__(self) -> None:
        self.warnings: list[str] = []

    def start(self, stage: str, total: int | None) -> None:
        """Ignored."""

    def advance(self, steps: int = 1) -> None:
        """Ignored."""

    def note(self, message: str) -> None:
        """Ignored."""

    def warn(self, message: str) -> None:
        """Remember `message`."""
        self.warnings.append(message)


class Remembering:
    """Hands everything on to another progress and remembers the warnings."""

    def __init__(self, progress: Progress) -> None:
        self.warnings: list[str] = []
        self._progress = progress
        self.start, self.advance, self.note = progress.start, progress.advance, progress.note

    def warn(self, message: str) -> None:
        """Handed on, and remembered."""
        self.warnings.append(message)
        self._progress.warn(message)
