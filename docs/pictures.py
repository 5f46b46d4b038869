"""Makes the pictures of the documents: `make pictures`.

From the sample logs, from the changed office that `benchmarks.simulated.comparison` simulates, and
from a real recording where `SPECMAP_DATA` names a folder that has it.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Sequence
from itertools import islice
from pathlib import Path

import cv2
import numpy as np

from benchmarks.data import missing, recording
from benchmarks.making.recordings import write
from benchmarks.making.spoiling import kidnapped
from benchmarks.simulated.comparison import changes
from specmap_cli.core.settings import LogConfig
from specmap_cli.logs import open_log
from specmap_cli.logs.stream import SweepStream

ROOT = Path(__file__).parent.parent
SAMPLES, IMAGES = ROOT / "sample_logs", ROOT / "docs" / "images"
WIDTH = 1400  # pixels at the most
CARRIED_S = (120.0, 60.0)  # when the robot is carried off, and for how long
SCANS = 1361  # with which the recording ends, soon after
SPLIT_TESTS = (5, 6, 7, 8)  # one region, a side that is too short, and two splits
GAP = 24


def specmap(*arguments: object) -> None:
    """Run a command as a user would."""
    subprocess.run(
        [sys.executable, "-m", "specmap_cli", *map(str, arguments), "--quiet"], check=True
    )


def put(picture: Path, name: str) -> None:
    """A picture among those of the documents, no wider than a page."""
    image = cv2.imread(str(picture))
    if image is None:
        raise SystemExit(f"{picture}: was not written")
    scale = min(1.0, WIDTH / image.shape[1])
    save(cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), name)


def side_by_side(pictures: Sequence[Path], name: str) -> None:
    """Pictures in a row, the lower ends level."""
    images = [cv2.imread(str(picture)) for picture in pictures]
    high = max(image.shape[0] for image in images)
    white = (255, 255, 255)
    row = [
        cv2.copyMakeBorder(
            image, high - image.shape[0], 0, 0, GAP, cv2.BORDER_CONSTANT, value=white
        )
        for image in images
    ]
    save(np.hstack(row)[:, :-GAP], name)


def save(image: np.ndarray, name: str) -> None:
    """Write a picture as small as PNG can."""
    cv2.imwrite(str(IMAGES / name), image, [cv2.IMWRITE_PNG_COMPRESSION, 9])
    print(IMAGES / name)


def main() -> None:
    """All of them."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder)
        specmap("build", SAMPLES / "office.mcap", "-o", out / "map", "--explain", out / "tests")
        put(out / "map" / "overview.png", "office.png")
        side_by_side(
            [out / "tests" / f"test_{number:04d}.png" for number in SPLIT_TESTS],
            "segmentation_tests.png",
        )
        again = ["localize", SAMPLES / "office_again.mcap", "--map", out / "map", "--metric"]
        specmap(*again, "-o", out / "again.csv", "--plot", out / "again.png")
        put(out / "again.png", "office_again.png")
        nodes = ["--explain", out / "nodes.png"]
        specmap("segment", SAMPLES / "office.yaml", "-o", out / "plan", *nodes)
        put(out / "nodes.png", "segmentation_nodes.png")
        with open_log([SAMPLES / "office.mcap"]) as log:
            sweeps = SweepStream(log, LogConfig())
            carried = islice(kidnapped(*CARRIED_S)(sweeps), SCANS)
            write(carried, iter, out / "carried.mcap")
        specmap("build", out / "carried.mcap", "-o", out / "doubtful")
        put(out / "doubtful" / "overview.png", "doubtful.png")
        changes(out)
        specmap("compare", out / "before", out / "after", "-o", out / "changes")
        put(out / "changes" / "compare.png", "compare.png")
        if missing(["logs"]):
            print(IMAGES / "csail.png", "stays as it is: SPECMAP_DATA has no real recording")
        else:
            specmap("build", recording("mit_csail"), "-o", out / "csail")
            put(out / "csail" / "overview.png", "csail.png")


if __name__ == "__main__":
    main()
