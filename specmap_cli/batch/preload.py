"""What Dask loads first in each new worker process of this machine, as `batch.workers` says.

It imports nothing of ours: that takes a second, in which a Ctrl-C would print tracebacks.
"""

from __future__ import annotations

import signal
import threading


def dask_setup(_worker: object) -> None:
    """Turn the worker deaf to Ctrl-C; Dask calls this.

    A terminal sends it to the workers, too; but it is the client that is asked to end, and ends
    them.
    """
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.SIG_IGN)
