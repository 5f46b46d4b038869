"""Constants of the package turned for a test, where nothing else shows what they do."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module

import pytest


@contextmanager
def turned(home: str, **constants: object) -> Iterator[None]:
    """Constants of the module `specmap_cli.HOME` have other values, wherever they are imported."""
    owner = import_module(f"specmap_cli.{home}")
    with pytest.MonkeyPatch.context() as patch:
        for name, value in constants.items():
            usual = getattr(owner, name)
            for module in list(sys.modules.values()):
                if vars(module).get(name) is usual:
                    patch.setattr(module, name, value)
        yield
