"""The versions of the program and of the libraries that it stands on."""

from __future__ import annotations

import platform
from importlib import metadata

from specmap_cli import __version__

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
    return found | {name: _version(name) for name in STANDS_ON}


def _version(distribution: str) -> str:
    try:
        return metadata.version(distribution)
    except metadata.PackageNotFoundError:
        return MISSING
