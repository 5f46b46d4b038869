"""`specmap evaluate`: scores of a map or a trajectory against truth."""

from __future__ import annotations


def evaluate() -> None:
    """Evaluate."""
