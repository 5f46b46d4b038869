"""A recording made on the spot, its messages, and readers of other packages."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from specmap_cli.logs.opening import open_log
from specmap_cli.logs.readers.recording import Message
from tests.logs.recordings import write_drive


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Install a package of one module that offers a reader, as pip would, for one test."""

    def add(module: str, code: str, *, entry: str, name: str = "") -> None:
        site = tmp_path / f"site-{module}"
        info = site / f"{module}-1.0.dist-info"
        info.mkdir(parents=True)
        (site / f"{module}.py").write_text(code)
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {module}\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text(f"[specmap.readers]\n{name or module} = {entry}\n")
        monkeypatch.syspath_prepend(site)
        monkeypatch.delitem(sys.modules, module, raising=False)

    return add


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """Where a recording is to be: its suffix says nothing."""
    return tmp_path / "log.mcap"


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    path = tmp_path / "drive.mcap"
    write_drive(path)
    return path


@pytest.fixture
def drive_messages(drive: Path) -> list[Message]:
    with open_log(drive) as log:
        return list(log.messages())
