"""A recording made on the spot and its messages."""

from pathlib import Path

import pytest

from specmap_cli.logs.opening import open_log
from specmap_cli.logs.readers.recording import Message
from tests.logs.recordings import write_drive


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
def driven(drive: Path) -> list[Message]:
    with open_log(drive) as log:
        return list(log.messages())
