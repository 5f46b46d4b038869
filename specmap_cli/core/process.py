"""The process that specmap runs in: its threads, its memory, the versions it stands on.

Linear algebra stays on one thread while specmap works, whoever calls it. The matrices here are
small, some hundreds of rows. Threads of BLAS would wait for each other for longer than they
compute, and far longer when other programs run beside them.
"""

from __future__ import annotations

import os
import platform
import re
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from importlib import metadata
from pathlib import Path

from specmap_cli import __version__

# Read by a library when it is loaded: some are loaded while the work is under way.
_VARIABLES = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
_LOCK = threading.Lock()
_limits = ExitStack()  # what gives the threads back
_inside = 0  # calls under way: the first takes the threads, the last gives them back


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Keep every BLAS of this process on one thread, also those that are loaded meanwhile.

    Calls may be nested or run in several threads. After the last has ended every BLAS has as many
    threads as before; one that was loaded meanwhile has as many as the others. It also decorates
    functions.
    """
    global _inside
    with _LOCK:
        if not _inside:
            _limits.enter_context(_limited())
        _inside += 1
    try:
        yield
    finally:
        with _LOCK:
            _inside -= 1
            if not _inside:
                _limits.close()


@contextmanager
def _limited() -> Iterator[None]:
    """The limit itself, set and taken back."""
    from threadpoolctl import ThreadpoolController  # what tells that it is missing can do without

    loaded = ThreadpoolController().select(user_api="blas")
    usual = max((one.num_threads for one in loaded.lib_controllers), default=os.cpu_count() or 1)
    known = {one.filepath for one in loaded.lib_controllers}
    before = {name: os.environ.get(name) for name in _VARIABLES}
    os.environ.update(dict.fromkeys(_VARIABLES, "1"))
    try:
        with loaded.limit(limits=1):
            yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
        for one in ThreadpoolController().select(user_api="blas").lib_controllers:
            if one.filepath not in known:
                one.set_num_threads(usual)


def processors() -> int:
    """How many processors this process may use; SPECMAP_PROCESSES=1 leaves the others to others."""
    return 1 if os.environ.get("SPECMAP_PROCESSES") == "1" else len(os.sched_getaffinity(0))


_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3  # as <malloc.h> has them
_LARGE = 1 << 24  # bytes: of smaller arrays new pages would take more time than the holes are worth


def give_memory_back() -> None:
    """Give the system the pages that hold nothing any more; where glibc is not, do nothing.

    Arrays of some megabytes that come and go leave holes, which glibc keeps for later ones. From
    the first call on the largest arrays leave none: each has pages of its own. Between calls glibc
    keeps twice as much free at its end, by its own rule, which a threshold that is set puts off:
    with none kept, every array at the end costs new pages.
    """
    import ctypes  # slow to load, and no need of a command that only tells

    with suppress(AttributeError, OSError, TypeError):  # Windows has no library without a name
        library = ctypes.CDLL(None)
        library.mallopt(_M_MMAP_THRESHOLD, _LARGE)
        library.mallopt(_M_TRIM_THRESHOLD, 2 * _LARGE)
        library.malloc_trim(0)


# Not `ru_maxrss`: there the peak of the process that started this one counts as well.
_STATUS = Path("/proc/self/status")
_PEAK = re.compile(r"^VmHWM:\s*(\d+) kB$", re.MULTILINE)
_KB_PER_MB = 1000.0 / 1.024  # the kernel means 1,024 bytes


def peak_memory_mb() -> float | None:
    """The most megabytes that this process has held so far; None where the system does not tell."""
    try:
        found = _PEAK.search(_STATUS.read_text(encoding="ascii"))
    except OSError:
        return None
    return None if found is None else round(int(found[1]) / _KB_PER_MB, 1)


# The distributions that the program needs when it runs, as pyproject.toml names them.
STANDS_ON = (
    "jinja2",
    "kiss-icp",
    "lz4",
    "mcap",
    "networkx",
    "numpy",
    "opencv-python-headless",
    "protobuf",
    "pydantic",
    "pyyaml",
    "rich",
    "rosbags",
    "scipy",
    "threadpoolctl",
    "typer",
    "zstandard",
)
MISSING = "not installed"


def versions() -> dict[str, str]:
    """The version of specmap, of Python and of each library, by name; MISSING where it is so."""
    found = {"specmap": __version__, "python": platform.python_version()}
    for name in STANDS_ON:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = MISSING
    return found
