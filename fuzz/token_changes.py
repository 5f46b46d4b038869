"""Mutations of the words and lines of CARMEN logs."""

from __future__ import annotations

import random

from fuzz.changes import Change, replaced

_WORDS = (
    b"inf",
    b"-inf",
    b"nan",
    b"1e300",
    b"-1e300",
    b"1e20",
    b"0",
    b"-1",
    b"1e-320",
    b"4294967296",
    b"999999999999999999999",
    b"0x10",
    b"1_0",
    b"1.2.3",
    b"",
    b"word",
    b"#",
    b"\xd9\xa1",  # an Arabic digit one
    b"\xff\xfe",
    b"\x00",
    b"\x1b[31m",
    b"9" * 5000,
    b"1" * 400 + b".5",
    b"FLASER",
    b"ODOM",
)


def change_tokens(rng: random.Random, data: bytes) -> Change:
    """A word replaced, dropped or repeated, or lines dropped, repeated, swapped or joined."""
    lines = data.split(b"\n")
    place = rng.randrange(len(lines))
    if rng.random() < 0.7:
        words, note = _change_words(rng, lines[place].split(b" "))
        line = b" ".join(words)
        hidden = line.startswith(b"#")  # a comment, by the format
        changed = b"\n".join(replaced(lines, place, line))
        return Change(changed, f"line {place}: {note}", clean=hidden)
    kind = rng.choice(["dropped", "twice", "swapped", "joined", "crlf", "long"])
    if kind == "dropped":
        return Change(b"\n".join(replaced(lines, place)), f"line {place} dropped")
    if kind == "twice":
        return Change(
            b"\n".join(replaced(lines, place, *[lines[place]] * 2)), f"line {place} twice"
        )
    if kind == "swapped":
        other = rng.randrange(len(lines))
        lines[place], lines[other] = lines[other], lines[place]
        return Change(b"\n".join(lines), f"lines {place} and {other} swapped")
    if kind == "joined":
        joined = b"\n".join(lines[: place + 1]) + b" " + b"\n".join(lines[place + 1 :])
        return Change(joined, f"lines {place} and {place + 1} joined")
    if kind == "crlf":
        return Change(b"\r\n".join(lines), "lines end as on Windows")
    return Change(
        b"\n".join(replaced(lines, place, b"x" * (3 << 20), lines[place])),
        f"a line of 3 MB before line {place}",
    )


def _change_words(rng: random.Random, words: list[bytes]) -> tuple[list[bytes], str]:
    place = rng.choice([0, 1, rng.randrange(len(words)), rng.randrange(len(words))])
    place = min(place, len(words) - 1)
    kind = rng.random()
    if kind < 0.05 and place + 1 < len(words):
        joined = rng.choice([b"\xc2\xa0", b"\xa0", b"\xe2\x80\xaf", b"\t"]).join(
            words[place : place + 2]
        )
        return [*words[:place], joined, *words[place + 2 :]], f"words {place} and the next joined"
    if kind < 0.1:
        return replaced(words, place), f"word {place} dropped"
    if kind < 0.2:
        return replaced(words, place, words[place], words[place]), f"word {place} twice"
    new = rng.choice(_WORDS)
    shown = new if len(new) < 40 else new[:10] + b"..."
    return replaced(words, place, new), f"word {place} = {shown!r}"
