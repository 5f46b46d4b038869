"""TFMessages made and read by their form: the bytes of the general serialiser, and its numbers."""

from __future__ import annotations

import math

from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.logs.readers.encoding import AlikeTransforms, Transform, transforms_cdr

names = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=9)
links = st.lists(st.tuples(names, names), min_size=1, max_size=3)
numbers = st.lists(st.floats(allow_nan=False), min_size=7, max_size=7)
stamps = st.integers(-(2**62), 2**62)


@given(links, stamps, st.data())
def test_the_bytes_are_those_of_the_general_serialiser(
    frames: list[tuple[str, str]], stamp_ns: int, data: st.DataObject
) -> None:
    rows = [data.draw(numbers) for _ in frames]
    pairs = zip(frames, rows, strict=True)
    general = transforms_cdr(stamp_ns, [Transform(*link, row[:3], row[3:]) for link, row in pairs])
    assert AlikeTransforms(frames).encoded(stamp_ns, rows) == general


@given(links, st.integers(0, 2**60), st.data())
def test_what_was_written_is_read_at_its_place(
    frames: list[tuple[str, str]], stamp_ns: int, data: st.DataObject
) -> None:
    form, rows = AlikeTransforms(frames), [data.draw(numbers) for _ in frames]
    for place, row in enumerate(rows):
        assert form.decoded(form.encoded(stamp_ns, rows), place) == (stamp_ns, tuple(row))


def test_a_message_of_other_frames_is_not_read() -> None:
    form = AlikeTransforms([("odom", "base")])
    level = [1.0, 2.0, 0.0, 0.0, 0.0, math.sin(0.5), math.cos(0.5)]
    mine = form.encoded(5, [level])
    for frames in ([("odom", "bass")], [("odom", "base_link")], [("odom", "base")] * 2):
        other = AlikeTransforms(frames).encoded(5, [level] * len(frames))
        assert form.decoded(other, 0) is None
    assert form.decoded(mine[:-1], 0) is None
    assert form.decoded(b"\0\2" + mine[2:], 0) is None  # another encoding
