"""The error tree: everything the tool tells a user in one line.

    SpecmapError            exit code
    ├── UsageError          2   the command, an option or the configuration is wrong
    ├── InputError          3   the input cannot be used
    │   ├── LogError            a recording: missing, damaged, without scans
    │   └── MapError            a map directory or an occupancy grid
    └── NoResultError       4   the run finished and there is nothing to show for it

A message says what, where (file, topic, byte or message), what was found, and what to do.
Nothing in the packages prints or exits: `specmap_cli.cli` holds the one handler.
"""

from __future__ import annotations

# The exit code of a run that finished, but whose result breaks a rule that was asked for.
BROKEN_RULE = 5


class SpecmapError(Exception):
    """Base of every error meant for the user; `exit_code` is the process's exit status."""

    exit_code = 1


class UsageError(SpecmapError):
    """The command, an option or the configuration is wrong."""

    exit_code = 2


class InputError(SpecmapError):
    """The input cannot be used."""

    exit_code = 3


class LogError(InputError):
    """A recording cannot be read or holds nothing usable."""


class MapError(InputError):
    """A map directory or an occupancy grid cannot be read."""


class NoResultError(SpecmapError):
    """The run finished without a result."""

    exit_code = 4
