"""Visits of rooms by day: nothing is lost between rooms, and midnight is where the zone has it."""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np
import pytest

from specmap_cli.core.errors import UsageError
from specmap_cli.core.records import NO_SUBMAP
from specmap_cli.history.record import (
    StayRecord,
    Tour,
    Visit,
    day_of,
    days_of,
    totals,
    tour_of,
    zone_of,
)

_NS = 1_000_000_000
_MIDNIGHT = int(datetime(2026, 3, 2, tzinfo=UTC).timestamp()) * _NS


def test_a_visit_lasts_until_the_next_begins_and_no_room_is_known_at_first() -> None:
    rooms = np.array([NO_SUBMAP, NO_SUBMAP, 0, 0, 1, 1, 0])
    tour = tour_of(_MIDNIGHT + np.array([0, 10, 20, 30, 40, 50, 70]) * _NS, rooms, 70.0)
    lasted = [(one.room, (one.end_ns - one.start_ns) / _NS) for one in tour.visits]
    assert lasted == [(0, 20), (1, 30), (0, 0)]
    assert tour.driven_m == 70


def test_a_day_ends_at_midnight_of_the_zone() -> None:
    assert day_of(_MIDNIGHT, zone_of("UTC")) == "2026-03-02"
    assert day_of(_MIDNIGHT - 1, zone_of("UTC")) == "2026-03-01"
    assert day_of(_MIDNIGHT - 1, zone_of("Europe/Berlin")) == "2026-03-02"
    assert day_of(-5 * _NS, zone_of("UTC")) == "1969-12-31"


@pytest.mark.parametrize("name", ["Mars/Base", "", "../../etc/passwd", "/etc/localtime"])
def test_an_unknown_zone_is_refused(name: str) -> None:
    with pytest.raises(UsageError, match="time zone"):
        zone_of(name)


def test_a_visit_counts_on_the_day_it_began() -> None:
    late = Tour(_MIDNIGHT - 60 * _NS, _MIDNIGHT + 60 * _NS, 12.0, (
        Visit(3, _MIDNIGHT - 60 * _NS, _MIDNIGHT + 30 * _NS),
        Visit(4, _MIDNIGHT + 30 * _NS, _MIDNIGHT + 60 * _NS),
    ))  # fmt: skip
    first, second = days_of([late], zone_of("UTC"))
    assert (first.day, first.recordings, first.driven_m) == ("2026-03-01", 1, 12.0)
    assert first.rooms == [StayRecord(room=3, visits=1, minutes=1.5)]
    assert (second.recordings, second.minutes) == (0, 0)
    assert second.rooms == [StayRecord(room=4, visits=1, minutes=0.5)]
    assert totals([Visit(1, 0, 60 * _NS), Visit(2, 0, _NS), Visit(1, 0, 30 * _NS)])[1] == (2, 1.5)
