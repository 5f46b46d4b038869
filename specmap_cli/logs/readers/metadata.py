"""metadata.yaml of a rosbag2 recording: how many messages its files should hold."""

from __future__ import annotations

import re
from pathlib import Path

_BYTES_MAX = 1 << 22  # of a metadata.yaml: some kilobytes, with many topics and files a megabyte
_ENTRY = re.compile(r"^\s*(?:- )?(path|message_count): *(.+?) *$", re.MULTILINE)
_SECTION = re.compile(r"^\s*files: *$", re.MULTILINE)


def recorded_messages(file: Path) -> int | None:
    """The messages in one file of a recording by the metadata beside it; None when it says nothing.

    The list `files` has a path and a number for each file; recorders before ROS 2 Galactic wrote
    no such list.
    """
    try:
        with file.with_name("metadata.yaml").open(encoding="utf-8") as lines:
            text = lines.read(_BYTES_MAX)
    except (OSError, UnicodeDecodeError):
        return None
    section = _SECTION.search(text)
    if section is None:
        return None
    named = False
    for key, value in _ENTRY.findall(text, section.end()):
        if key == "path":
            named = value.strip("'\"") == file.name
        elif named and value.isdecimal():
            return int(value[:18])
    return None
