"""Single files that appear complete or not at all."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

from specmap_cli.core.errors import UsageError


def write_text(path: Path, text: str) -> None:
    """Write a file, replacing one of that name. UsageError when it cannot be written."""
    write_bytes(path, text.encode("utf-8"))


def write_bytes(path: Path, data: bytes) -> None:
    """Write a file, replacing one of that name. UsageError when it cannot be written."""
    partial = path.with_name(f".{path.name}.partial-{os.getpid()}")
    try:
        partial.write_bytes(data)
        os.replace(partial, path)
    except OSError as error:
        raise UsageError(
            f"{path}: cannot be written: {error.strerror}; choose another place"
        ) from None
    finally:
        with suppress(OSError):
            partial.unlink(missing_ok=True)
