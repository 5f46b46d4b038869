"""How a run shows itself: progress and notes on stderr, results on stdout."""

from __future__ import annotations

from typing import Any

from rich.console import Console
from rich.progress import BarColumn, ProgressColumn, Task, TaskID, TextColumn, TimeRemainingColumn
from rich.progress import Progress as RichProgress
from rich.text import Text

from specmap_cli.cli.stdout import print_text


class _Rate(ProgressColumn):
    """Steps done and steps per second."""

    def render(self, task: Task) -> Text:
        """The column's text."""
        total = f"/{task.total:,.0f}" if task.total is not None else ""
        rate = f"{task.speed:,.0f}/s" if task.speed else ""
        return Text(f"{task.completed:,.0f}{total} {rate}")


class ConsoleProgress:
    """A `Progress` on stderr: bars on a terminal, notes unless quiet, warnings always."""

    def __init__(self, quiet: bool = False) -> None:
        self.quiet = quiet
        self._console = Console(
            stderr=True, highlight=False, soft_wrap=True, markup=False, emoji=False
        )
        self._bars = RichProgress(
            TextColumn("{task.description}"),
            BarColumn(),
            _Rate(),
            TimeRemainingColumn(),
            console=self._console,
            transient=True,
            disable=quiet or not self._console.file.isatty(),
        )
        self._task: TaskID | None = None

    def __enter__(self) -> ConsoleProgress:
        self._bars.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bars.stop()

    def start(self, stage: str, total: int | None) -> None:
        """Show a new bar in place of the last one."""
        if self._task is not None:
            self._bars.remove_task(self._task)
        self._task = self._bars.add_task(stage, total=total)

    def advance(self, steps: int = 1) -> None:
        """Move the bar."""
        if self._task is not None:
            self._bars.advance(self._task, steps)

    def note(self, message: str) -> None:
        """A line on stderr, unless quiet."""
        if not self.quiet:
            self._line(message)

    def warn(self, message: str) -> None:
        """A line on stderr, also when quiet."""
        self._line(f"warning: {message}")

    def _line(self, message: str) -> None:
        self._console.print(f"specmap: {message}")


def print_result(result: dict[str, Any], lines: list[str], as_json: bool) -> None:
    """The result of a command on stdout: one JSON object, or lines for a person."""
    from specmap_cli.core.text import to_json

    print_text(to_json(result) if as_json else "\n".join(lines) + "\n")
