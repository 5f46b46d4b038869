"""The room/hallway baseline: which rooms are hallways, what it learns, which borders it sees."""

from __future__ import annotations

import numpy as np
import pytest

from specmap_cli.core.errors import InputError
from specmap_cli.core.progress import Silent
from specmap_cli.evaluation import semantic
from specmap_cli.evaluation.semantic import HALLWAY, ROOM, Labelled, room_hallway
from specmap_cli.simulation.worlds import RoomTruth
from tests.flats import QUICK, Mapped


def test_a_border_between_two_rooms_is_not_seen() -> None:
    submaps = np.array([0, 0, 1, 1, 2, 2])
    predicted = np.array([HALLWAY, HALLWAY, ROOM, ROOM, ROOM, ROOM])
    truth = np.array([HALLWAY, -1, ROOM, ROOM, ROOM, HALLWAY])
    result = semantic.semantic_scores(predicted, truth, submaps, [(0, 1), (1, 2), (2, 7)])
    assert result.borders_seen == pytest.approx(0.5)
    assert result.borders == 2
    assert result.scores.scans == 5
    assert result.as_dict()["room_hallway"]["accuracy"] == pytest.approx(0.8)


def test_rooms_and_hallways_from_file_to_figures(
    first_tour: Mapped, second_tour: Mapped, flat_rooms: RoomTruth
) -> None:
    assert semantic.hallways(flat_rooms) == {4}
    logs = first_tour.log, second_tour.log
    learned, asked = (Labelled(log.log, log.truth, flat_rooms) for log in logs)
    found = room_hallway(learned, asked, QUICK, Silent())
    assert found.scores.accuracy > 0.9
    assert found.borders >= 3
    assert any("hallways" in line for line in semantic.semantic_lines(found))


def test_a_building_without_both_kinds_is_refused(
    first_tour: Mapped, flat_rooms: RoomTruth
) -> None:
    rooms = RoomTruth(np.where(flat_rooms.labels == 4, 0, flat_rooms.labels), 0.05)
    labelled = Labelled(first_tour.log.log, first_tour.log.truth, rooms)
    with pytest.raises(InputError, match="not of both rooms and hallways"):
        room_hallway(labelled, labelled, QUICK, Silent())
