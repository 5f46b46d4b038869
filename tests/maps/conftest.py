"""A map directory of the small building of `tests.house`."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest


def place_in(document: Any, keys: Sequence[str]) -> Any:
    """The part of a JSON document that keys and numbers lead to."""
    for key in keys:
        document = document[int(key) if key.isdigit() else key]
    return document


def edit(path: Path, **changes: Any) -> None:
    """Change keys of a JSON file; `graph__frame` reaches into `graph`."""
    document = json.loads(path.read_text())
    for key, value in changes.items():
        *parents, last = key.split("__")
        place_in(document, parents)[int(last) if last.isdigit() else last] = value
    path.write_text(json.dumps(document))


@pytest.fixture
def stored(house: Path) -> Path:
    return house
