"""Pages of the small house, and of a map that was built of a recording; each made once."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from specmap_cli.core.findings import Finding, Quality, Where
from specmap_cli.maps.store import Map, read_map
from specmap_cli.maps.writing import MapResult, write_map
from specmap_cli.pipelines.report import report_map
from specmap_cli.report.layers import Evidence, Learned, SplitTrial
from specmap_cli.report.page import render
from specmap_cli.topology.topological_map import Door
from tests.report.browser import Browser, BrowserGoneError, installed
from tests.sharing import made_once

# A name that somebody typed, and that would be markup if nobody minded.
HOSTILE = "\"'><script>alert(1)</script>&"


@pytest.fixture
def house(tmp_path: Path, result: MapResult) -> Map:
    """The map directory of the small house: hostile texts, two doors, findings."""
    topology = result.topology
    submaps = dict(topology.submaps)
    submaps[1] = replace(submaps[1], name=HOSTILE, properties={HOSTILE: HOSTILE, "floor": 2})
    closures = tuple(replace(each, reason=f"{HOSTILE} {each.reason}") for each in topology.closures)
    door = Door(id=0, x=-3.0, y=1.25, width_m=0.9, theta=1.5, between=(0, 1))
    doors = (
        replace(door, crossings=topology.edges[0, 1].traversals, driven=True),
        Door(id=1, x=3.0, y=1.5, width_m=0.8, theta=1.5, between=(0, 2), forbidden=True),
    )
    gap = Finding(code="hole-in-log", severity="note", message=f"a gap {HOSTILE}")
    place = Where(None, 1.0, 0.5)
    bent = Finding(code="walls-disagree", severity="doubtful", message="walls", where=place)
    changed = replace(topology, submaps=submaps, closures=closures, doors=doors)
    logs = tuple(replace(log, name=f"{HOSTILE}.mcap") for log in result.logs)
    out = tmp_path / "house"
    out.mkdir()
    write_map(out, replace(result, topology=changed, logs=logs, quality=Quality.of((gap, bent))))
    return read_map(out)


@pytest.fixture
def evidence() -> Evidence:
    """What might be found out about the house."""
    features = (("area", 0.5), (HOSTILE, 0.25))
    nodes = np.array([[0.0, 0.0], [1.0, 0.5], [-3.0, 3.5]])
    values, sides = np.array([1.0, 0.9, 0.4]), np.array([1.0, 0.5, -1.0])
    trial = SplitTrial(
        keyframe=5, eigenvalues=values, chosen=0, split=False, nodes=nodes, sides=sides
    )
    split = replace(trial, split=True)
    tests = (trial, replace(split, keyframe=12, chosen=1), replace(split, keyframe=20, chosen=2))
    return Evidence(
        learned={1: Learned(features=features, scans=10, right=0.9, alike=((2, 0.7),))},
        fit=np.linspace(0.4, 1.0, 30),
        tests=tests,
        threshold=0.8,
        notes=(f"a note {HOSTILE}",),
    )


@pytest.fixture
def page(house: Map, evidence: Evidence) -> str:
    return render(house, evidence)


@pytest.fixture(scope="session")
def flat_page(flat_map: Map, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Its page as a file."""

    def make(folder: Path) -> Path:
        (folder / "flat.html").write_text(report_map(flat_map), encoding="utf-8")
        return folder / "flat.html"

    return made_once(tmp_path_factory, "page", make)


@pytest.fixture(scope="session")
def chromium() -> Iterator[Browser]:
    """A headless Chromium; without one the test is skipped."""
    program = installed()
    if program is None:
        pytest.skip("no Chromium is installed: the page is not tried in a browser")
    try:
        browser = Browser(program)
    except BrowserGoneError as error:
        pytest.skip(f"{error}: the page is not tried in a browser")
    with browser:
        yield browser


@pytest.fixture
def browser(chromium: Browser, flat_page: Path) -> Iterator[Browser]:
    """The same with the page of the flat open, as large as on a desk; it must not complain."""
    chromium.prefers(color_scheme="light", reduced_motion="reduce")
    chromium.size(1280, 900)
    chromium.open(flat_page)
    yield chromium
    assert chromium.errors == []
