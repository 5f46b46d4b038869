"""What a mutation gives: the damaged bytes, and what to expect of a reader."""

from __future__ import annotations

import random
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

Thing = TypeVar("Thing")


@dataclass(frozen=True, slots=True)
class Change:
    """Damaged bytes and a few words on the damage.

    `clean` is damage that leaves a whole file behind, such as a record cut out: what it took can
    only be missed where the file counts its messages. `foreign` is something added that is no part
    of the recording, which must be told even where nothing is lost.
    """

    data: bytes
    note: str
    clean: bool = False
    foreign: bool = False


def spot(rng: random.Random, size: int) -> int:
    """A place among `size`, more often near either end, where headers and indexes are."""
    if size < 2:
        return 0
    corner = min(64, size)
    kind = rng.random()
    if kind < 0.15:
        return rng.randrange(corner)
    if kind < 0.3:
        return size - 1 - rng.randrange(corner)
    return rng.randrange(size)


def replaced(things: Sequence[Thing], place: int, *new: Thing) -> list[Thing]:
    """A list with the thing at `place` replaced by others, or by none."""
    return [*things[:place], *new, *things[place + 1 :]]
