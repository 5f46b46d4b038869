"""The command line: it translates only. Parse, call the library, print, choose the exit code."""

from __future__ import annotations

from specmap_cli.cli.entry import main

__all__ = ["main"]
