"""A map directory of the small building of `tests.house`."""

from __future__ import annotations

from pathlib import Path

import pytest

from specmap_cli.maps.writing import MapResult, write_map


@pytest.fixture
def stored(tmp_path: Path, result: MapResult) -> Path:
    out = tmp_path / "out"
    out.mkdir()
    write_map(out, result)
    return out
