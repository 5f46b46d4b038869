"""What the machine lacks, in words."""

from __future__ import annotations

import errno
import os

import pytest

from specmap_cli.core.errors import is_of_the_machine, is_of_the_place, reason


@pytest.mark.parametrize(
    ("number", "told"),
    [
        (errno.ENOSPC, "No space left on device; free some space, or go"),
        (errno.EDQUOT, "Disk quota exceeded; your quota is used up: remove some files, or go"),
        (errno.EROFS, "Read-only file system; go"),
        (errno.EFBIG, "File too large; see `ulimit -f`, or go"),
        (errno.EIO, "Input/output error; the disk fails: check it, or go"),
        (errno.EMFILE, "Too many open files; give fewer files at once, or raise the limit with"),
        (errno.ENFILE, "Too many open files in system; this machine has too many of them open: "),
        (errno.ENOMEM, "Cannot allocate memory; end other programs, or give less at once"),
        (errno.EACCES, "Permission denied; go"),
    ],
)
def test_each_has_its_own_advice(number: int, told: str) -> None:
    assert reason(OSError(number, os.strerror(number)), "go").startswith(told)


def test_without_advice_only_what_helps_anywhere_is_said() -> None:
    assert reason(OSError(errno.EIO, os.strerror(errno.EIO))) == "Input/output error"
    assert "ulimit -n" in reason(OSError(errno.EMFILE, os.strerror(errno.EMFILE)))
    assert reason(OSError("no number")) == "no number"


def test_an_error_of_our_own_keeps_its_words() -> None:
    error = OSError(errno.EFBIG, "larger than 5 MB")
    assert not is_of_the_place(error)
    assert not is_of_the_machine(error)
    assert reason(error, "build the map again") == "larger than 5 MB; build the map again"
