"""Progress, notes and warnings on stderr."""

from __future__ import annotations

from time import monotonic

from rich.console import Console
from rich.progress import BarColumn, ProgressColumn, Task, TaskID, TextColumn, TimeRemainingColumn
from rich.progress import Progress as RichProgress
from rich.text import Text

from specmap_cli.cli.entry import one_line
from specmap_cli.core.progress import Level


class Rate(ProgressColumn):
    """Steps done and steps per second."""

    def render(self, task: Task) -> Text:
        """The column's text."""
        total = f"/{task.total:,.0f}" if task.total is not None else ""
        rate = f"{task.speed:,.0f}/s" if task.speed else ""
        return Text(f"{task.completed:,.0f}{total} {rate}")


class ConsoleProgress:
    """A `Progress` on stderr: what its level shows; bars on a terminal alone."""

    def __init__(self, level: Level = Level.INFO) -> None:
        self.level = level
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
            disable=not level.shows(Level.INFO) or not self._console.file.isatty(),
        )
        self._task: TaskID | None = None
        self._stage, self._done, self._since = "", 0, 0.0

    def __enter__(self) -> ConsoleProgress:
        if not self._bars.disable:
            self._bars.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._end_stage()
        if not self._bars.disable:  # up to rich 14.2 even a disabled one would end with a line
            self._bars.stop()

    def start(self, stage: str, total: int | None) -> None:
        """Show a new bar in place of the last one."""
        self._end_stage()
        self._stage, self._done, self._since = stage, 0, monotonic()
        if self._task is not None:
            self._bars.remove_task(self._task)
        self._task = self._bars.add_task(stage, total=total)

    def advance(self, steps: int = 1) -> None:
        """Move the bar."""
        if self._task is not None:
            self._bars.advance(self._task, steps)
        self._done += steps

    def reach(self, steps: int, stage: str) -> None:
        """`steps` of the current stage are done in all, and it says so in words of its own."""
        if self._task is not None:
            self._bars.update(self._task, completed=steps, description=stage)

    def note(self, message: str) -> None:
        """A line, where the level shows it."""
        self._line(Level.INFO, message)

    def warn(self, message: str) -> None:
        """A line, where the level shows it: the result has its warnings, too."""
        self._line(Level.WARNING, f"warning: {message}")

    def _end_stage(self) -> None:
        """Tell of the stage that ends, in a line: `mapping: 4,187 steps in 12.3 s`."""
        if self._stage:
            steps = f"{self._done:,} steps in " if self._done else ""
            took_s = monotonic() - self._since
            self._line(Level.DEBUG, f"debug: {self._stage}: {steps}{took_s:.1f} s")
        self._stage = ""

    def _line(self, level: Level, message: str) -> None:
        if self.level.shows(level):
            self._console.print(f"specmap: {one_line(message)}")
