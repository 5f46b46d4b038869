"""Packages that other people would install, made on the spot, and files that belong to none."""

import importlib
import importlib.util
import sys
from pathlib import Path
from textwrap import dedent
from types import ModuleType

import pytest


def install(
    folder: Path, monkeypatch: pytest.MonkeyPatch, group: str, entries: dict[str, str], code: str
) -> None:
    """A package `stranger` in `folder`, for a test: `entries` (name -> attribute) under `group`."""
    module = f"stranger_{len(sys.modules)}"
    (folder / f"{module}.py").write_text(dedent(code), encoding="utf-8")
    facts = folder / f"{module}-1.0.dist-info"
    facts.mkdir()
    facts.joinpath("METADATA").write_text(f"Metadata-Version: 2.1\nName: {module}\nVersion: 1.0\n")
    lines = [f"{name} = {module}:{attribute}" for name, attribute in entries.items()]
    facts.joinpath("entry_points.txt").write_text("\n".join([f"[{group}]", *lines]) + "\n")
    monkeypatch.syspath_prepend(str(folder))
    importlib.invalidate_caches()


def module_at(path: Path) -> ModuleType:
    """The module of a file that belongs to no package."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
