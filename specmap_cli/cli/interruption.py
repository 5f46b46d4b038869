"""Ctrl-C and SIGTERM as an exception, so that every `with` block on the way out cleans up."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

SIGNALS = (signal.SIGINT, signal.SIGTERM)
# A second signal within this time is the same impatience and must not stop the cleaning up.
_PATIENCE_S = 1.0


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
        now = time.monotonic()
        if now - heeded >= _PATIENCE_S:
            heeded = now
            raise Interruption(number)

    before = {number: signal.signal(number, interrupt) for number in SIGNALS}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, signal.SIG_IGN if last else handler or signal.SIG_DFL)
