"""Parts of one drive, mapped each by itself: is each laid where it belongs in the map of another?

The rooms of mit_csail have no right angles. Of four parts of its recording each is built alone, and
each two are compared, either way. Where a part truly lies its corrected poses tell.
"""

from __future__ import annotations

from itertools import islice, permutations
from pathlib import Path

from benchmarks.data import truth_file
from benchmarks.making.recordings import copied, rms
from benchmarks.scoreboard.bench import Bench
from benchmarks.scoreboard.rows import Figures, Row
from specmap_cli.core.geometry import Pose2, nearest_motion
from specmap_cli.core.records import Trajectory
from specmap_cli.evaluation.trajectories import associate
from specmap_cli.maps.store import Map, read_map
from specmap_cli.maps.text_files import read_tum
from specmap_cli.pipelines.overlaps import stored_to_align
from specmap_cli.recognition.closure.alignment import align

LOG = "mit_csail"
PARTS = ((0, 994), (696, 1590), (1093, 1988), (398, 1292))  # scans from, to
_RIGHT_M = 1.5  # a part alone is bent by a metre; rooms are larger

ROWS = (
    Row("right", "parts of mit_csail that are laid rightly in each other, of 12", form=".0f"),
    Row("wrong", "the same: wrongly", 0, 0, "less", ".0f"),
)


def measure(bench: Bench) -> Figures:
    """A line a pair: how far off the new part is laid (root mean square), or why nowhere."""
    truth = read_tum(truth_file(f"{LOG}_corrected.tum"))
    maps = {part: read_map(made(bench, *part)) for part in PARTS}
    right = wrong = 0
    for old, new in permutations(PARTS, 2):
        found = align(stored_to_align(maps[old]), stored_to_align(maps[new]))
        told = found.reason
        if found.old_from_new is not None:
            truly = placed(maps[old], truth).inverse() @ placed(maps[new], truth)
            way = maps[new].trajectory.poses[:, :2]
            off_m = rms(found.old_from_new.apply(way) - truly.apply(way))
            is_right = off_m <= _RIGHT_M
            right, wrong = right + is_right, wrong + (not is_right)
            told = f"{'right' if is_right else 'wrong'}: {off_m:.2f} m; {told}"
        print(f"scans {new[0]} to {new[1]} in {old[0]} to {old[1]}: {told}", flush=True)
    return {"right": right, "wrong": wrong}


def made(bench: Bench, first: int, end: int) -> Path:
    """The map of a part."""

    def cut(log: Path) -> None:
        copied(LOG, lambda sweeps: islice(sweeps, first, end), log)

    return bench.simulated(f"{LOG}-{first}-{end}", cut)


def placed(part: Map, truth: Trajectory) -> Pose2:
    """Where a part lies in the frame of the truth."""
    found = part.trajectory
    rows, at = associate(found.stamps_ns, truth.stamps_ns)
    return nearest_motion(found.poses[at, :2], truth.poses[rows, :2])
