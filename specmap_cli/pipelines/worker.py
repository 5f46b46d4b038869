"""Work that runs ahead in a second process, its results taken one by one, in order, in this one.

Registration needs nothing that later stages find out, and neither do classifiers of raw scans need
those of virtual ones: where there is a second processor, a forked child does its part meanwhile.
The results are those of one process, bit for bit, and wait in a pipe of bounded size.
"""

from __future__ import annotations

import fcntl
import multiprocessing
import os
import signal
import threading
import traceback
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import TypeVar, cast

import cv2

from specmap_cli.core.errors import SpecmapError

Item = TypeVar("Item")

_PIPE_BYTES = 1 << 20  # some hundred scans
_SIGNALS = (signal.SIGINT, signal.SIGTERM)


@contextmanager
def ahead(produce: Callable[[], Iterator[Item]]) -> Iterator[Iterator[Item]]:
    """The items of `produce()`, made ahead of their use in a child process where there can be one.

    What `produce` changes in its process stays there: it must yield all that is needed of it. Its
    errors are raised here, where the items are taken. Leaving the block ends the child.
    """
    if not _possible():
        yield produce()
        return
    cv2.setNumThreads(1)  # the threads of a pool would be missing in the child, and waited for
    context = multiprocessing.get_context("fork")
    receiver, sender = context.Pipe(duplex=False)
    with suppress(AttributeError, OSError):  # a system of fixed pipes: fewer items wait
        fcntl.fcntl(sender.fileno(), fcntl.F_SETPIPE_SZ, _PIPE_BYTES)
    child = context.Process(target=_child, args=(produce, receiver, sender), daemon=True)
    try:
        with _held_signals(), warnings.catch_warnings():
            # Python 3.12 warns of other threads: of a progress bar's, whose locks the child avoids
            warnings.simplefilter("ignore", DeprecationWarning)
            child.start()
        sender.close()
        yield _received(receiver, child)
    finally:
        receiver.close()
        sender.close()
        if child.pid is not None:
            child.terminate()
            child.join()


def _possible() -> bool:
    """Whether there can be a child, and a processor for it.

    A fork copies locks as they are held by other threads: none is made but from the main thread.
    """
    if "fork" not in multiprocessing.get_all_start_methods():
        return False
    in_main = threading.current_thread() is threading.main_thread()
    return in_main and _processors() > 1 and not multiprocessing.current_process().daemon


def _processors() -> int:
    """How many processors this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@contextmanager
def _held_signals() -> Iterator[None]:
    """Hold requests to end back until the child heeds them in its own way."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, _SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _child(produce: Callable[[], Iterator[Item]], receiver: Connection, sender: Connection) -> None:
    """The child: sends every item in a tuple, then None, or the error that ended the work.

    It ends with its work, when its parent tells it to, or when that is no more.
    """
    receiver.close()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches both: the parent decides
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _SIGNALS)
    try:
        for item in produce():
            sender.send((item,))
        sender.send(None)
    except BrokenPipeError:  # nobody takes the items any more
        return
    except Exception as error:
        if not isinstance(error, SpecmapError):
            error.add_note(f"in the process that ran ahead:\n{traceback.format_exc()}")
        with suppress(BrokenPipeError):
            sender.send(error)
        raise SystemExit(1) from None  # it is the parent that tells


def _received(receiver: Connection, child: BaseProcess) -> Iterator[Item]:
    """The items as they come from the child; raises its error, or one that tells of its death."""
    while True:
        try:
            message: object = receiver.recv()
        except (EOFError, ConnectionResetError):
            child.join()
            raise SpecmapError(
                f"the process that worked ahead ended with status {child.exitcode}: "
                "was it killed for want of memory? A shorter or coarser log needs less"
            ) from None
        if isinstance(message, Exception):
            raise message
        if message is None:
            return
        yield cast(tuple[Item], message)[0]
