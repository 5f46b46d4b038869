"""Commands that the system gives too little: files, room, memory. One line, and nothing stays."""

from __future__ import annotations

import resource
import sys
from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.cli.conftest import QUICK, Outcome, leftovers, ran, standing_log

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="limits as Linux has them")


def limited(limits: Mapping[int, int], *arguments: str | Path) -> Outcome:
    """What a command leaves in a process of limits."""

    def limit() -> None:
        for which, most in limits.items():
            resource.setrlimit(which, (most, most))

    ended = ran(*arguments, preexec_fn=limit)
    assert "Traceback" not in ended.err
    return ended


def test_more_files_than_may_be_open(tmp_path: Path) -> None:
    parts = tmp_path / "parts"
    parts.mkdir()
    for number in range(30):
        standing_log(parts / f"{number:02}.mcap", 3.0, scans=2)
    told = "Too many open files; give fewer files at once, or raise the limit with `ulimit -n`"
    said = limited({resource.RLIMIT_NOFILE: 24}, "info", parts)
    said.fails(3, f"{parts}/", f".mcap: cannot read: {told}")


TOO_LARGE = "File too large; see `ulimit -f`, or"


@pytest.mark.parametrize(
    ("what", "most", "told"),
    [
        ("build", 500, f"temporary files cannot be written: {TOO_LARGE}"),
        ("build", 2000, f"out: cannot be written: {TOO_LARGE} choose another output"),
        ("convert", 500, f"out: cannot be written: {TOO_LARGE} choose"),
    ],
)
def test_files_that_may_not_grow(tmp_path: Path, what: str, most: int, told: str) -> None:
    log = standing_log(tmp_path / "log.mcap", 3.0)
    out = tmp_path / "out"
    options = QUICK if what == "build" else ()
    limited({resource.RLIMIT_FSIZE: most}, what, log, "-o", out, *options).fails(2, told)
    assert leftovers(tmp_path) == []
    assert sorted(path.name for path in tmp_path.iterdir()) == ["log.mcap"]


def test_a_picture_that_does_not_fit_into_memory(tmp_path: Path) -> None:
    path = tmp_path / "plan.png"
    cv2.imwrite(str(path), np.zeros((9000, 9000), dtype=np.uint8))
    limits = {resource.RLIMIT_AS: 700_000_000}
    smaller = "a shorter log or a coarser grid (--set grid.resolution_m) needs less"
    said = limited(limits, "segment", path, "--resolution", "0.05", "-o", tmp_path / "rooms")
    said.fails(3, "not enough memory", smaller)
    assert sorted(each.name for each in tmp_path.iterdir()) == ["plan.png"]
