"""Packages that other people would install, made on the spot: a module and its entry points."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from textwrap import dedent

import pytest


def install(
    folder: Path, monkeypatch: pytest.MonkeyPatch, group: str, entries: dict[str, str], code: str
) -> None:
    """A package `stranger` in `folder` that offers `entries` (name -> attribute) under `group`.

    It is gone when the test ends.
    """
    module = f"stranger_{len(sys.modules)}"
    (folder / f"{module}.py").write_text(dedent(code), encoding="utf-8")
    facts = folder / f"{module}-1.0.dist-info"
    facts.mkdir()
    facts.joinpath("METADATA").write_text(f"Metadata-Version: 2.1\nName: {module}\nVersion: 1.0\n")
    lines = [f"{name} = {module}:{attribute}" for name, attribute in entries.items()]
    facts.joinpath("entry_points.txt").write_text("\n".join([f"[{group}]", *lines]) + "\n")
    monkeypatch.syspath_prepend(str(folder))
    importlib.invalidate_caches()
