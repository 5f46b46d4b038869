"""Progress, notes and warnings on stderr."""

from __future__ import annotations

import sys
from time import monotonic
from typing import TYPE_CHECKING

from specmap_cli.cli.entry import one_line
from specmap_cli.core.progress import Level

if TYPE_CHECKING:
    from rich.progress import Progress as RichProgress
    from rich.progress import TaskID


def bars() -> RichProgress:
    """Bars on a terminal: the stage, steps done and steps per second, and the time that is left."""
    from rich import progress  # slow to load: where no bar is shown nobody waits for it
    from rich.console import Console
    from rich.text import Text

    class Rate(progress.ProgressColumn):
        def render(self, task: progress.Task) -> Text:
            total = f"/{task.total:,.0f}" if task.total is not None else ""
            rate = f"{task.speed:,.0f}/s" if task.speed else ""
            return Text(f"{task.completed:,.0f}{total} {rate}")

    console = Console(stderr=True, highlight=False, soft_wrap=True, markup=False, emoji=False)
    stage, left = progress.TextColumn("{task.description}"), progress.TimeRemainingColumn()
    columns = stage, progress.BarColumn(), Rate(), left
    return progress.Progress(*columns, console=console, transient=True)


class ConsoleProgress:
    """A `Progress` on stderr: what its level shows; bars on a terminal alone."""

    def __init__(self, level: Level = Level.INFO) -> None:
        self.level = level
        shown = level.shows(Level.INFO) and sys.stderr.isatty()
        self._bars = bars() if shown else None
        self._task: TaskID | None = None
        self._stage, self._done, self._since = "", 0, 0.0

    def __enter__(self) -> ConsoleProgress:
        if self._bars is not None:
            self._bars.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._end_stage()
        if self._bars is not None:
            self._bars.stop()

    def start(self, stage: str, total: int | None) -> None:
        """Show a new bar in place of the last one."""
        self._end_stage()
        self._stage, self._done, self._since = stage, 0, monotonic()
        if self._bars is not None:
            if self._task is not None:
                self._bars.remove_task(self._task)
            self._task = self._bars.add_task(stage, total=total)

    def advance(self, steps: int = 1) -> None:
        """Move the bar."""
        if self._bars is not None and self._task is not None:
            self._bars.advance(self._task, steps)
        self._done += steps

    def reach(self, steps: int, stage: str) -> None:
        """`steps` of the current stage are done in all, and it says so in words of its own."""
        if self._bars is not None and self._task is not None:
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
            line = f"specmap: {one_line(message)}"
            if self._bars is None:
                print(line, file=sys.stderr)
            else:
                self._bars.console.print(line)
