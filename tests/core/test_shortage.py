"""What the machine lacks, in words."""

from __future__ import annotations

import errno
import os

import pytest

from specmap_cli.core.errors import is_of_the_machine, is_of_the_place, reason


@pytest.mark.parametrize(
    ("number", "hint"),
    [
        (errno.ENOSPC, "free some space, or go"),
        (errno.EDQUOT, "your quota is used up: remove some files, or go"),
        (errno.EROFS, "go"),
        (errno.EFBIG, "see `ulimit -f`, or go"),
        (errno.EIO, "the disk fails: check it, or go"),
        (errno.EMFILE, "give fewer files at once, or raise the limit with `ulimit -n`"),
        (errno.ENFILE, "this machine has too many of them open: end other programs"),
        (errno.ENOMEM, "end other programs, or give less at once"),
        (errno.EACCES, "go"),
    ],
)
def test_each_has_its_own_advice(number: int, hint: str) -> None:
    assert reason(OSError(number, os.strerror(number)), "go") == (os.strerror(number), hint)


def test_without_advice_only_what_helps_anywhere_is_said() -> None:
    assert reason(OSError(errno.EIO, os.strerror(errno.EIO))) == ("Input/output error", "")
    assert "ulimit -n" in reason(OSError(errno.EMFILE, os.strerror(errno.EMFILE)))[1]
    assert reason(OSError("no number")) == ("no number", "")


def test_an_error_of_our_own_keeps_its_words() -> None:
    error = OSError(errno.EFBIG, "larger than 5 MB")
    assert not is_of_the_place(error)
    assert not is_of_the_machine(error)
    assert reason(error, "build the map again") == ("larger than 5 MB", "build the map again")
