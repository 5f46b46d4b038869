"""Where logs are and where results go: paths of this machine, and stores that fsspec knows."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from specmap_cli.core.errors import MACHINE, PACKAGE, SpecmapError, UsageError

_SCHEME = re.compile(r"([A-Za-z][A-Za-z0-9+.-]+)(://|::)")
_LOCAL = ("file://", "local://")


class PlaceError(SpecmapError):
    """A disk or a store cannot be used: full, out of reach, or closed to us."""

    exit_code = 2
    code = MACHINE


def path_at(place: str) -> Path | None:
    """The path of a place on this machine; None for a URL of a store."""
    for scheme in _LOCAL:
        if place.startswith(scheme):
            return Path(place.removeprefix(scheme))
    return None if _SCHEME.match(place) else Path(place)


def absolute(place: str) -> str:
    """The same place for a worker in another directory: an absolute path, or a URL as it is."""
    path = path_at(place)
    return place if path is None else str(path.absolute())


def store_at(url: str) -> tuple[Any, str]:
    """The file system of a URL and the path in it. Raises UsageError for one that is not known."""
    try:
        import fsspec
    except ImportError:
        raise UsageError(
            f"{url}: needs an extra: pip install 'specmap-cli[batch]'", code=PACKAGE
        ) from None
    try:
        with reaching(url):
            system, path = fsspec.core.url_to_fs(url)
            return system, str(path)
    except PlaceError as error:
        cause = error.__cause__
        if isinstance(cause, ImportError | ValueError):
            raise UsageError(f"{url}: {cause}", code=PACKAGE) from None
        raise


@contextmanager
def reaching(url: str) -> Iterator[None]:
    """A block that speaks with a store: whatever it raises is a PlaceError, and a missing file.

    Raises FileNotFoundError as it is.
    """
    try:
        yield
    except (FileNotFoundError, SpecmapError):
        raise
    except Exception as error:  # any of any store's library: they have no class in common
        said = " ".join(str(error).split()) or type(error).__name__
        raise PlaceError(f"{url}: cannot be reached or used: {said:.300}") from error
