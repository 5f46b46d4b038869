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
def interruptible() -> Iterator[None]:
    """Raise Interruption inside the block when a signal asks to end; afterwards all is as before.

    Only the main thread can receive signals: in another one the block runs as it is.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    last = -_PATIENCE_S

    def interrupt(number: int, _frame: FrameType | None) -> None:
        nonlocal last
        now = time.monotonic()
        if now - last >= _PATIENCE_S:
            last = now
            raise Interruption(number)

    before = {number: signal.signal(number, interrupt) for number in SIGNALS}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)
