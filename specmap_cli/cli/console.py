"""Progress, notes and warnings on stderr."""

from __future__ import annotations

from rich.console import Console
from rich.progress import BarColumn, ProgressColumn, Task, TaskID, TextColumn, TimeRemainingColumn
from rich.progress import Progress as RichProgress
from rich.text import Text

from specmap_cli.cli.streams import one_line


class Rate(ProgressColumn):
    """Steps done and steps per second."""

    def render(self, task: Task) -> Text:
        """The column's text."""
        total = f"/{task.total:,.0f}" if task.total is not None else ""
        rate = f"{task.speed:,.0f}/s" if task.speed else ""
        return Text(f"{task.completed:,.0f}{total} {rate}")


class ConsoleProgress:
    """A `Progress` on stderr: bars on a terminal, notes and warnings; nothing when quiet."""

    def __init__(self, quiet: bool = False) -> None:
        self.quiet = quiet
        self._console = Console(
            stderr=True, highlight=False, soft_wrap=True, markup=False, emoji=False
        )
        self._bars = RichProgress(
            TextColumn("{task.description}"),
            BarColumn(),
            Rate(),
            TimeRemainingColumn(),
            console=self._console,
            transient=True,
            disable=quiet or not self._console.file.isatty(),
        )
        self._task: TaskID | None = None

    def __enter__(self) -> ConsoleProgress:
        if not self._bars.disable:
            self._bars.start()
        return self

    def __exit__(self, *_: object) -> None:
        if not self._bars.disable:  # up to rich 14.2 even a disabled one would end with a line
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
        """A line, unless quiet."""
        self._line(message)

    def warn(self, message: str) -> None:
        """A line, unless quiet: the result has its warnings, too."""
        self._line(f"warning: {message}")

    def _line(self, message: str) -> None:
        if not self.quiet:
            self._console.print(f"specmap: {one_line(message)}")
