"""Places: where motion leads from them, and which of them led."""

from __future__ import annotations

import pytest

from specmap_cli.core.geometry import Pose2
from specmap_cli.recognition.localization.places import LeadingPlace, Place, looking_back

TRACK = Pose2(40.0, -3.0, 2.0)  # registration has a frame of its own
PLACE = Place(1, Pose2(1.0, 2.0, 0.5), TRACK)
STEP = Pose2(0.4, 0.1, -0.2)
FRAMES = {1: Pose2(10.0, 5.0, 1.0), 4: Pose2(-2.0, 7.0, -2.5)}


def test_motion_leads_within_a_submap_and_the_layout_into_another() -> None:
    assert PLACE.led_to(1, TRACK @ STEP, {}) == pytest.approx(PLACE.pose @ STEP)
    found = PLACE.led_to(4, TRACK @ STEP, FRAMES)
    assert found is not None
    assert FRAMES[4] @ found == pytest.approx(FRAMES[1] @ PLACE.pose @ STEP)
    for frames in ({}, {1: FRAMES[1]}, {4: FRAMES[4]}):
        assert PLACE.led_to(4, TRACK, frames) is None, "without both frames nothing is known"


def test_the_next_lead_is_carried_back_within_reach() -> None:
    late = LeadingPlace(Place(7, Pose2(5.0, 1.0, 0.0), Pose2(3.0, 0.0, 0.0)), 0.97)
    scans = [(Pose2(x, 0.0, 0.0), False, late if x == 3 else None) for x in range(6)]
    found = looking_back(scans, 2.0)
    assert [lead is not None for lead in found] == [False, True, True, True, False, False]
    assert [lead.place.pose.x for lead in found if lead is not None] == [3.0, 4.0, 5.0]
    assert {lead.probability for lead in found if lead is not None} == {0.97}


@pytest.mark.parametrize(("restarted", "known"), [(1, [False, True]), (0, [True, True])])
def test_it_is_not_carried_past_a_loss_of_tracking(restarted: int, known: list[bool]) -> None:
    lead = LeadingPlace(Place(7, Pose2(0.0, 0.0, 0.0), Pose2(0.1, 0.0, 0.0)), 0.97)
    scans = [(Pose2(0.1 * k, 0.0, 0.0), k == restarted, (None, lead)[k]) for k in range(2)]
    assert [each is not None for each in looking_back(scans, 10.0)] == known
