"""Where a run begins and ends: signals, stdout, progress, and where errors become a line.

Ctrl-C and SIGTERM are an exception, so that every `with` block on the way out cleans up. This
module imports nothing that takes time, so that a signal is heeded from the first moment on.
"""

from __future__ import annotations

import gc
import io
import json
import os
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from time import monotonic
from types import FrameType
from typing import TYPE_CHECKING

from specmap_cli.core.errors import (
    INTERRUPTED,
    MACHINE,
    MEMORY,
    InputError,
    SpecmapError,
    UsageError,
    is_of_the_machine,
    is_of_the_place,
    reason,
)
from specmap_cli.core.progress import Level
from specmap_cli.core.text import one_line

if TYPE_CHECKING:
    from rich.progress import Progress as RichProgress
    from rich.progress import TaskID


SIGNALS = (signal.SIGINT, signal.SIGTERM)
# A second signal within this time is the same impatience and must not stop the cleaning up.
_PATIENCE_S = 1.0
_TOLD_EVERY_S = 10.0  # where stderr is no terminal


class Interruption(BaseException):
    """A signal asked the run to end; not an Exception, so that nothing swallows it."""

    def __init__(self, number: int) -> None:
        self.name = signal.Signals(number).name
        self.exit_code = 128 + number


@contextmanager
def interruptible(*, last: bool = False) -> Iterator[None]:
    """Raise Interruption inside the block when a signal asks to end.

    Afterwards all is as before; when the block is the `last` thing a process does, signals find it
    done and are ignored, so that the exit code stays what it was. Only the main thread receives
    signals: in another one the block runs as it is.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    heeded = -_PATIENCE_S

    def interrupt(number: int, _frame: FrameType | None) -> None:
        nonlocal heeded
        now = monotonic()
        if now - heeded >= _PATIENCE_S:
            heeded = now
            raise Interruption(number)

    before = {number: signal.signal(number, interrupt) for number in SIGNALS}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, signal.SIG_IGN if last else handler or signal.SIG_DFL)


_LOADED = 200_000  # to load a command makes half as many things that a collection looks through


def _collect_later() -> None:
    """Look for garbage only when all is loaded, which stays; from then on as usual."""
    usual = gc.get_threshold()

    def as_usual(phase: str, _: object) -> None:
        if phase == "stop":
            gc.callbacks.remove(as_usual)
            gc.set_threshold(*usual)

    gc.callbacks.append(as_usual)
    gc.set_threshold(_LOADED)


_YES = {"1", "true", "t", "yes", "y", "on"}  # as Typer reads a flag
_NO_TEMPORARY = "No usable temporary directory"  # how Python's own error begins
_OPENCV_NO_MEMORY = -4  # its code StsNoMem


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit code; without `arguments`, those of the process.

    An error is a line on stderr, and with `--json` an object on stdout, too. A bug is raised.
    """
    options = sys.argv[1:] if arguments is None else arguments
    if "--" in options:  # what follows are names of files
        options = options[: options.index("--")]
    as_json = "--json" in options or os.environ.get(JSON_VARIABLE, "").lower() in _YES
    alone = arguments is None
    if alone:
        _collect_later()
    try:
        with interruptible(last=alone):
            return _run(arguments, as_json)
    except Interruption as interruption:
        message = f"interrupted by {interruption.name}; nothing half-written is left"
        error = SpecmapError(message, code=INTERRUPTED)
        error.exit_code = interruption.exit_code
        return _fail(error, as_json)
    finally:
        if alone:  # what is left goes with the process: nobody need look through it first
            gc.freeze()


def _run(arguments: Sequence[str] | None, as_json: bool) -> int:
    from specmap_cli.cli.app import run

    try:
        code = run(arguments)
        if sys.stdout is not None:
            sys.stdout.flush()
        return code
    except BrokenPipeError:
        discard_stdout()
        return 0
    except Exception as error:
        told = _told(error)
        if told is None:
            _print_error(SpecmapError(f"a bug: {type(error).__name__}: {error}"), as_json)
            raise
        if isinstance(error, OSError):  # stdout itself may be full
            discard_stdout()
        return _fail(told, as_json)


def _told(error: Exception) -> SpecmapError | None:
    """What to say of an error that is no bug."""
    if isinstance(error, SpecmapError):
        return error
    of_opencv = type(error).__module__ == "cv2"  # it has an error of its own for want of memory
    short = of_opencv and getattr(error, "code", None) == _OPENCV_NO_MEMORY
    if isinstance(error, MemoryError) or short:
        what = f": {error}" if str(error) else ""
        hint = "a shorter log or a coarser grid (--set grid.resolution_m) needs less"
        return InputError(f"not enough memory{what}", hint, mark=";", code=MEMORY)
    if not isinstance(error, OSError):
        return None
    # what a machine runs out of is no bug, and no trace of it would help
    if (error.strerror or "").startswith(_NO_TEMPORARY):
        hint = "free some space there, or set TMPDIR to another directory"
        return UsageError(error.strerror, hint, code=MACHINE)
    if is_of_the_machine(error):
        said, hint = reason(error)
        return UsageError(said, hint, mark=";", where=error.filename, code=MACHINE)
    if isinstance(error, FileNotFoundError) and error.filename is None:  # of `os.getcwd`
        hint = "change to another one"
        return UsageError("the current directory was removed", hint, code=MACHINE)
    if is_of_the_place(error):
        from tempfile import gettempdir

        where, advice = error.filename or "the output", "write elsewhere"
        if isinstance(where, str) and where.startswith(os.path.join(gettempdir(), "")):
            advice = "set TMPDIR to another directory"
        return UsageError.of_system(error, "cannot be written", advice, where=where, code=MACHINE)
    return None


def _fail(error: SpecmapError, as_json: bool) -> int:
    """One line on stderr, which may be closed or full: the exit code tells then."""
    _print_error(error, as_json)
    if sys.stderr is not None:
        with suppress(OSError):
            print(f"specmap: error: {one_line(str(error))}", file=sys.stderr)
    return error.exit_code


def _print_error(error: SpecmapError, as_json: bool) -> None:
    """The error as an object in one line of stdout, if it is to be JSON: error.schema.json."""
    if not as_json:
        return
    parts = {
        "code": error.code,
        "message": one_line(str(error)),
        "where": None if error.where is None else one_line(error.where),
        "hint": None if error.hint is None else one_line(error.hint),
        "exit_code": error.exit_code,
    }
    with suppress(OSError):
        print_text(json.dumps({"schema_version": 1, "error": parts}, ensure_ascii=False) + "\n")


JSON_VARIABLE = "SPECMAP_JSON"  # in the environment: as `--json` on the command line


def print_text(text: str) -> None:
    """`text` on stdout; a reader that has seen enough, such as `head`, is no error.

    What the terminal cannot show, such as a file name of any bytes, is escaped.
    """
    try:
        try:
            _print_all(text)
        except UnicodeEncodeError:
            encoding = sys.stdout.encoding
            shown = text.encode(encoding, "backslashreplace").decode(encoding)
            _print_all(shown)
    except BrokenPipeError:
        discard_stdout()


def _print_all(text: str) -> None:
    """A text to its end: without a buffer (PYTHONUNBUFFERED) print takes a part for the whole."""
    raw = getattr(sys.stdout, "buffer", None)
    if not isinstance(raw, io.RawIOBase):
        print(text, end="", flush=True)
        return
    sys.stdout.flush()
    data = text.encode(sys.stdout.encoding, sys.stdout.errors or "strict")
    while data:
        data = data[raw.write(data) or 0 :]


def discard_stdout() -> None:
    """What is still buffered has nowhere to go: the interpreter must not try again at its exit."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    with suppress(OSError, AttributeError):  # closed, or no file at all
        os.dup2(nowhere, sys.stdout.fileno())
    os.close(nowhere)


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
    """A `Progress` on stderr: what its level shows; bars on a terminal, else lines now and then."""

    def __init__(self, level: Level = Level.INFO) -> None:
        self.level = level
        shown = level.shows(Level.INFO)
        self._bars = bars() if shown and sys.stderr.isatty() else None
        self._task: TaskID | None = None
        self._stage, self._done, self._since = "", 0, 0.0
        self._total: int | None = None
        self._over = threading.Event()
        lines = shown and self._bars is None
        self._teller = threading.Thread(target=self._tell, daemon=True) if lines else None

    def __enter__(self) -> ConsoleProgress:
        if self._bars is not None:
            self._bars.start()
        if self._teller is not None:
            self._teller.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        if self._teller is not None:
            self._teller.join()
        self._end_stage()
        if self._bars is not None:
            self._bars.stop()

    def _tell(self) -> None:
        """Where the work is, every ten seconds: `mapping: 1,204 of 4,934, 12 s`."""
        while not self._over.wait(_TOLD_EVERY_S):
            stage, done, total = self._stage, self._done, self._total
            steps = f" {done:,}{'' if total is None else f' of {total:,}'}," if done else ""
            if stage:
                self._line(Level.INFO, f"{stage}:{steps} {monotonic() - self._since:.0f} s")

    def start(self, stage: str, total: int | None) -> None:
        """Show a new bar in place of the last one."""
        self._end_stage()
        self._stage, self._done, self._since, self._total = stage, 0, monotonic(), total
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
        self._stage = stage

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
