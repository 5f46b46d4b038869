"""Where the motion leads from a place, within a submap and from one into another."""

from __future__ import annotations

import pytest

from specmap_cli.core.geometry import Pose2
from specmap_cli.recognition.localization.places import Place

TRACK = Pose2(40.0, -3.0, 2.0)  # registration has a frame of its own
PLACE = Place(1, Pose2(1.0, 2.0, 0.5), TRACK)
STEP = Pose2(0.4, 0.1, -0.2)
FRAMES = {1: Pose2(10.0, 5.0, 1.0), 4: Pose2(-2.0, 7.0, -2.5)}


def test_in_the_same_submap_the_motion_alone_leads() -> None:
    assert PLACE.led_to(1, TRACK @ STEP, {}) == pytest.approx(PLACE.pose @ STEP)


def test_in_another_submap_the_layout_says_where_it_leads() -> None:
    found = PLACE.led_to(4, TRACK @ STEP, FRAMES)
    assert found is not None
    assert FRAMES[4] @ found == pytest.approx(FRAMES[1] @ PLACE.pose @ STEP)


@pytest.mark.parametrize("frames", [{}, {1: FRAMES[1]}, {4: FRAMES[4]}])
def test_without_both_frames_nothing_is_known_of_another_submap(frames: dict[int, Pose2]) -> None:
    assert PLACE.led_to(4, TRACK, frames) is None
