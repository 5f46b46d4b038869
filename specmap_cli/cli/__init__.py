"""The command line: it translates only. Parse, call the library, print, choose the exit code.

Exit codes: 0 done; 1 a bug (with its traceback); 2 usage; 3 the input cannot be used; 4 finished
without a result; 130 and 143 interrupted by Ctrl-C and SIGTERM.
"""

from __future__ import annotations

from specmap_cli.cli.entry import main

__all__ = ["main"]
