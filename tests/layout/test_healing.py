"""What the audit finds drawn twice is brought together, and what cannot be mended stays."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from specmap_cli.core.geometry import FloatArray, Pose2, compose
from specmap_cli.core.records import PlanarScan
from specmap_cli.core.settings import RelaxationConfig
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.layout.audit import audit
from specmap_cli.layout.healing import healed
from specmap_cli.layout.relaxation import Layout, relax
from tests.layout.driving import drifted, stored, worst
from tests.turning import turned

Drive = tuple[FloatArray, list[PlanarScan]]
CONFIG = RelaxationConfig()


def as_tracked(store: KeyframeStore) -> Layout:
    """A layout without any nearby pass."""
    with turned("layout.nearby_passes", LOOPS_PER_NODE=0):
        return relax(store, [], [], CONFIG)


@pytest.fixture(scope="module")
def bent(drive: Drive) -> Iterator[tuple[KeyframeStore, Layout]]:
    """The drive with a turn that goes on, and its layout without any nearby pass."""
    truth, scans = drive
    with stored(drifted(truth), scans) as store:
        yield store, as_tracked(store)


def test_walls_drawn_twice_are_brought_together(
    drive: Drive, bent: tuple[KeyframeStore, Layout]
) -> None:
    truth, _ = drive
    store, layout = bent
    before = audit(store, layout.poses, [])
    found = healed(store, layout, [])
    assert before.disagreements
    assert worst(layout.poses, truth) > 1.5
    assert worst(found.layout.poses, truth) < 0.4
    assert found.audit.disagreements == ()
    assert found.audit == audit(store, found.layout.poses, [])
    healing = found.layout.healing
    assert healing is not None
    assert healing.walls_m == before.walls_m > 0.0
    assert healing.moved_m > 1.0
    assert set(map(id, healing.links)) == set(map(id, found.layout.kept))
    assert {link.kind for link in healing.links} == {"nearby"}
    evidence = found.layout.evidence
    assert evidence.standing.share < 0.1 * layout.evidence.standing.share
    assert layout.healing is None, "the layout before is as it was"


def test_the_same_bytes_every_time(bent: tuple[KeyframeStore, Layout]) -> None:
    store, layout = bent
    once, twice = (healed(store, layout, []) for _ in range(2))
    assert np.array_equal(once.layout.poses, twice.layout.poses)


def test_no_rounds_no_healing(bent: tuple[KeyframeStore, Layout]) -> None:
    store, layout = bent
    with turned("layout.healing", _HEAL_ROUNDS=0):
        found = healed(store, layout, [])
    assert found.layout is layout
    assert found.audit.disagreements


def test_a_right_layout_is_left_as_it_is(store: KeyframeStore) -> None:
    layout = relax(store, [], [], CONFIG)
    found = healed(store, layout, [])
    assert found.layout is layout
    assert found.audit.disagreements == ()


def test_poses_as_tracked_have_no_graph_to_mend(store: KeyframeStore) -> None:
    layout = relax(store, [], [], RelaxationConfig(enabled=False))
    found = healed(store, layout, [])
    assert found.layout is layout
    assert found.audit.disagreements


def test_another_building_is_not_bent_until_it_fits(drive: Drive) -> None:
    """The second lap drawn over the first, turned: no small motion mends that."""
    truth, scans = drive
    second = 480
    folded = np.array(truth)
    folded[second:] = compose(np.array(Pose2(9.0, -2.0, np.pi / 2)), truth[second:])
    with stored(folded, scans) as store:
        layout = as_tracked(store)
        found = healed(store, layout, [])
    assert found.audit.disagreements
    assert worst(found.layout.poses[:second], truth[:second]) < 0.1
    assert worst(found.layout.poses[second:], truth[second:]) < 0.1, "each lap keeps its form"


def test_a_layout_as_tracked_that_is_mended_is_one_of_passes(
    bent: tuple[KeyframeStore, Layout],
) -> None:
    store, layout = bent
    refused = replace(layout, evidence=replace(layout.evidence, choice="tracked"))
    assert healed(store, refused, []).layout.evidence.choice == "passes"
