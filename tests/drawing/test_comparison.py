"""The picture of two maps: what is only in one of them has its colour, and names itself."""

from unittest.mock import Mock

import pytest

from specmap_cli.core.geometry import IDENTITY, BentMotion
from specmap_cli.drawing import comparison
from specmap_cli.drawing.canvas import Canvas
from specmap_cli.drawing.palette import paler
from specmap_cli.grids.gridmap import UNKNOWN
from specmap_cli.topology.differences import differences
from specmap_cli.topology.regions import NOBODY, Regions
from tests.drawing.looking import of_colour
from tests.topology.rooms import regions_of
from tests.topology.test_differences import CABINET, TRACK, drawn, flat

RIGID = BentMotion(IDENTITY)


def furnished() -> Regions:
    """The flat with a cabinet, in which no beam ends."""
    inside = tuple(slice(part.start + 1, part.stop - 1) for part in CABINET)
    return drawn(drawn(flat(), CABINET), (inside[0], inside[1]), state=UNKNOWN)


@pytest.mark.parametrize("appears", [True, False])
def test_what_stands_in_one_map_only_has_the_colour_of_that_map(appears: bool) -> None:
    maps = (flat(), furnished()) if appears else (furnished(), flat())
    found = differences(*maps, (TRACK, TRACK), RIGID)
    assert [len(found.appeared), len(found.vanished)] == [appears, not appears]
    picture = comparison.render_comparison(*maps, RIGID, found, ("monday", "friday"))
    picture = picture[:-250]  # above the legend
    own, other = (comparison.NEW, comparison.OLD)[:: 1 if appears else -1]
    assert of_colour(picture, own).sum() > 500
    assert of_colour(picture, paler(own, 0.78)).sum() > 1000
    assert of_colour(picture, other).sum() == of_colour(picture, paler(other, 0.78)).sum() == 0


def test_a_new_room_with_the_number_of_an_old_one_differs(monkeypatch: pytest.MonkeyPatch) -> None:
    rooms = {0: [(0.2, 0.2, 4.9, 5.8), (4.9, 2.9, 5.1, 3.8)], 1: [(5.1, 0.2, 9.8, 5.8)]}
    new = regions_of((10.0, 6.0), {1: rooms[0], 0: rooms[1]})
    cells, owner = flat().grid.cells.copy(), flat().owner.copy()
    cells[:, 101:], owner[:, 101:] = UNKNOWN, NOBODY
    old = Regions.of(flat().grid.__class__(cells, flat().grid.resolution, (0.0, 0.0)), owner)
    found = differences(old, new, (TRACK[TRACK[:, 0] < 4.5], TRACK), RIGID)
    assert list(found.identity.new) == [0]
    text = Mock()
    monkeypatch.setattr(Canvas, "text", text)
    comparison.render_comparison(old, new, RIGID, found, ("monday", "friday"))
    assert {"0", "new 0"} <= {one.args[2] for one in text.mock_calls}
