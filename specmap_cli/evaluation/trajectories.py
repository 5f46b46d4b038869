"""How good a trajectory is: against relations between poses, or against reference poses.

The relation error is the one of Burgard et al., "A Comparison of SLAM Algorithms Based on a Graph
of Relations" (IROS 2009) and Kuemmerle et al. (Autonomous Robots 2009), without squares: each
relation's error is split into a distance and an angle. Relative errors over 1, 5 and 20 m of path
and the absolute error after the best rigid motion follow Sturm et al. (IROS 2012).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from specmap_cli.core.errors import InputError
from specmap_cli.core.geometry import FloatArray, compose, invert, nearest_motion, travelled
from specmap_cli.core.records import IntArray, Trajectory
from specmap_cli.maps.text_files import stamped_rows

PATH_LENGTHS_M = (1.0, 5.0, 20.0)  # a room's details, a room, a wing of a building
_TOLERANCE_NS = 2_000_000  # stamps in text files are rounded to microseconds at the worst
_BETWEEN_NS = 250_000_000  # true poses this near in time tell those between them


@dataclass(frozen=True, slots=True, kw_only=True)
class Spread:
    """Mean, standard deviation, median, 95th percentile and maximum of errors."""

    mean: float
    std: float
    median: float
    p95: float
    max: float

    @classmethod
    def of(cls, values: FloatArray) -> Spread:
        """Of values (n,), n >= 1."""
        return cls(
            mean=float(values.mean()),
            std=float(values.std()),
            median=float(np.median(values)),
            p95=float(np.percentile(values, 95)),
            max=float(values.max()),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class RelativeErrors:
    """Errors of relative poses: translations in metres, rotations in degrees.

    `matched` of `total` pairs could be compared.
    """

    translation_m: Spread
    rotation_deg: Spread
    matched: int
    total: int


@dataclass(frozen=True, slots=True, kw_only=True)
class ReferenceErrors:
    """Errors against reference poses: per metres of path, absolute, and from end to end.

    `relative` holds an entry for each length the path reaches; `ate_m` is the root mean square
    after the best rigid motion; `end_m` and `end_deg` compare the motion from first to last pose.
    """

    relative: Mapping[float, RelativeErrors]
    ate_m: float
    end_m: float
    end_deg: float
    matched: int
    total: int

    def as_dict(self) -> dict[str, Any]:
        """For JSON, lengths as text."""
        relative = {f"{length:g}": asdict(errors) for length, errors in self.relative.items()}
        return {**asdict(self), "relative": relative}


@dataclass(frozen=True, slots=True)
class Relations:
    """Relative poses (n, 3) of the base at `later_ns` (n,) seen from the base at `earlier_ns`."""

    earlier_ns: IntArray
    later_ns: IntArray
    poses: FloatArray


def read_relations(path: str | Path) -> Relations:
    """Ground-truth relations: `t1 t2 x y z roll pitch yaw` a line, seconds, metres, radians.

    Raises InputError naming the line that is not so.
    """
    expected = "`t1 t2 x y z roll pitch yaw`"
    rows = stamped_rows(path, 2, "relations have 8", "relation", expected)
    earlier, later = np.array([stamps for stamps, _ in rows], dtype=np.int64).T
    poses = [(x, y, yaw) for _, (x, y, _, _, _, yaw) in rows]
    return Relations(earlier, later, np.array(poses, dtype=np.float64))


def associate(
    stamps_ns: IntArray, wanted_ns: IntArray, tolerance_ns: int = _TOLERANCE_NS
) -> tuple[IntArray, IntArray]:
    """Pairs by nearest stamp: rows of `wanted_ns` that have one, and its rows in `stamps_ns`.

    `stamps_ns` need not be sorted; of equal stamps the first counts.
    """
    if not len(stamps_ns) or not len(wanted_ns):
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    order = np.argsort(stamps_ns, kind="stable")
    ordered = stamps_ns[order]
    right = np.minimum(np.searchsorted(ordered, wanted_ns), len(ordered) - 1)
    left = np.maximum(right - 1, 0)
    nearer = np.abs(ordered[left] - wanted_ns) < np.abs(ordered[right] - wanted_ns)
    nearest = np.where(nearer, left, right)
    nearest = np.searchsorted(ordered, ordered[nearest])  # the first of equal stamps
    rows = np.flatnonzero(np.abs(ordered[nearest] - wanted_ns) <= tolerance_ns)
    return rows.astype(np.int64), order[nearest[rows]].astype(np.int64)


def relation_errors(trajectory: Trajectory, relations: Relations) -> RelativeErrors:
    """Errors of a base trajectory over all relations whose two stamps it has.

    Raises InputError when it has none of them.
    """
    first, i = associate(trajectory.stamps_ns, relations.earlier_ns)
    second, j = associate(trajectory.stamps_ns, relations.later_ns)
    both, in_first, in_second = np.intersect1d(first, second, return_indices=True)
    poses = trajectory.poses
    measured = compose(invert(poses[i[in_first]]), poses[j[in_second]])
    return _relative_errors(relations.poses[both], measured, len(relations.poses))


def reference_errors(trajectory: Trajectory, reference: Trajectory) -> ReferenceErrors:
    """Errors of a trajectory against reference poses of the same body, joined by stamp.

    Where the reference has a pose before and after a stamp, at most 0.25 s apart, it is
    interpolated. Raises InputError when fewer than two stamps are common to both.
    """
    rows, truth = _true_at(reference, trajectory.stamps_ns)
    if len(rows) < 2:
        raise _too_few(len(rows), len(reference.stamps_ns))
    poses = trajectory.poses[rows]
    way = travelled(truth)
    relative = {}
    for length in PATH_LENGTHS_M:
        ends = np.searchsorted(way, way + length)
        starts = np.flatnonzero(ends < len(way))
        if len(starts):
            want = compose(invert(truth[starts]), truth[ends[starts]])
            have = compose(invert(poses[starts]), poses[ends[starts]])
            relative[length] = _relative_errors(want, have, len(starts))
    driven = compose(invert(truth[0]), truth[-1])
    whole = compose(invert(driven), compose(invert(poses[0]), poses[-1]))
    moved = nearest_motion(poses[:, :2], truth[:, :2]).apply(poses[:, :2])
    return ReferenceErrors(
        relative=relative,
        ate_m=math.sqrt(float(((moved - truth[:, :2]) ** 2).sum(axis=1).mean())),
        end_m=float(np.hypot(*whole[:2])),
        end_deg=float(np.degrees(abs(whole[2]))),
        matched=len(rows),
        total=len(trajectory.stamps_ns),
    )


def _true_at(reference: Trajectory, stamps_ns: IntArray) -> tuple[IntArray, FloatArray]:
    """Which stamps (n,) the reference knows, in the order of time, and its poses (m, 3) there."""
    known_ns, first = np.unique(reference.stamps_ns, return_index=True)
    rows = np.argsort(stamps_ns, kind="stable")
    wanted_ns = stamps_ns[rows]
    after = np.clip(np.searchsorted(known_ns, wanted_ns), 1, max(len(known_ns) - 1, 1))
    ends = [known_ns[np.minimum(k, len(known_ns) - 1)] for k in (after - 1, after)]
    off_ns = np.minimum(*(np.abs(end - wanted_ns) for end in ends))
    between = (ends[0] <= wanted_ns) & (wanted_ns <= ends[1]) & (ends[1] - ends[0] <= _BETWEEN_NS)
    known = between | (off_ns <= _TOLERANCE_NS)
    x, y, theta = reference.poses[first].T
    times, wanted = (t - known_ns[0] for t in (known_ns, wanted_ns[known]))
    columns = [np.interp(wanted, times, column) for column in (x, y, np.unwrap(theta))]
    return rows[known], np.stack(columns, axis=1)


def _too_few(common: int, total: int) -> InputError:
    """The error for a truth of which too few stamps are found."""
    return InputError(
        f"trajectory and truth have {'one stamp' if common else 'no stamps'} in common "
        f"({total} in the truth): are they of the same log, in seconds of the same clock?"
    )


def _relative_errors(want: FloatArray, have: FloatArray, total: int) -> RelativeErrors:
    """The errors of poses (n, 3) against those wanted."""
    if not len(want):
        raise _too_few(0, total)
    error = compose(invert(want), have)
    return RelativeErrors(
        translation_m=Spread.of(np.hypot(error[:, 0], error[:, 1])),
        rotation_deg=Spread.of(np.degrees(np.abs(error[:, 2]))),
        matched=len(want),
        total=total,
    )


def relation_lines(errors: RelativeErrors) -> list[str]:
    """Errors over all relations."""
    return [
        f"{errors.matched:,} of {errors.total:,} relations matched",
        *_spread_lines(errors.translation_m, errors.rotation_deg),
    ]


def reference_lines(errors: ReferenceErrors) -> list[str]:
    """Relative errors at each length of path, the absolute error, the error from end to end."""
    lines = [f"the truth knows {errors.matched:,} of {errors.total:,} poses"]
    for length, relative in errors.relative.items():
        lines.append(f"relative errors over {length:g} m of path")
        lines += _spread_lines(relative.translation_m, relative.rotation_deg)
    lines.append(f"absolute error (rmse, aligned)  {errors.ate_m:.4f} m")
    lines.append(f"from first to last pose         {errors.end_m:.4f} m, {errors.end_deg:.3f} deg")
    return lines


def _spread_lines(translation: Spread, rotation: Spread) -> list[str]:
    return [
        f"  {name:14} mean {spread.mean:.4f}  std {spread.std:.4f}  median {spread.median:.4f}  "
        f"p95 {spread.p95:.4f}  max {spread.max:.4f}"
        for name, spread in (("translation m", translation), ("rotation deg", rotation))
    ]
