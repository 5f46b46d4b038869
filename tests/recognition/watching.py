"""Calls that are counted while they do what they always do."""

from typing import Any

import pytest


def watched(monkeypatch: pytest.MonkeyPatch, owner: Any, name: str) -> list[tuple[Any, ...]]:
    """The arguments by place of every call of a function of a module or a class, from now on."""
    calls: list[tuple[Any, ...]] = []
    real = getattr(owner, name)

    def watching(*given: Any, **more: Any) -> Any:
        calls.append(given)
        return real(*given, **more)

    monkeypatch.setattr(owner, name, watching)
    return calls
