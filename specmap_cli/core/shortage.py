"""What a machine runs out of, told as what it is, each with what to do about it."""

from __future__ import annotations

import errno
import os

# Another place helps against these,
_OF_THE_PLACE = {
    errno.ENOSPC: "free some space, or ",
    errno.EDQUOT: "your quota is used up: remove some files, or ",
    errno.EROFS: "",
    errno.EFBIG: "see `ulimit -f`, or ",
    errno.EIO: "the disk fails: check it, or ",
}
# and nothing but this against these.
_OF_THE_MACHINE = {
    errno.EMFILE: "give fewer files at once, or raise the limit with `ulimit -n`",
    errno.ENFILE: "this machine has too many of them open: end other programs",
    errno.ENOMEM: "end other programs, or give less at once",
}


def is_of_the_place(error: OSError) -> bool:
    """Whether the system refused to write at one place: a full disk, a quota, and the like."""
    return error.errno in _OF_THE_PLACE and _is_of_the_system(error)


def is_of_the_machine(error: OSError) -> bool:
    """Whether the process or the machine has too little of something, wherever files are."""
    return error.errno in _OF_THE_MACHINE and _is_of_the_system(error)


def reason(error: OSError, advice: str = "") -> str:
    """What the system says of an error, and what to do: `advice` where another place helps.

    >>> reason(OSError(errno.ENOSPC, "No space left on device"), "choose another place")
    'No space left on device; free some space, or choose another place'
    """
    said = error.strerror or str(error)
    number = error.errno or 0
    if is_of_the_machine(error):
        return f"{said}; {_OF_THE_MACHINE[number]}"
    if is_of_the_place(error) and advice:
        return f"{said}; {_OF_THE_PLACE[number]}{advice}"
    return f"{said}; {advice}" if advice else said


def _is_of_the_system(error: OSError) -> bool:
    """Whether the words are the system's: errors of our own have their own."""
    return error.strerror == os.strerror(error.errno or 0)
