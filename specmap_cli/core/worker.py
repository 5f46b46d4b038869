"""Work that runs ahead of its use in a second process.

Registration needs nothing that later stages find out. One placement of the nodes of a large map
needs no other. The classifiers of raw scans need no grids of submaps. The other files of a map do
not need the one of its scans. Where there is a second processor, a forked child does such work
meanwhile. The results are those of one process, bit for bit. They wait in a pipe of bounded size.

The work is a generator: what it yields are the items, what it returns is the result.
"""

from __future__ import annotations

import fcntl
import gc
import multiprocessing
import signal
import sys
import threading
import traceback
import warnings
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from multiprocessing.reduction import ForkingPickler
from typing import Any, Generic, TypeVar

import cv2

from specmap_cli.core.errors import INTERRUPTED, MEMORY, InputError, SpecmapError
from specmap_cli.core.process import give_memory_back, processors

Item = TypeVar("Item")
Result = TypeVar("Result")

_PIPE_BYTES = 1 << 20  # some hundred scans; Linux gives it without special rights
_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_TOGETHER_BYTES = 1 << 16  # some ten scans: one by one, each would wake the other process
_ITEMS, _RESULT, _ERROR = range(3)  # the kinds of messages from the child


class Ahead(Generic[Item, Result]):
    """The items of a generator in order, and then its result."""

    def __init__(self, source: Generator[Item, None, Result]) -> None:
        self._source = source
        self._returned: list[Result] = []  # empty until the source has ended

    def __iter__(self) -> Iterator[Item]:
        return self

    def __next__(self) -> Item:
        try:
            return next(self._source)
        except StopIteration as end:
            if not self._returned:
                self._returned.append(end.value)
            raise

    @property
    def result(self) -> Result:
        """What the generator returned; items that nobody took are skipped to get there."""
        for _ in self:
            pass
        return self._returned[0]


@contextmanager
def ahead(
    produce: Callable[[], Generator[Item, None, Result]], *, worthwhile: bool = True
) -> Iterator[Ahead[Item, Result]]:
    """Run `produce()` ahead of its use, in a child process where it is worth one and can have one.

    What `produce` changes in its process stays there: all that is needed of it must be yielded or
    returned. Its errors are raised here, where the items are taken. Leaving the block ends the
    child. Raises SpecmapError when the child dies.
    """
    # A fork is safe on Linux only: libraries of other systems hold threads and handles that it
    # breaks. It copies locks as other threads hold them: only the main thread forks.
    in_main = threading.current_thread() is threading.main_thread()
    alone = not multiprocessing.current_process().daemon
    possible = sys.platform == "linux" and in_main and alone and processors() > 1
    if not (worthwhile and possible):
        yield Ahead(produce())
        return
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)  # the child would wait for the threads of a pool that it does not have
    context = multiprocessing.get_context("fork")
    receiver, sender = context.Pipe(duplex=False)
    with suppress(AttributeError, OSError):  # more items wait in it where the system allows that
        fcntl.fcntl(sender.fileno(), fcntl.F_SETPIPE_SZ, _PIPE_BYTES)
    child = context.Process(target=_child, args=(produce, receiver, sender), daemon=True)
    try:
        with _held_signals(), warnings.catch_warnings():
            # Python 3.12 warns of other threads: of a progress bar's, whose locks the child avoids
            warnings.simplefilter("ignore", DeprecationWarning)
            give_memory_back()
            gc.freeze()  # a collection in the child would make it a copy of every page of objects
            child.start()
            gc.unfreeze()
        sender.close()
        yield Ahead(_received(receiver, child))
    finally:
        receiver.close()
        sender.close()
        if child.pid is not None:
            child.terminate()
            child.join()
        cv2.setNumThreads(threads)


@contextmanager
def _held_signals() -> Iterator[None]:
    """Hold requests to end back until the child heeds them in its own way."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, _SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _child(
    produce: Callable[[], Generator[Any, None, Any]], receiver: Connection, sender: Connection
) -> None:
    """The child sends all items, then the result or the error; it ends when its parent is gone."""
    receiver.close()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches both: the parent decides
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _SIGNALS)
    work = Ahead(produce())
    try:
        _send_items(work, sender)
        sender.send((_RESULT, work.result))
    except BrokenPipeError:  # nobody takes the items any more
        return
    except Exception as error:
        with suppress(BrokenPipeError):
            sender.send((_ERROR, _portable(error)))
        raise SystemExit(1) from None  # it is the parent that tells


def _send_items(work: Iterator[Any], sender: Connection) -> None:
    """Send every item, small ones together; also those before an error."""
    waiting: list[bytes] = []
    size = 0
    try:
        for item in work:
            packed = bytes(ForkingPickler.dumps(item))
            waiting.append(packed)
            size += len(packed)
            if size >= _TOGETHER_BYTES:
                sender.send((_ITEMS, waiting))
                waiting, size = [], 0
    finally:
        sender.send((_ITEMS, waiting))


def _portable(error: Exception) -> Exception:
    """The error as it can be sent to the parent, with its place unless it is meant for the user."""
    place = f"in the process that ran ahead:\n{traceback.format_exc()}"
    try:
        ForkingPickler.loads(ForkingPickler.dumps(error))
    except Exception:  # it holds what cannot be sent, or cannot be made again from its arguments
        error = RuntimeError(f"{type(error).__name__}: {error}")
    if not isinstance(error, SpecmapError):
        error.add_note(place)
    return error


def _received(receiver: Connection, child: BaseProcess) -> Generator[Any, None, Any]:
    """The items as they come from the child, then its result; raises its error, or of its death."""
    while True:
        try:
            kind, value = receiver.recv()
        except (EOFError, OSError):  # also in the middle of a message
            child.join()
            if child.exitcode == -signal.SIGKILL:
                raise InputError(
                    "the process that worked ahead was killed, as a system does for want of "
                    "memory; a shorter log or a coarser grid (--set grid.resolution_m) needs less",
                    code=MEMORY,
                ) from None
            told = f"the process that worked ahead ended with status {child.exitcode}"
            ended = SpecmapError(told)
            if child.exitcode in (-signal.SIGINT, -signal.SIGTERM):  # somebody asked it to
                ended = SpecmapError(told, code=INTERRUPTED)
                ended.exit_code = 128 - child.exitcode
            raise ended from None
        if kind == _ERROR:
            raise value
        if kind == _RESULT:
            return value
        yield from map(ForkingPickler.loads, value)
