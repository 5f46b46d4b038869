"""What follows a way that nothing measured: where its walls fit, and what is told of it."""

from dataclasses import replace

import numpy as np
import pytest

from specmap_cli.core.geometry import Pose2
from specmap_cli.core.records import Trajectory
from specmap_cli.core.settings import Config
from specmap_cli.grids.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap
from specmap_cli.grids.keyframes import integrate_keyframes
from specmap_cli.layout.audit import Agreement
from specmap_cli.layout.relaxation import relax
from specmap_cli.pipelines.pieces import Pieces, _Drawn, pieces_placed
from specmap_cli.pipelines.session import Session
from tests.layout.driving import (
    SECOND_LAP,
    building,
    moved_from,
    round_trip,
    scans_of,
    stored,
    worst,
)

Motion = tuple[float, float, float]
ELSEWHERE = (9.0, -4.0, 2.0)  # a motion of the map


def placed(
    world: GridMap, motion: Motion, end: int | None = None, bent_m: float = 0.0, tied: bool = False
) -> Pieces:
    """Two laps in a building; the second is laid out elsewhere, and nothing measured the way."""
    truth = round_trip()[:end]
    poses, breaks = moved_from(SECOND_LAP, truth, motion), {SECOND_LAP: None}
    with stored(poses, scans_of(world, truth)) as store:
        found = relax(store, (), breaks, Config().relaxation)
        laid, bad = poses.copy(), Agreement(agree=900, contradict=100)
        laid[SECOND_LAP:, 0] += np.linspace(0.0, bent_m, len(laid) - SECOND_LAP)
        wrong = replace(found, poses=laid, loose=() if tied else found.loose, agreement=bad)
        tracked = Trajectory(store.stamps_ns, store.poses)
        return pieces_placed(Session(Config(), store), Pieces(wrong, (), breaks), tracked)


def bare() -> GridMap:
    """The ring alone, which is the same turned round."""
    cells = np.full((300, 380), OCCUPIED, dtype=np.uint8)
    cells[30:270, 30:350] = FREE
    cells[70:230, 70:310] = OCCUPIED
    return GridMap(cells, 0.05)


@pytest.mark.parametrize(
    ("motion", "bent_m"),
    [
        (ELSEWHERE, 0.0),
        (ELSEWHERE, 3.0),  # what tied it bent it
        ((0.4, 0.3, 0.0), 0.0),  # near, but not where it fits
        ((0.0, 0.0, 0.0), 0.0),  # a guess that is right
    ],
)
def test_a_piece_is_moved_to_where_its_walls_fit(motion: Motion, bent_m: float) -> None:
    found = placed(building(), motion, bent_m=bent_m)
    assert worst(found.layout.poses, round_trip()) < 0.3
    assert found.fitting == {SECOND_LAP}
    assert not found.rivals
    assert not found.layout.loose
    assert len(found.ties) >= 3
    assert set(found.ties) <= set(found.layout.kept)


def test_a_piece_that_lies_where_it_fits_stays_and_is_sure() -> None:
    found = placed(building(), (0.1, 0.1, 0.0), tied=True)
    assert found.fitting == {SECOND_LAP}
    assert not found.rivals
    assert not found.ties


def test_of_a_piece_that_fits_twice_nobody_can_tell_where_it_lies() -> None:
    found = placed(bare(), (0.0, 0.0, 0.0))
    (rival,) = found.rivals
    turned = Pose2(19.0, 15.0, np.pi)  # about the middle of the ring
    there = round_trip()[SECOND_LAP:, :2].mean(axis=0)[None]
    assert rival.keyframe == SECOND_LAP
    assert abs(rival.away_m - np.hypot(*(turned.apply(there) - there)[0])) < 0.5
    assert not found.fitting
    assert not found.ties


def test_a_few_metres_say_nothing() -> None:
    found = placed(building(), ELSEWHERE, end=SECOND_LAP + 60)
    assert not found.fitting
    assert not found.rivals
    assert not found.ties


def test_all_before_a_piece_is_drawn_on_as_if_it_were_drawn_at_once() -> None:
    """Of two pieces that are asked, with one between them that is not."""
    truth = round_trip()[:120]
    with stored(truth, scans_of(building(), truth)) as store:
        session = Session(Config(), store)
        drawn = _Drawn(session, truth)
        for span in (range(30, 60), range(60, 80), range(100, 120)):
            for told, numbers in zip(drawn.go_on(span), (range(span.start), span), strict=True):
                at_once = integrate_keyframes(store, numbers, truth[list(numbers)], Config().grid)
                whole = at_once.snapshot()
                seen = np.argwhere(whole.cells != UNKNOWN)
                there = told.whole.values_at(whole.centres_of(seen))
                assert there.tolist() == whole.cells[tuple(seen.T)].tolist()
                assert len(seen) == np.count_nonzero(told.whole.cells != UNKNOWN) > 1000
