"""What a long computation tells about itself; the command line decides how it looks."""

from __future__ import annotations

from typing import Protocol


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
