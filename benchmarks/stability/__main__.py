"""Is it the same map again: another seed, other noise, travelled backwards, begun elsewhere?

    OMP_NUM_THREADS=1 python -m benchmarks.stability [--only NAME ...] [--kind ...] [--keep DIR]

Takes of one building that should become the same submaps: the sample office and three plans of
$SPECMAP_DATA/rooms, toured by a simulated robot, and two recorded logs. Each take is one variation
of the first: another seed (of a simulated robot the errors of laser and wheels, too), noise of 10
and 11 mm (added to what a recorded log holds), the way backwards, another start. A simulated robot
also tours the same building on other ways. Nobody can drive a recorded log again: it is played
backwards, and from a third of it to its beginning and then to its end, without a jump.

The finished map of each take is brought over that of the first one: by the true poses of a
simulated robot, by the places of the same scans in both maps of a recorded log. Of the cells that
belong to a submap in both, `share` is the share of submaps with a partner whose intersection over
union is above 0.5, of the map that has more of them; `IoU` the mean of the best ones.

--keep DIR keeps the layouts, so that the division alone can be measured again in seconds.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from benchmarks.stability.comparing import Agreement, agreement
from benchmarks.stability.maps import Placed, divided, placed
from benchmarks.stability.recordings import BUILDINGS, KINDS, Take, takes
from specmap_cli.core.geometry import FloatArray


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--only", nargs="+", choices=BUILDINGS, default=BUILDINGS)
    parser.add_argument("--kind", nargs="+", choices=KINDS, default=KINDS)
    parser.add_argument("--keep", type=Path, help="a folder for the layouts")
    arguments = parser.parse_args()
    print(f"{'building':27} {'take':14} submaps  matched  share    IoU")
    rows = [
        row
        for building in arguments.only
        for row in _measured(building, arguments.kind, arguments.keep)
    ]
    for kind in KINDS:
        of_kind = [(row.share, row.iou) for of, row in rows if of == kind]
        if of_kind:
            share, iou = np.mean(of_kind, axis=0)
            print(f"{'mean':27} {kind:14} {'':7} {'':8} {share:6.3f} {iou:6.3f}")


def _measured(
    building: str, kinds: Sequence[str], keep: Path | None
) -> Iterator[tuple[str, Agreement]]:
    """Kind and agreement of each take of a building of some kinds, printed as they come."""
    others = takes(building)
    take = next(others)
    first = _kept(building, take, keep)
    base = divided(first, _shared(take, first, first))
    for take in others:
        if take.kind not in kinds:
            continue
        kept = _kept(building, take, keep)
        row = agreement(base, divided(kept, _shared(take, kept, first)))
        numbers = f"{row.first:3}/{row.second:<3} {row.matched:8} {row.share:6.3f} {row.iou:6.3f}"
        apart = "  in pieces" if kept.apart else ""
        print(f"{building:27} {take.kind + ' ' + take.name:14} {numbers}{apart}", flush=True)
        yield take.kind, row


def _kept(building: str, take: Take, keep: Path | None) -> Placed:
    """The layout of a take, as it was kept, or made now."""
    if keep is None:
        return placed(take)
    path = keep / f"{building}-{take.kind}-{take.name}.npz".replace(" ", "_")
    if not path.exists():
        keep.mkdir(parents=True, exist_ok=True)
        placed(take).save(path)
    return Placed.load(path)


def _shared(take: Take, kept: Placed, base: Placed) -> FloatArray:
    """(n, 2) the places of the keyframes: the true ones, or those of the same scans in `base`."""
    if take.references is not None:
        return take.references[kept.sweeps, :2]
    numbers = np.array(take.sources)[kept.sweeps]  # of the first take, whose log is as recorded
    return np.column_stack([np.interp(numbers, base.sweeps, base.poses[:, k]) for k in (0, 1)])


if __name__ == "__main__":
    main()
