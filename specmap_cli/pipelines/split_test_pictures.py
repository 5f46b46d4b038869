"""Pictures of every test that may split a submap, for `specmap build --explain`."""

from __future__ import annotations

from pathlib import Path

from specmap_cli.core.config import SegmentationConfig
from specmap_cli.core.errors import UsageError
from specmap_cli.drawing.split_tests import draw_test
from specmap_cli.grids.map_server import write_png
from specmap_cli.segmentation.splitting import SplitTest

_NAMES = "test_*.png"


class TestAlbum:
    """An observer of the segmentation: writes test_0001.png, test_0002.png, ... as they happen.

    Raises UsageError when the directory cannot be made, or holds an album already and it is not to
    be overwritten.
    """

    __test__ = False  # no test of pytest's

    def __init__(
        self, directory: Path, config: SegmentationConfig, *, overwrite: bool = False
    ) -> None:
        self.directory = directory
        self.count = 0
        self._threshold = config.split_eigenvalue
        try:
            directory.mkdir(parents=True, exist_ok=True)
            old = sorted(directory.glob(_NAMES))
            if old and not overwrite:
                raise UsageError(
                    f"{directory}: holds pictures of an earlier run: use --overwrite to replace "
                    "them, or another directory"
                )
            for picture in old:
                picture.unlink()
        except OSError as error:
            raise UsageError(
                f"{directory}: cannot write pictures there: {error.strerror}; "
                "choose another directory"
            ) from None

    def __call__(self, test: SplitTest, split: bool) -> None:
        """Draw one test and its decision; one outside the grid has nothing to show."""
        if not test.grid.cells.size:
            return
        self.count += 1
        path = self.directory / f"test_{self.count:04d}.png"
        write_png(path, draw_test(test, self._threshold, split))
