"""Pictures of every test that may split a submap, for `specmap build --explain`."""

from __future__ import annotations

from itertools import count
from pathlib import Path

from specmap_cli.core.errors import UsageError
from specmap_cli.core.settings import SegmentationConfig
from specmap_cli.drawing.split_tests import draw_test
from specmap_cli.grids.map_server import write_png
from specmap_cli.segmentation.online import Observer, Occasion
from specmap_cli.segmentation.splitting import SplitTest

_NAMES = "test_*.png"


def split_test_pictures(
    directory: Path | str, config: SegmentationConfig, *, overwrite: bool = False
) -> Observer:
    """An observer that writes test_0001.png, test_0002.png, ... as the tests happen.

    Raises UsageError when the directory cannot be made, or holds pictures of an earlier run that
    are not to be overwritten.
    """
    folder = Path(directory)
    _make_room(folder, overwrite)
    numbers = count(1)

    def draw(test: SplitTest, split: bool, occasion: Occasion) -> None:
        if test.grid.cells.size:  # one outside the grid has nothing to show
            picture = draw_test(test, config.split_eigenvalue, split, occasion)
            write_png(folder / f"test_{next(numbers):04d}.png", picture)

    return draw


def _make_room(folder: Path, overwrite: bool) -> None:
    """Make the directory, without pictures of an earlier run."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        old = sorted(folder.glob(_NAMES))
        if old and not overwrite:
            raise UsageError(
                f"{folder}: holds pictures of an earlier run: use --overwrite to replace them, "
                "or another directory"
            )
        for picture in old:
            picture.unlink()
    except OSError as error:
        raise UsageError(
            f"{folder}: cannot write pictures there: {error.strerror}; choose another directory"
        ) from None
