"""What the benchmark of batches starts and kills: scheduler, workers, the server of a bucket."""

from __future__ import annotations

import contextlib
import os
import random
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import psutil

WORKERS = 2


class Crew:
    """A scheduler and workers in processes of their own, started again when they are killed."""

    def __init__(self, folder: Path) -> None:
        self.port = _free_port()
        self.address = f"tcp://127.0.0.1:{self.port}"
        self._folder = folder
        self._processes: dict[str, subprocess.Popen[bytes]] = {}

    def keep(self) -> None:
        """Start whoever is not there."""
        for name in ("scheduler", *(f"worker-{k}" for k in range(WORKERS))):
            process = self._processes.get(name)
            if process is None or process.poll() is not None:
                self._processes[name] = self._started(name)

    def kill(self, kind: str, chance: random.Random) -> bool:
        """Kill one of them with all that it started."""
        names = sorted(name for name in self._processes if name.startswith(kind))
        _kill_tree(self._processes[chance.choice(names)].pid)
        return True

    def close(self) -> None:
        """Kill them all."""
        for process in self._processes.values():
            _kill_tree(process.pid)
            process.wait()

    def _started(self, name: str) -> subprocess.Popen[bytes]:
        if name == "scheduler":
            command = ["dask_scheduler", "--host", "127.0.0.1", "--port", str(self.port)]
        else:
            command = ["dask_worker", self.address, "--nthreads", "1", "--death-timeout", "20"]
            command += ["--local-directory", str(self._folder)]
        return subprocess.Popen(
            [sys.executable, "-m", f"distributed.cli.{command[0]}", *command[1:], "--no-dashboard"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )


@contextlib.contextmanager
def bucket() -> Iterator[str]:
    """The URL of a bucket on a server of moto; the environment leads fsspec there."""
    port = _free_port()
    server = subprocess.Popen(
        [sys.executable, "-m", "moto.server", "-H", "127.0.0.1", "-p", str(port)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    os.environ.update(
        AWS_ENDPOINT_URL=f"http://127.0.0.1:{port}",
        AWS_ACCESS_KEY_ID="testing",
        AWS_SECRET_ACCESS_KEY="testing",
        AWS_DEFAULT_REGION="us-east-1",
    )
    try:
        import fsspec

        _wait_for(port)
        fsspec.filesystem("s3").mkdir("fleet")
        yield "s3://fleet/maps"
    finally:
        server.kill()
        server.wait()


def fetched(url: str, folder: Path) -> Path:
    """The results in a bucket, copied to a directory."""
    import fsspec

    store = fsspec.filesystem("s3")
    store.invalidate_cache()
    store.get(url, str(folder), recursive=True)
    return folder


def _kill_tree(pid: int) -> None:
    with contextlib.suppress(psutil.Error):
        parent = psutil.Process(pid)
        for process in [parent, *parent.children(recursive=True)]:
            with contextlib.suppress(psutil.Error):
                process.kill()


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def _wait_for(port: int) -> None:
    until = time.monotonic() + 60.0
    while time.monotonic() < until:
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), 1.0):
            return
        time.sleep(0.2)
    raise SystemExit("moto's server does not answer")
