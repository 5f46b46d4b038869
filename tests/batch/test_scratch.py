"""Temporary directories of jobs: locked, private, and swept when their run was killed."""

from __future__ import annotations

import os
import stat
from pathlib import Path

import pytest

from specmap_cli.batch import scratch
from specmap_cli.batch.scratch import scratch_directory
from specmap_cli.core.files import lock


def test_what_killed_runs_left_is_removed_and_what_lives_stays(tmp_path: Path) -> None:
    left, other = tmp_path / "specmap-job-0123abcd", tmp_path / "specmap-job-thesis"
    for directory in (left, other):
        directory.mkdir()
    with scratch_directory(str(tmp_path)) as first, scratch_directory(str(tmp_path)) as second:
        assert set(tmp_path.iterdir()) == {first, second, other}
        assert stat.S_IMODE(first.stat().st_mode) == 0o700
    assert list(tmp_path.iterdir()) == [other]


def test_a_directory_that_another_run_sweeps_away_is_not_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The other run has its lock already, and removes it only later."""
    locked = lock
    refused = iter([True])
    monkeypatch.setattr(scratch, "lock", lambda one: not next(refused, False) and locked(one))
    with scratch_directory(str(tmp_path)) as directory:
        assert list(tmp_path.iterdir()) == [directory]
        descriptor = os.open(directory, os.O_RDONLY)
        assert not locked(descriptor)  # it is ours alone
        os.close(descriptor)


def test_without_locks_there_are_directories_all_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scratch, "lock", lambda _: False)
    with scratch_directory(str(tmp_path)) as directory:
        assert list(tmp_path.iterdir()) == [directory]
    assert list(tmp_path.iterdir()) == []
