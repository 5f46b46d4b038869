"""metadata.yaml of a rosbag2 recording: how many messages its files should hold."""

from __future__ import annotations

from pathlib import Path

from specmap_cli.core.files import read_bytes
from specmap_cli.core.yaml import read_yaml

_LARGEST_MB = 4.0  # of a metadata.yaml: some kilobytes, with many topics and files a megabyte
_MOST = 10**18  # messages in a file


def recorded_messages(file: Path) -> int | None:
    """The messages in one file of a recording by the metadata beside it; None when it says nothing.

    The list `files` has a path and a number for each file; recorders before ROS 2 Galactic wrote
    no such list.
    """
    try:
        found = read_yaml(read_bytes(file.with_name("metadata.yaml"), _LARGEST_MB))
        files = {one["path"]: one for one in found["rosbag2_bagfile_information"]["files"]}
        messages = int(files[file.name]["message_count"])
    except (OSError, ValueError, TypeError, KeyError):  # missing, damaged, or without the list
        return None
    return messages if 0 <= messages < _MOST else None
