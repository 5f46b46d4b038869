"""A release is refused where the tree or its changelog says that it is none."""

from __future__ import annotations

import pytest

from benchmarks.release import faults, tried_on
from tests.conftest import SAMPLE_LOGS


@pytest.mark.parametrize(
    ("changes", "changelog", "said"),
    [
        ("", "# Changelog\n## 1.0.0 (2026-11-23)\n## 0.9.0 (2026-01-01)\n", []),
        (" M x.py\n", "## 1.0.0 (2026-11-23)\n", ["the tree is not clean: M x.py"]),
        ("", "## Unreleased\n## 1.0.0 (2026-11-23)\n", ["CHANGELOG.md does not begin with"]),
        ("", "## 1.0.01 (2026-11-23)\n", ["CHANGELOG.md does not begin with"]),
    ],
)
def test_what_is_no_release_is_refused(changes: str, changelog: str, said: list[str]) -> None:
    found = faults(changes, changelog, "1.0.0")
    assert len(found) == len(said)
    assert all(one.startswith(words) for one, words in zip(found, said, strict=True))


def test_a_python_that_is_not_there_is_told() -> None:
    told = tried_on("python3.no", SAMPLE_LOGS / "office.mcap")
    assert told == "not tried: it is not on this machine"
