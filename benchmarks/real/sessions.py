"""Second sessions in a building: is each found in the map of the other?

Each session is localised in the map of another one of the same building, with `--metric`. What is
true was found by laying the one map on the other by its walls (laying.py). Scans of places that the
map never saw do not count. What is right is in localized.py. Then maps are compared and updated:
the transform against the laid one.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.cost.processes import SPECMAP
from benchmarks.cost.processes import measure as measured
from benchmarks.data import recording
from benchmarks.localized import HEADER, NOTHING, Found, localized, nearest, scored
from benchmarks.real.laying import Placed, Seen, placed
from benchmarks.scoreboard.bench import Bench
from benchmarks.scoreboard.rows import Figures, Row
from specmap_cli.core.geometry import FloatArray, Pose2, compose, invert
from specmap_cli.core.records import IntArray
from specmap_cli.maps.store import Map, read_map
from specmap_cli.maps.text_files import read_tum

# (session, in the map of)
PAIRS = (
    ("corridor_1", "corridor_2"),
    ("corridor_3", "corridor_2"),
    ("corridor_2", "corridor_1"),
    ("corridor_2", "corridor_3"),
    ("room_4", "room_1"),
    ("room_1", "room_4"),
    ("room_loop", "room_1"),
    ("floor_2", "floor_1"),
    ("floor_1", "floor_2"),
    ("carried_after", "floor_1"),
    ("hallway_2", "hallway_1"),
    ("hallway_1", "hallway_2"),
    ("corridor_1", "corridor_3"),
)
JOINED = (0, 1, 4, 6, 7, 9, 10)  # pairs of which the session is also added to the map
_ALIGNED_M, _ALIGNED_RAD = 0.3, math.radians(5.0)

ROWS = (
    Row("person_right", "corridor_1 (a person beside) in corridor_2: known and right", 0.9, 0.98),
    Row("person_poses", "the same: poses within .1 m and 1 degree", 0.8, 0.95),
    Row("corridor", "corridor_3 in corridor_2: known and right", 1.0, 1.0),
    Row("room", "room_4 in room_1: known and right", 0.95),
    Row("floor", "floor_2 in floor_1: known and right", 0.8),
    Row("hallway_wrong", "hallway_2 in hallway_1: wrong poses", 0.05, 0.0, "less"),
    Row("right", "known and right, mean of 13 pairs"),
    Row("unknown", "unknown, mean of 13 pairs", better="less"),
    Row("poses", "poses within .1 m and 1 degree, mean of 13 pairs"),
    Row("wrong", "wrong poses, mean of 13 pairs", better="less"),
    Row("compared", "maps of one place that `compare` aligns rightly, of 13", form=".0f"),
    Row("compared_wrong", "the same: wrongly", 0, 0, "less", ".0f"),
    Row("told", "the longest thing that it tells of them", better="less", form=".1f", unit="m"),
    Row("updated", "sessions that `update` takes, of 7", 7, 7, form=".0f"),
    Row("updated_wrong", "the same: taken to a wrong place", 0, 0, "less", ".0f"),
)


def measure(bench: Bench) -> Figures:
    """Localise, compare and update the sessions of each place."""
    maps = {name: bench.recorded(name) for name in {n for pair in PAIRS for n in pair}}
    seen = {name: Seen(read_map(path)) for name, path in maps.items()}
    print(f"{'session':14} {'in the map of':14} {HEADER}  compare; update")
    found, compared, updated = list[Found](), list[Compared](), list[str]()
    with bench.scratch("sessions") as folder:
        for number, (name, other) in enumerate(PAIRS):
            truth = placed(seen[other], seen[name])
            one = located(seen[other].stored, seen[name], name, truth, folder)
            found.append(one)
            compared.append(comparison(maps[other], maps[name], seen[name], truth, folder))
            if number in JOINED:
                updated.append(update(seen[other], seen[name], name, truth, folder))
            also = f"; {updated[-1]}" if number in JOINED else ""
            print(f"{name:14} {other:14} {one}  {compared[-1].said}{also}", flush=True)
    by_pair = dict(zip(PAIRS, found, strict=True))
    person = by_pair["corridor_1", "corridor_2"]
    return {
        "person_right": person.right,
        "person_poses": person.poses,
        "corridor": by_pair["corridor_3", "corridor_2"].right,
        "room": by_pair["room_4", "room_1"].right,
        "floor": by_pair["floor_2", "floor_1"].right,
        "hallway_wrong": by_pair["hallway_2", "hallway_1"].wrong,
        "right": float(np.mean([one.right for one in found])),
        "unknown": float(np.mean([one.unknown for one in found])),
        "poses": float(np.mean([one.poses for one in found])),
        "wrong": float(np.mean([one.wrong for one in found])),
        "compared": sum(one.said.startswith("right") for one in compared),
        "compared_wrong": sum(one.said.startswith("wrong") for one in compared),
        "told": max(one.longest_m for one in compared),
        "updated": sum(one.startswith("right") for one in updated),
        "updated_wrong": sum(one.startswith("wrong") for one in updated),
    }


def located(map_: Map, here: Seen, log: str, truth: Placed, folder: Path) -> Found:
    """Localise a session in a map and hold every scan against the truth."""
    said = localized(map_, recording(log), folder, "--metric")
    if said is None:
        return NOTHING
    return scored(map_, said, true_poses(here, truth, said.stamps_ns))


def true_poses(here: Seen, truth: Placed, stamps_ns: IntArray) -> FloatArray:
    """(n, 3) where the robot truly was at some scans, NaN where nothing tells.

    The nearest keyframe that was looked at tells it, by the way that the session's own map has from
    there.
    """
    track = read_tum(here.stored.path / "trajectory.tum")
    own = track.poses[nearest(track.stamps_ns, stamps_ns)]
    near = nearest(here.stamps_ns[truth.rows], stamps_ns)
    return compose(truth.poses[near], compose(invert(here.poses[truth.rows[near]]), own))


class Compared(NamedTuple):
    """Whether `compare` aligns two maps of a place, and the longest thing that it tells of them."""

    said: str
    longest_m: float = 0.0


def comparison(old: Path, new: Path, here: Seen, truth: Placed, folder: Path) -> Compared:
    """Whether `compare` aligns two maps of a place, and rightly; and what it tells.

    Where it made a stretch longer, what it tells holds for the beginning of the new map.
    """
    out = folder / "comparison"
    command = [SPECMAP, "compare", str(old), str(new), "-o", str(out), "--overwrite", "-q"]
    try:
        measured(command, folder)
    except RuntimeError as error:
        return Compared(f"refused ({str(error).rpartition(': ')[2]})")
    told = json.loads(next(out.glob("*.json")).read_text(encoding="utf-8"))
    right = truth.whole.pose
    if told["alignment"]["longer_m"]:
        first = int(np.flatnonzero(truth.known)[0])
        own = Pose2(*here.poses[truth.rows[first]].tolist())
        right = Pose2(*truth.poses[first].tolist()) @ own.inverse()
    off = right.inverse() @ Pose2(*told["alignment"]["old_from_new"])
    turned = abs(math.remainder(off.theta, 2 * math.pi))
    is_right = off.distance <= _ALIGNED_M and turned <= _ALIGNED_RAD
    things = told["things"]
    longest_m = max([one["length_m"] for all_ in things.values() for one in all_], default=0.0)
    verdict = "right" if is_right else "wrong"
    said = f"{verdict}: {off.distance:.2f} m {math.degrees(turned):.1f} deg, {longest_m:.1f} m told"
    return Compared(said, longest_m)


def update(there: Seen, here: Seen, log: str, truth: Placed, folder: Path) -> str:
    """Whether `update` adds a session to a map, and to the right place."""
    out = folder / "updated"
    command = [SPECMAP, "update", str(there.stored.path), str(recording(log)), "-o", str(out)]
    try:
        measured([*command, "--overwrite", "-q"], folder)
    except RuntimeError:
        return "refused"
    stamps = here.stamps_ns[truth.rows[truth.known]]
    made = read_tum(out / "trajectory.tum")
    order = np.argsort(made.stamps_ns)  # the session may be older than the map
    rows = order[nearest(made.stamps_ns[order], stamps)]
    same = np.abs(made.stamps_ns[rows] - stamps) < 10_000
    off = made.poses[rows[same], :2] - truth.poses[truth.known][same, :2]
    away = float(np.median(np.hypot(*off.T))) if same.any() else math.inf
    return f"{'right' if away <= _ALIGNED_M else 'wrong'}: {away:.2f} m"
