"""edits.toml: what a person writes is read, refused in one line, and written without losing it."""

from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.errors import MapError
from specmap_cli.maps.edits import (
    EDITS,
    Edits,
    SubmapEdit,
    borders_in,
    edits_text,
    read_edits,
    said_in,
    written,
)
from specmap_cli.topology.topological_map import Merge, Said, Split

BY_HAND = """# ours

# the big one
[submaps.3]
name = 'Küche'   # of Ann
kind="room"

[submaps.4.properties]
floor = 2

# one room, whatever the robot thinks
[[changes]]
merge=[3,4]
[[changes]]
split=5
line=[[1,2],[3,4.5]]
new=7
"""

ids = st.integers(0, 999)
numbers = st.floats(-1e3, 1e3, allow_nan=False) | st.integers(-1000, 1000)
words = st.text(st.characters(categories=("L", "N", "P", "S")), min_size=1, max_size=8)
names = st.lists(words, min_size=1, max_size=3).map(" ".join)
values = st.booleans() | numbers | st.text(max_size=20)
places = st.tuples(st.integers(-99, 99), st.integers(-99, 99)).map(lambda p: [p[0] / 4, p[1] / 3])
pairs = st.lists(ids, min_size=2, max_size=2, unique=True)
lines = st.lists(places, min_size=2, max_size=2, unique_by=tuple)
changes = st.one_of(
    st.fixed_dictionaries({"merge": pairs}),
    st.fixed_dictionaries({"split": ids, "line": lines}, optional={"new": ids}),
    st.fixed_dictionaries({"forbid": pairs}, optional={"at": places}),
)
said = st.fixed_dictionaries(
    {},
    optional={
        "name": names,
        "kind": st.sampled_from(["room", "corridor", "hall"]),
        "properties": st.dictionaries(names, values, max_size=3),
    },
)
of_submaps = st.dictionaries(ids.map(str), said, max_size=4)
of_both = {"submaps": of_submaps, "changes": st.lists(changes, max_size=4)}
documents = st.fixed_dictionaries(of_both)


def meant(edits: Edits) -> tuple[Any, ...]:
    """What edits say; a table that says nothing says nothing."""
    return said_in(edits), edits.changes


@given(documents, documents)
def test_the_text_says_what_is_meant(before: dict[str, Any], document: dict[str, Any]) -> None:
    text = written(Edits.model_validate(before))
    edits = Edits.model_validate(document)
    for stood in ("", text):
        assert meant(EDITS.of_text(written(edits, stood))) == meant(edits)
    again = written(edits, written(edits, text))
    assert again == written(edits, text)


def test_what_a_person_wrote_stays_to_the_letter() -> None:
    edits = EDITS.of_text(BY_HAND)
    assert written(edits, BY_HAND) == BY_HAND
    more = edits.model_copy(update={"submaps": {**edits.submaps, 9: SubmapEdit(name="Lab")}})
    assert written(more, BY_HAND) == BY_HAND + '\n[submaps.9]\nname = "Lab"\n'
    fewer = edits.model_copy(update={"changes": edits.changes[1:]})
    gone = BY_HAND[BY_HAND.index("# one room") : BY_HAND.index("[[changes]]\nsplit")]
    assert written(fewer, BY_HAND) == BY_HAND.replace(gone, "")
    renamed = {**edits.submaps, 3: SubmapEdit(name="Bad", kind="room")}
    text = written(edits.model_copy(update={"submaps": renamed}), BY_HAND)
    assert '# the big one\n[submaps.3]\nname = "Bad"\nkind = "room"\n' in text
    assert text.endswith(BY_HAND[BY_HAND.index("[submaps.4") :])


def test_text_that_cannot_be_taken_apart_is_written_anew() -> None:
    text = '[submaps.3]\nproperties = { note = """\n[not a table\n""" }\n'
    edits = EDITS.of_text(text)
    more = edits.model_copy(update={"changes": EDITS.of_text("[[changes]]\nmerge=[1,2]").changes})
    assert meant(EDITS.of_text(written(more, text))) == meant(more)


def test_a_byte_order_mark_is_passed_over(tmp_path: Path) -> None:
    (tmp_path / "edits.toml").write_text('[submaps.3]\nname = "Lab"\n', encoding="utf-8-sig")
    assert read_edits(tmp_path) == Edits(submaps={3: SubmapEdit(name="Lab")})
    text = written(Edits(submaps={3: SubmapEdit(name="Bad")}), edits_text(tmp_path))
    assert text == '[submaps.3]\nname = "Bad"\n\n'


def test_what_the_file_asks_for() -> None:
    edits = EDITS.of_text(BY_HAND)
    assert said_in(edits) == (Said(3, "Küche", "room"), Said(4, None, None, {"floor": 2}))
    split = Split(submap=5, line=((1.0, 2.0), (3.0, 4.5)), new=7)
    assert borders_in(edits) == [Merge((3, 4)), split]
    assert written(Edits()) == ""
    assert read_edits(Path("nowhere")) == Edits()


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("a = 1", "a: no such key, expected submaps, changes"),
        ("x = = 3", "not valid TOML: Invalid value (at line 1, column 5)"),
        ("[submaps.3]\n[submaps.3]", "twice (at line 2, column 11)"),
        ("submaps = 3", "submaps: must be tables such as [submaps.3], found 3"),
        ("[submaps.x]", "submaps: 'x' is no id of a submap: expected a number"),
        ("[submaps.03]", "submaps: '03' is no id of a submap"),
        ("[submaps.9999999999]", "is no id of a submap"),
        ("submaps.3 = 4", "submaps.3: must be a table, found 4"),
        ('[submaps.3]\nnmae = "K"', "submaps.3.nmae: no such key, did you mean name?"),
        ("[submaps.3]\nname = 3", "submaps.3.name: must be text, found 3"),
        ('[submaps.3]\nname = " K"', "submaps.3.name: must be one line of printable characters"),
        ('[submaps.3]\nname = "a\\nb"', "submaps.3.name: must be one line"),
        (f'[submaps.3]\nname = "{"x" * 81}"', "must have 80 characters at the most"),
        ('[submaps.3]\nkind = "cellar"', "submaps.3.kind: must be 'room', 'corridor'"),
        ("[submaps.3]\nproperties = 3", "submaps.3.properties: must be a table, found 3"),
        ("[submaps.3]\nproperties = {a = [1]}", "submaps.3.properties.a: must be a string, true"),
        ("[submaps.3]\nproperties = {a = nan}", "submaps.3.properties.a: must be a string, true"),
        ("[submaps.3]\nproperties = {a = 1e20}", "or a number up to 1e+09, found 1e+20"),
        ("[submaps.3]\nproperties = {a = 2026-01-01}", "must be a string, true"),
        ("changes = 3", "changes: must be tables such as [[changes]], found 3"),
        ("changes = [3]", "changes, number 1: must have one of the keys merge, split and forbid"),
        ("[[changes]]\nmerge=[1,2]\nsplit=3", "changes, number 1: must have one of the keys"),
        ("[[changes]]\nmerge=[1,2]\n[[changes]]\nmerge=[3]", "changes, number 2: merge: must be"),
        ("[[changes]]\nmerge=[3,3]", "merge: must be two different submaps, found [3, 3]"),
        ("[[changes]]\nmerge=[3,true]", "merge: must be the ids of two submaps, as in [3, 4]"),
        ('[[changes]]\nmerge=["3",4]', "merge: must be the ids of two submaps"),
        ("[[changes]]\nmerge=[3,4]\ninto=5", "number 1: into: no such key, expected merge"),
        ("[[changes]]\nsplit=3", "changes, number 1: line: is missing"),
        ("[[changes]]\nsplit=3\nline=[1,2,3,4]", "line: must be two places, as in [["),
        ("[[changes]]\nsplit=3\nline=[[1,2],[1,2]]", "line: must be two places 0.1 m apart"),
        ("[[changes]]\nsplit=3\nline=[[1,2],[1,nan]]", "line: must be a place in metres"),
        ("[[changes]]\nsplit=3\nline=[[1,2],[1,1e12]]", "line: must be a place in metres"),
        ("[[changes]]\nsplit=3\nline=[[1,2],[2,2]]\nnew=-1", "new: must be the id of a submap"),
        ("[[changes]]\nforbid=[1,2]\nat=[1]", "at: must be a place in metres, as in [1.5, 2.0]"),
        ("x = " + "9" * 5000, "a number of too many digits"),
        ("x = " + "[" * 3000, "nested too deeply"),
    ],
)
def test_what_is_wrong_is_one_line(text: str, complaint: str, tmp_path: Path) -> None:
    (tmp_path / "edits.toml").write_text(text, encoding="utf-8")
    with pytest.raises(MapError) as caught:
        read_edits(tmp_path)
    line = str(caught.value)
    assert complaint in line
    assert line.startswith(f"{tmp_path / 'edits.toml'}: ")
    assert line.endswith("correct it, or see docs/edit.md")
    assert caught.value.where == str(tmp_path / "edits.toml")
    assert line.endswith(str(caught.value.hint))
    assert "\n" not in line


def test_a_file_that_is_no_text_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "edits.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(MapError, match=r"edits\.toml: not UTF-8 text: save it as UTF-8"):
        read_edits(tmp_path)
    (tmp_path / "edits.toml").unlink()
    (tmp_path / "edits.toml").mkdir()
    with pytest.raises(MapError, match=r"edits\.toml: cannot be read"):
        read_edits(tmp_path)
