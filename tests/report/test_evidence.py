"""What is found out for a report: from the scans and the classifiers of a map."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from specmap_cli.core.errors import MapError
from specmap_cli.core.progress import Silent
from specmap_cli.maps.store import Map, read_map
from specmap_cli.pipelines.report import evidence_of, report_map
from specmap_cli.pipelines.segment import segment_map
from specmap_cli.recognition.learning.boosting import StumpBoost, TreeBoost, feature_shares
from specmap_cli.recognition.learning.trees import Forest
from specmap_cli.report.evidence import Evidence
from tests.flats import Explained
from tests.maps.conftest import edit


@pytest.fixture(scope="module")
def found(flat_map: Map) -> Evidence:
    return evidence_of(flat_map, Silent())


def test_scans_fit_their_walls_and_submaps_are_likened(found: Evidence, flat_map: Map) -> None:
    assert found.fit is not None
    assert len(found.fit) == len(flat_map.labels.stamps_ns)
    assert np.nanmedian(found.fit) > 0.9
    assert np.nanmax(found.fit) <= 1.0
    assert sorted(found.learned) == flat_map.ids
    for id_, learned in found.learned.items():
        assert learned.right > 0.8
        assert 0 < learned.scans <= 60
        assert id_ not in {submap for submap, _ in learned.alike}
        shares = [share for _, share in learned.alike]
        assert shares == sorted(shares, reverse=True)
        assert sum(shares) == pytest.approx(1.0, abs=0.05)
        assert sum(share for _, share in learned.features) <= 1.0 + 1e-9


def test_tests_are_the_build_s(found: Evidence, flat_map: Map, flat_built: Explained) -> None:
    assert len(found.tests) == len(list(flat_built.pictures.iterdir()))
    assert any(one.split for one in found.tests)
    grid = flat_map.map_grid
    for one in found.tests:
        assert one.split <= (one.eigenvalue > found.threshold)
        assert len(one.nodes) == len(one.sides)
        assert grid.inside(grid.cells_of(one.nodes)).all()  # in the map, not as registered


def test_a_map_without_scans_says_so(flat_map: Map, tmp_path: Path) -> None:
    own = Path(shutil.copytree(flat_map.path, tmp_path / "own"))
    (own / "keyframes.mcap").unlink()
    found = evidence_of(read_map(own), Silent())
    assert found.tests == ()
    assert found.fit is None
    assert found.learned[0].features
    assert found.learned[0].scans == 0
    (note,) = found.notes
    assert "keeps no scans" in note


def test_a_divided_plan_has_a_page_unless_it_is_torn_apart(plan: Path, tmp_path: Path) -> None:
    rooms = segment_map(plan, tmp_path / "rooms").out
    page = report_map(rooms)
    assert page.count('class="region"') == len(read_map(rooms).ids) > 2
    assert 'id="time"' not in page
    assert "No classifiers" in page
    (rooms / "map.yaml").unlink()  # which earlier versions did not write
    assert report_map(rooms).count('class="region"') == page.count('class="region"')
    edit(rooms / "topology.json", nodes__0__x=1e8)
    with pytest.raises(MapError, match="its submaps lie so far apart"):
        report_map(rooms)


def test_the_older_map_is_drawn(flat_map: Map) -> None:
    page = report_map(flat_map, flat_map)
    assert 'class="old-walls"' in page
    assert "map: identical to map" in page
    assert str(flat_map.path) not in page


def test_features_share_by_how_far_apart_the_votes_lie() -> None:
    X = np.array([[0.0, 5.0], [1.0, 5.0], [2.0, 5.0], [3.0, 5.0]])
    y = np.array([-1, -1, 1, 1])
    assert feature_shares(StumpBoost(("a", "b")).fit(X, y)).tolist() == [1.0, 0.0]
    assert feature_shares(StumpBoost(("a", "b"))).tolist() == [0.0, 0.0]
    forest = Forest(np.array([[0, 1, 2]]), np.full((1, 3), 0.5), np.array([[-1.0, -1.0, 1.0, 3.0]]))
    shares = feature_shares(TreeBoost(("a", "b", "c", "d"), forest))
    # the root parts -1 from 2, on average; the node above parts 1 from 3 for every second scan
    assert shares == pytest.approx([0.75, 0.0, 0.25, 0.0])
