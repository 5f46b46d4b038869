"""Temporary copies of files that are compressed as a whole, of bounded size."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import IO, NamedTuple

from specmap_cli.core.errors import TOO_LARGE, LogError, reason
from specmap_cli.core.settings import LogConfig
from specmap_cli.logs.readers.compression import stream
from specmap_cli.logs.readers.recording import unreadable

_UNPACKED_RATIO_MAX = 500.0  # a file of 100 MB and more that swells by more is a bomb, no log
LOOKED_AT_BYTES = 1 << 23  # of the copy, before the rest: a CARMEN log is known by less than these

_COPY_BYTES = 1 << 20  # of a compressed file in memory at once
_BYTES_PER_GB = 1e9
_RATIO_FROM_BYTES = 100_000_000  # a small copy may swell as it likes


class Copy(NamedTuple):
    """A temporary file, and what of the compressed one is not in it, None when all of it is."""

    file: Path
    lost: str | None


def unpacked(
    path: Path,
    compression: str,
    config: LogConfig,
    look: Callable[[Path], object],
    held: ExitStack,
) -> Copy:
    """A copy of what is in a compressed file, which lasts as long as `held`.

    So a reader may open it as often as it likes. `look` is shown the beginning of the copy and may
    raise to be spared the rest. Raises LogError for a file that swells beyond the settings and
    when there is no room.
    """
    try:
        temporary = tempfile.NamedTemporaryFile(prefix="specmap-")  # noqa: SIM115 (held closes it)
        copy = held.enter_context(temporary)
        lost = _fill(copy, path, compression, config, look)
    except OSError as error:
        raise LogError(
            f"{path}: cannot unpack into the temporary directory: "
            f"{reason(error, 'set TMPDIR to another one')}"
        ) from None
    return Copy(Path(copy.name), lost)


def _fill(
    copy: IO[bytes],
    path: Path,
    compression: str,
    config: LogConfig,
    look: Callable[[Path], object],
) -> str | None:
    """Write the copy; what is lost of the file."""
    looked = complete = ended = False
    for part, complete in stream(_slices(path), compression):
        copy.write(part)
        ended = complete or (ended and not part)
        _refuse_swelling(copy.tell(), path, config)
        if not looked and copy.tell() >= LOOKED_AT_BYTES:
            copy.flush()
            look(Path(copy.name))
            looked = True
    copy.flush()
    if complete:
        return None
    if ended:
        return f"what follows the {compression} compression is no part of it and was left out"
    return f"the {compression} compression is damaged or ends early: the rest is lost"


def _refuse_swelling(copied: int, path: Path, config: LogConfig) -> None:
    if copied > config.unpacked_max_gb * _BYTES_PER_GB:
        fault = (
            f"{config.unpacked_max_gb:g} GB, which log.unpacked_max_gb allows; if it is a log, "
            "raise the setting"
        )
    elif copied > max(_UNPACKED_RATIO_MAX * path.stat().st_size, _RATIO_FROM_BYTES):
        fault = (
            f"{_UNPACKED_RATIO_MAX:g} times its size, as no log does; if it is a log, unpack it "
            "first"
        )
    else:
        return
    raise LogError(f"{path}: unpacks to more than {fault}", code=TOO_LARGE)


def _slices(path: Path) -> Iterator[bytes]:
    try:
        with path.open("rb") as file:
            while piece := file.read(_COPY_BYTES):
                yield piece
    except OSError as error:
        raise unreadable(path, error) from None
