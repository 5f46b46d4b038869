"""The table of readers: the built-in ones, and those that installed packages add."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from types import MappingProxyType

from specmap_cli.core.errors import PACKAGE, UsageError
from specmap_cli.core.plugins import with_plugins
from specmap_cli.logs.readers.carmen import CarmenFile
from specmap_cli.logs.readers.mcap import McapFile
from specmap_cli.logs.readers.recording import Recording
from specmap_cli.logs.readers.rosbag1 import Rosbag1File
from specmap_cli.logs.readers.rosbag2 import Rosbag2File

GROUP = "specmap.readers"
BUILT_IN: Mapping[str, type[Recording]] = MappingProxyType(
    {"mcap": McapFile, "rosbag2": Rosbag2File, "rosbag1": Rosbag1File, "carmen": CarmenFile}
)


def known_readers() -> dict[str, type[Recording]]:
    """The readers by name, those of other packages first, as they are asked first.

    So a package can read a dialect of a format that a built-in reader would take. Raises
    UsageError for an entry point that cannot be loaded or that is no whole `Recording`.
    """
    table = with_plugins(GROUP, BUILT_IN)
    added = {name: _checked(name, table[name]) for name in table if name not in BUILT_IN}
    return {**added, **BUILT_IN}


def reader_for(
    head: bytes, file: Path, readers: Mapping[str, type[Recording]]
) -> type[Recording] | None:
    """The first reader that knows the file, None when none does."""
    return next((reader for reader in readers.values() if reader.sniff(head, file)), None)


def format_names(readers: Iterable[type[Recording]]) -> str:
    """The formats in a phrase: `MCAP, ROS 1 bag or CARMEN log`."""
    *others, last = [reader.format for reader in readers]
    return f"{', '.join(others)} or {last}" if others else last


def _checked(name: str, reader: object) -> type[Recording]:
    """What an entry point names, if it is a reader; raises UsageError saying what it lacks."""
    if not isinstance(reader, type) or not issubclass(reader, Recording):
        raise _unfit(name, "is no class derived from specmap_cli.logs.readers.Recording")
    missing = sorted(reader.__abstractmethods__)
    if not isinstance(getattr(reader, "format", None), str):
        missing.append("format")
    own_sniff = any("sniff" in vars(base) for base in reader.__mro__ if base is not Recording)
    if not reader.magic and not own_sniff:
        missing.append("magic or sniff")
    if missing:
        raise _unfit(name, f"lacks {', '.join(missing)}")
    return reader


def _unfit(name: str, fault: str) -> UsageError:
    return UsageError(
        f"the reader {name!r} of {GROUP} {fault}; mend or remove its package", code=PACKAGE
    )
