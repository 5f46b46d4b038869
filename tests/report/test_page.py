"""The page as text: everything there, everything escaped, nothing from elsewhere."""

import base64
import hashlib
import json
import re
from collections import Counter
from dataclasses import replace
from html import unescape
from html.parser import HTMLParser
from pathlib import Path

import pytest

from specmap_cli.core.errors import MapError
from specmap_cli.core.geometry import BentMotion, Pose2
from specmap_cli.maps.store import Map, read_map
from specmap_cli.report.layers import MOST_REFUSED, MOST_TESTS, Changes, Evidence
from specmap_cli.report.page import render
from tests.comparisons import comparison, thing, way
from tests.flats import forget_digests
from tests.maps.conftest import edit
from tests.report.conftest import HOSTILE

LAYERS = {"regions", "walls", "badges", "doors", "ways", "track", "findings", "accepted", "refused"}
VOID = {"meta", "link", "img", "input", "br", "path", "circle", "rect"}


class Read(HTMLParser):
    """A page read by somebody else's parser: tags, attributes, texts; open tags must be closed."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.texts: list[str] = []
        self.open: list[str] = []
        self.feed(page)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        assert len({name for name, _ in attrs}) == len(attrs), attrs
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        if tag not in VOID:
            assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.texts.append(data)

    def of(self, tag: str, **given: str) -> list[dict[str, str | None]]:
        """The attributes of all tags of a kind that have those `given`."""
        wanted = {name.rstrip("_"): value for name, value in given.items()}.items()
        return [found for name, found in self.tags if name == tag and wanted <= found.items()]

    @property
    def words(self) -> str:
        return " ".join(" ".join(self.texts).split())


@pytest.fixture
def read(page: str) -> Read:
    return Read(page)


def test_whatever_somebody_wrote_stays_text(page: str, read: Read) -> None:
    assert read.open == []
    data = json.loads(next(text for text in read.texts if text.startswith('{"height"')))
    assert data["names"] == {"0": "submap 0", "1": HOSTILE, "2": "submap 2"}
    assert Counter(tag for tag, _ in read.tags)["script"] == 2  # data, and ours
    assert "<script>alert" not in page
    names = [text for text in read.texts if HOSTILE in text]
    assert len(names) > 10  # name, property, note, finding, reason, recording, feature
    handlers = [name for _, attributes in read.tags for name in attributes if name.startswith("on")]
    assert handlers == []


def test_every_layer_is_there_and_can_be_hidden_and_the_fit_has_its_own_colours(read: Read) -> None:
    drawn = {attributes.get("data-layer") for _, attributes in read.tags} - {None}
    boxes = {attributes.get("data-shows") for attributes in read.of("input")} - {None}
    assert drawn >= LAYERS - {"regions"}, "which lose their colours, and stay"
    assert boxes == LAYERS
    paths = [attributes["d"] for attributes in read.of("path")]
    assert [each for each in paths if not re.fullmatch(r"[MlhHz\d\s-]*", each or "")] == []
    styles = {each.get("style") or "" for each in read.of("path")}
    assert {f"stroke:var(--fit-{k})" for k in range(5)} <= styles
    assert f"stroke:var(--time-{11})" in styles


def test_nothing_comes_from_elsewhere_and_no_script_but_ours_runs(page: str, read: Read) -> None:
    loading = {"src", "href", "xlink:href", "action", "srcset", "data"}
    places = [of[name] for _, of in read.tags for name in of if name in loading]
    assert places
    assert all(place and place.startswith(("#", "data:image/png;base64,")) for place in places)
    assert "@import" not in page
    assert "url(" not in page
    # the one address is the name of a format, which no browser asks for
    assert set(re.findall(r"\w+://[\w./-]+", page)) == {"http://www.w3.org/2000/svg"}
    (policy,) = (each["content"] for each in read.of("meta") if each.get("http-equiv"))
    script = page.rsplit("<script>", 1)[1].split("</script>")[0]
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    assert policy is not None
    assert f"script-src 'sha256-{digest}'" in policy
    assert policy.startswith("default-src 'none'")


def test_the_same_map_gives_the_same_bytes(house: Map, evidence: Evidence, page: str) -> None:
    assert render(read_map(house.path), evidence) == page
    assert len(page.encode()) < 150_000


def test_submaps_doors_and_findings_are_told_of_wherever_they_are(page: str, read: Read) -> None:
    marked = [tag for tag, attributes in read.tags if attributes.get("data-submap") == "1"]
    assert {"article", "tr", "g", "rect", "a"} <= set(marked)
    for told in ("door 0", "0.90 m", "Of 10 of its own scans 90 % are told right"):
        assert told in read.words
    groups = {each.get("id"): each.get("class") or "" for each in read.of("g")}
    assert groups["door-0"].split() == ["door", "driven"]
    assert groups["door-1"].split() == ["door", "forbidden"]
    (mark,) = (each for each in read.of("g") if each.get("data-finding"))
    assert "severity-doubtful" in (mark["class"] or "")
    (link,) = (each for each in read.of("button") if each.get("data-finding"))
    assert link["data-finding"] == mark["data-finding"] == "1"  # the gravest comes first
    assert (mark["aria-label"] or "").startswith("Finding A: ")  # numbers are those of submaps
    for told in ("A doubtful", "told right : of some of its own scans", "it could be confused."):
        assert told in read.words
    assert "doubtful" in page


def test_headings_and_names_for_those_who_hear_the_page(read: Read) -> None:
    every = [attributes for _, attributes in read.tags]
    assert [tag for tag, _ in read.tags if tag == "h1"] == ["h1"]
    ids = [of["id"] for of in every if of.get("id")]
    assert len(ids) == len(set(ids))
    assert {of["aria-labelledby"] for of in every if of.get("aria-labelledby")} <= set(ids)
    assert all(of.get("aria-label") for of in every if of.get("role") == "button")
    assert all(each.get("alt") for each in read.of("img"))


def test_what_differs_from_an_older_map_is_drawn_in_place(house: Map, evidence: Evidence) -> None:
    """The house against one that lies a metre beside it, with a thing gone and a way closed."""
    record = comparison(
        names=("a", HOSTILE, "c"),
        submaps={
            **{"gone": [2], "same": [{"old": 1, "new": 0, "iou": 0.9}]},
            **{"new": [1], "split": [{"old": 0, "new": [2]}]},
        },
        closed=[way(-3.0, 1.25)],
        vanished=[thing(1.0, 0.0, 0.5)],
    )
    moved = BentMotion(Pose2(-1.0, 0.0, 0.0))
    lines = (f"gone: {HOSTILE}",)
    changes = Changes(old=house, record=record, lines=lines, new_from_old=moved)
    page = render(house, evidence, changes)
    read = Read(page)
    (vanished,), (closed,), (old,), (new,) = (
        read.of("path", class_=name)
        for name in ("change-vanished", "change-closed", "old-walls", "walls")
    )
    first = [re.match(r"M(-?\d+) (-?\d+)", each["d"] or "") for each in (old, new)]
    (x, y), (u, v) = ((int(found[1]), int(found[2])) for found in first if found)
    # the old map lies a metre to the left of the new one
    assert (u - x, v - y) == pytest.approx((100, 0), abs=1)
    assert "l100 0 0-50-100 0z" in (vanished["d"] or "")
    assert closed["data-tip"] == "way closed: 0.9 m wide"
    was = re.findall(r"<dt>in house</dt><dd>(.*?)</dd>", page)
    assert [unescape(each) for each in was] == [HOSTILE, "not there", "a part of a"]
    assert (f"Against {house.path.name}") in read.texts


def test_a_map_of_schema_1_without_evidence_has_a_page_without_these_parts(house: Map) -> None:
    old = Path(__file__).parents[1] / "maps" / "topology_1.json"
    for schema_1 in (False, True):
        if schema_1:
            (house.path / "topology.json").write_bytes(old.read_bytes())
        read = Read(render(read_map(house.path), Evidence()))
        assert read.of("div", id="tests") == read.of("select", id="colours") == []
        assert "most like" not in read.words
        assert any("schema 1" in text for text in read.texts) == schema_1
        assert len(read.of("g", class_="region")) == 3
    (house.path / "labels.csv").write_text("nonsense\n")
    with pytest.raises(MapError, match=r"labels\.csv: line 1"):
        render(read_map(house.path), Evidence())


def test_a_changed_run_is_shown_and_lost_scans_are_marked(house: Map, evidence: Evidence) -> None:
    run = {"counts": {"scans": 30, "odd": "x"}, "seconds": {"a": "b"}, "inputs": 4, "config": {}}
    forget_digests(house.path)
    (house.path / "run.json").write_text(json.dumps(run))
    tum = house.path / "trajectory.tum"
    first, second, *rest = tum.read_text().splitlines(keepends=True)
    tum.write_text("".join([first, "# lost: a guess\n", second, "# found\n", *rest]))
    read = Read(render(read_map(house.path), evidence))
    assert "Counted" in read.words
    assert "Seconds of each stage" not in read.words
    assert len(read.of("path", class_="lost")) == 1
    assert "of 30 scans lost" in read.texts


def test_not_all_tests_and_closures_are_drawn(house: Map, evidence: Evidence, read: Read) -> None:
    many_tests = replace(evidence, tests=evidence.tests * MOST_TESTS)
    document = json.loads((house.path / "topology.json").read_text())
    (refused,) = (each for each in document["graph"]["closures"] if not each["accepted"])
    many = [{**refused, "xi": 0.001 * k} for k in range(2 * MOST_REFUSED)]
    edit(house.path / "topology.json", graph__closures=many)
    assert "split tests" not in read.words.split('"use')[0]
    read = Read(render(read_map(house.path), many_tests))
    assert f"Of {3 * MOST_TESTS:,} split tests {MOST_TESTS:,} are shown" in read.words
    drawn = read.of("path", class_="closure-refused")
    assert len(drawn) == MOST_REFUSED
    assert f"(xi {0.001 * (2 * MOST_REFUSED - 1):.2f})" in (drawn[0]["data-tip"] or "")
    said = f"Of {2 * MOST_REFUSED:,} refused closures the {MOST_REFUSED:,} with the largest"
    assert any(said in text for text in read.texts)


def test_words_in_tables_are_not_broken_in_the_middle(page: str) -> None:
    """A long name made the column beside it so narrow that `room` stood as `roo` over `m`."""
    assert re.search(r"\bbody \{[^}]*overflow-wrap: anywhere", page)
    assert re.search(r"\btable \{[^}]*overflow-wrap: normal", page)
    assert re.search(r"\.sortable :is\(th, td\) \{[^}]*white-space: nowrap", page)
