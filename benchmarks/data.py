"""Where the real logs are that benchmarks and a few tests use."""

from __future__ import annotations

import os
from pathlib import Path


def data_folder() -> Path:
    """The folder named by SPECMAP_DATA, by default ../shared/data; ends the program without it."""
    folder = Path(os.environ.get("SPECMAP_DATA", "../shared/data"))
    if not (folder / "logs").is_dir():
        raise SystemExit(
            f"no real logs in {folder}: set SPECMAP_DATA to a folder laid out as "
            "benchmarks/README.md says"
        )
    return folder
