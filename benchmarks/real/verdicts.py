"""What maps of real recordings think of themselves, against what is known of them.

A map is right when its trajectory is at most 0.3 m off the truth. Where there is none, its walls
must stand once: no two views of a second pass lie off the first (laying.py), and its walls lie on
those of another session of the building to 0.3 m (95 of 100 views). `good` is right for a right
map; `doubtful` or `poor` for a wrong one. Of `carried_before` it is known that the robot was
carried in its last seconds: a map is right only if all its views lie where the other session has
them.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np

from benchmarks.data import recording, truth_file
from benchmarks.making.recordings import Score, absolute, own_odometry
from benchmarks.real.laying import Seen, passes, placed
from benchmarks.real.trajectories import WITHOUT, thinned
from benchmarks.scoreboard.bench import Bench, verdict_of
from benchmarks.scoreboard.rows import Figure, Figures, Row
from specmap_cli.evaluation.trajectories import read_relations, relation_errors
from specmap_cli.maps.store import read_map
from specmap_cli.maps.text_files import read_tum

# recordings without a truth, and another session of the same building, "" for none
SESSIONS = {
    "corridor_1": "corridor_2",
    "corridor_2": "corridor_3",
    "corridor_3": "corridor_2",
    "room_1": "room_4",
    "room_4": "room_1",
    "room_loop": "",
    "ring": "",
    "hallway_1": "hallway_2",
    "hallway_2": "hallway_1",
    "floor_1": "carried_after",
    "floor_2": "",
    "carried_before": "floor_1",
    "carried_after": "floor_1",
    "ual": "",
}
CARRIED = "carried_before"
_RIGHT_M, _MOST_DOUBLED = 0.3, 1  # a single view may be laid wrongly
_ALL = 0.97  # of the views of a session, that must lie in the other

ROWS = (
    Row("right_good", "right maps that are called good", 1.0, 1.0),
    Row("right_poor", "right maps that are called poor", 0.0, 0.0, "less"),
    Row("wrong_told", "wrong maps that are called doubtful or poor", 1.0, 1.0),
)


def measure(bench: Bench) -> Figures:
    """A line a map: how far it is off, what it is, and what it says."""
    table: Counter[tuple[bool, str]] = Counter()
    print(f"{'recording':22} its map is, and says; why")
    for name, (map_, is_right, why) in judged(bench).items():
        verdict = verdict_of(map_)
        table[is_right, verdict] += 1
        missed = "" if is_right == (verdict == "good") else "  MISSED"
        print(
            f"{name:22} {'right' if is_right else 'WRONG':6} {verdict:9} {why}{missed}", flush=True
        )
    for is_right in (True, False):
        counts = ", ".join(f"{n} {v}" for (r, v), n in sorted(table.items()) if r == is_right)
        print(f"{'right' if is_right else 'wrong'} maps: {counts}")
    return {
        "right_good": _share(table, True, "good"),
        "right_poor": _share(table, True, "poor"),
        "wrong_told": _share(table, False, "doubtful", "poor"),
    }


def _share(table: Counter[tuple[bool, str]], is_right: bool, *verdicts: str) -> Figure:
    """Of the maps that are right, or wrong, those with some verdicts."""
    of = sum(count for (right, _), count in table.items() if right == is_right)
    some = sum(table[is_right, verdict] for verdict in verdicts)
    return Figure(some / of if of else None, note=f"{some} of {of} maps")


def judged(bench: Bench) -> dict[str, tuple[Path, bool, str]]:
    """Each map, whether it is right, and why."""
    found = {}
    for name, (map_, score) in with_truth(bench).items():
        off = score(read_tum(map_ / "trajectory.tum"))
        found[name] = map_, off <= _RIGHT_M, f"{off:.3f} m off the truth"
    for name, other in SESSIONS.items():
        map_ = bench.recorded(name)
        found[name] = (map_, *_by_walls(bench, name, other))
    return found


def with_truth(bench: Bench) -> dict[str, tuple[Path, Score]]:
    """Maps whose trajectory is known, and how far one is off."""
    relations = read_relations(truth_file("fr079.relations"))

    def of_relations(found: object) -> float:
        return relation_errors(found, relations).translation_m.mean  # type: ignore[arg-type]

    def of_poses(name: str) -> Score:
        return absolute(read_tum(truth_file(name)))

    csail, space = of_poses("mit_csail_corrected.tum"), of_poses("fr079_3d_truth.tum")
    return {
        "fr079": (bench.recorded("fr079"), of_relations),
        "fr079, no odometry": (bench.recorded("fr079", WITHOUT), of_relations),
        "fr079, each 0.5 m": (thinned(bench, 0.5), of_relations),
        "fr079, each metre": (thinned(bench, 1.0), of_relations),
        "mit_csail": (bench.recorded("mit_csail"), csail),
        "mit_csail, no odometry": (bench.recorded("mit_csail", WITHOUT), csail),
        "fr079_3d": (bench.recorded("fr079_3d"), space),
        "fr079_3d, no odometry": (bench.recorded("fr079_3d", WITHOUT), space),
        "fr101_sparse": (
            bench.recorded("fr101_sparse"),
            own_odometry(recording("fr101_sparse")).score,
        ),
        "hall_livox": (bench.recorded("hall_livox"), of_poses("hall_livox_truth.tum")),
    }


def _by_walls(bench: Bench, name: str, other: str) -> tuple[bool, str]:
    """Whether the walls of a map stand once, and where another session has them."""
    seen = Seen(read_map(bench.recorded(name)))
    twice = list(passes(seen))
    doubled = [one for one in twice if one.is_doubled]
    worst = max((one.off_m for one in doubled), default=0.0)
    is_right = len(doubled) <= _MOST_DOUBLED
    why = f"{len(doubled)} of {len(twice)} second passes off, by {worst:.2f} m"
    if other:
        laid = placed(Seen(read_map(bench.recorded(other))), seen)
        apart = float(np.nanpercentile(laid.off_m, 95))
        here = float(laid.known.mean())
        is_right &= apart <= _RIGHT_M and (name != CARRIED or here >= _ALL)
        why += f"; from {other} {apart:.2f} m, {here:.0%} of it there"
    return is_right, why
