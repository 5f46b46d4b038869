"""A place that leads at last tells of the scans before it, as far as the track is one."""

from __future__ import annotations

from dataclasses import replace

import pytest

from specmap_cli.core.geometry import Pose2
from specmap_cli.recognition.localization.places import LeadHistory, LeadingPlace, Place
from tests.recognition.localization.posed import at


def test_the_next_lead_is_carried_back_within_reach() -> None:
    leads = LeadHistory()
    late = LeadingPlace(Place(7, Pose2(5.0, 1.0, 0.0), Pose2(3.0, 0.0, 0.0)), 0.97)
    for x in range(6):
        leads.add(at(float(x)), late if x == 3 else None)
    found = leads.looking_back(2.0)
    assert [lead is not None for lead in found] == [False, True, True, True, False, False]
    assert [lead.place.pose.x for lead in found if lead is not None] == [3.0, 4.0, 5.0]
    assert {lead.probability for lead in found if lead is not None} == {0.97}


@pytest.mark.parametrize(("restarted", "known"), [(1, [False, True]), (0, [True, True])])
def test_it_is_not_carried_past_a_loss_of_tracking(restarted: int, known: list[bool]) -> None:
    leads = LeadHistory()
    lead = LeadingPlace(Place(7, Pose2(0.0, 0.0, 0.0), Pose2(0.1, 0.0, 0.0)), 0.97)
    for k in range(2):
        scan = replace(at(0.1 * k), restarted=k == restarted)
        leads.add(scan, lead if k == 1 else None)
    assert [each is not None for each in leads.looking_back(10.0)] == known
