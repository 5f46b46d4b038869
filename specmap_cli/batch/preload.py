"""What a worker of this machine does when it begins: it turns deaf to Ctrl-C.

A terminal sends it to the workers, too; but it is the client that is asked to end, and ends them.
"""

from __future__ import annotations

import signal
import threading


def dask_setup(_worker: object) -> None:
    """Called by Dask in each new worker process, as `distributed.worker.preload` says."""
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.SIG_IGN)
