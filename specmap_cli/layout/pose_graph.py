"""A pose graph in the plane, its solution by robust Gauss-Newton, and its text.

Minimises, over poses x_i, the sum of rho(e^T W e) with the error e of an edge (i, j), measured as
`i_from_j` = z, written as the motion inv(z) inv(x_i) x_j and its information matrix W (Grisetti et
al., "A Tutorial on Graph-Based SLAM", 2010). rho is Cauchy's kernel for edges that may be wrong.

As text it has the format of g2o (Kuemmerle et al., ICRA 2011), VERTEX_SE2 and EDGE_SE2, which
Ceres' and GTSAM's examples and other solvers read, too, so that a layout can be checked there.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.linalg import SuperLU, splu

from specmap_cli.core.errors import InputError
from specmap_cli.core.geometry import FloatArray, Pose2, compose, invert, product, wrap_angles
from specmap_cli.core.records import IntArray

# odometry: the front end's motion; bridge: a motion over a break of the tracking that something
# else measured; loose: one that nothing did, a guess; closure: two submaps recognised as one;
# nearby: walls of two passes matched.
LinkKind = Literal["odometry", "bridge", "loose", "closure", "nearby"]

# Levenberg's damping, of a diagonal scaled to 1: none while steps help, then from the first value
# up by the factor and down again; above the last value a step is too small to matter.
_DAMPING_FIRST, _DAMPING_FACTOR, _DAMPING_LAST = 1e-3, 10.0, 1e6
_DAMPING_NONE = 1e-4
_STILL = 1e-7  # metres and radians of a step that changes nothing
SETTLED = 1e-6  # share of the cost that a last step gained
_RIDGE = 1e-9  # keeps a direction that no edge holds from making the matrix singular

_UPPER = np.triu_indices(3)
_COUNTS = {"VERTEX_SE2": (1, 3), "EDGE_SE2": (2, 9)}  # of a line: its vertices and its values
_NUMBER = "{:.9g}".format


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Link:
    """An edge of the pose graph: `source_from_target` with its information matrix (3, 3).

    `source` and `target` are keyframe numbers; the error it weighs is in the target's frame. Each
    link equals itself alone: two matches may say the same.
    """

    source: int
    target: int
    source_from_target: Pose2
    information: FloatArray
    kind: LinkKind

    @classmethod
    def closure(
        cls, source: int, target: int, seen: Pose2, sigma_m: float, sigma_rad: float
    ) -> Link:
        """A closure: the target, `seen` from the source with this spread of place and heading."""
        information = np.diag(1.0 / np.array([sigma_m, sigma_m, sigma_rad]) ** 2)
        return cls(
            source=source,
            target=target,
            source_from_target=seen,
            information=information,
            kind="closure",
        )


class LinkArrays(NamedTuple):
    """Links as arrays: `i`, `j` (E,) rows of the poses, `z` (E, 3), `w` (E, 3, 3).

    `width` (E,) is the scale of Cauchy's kernel in sigmas, inf for a plain square.
    """

    i: IntArray
    j: IntArray
    z: FloatArray
    w: FloatArray
    width: FloatArray

    @classmethod
    def of(
        cls, links: Sequence[Link], row: Mapping[int, int] | range, width: Mapping[str, float]
    ) -> LinkArrays:
        """Arrays of links; `row` maps keyframe numbers to rows, `width` kinds to kernels."""
        return cls(
            i=np.array([row[link.source] for link in links], dtype=np.int64),
            j=np.array([row[link.target] for link in links], dtype=np.int64),
            z=np.array([link.source_from_target for link in links]).reshape(-1, 3),
            w=np.array([link.information for link in links]).reshape(-1, 3, 3),
            width=np.array([width.get(link.kind, np.inf) for link in links]),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Solution:
    """Optimised poses (n, 3), the robust cost, and the chi2 = e^T W e (E,) of each edge."""

    poses: FloatArray
    cost: float
    chi2: FloatArray


def errors(poses: FloatArray, i: IntArray, j: IntArray, z: FloatArray) -> FloatArray:
    """(E, 3) what edges from rows `i` to `j` (E,), measured as `z` (E, 3), miss at poses (n, 3).

    It is the motion inv(z) inv(x_i) x_j, in the frame of row j.
    """
    return compose(invert(z), compose(invert(poses[i]), poses[j]))


def adjoint(poses: FloatArray) -> FloatArray:
    """(L, 3, 3) what turns a small motion in the frame of each pose (L, 3) into one of the map."""
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    matrix = np.zeros((len(poses), 3, 3))
    matrix[:, 0, 0], matrix[:, 0, 1], matrix[:, 0, 2] = c, -s, poses[:, 1]
    matrix[:, 1, 0], matrix[:, 1, 1], matrix[:, 1, 2] = s, c, -poses[:, 0]
    matrix[:, 2, 2] = 1.0
    return matrix


def moved_covariance(matrix: FloatArray, covariance: FloatArray) -> FloatArray:
    """(L, 3, 3) A C A^T, summed in one order on every processor."""
    half = np.einsum("lab,lbc->lac", matrix, covariance)
    return np.asarray(np.einsum("lac,ldc->lad", half, matrix), dtype=np.float64)


def squared(poses: FloatArray, edges: LinkArrays) -> FloatArray:
    """(E,) chi2 of each edge."""
    e = errors(poses, edges.i, edges.j, edges.z)
    return np.asarray(np.einsum("ea,eab,eb->e", e, edges.w, e), dtype=np.float64)


def solve(
    poses: FloatArray, edges: LinkArrays, iterations: int = 20, settled: float = SETTLED
) -> Solution:
    """Poses (n, 3) that minimise the edges' robust cost, the first one held fixed.

    Gauss-Newton with a sparse LU factorisation, damped (Levenberg) only when a step does not
    lower the cost; `iterations` steps at the most, until one gains less than the share `settled` of
    the cost. Deterministic. Every pose must hang on the first by some chain of edges.
    """
    current = np.array(poses, dtype=np.float64)
    cost, damping = _cost(squared(current, edges), edges.width), 0.0
    converged = len(current) < 2 or not len(edges.i)
    for _ in range(iterations):
        if converged:
            break
        factor, gradient = _normal(current, edges, damping)
        step = np.asarray(factor.solve(-gradient[1:].ravel()), dtype=np.float64).reshape(-1, 3)
        trial = current.copy()
        trial[1:] += step
        trial[:, 2] = wrap_angles(trial[:, 2])
        trial_cost = _cost(squared(trial, edges), edges.width)
        if float(np.abs(step).max()) < _STILL:  # rounding would decide which cost is less
            converged = True
        elif trial_cost < cost:
            converged = cost - trial_cost < settled * (1.0 + cost)
            current, cost = trial, trial_cost
            damping = damping / _DAMPING_FACTOR if damping > _DAMPING_NONE else 0.0
        else:
            converged = damping > _DAMPING_LAST
            damping = max(_DAMPING_FIRST, _DAMPING_FACTOR * damping)
    return Solution(poses=current, cost=cost, chi2=squared(current, edges))


def _cost(chi2: FloatArray, width: FloatArray) -> float:
    """Sum of Cauchy's kernel c^2 log(1 + chi2 / c^2), of chi2 itself where c is inf."""
    plain = np.isinf(width)
    c2 = np.where(plain, 1.0, width) ** 2
    return float(np.where(plain, chi2, c2 * np.log1p(chi2 / c2)).sum())


def spread_between(poses: FloatArray, edges: LinkArrays, a: IntArray, b: IntArray) -> FloatArray:
    """Covariances (L, 3, 3) of the poses of rows `b` (L,) seen from rows `a`, by all edges.

    In the frame of row `b`, as the errors of edges.
    """
    pairs = LinkArrays(
        i=a,
        j=b,
        z=compose(invert(poses[a]), poses[b]),
        w=np.tile(np.eye(3), (len(a), 1, 1)),
        width=np.full(len(a), np.inf),
    )
    factor, _ = _normal(poses, edges, 0.0)
    found = np.zeros((len(a), 3, 3))
    for number, (i, j, by_i, by_j) in enumerate(zip(a, b, *_jacobians(poses, pairs), strict=True)):
        moved = np.zeros((len(poses), 3, 3))  # what moves the pair's error, transposed
        moved[i], moved[j] = by_i.T, by_j.T
        right = moved[1:].reshape(-1, 3)
        found[number] = product(right.T, np.asarray(factor.solve(right), dtype=np.float64))
    return found


def _normal(poses: FloatArray, edges: LinkArrays, damping: float) -> tuple[SuperLU, FloatArray]:
    """The normal equations: factors of the matrix, without the first pose, and gradient (n, 3)."""
    e = errors(poses, edges.i, edges.j, edges.z)
    a, b = _jacobians(poses, edges)
    chi2 = np.einsum("ea,eab,eb->e", e, edges.w, e)
    weight = 1.0 / (1.0 + chi2 / edges.width**2)  # the derivative of Cauchy's kernel by chi2
    w = edges.w * weight[:, None, None]
    wa, wb = product(w, a), product(w, b)
    at, bt = a.transpose(0, 2, 1), b.transpose(0, 2, 1)
    blocks = np.concatenate([product(at, wa), product(at, wb), product(bt, wa), product(bt, wb)])
    rows = np.concatenate([edges.i, edges.i, edges.j, edges.j])
    columns = np.concatenate([edges.i, edges.j, edges.i, edges.j])
    gradient = np.zeros((len(poses), 3))
    np.add.at(gradient, edges.i, np.einsum("eba,eb->ea", wa, e))
    np.add.at(gradient, edges.j, np.einsum("eba,eb->ea", wb, e))
    free, k, n = (rows > 0) & (columns > 0), np.arange(3), 3 * (len(poses) - 1)
    r = (3 * (rows[free, None, None] - 1) + k[:, None]) + 0 * k
    c = (3 * (columns[free, None, None] - 1) + k[None, :]) + 0 * k[:, None]
    values = blocks[free].ravel()  # those of the same cell add up
    hessian = coo_matrix((values, (r.ravel(), c.ravel())), shape=(n, n)).tocsc()
    hessian.setdiag(hessian.diagonal() * (1.0 + damping) + _RIDGE)
    factor = splu(hessian, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
    return factor, gradient


def _jacobians(poses: FloatArray, edges: LinkArrays) -> tuple[FloatArray, FloatArray]:
    """Derivatives (E, 3, 3) of the errors by the poses at either end."""
    xi, xj = poses[edges.i], poses[edges.j]
    d = xj[:, :2] - xi[:, :2]
    ci, si = np.cos(xi[:, 2]), np.sin(xi[:, 2])
    cz, sz = np.cos(edges.z[:, 2]), np.sin(edges.z[:, 2])
    ri = np.array([[ci, si], [-si, ci]]).transpose(2, 0, 1)  # transposed rotation of x_i
    rz = np.array([[cz, sz], [-sz, cz]]).transpose(2, 0, 1)
    turned = np.stack([-si * d[:, 0] + ci * d[:, 1], -ci * d[:, 0] - si * d[:, 1]], axis=1)
    a, b = np.zeros((len(d), 3, 3)), np.zeros((len(d), 3, 3))
    b[:, :2, :2] = product(rz, ri)
    a[:, :2, :2] = -b[:, :2, :2]
    a[:, :2, 2] = np.einsum("eab,eb->ea", rz, turned)
    a[:, 2, 2], b[:, 2, 2] = -1.0, 1.0
    return a, b


def graph_text(poses: Mapping[int, FloatArray], links: Iterable[Link], fixed: Iterable[int]) -> str:
    """A graph of poses (3,) by vertex number; the `fixed` ones do not move.

    The fixed ones stand last. GTSAM reads two numbers behind every tag while it looks for edges,
    and stops where there is only one.
    """
    lines = [
        f"VERTEX_SE2 {number} {' '.join(map(_NUMBER, pose))}" for number, pose in poses.items()
    ]
    lines += [
        f"EDGE_SE2 {link.source} {link.target} "
        f"{' '.join(map(_NUMBER, [*link.source_from_target, *link.information[_UPPER]]))}"
        for link in links
    ]
    lines += [f"FIX {number}" for number in fixed]
    return "".join(line + "\n" for line in lines)


def read_g2o(text: str) -> tuple[dict[int, FloatArray], list[Link]]:
    """Poses (3,) by vertex number, and the edges, of a planar graph in g2o's format.

    Other tags than VERTEX_SE2 and EDGE_SE2 are passed over. Raises InputError for a line that
    cannot be read.
    """
    poses: dict[int, FloatArray] = {}
    links: list[Link] = []
    for number, line in enumerate(text.splitlines(), start=1):
        tag, *words = line.split() or [""]
        if tag not in _COUNTS:
            continue
        ends, count = _COUNTS[tag]
        try:
            vertices = [int(word) for word in words[:ends]]
            values = [float(word) for word in words[ends:]]
        except ValueError:
            values = []
        if len(values) != count or not all(map(math.isfinite, values)):
            raise InputError(f"g2o, line {number}: {line!r} is no {tag}", "mend the line", mark=";")
        if tag == "VERTEX_SE2":
            poses[vertices[0]] = np.array(values)
            continue
        information = np.zeros((3, 3))
        information[_UPPER] = values[3:]
        source, target = vertices
        link = Link(
            source=source,
            target=target,
            source_from_target=Pose2(*values[:3]),
            information=information + np.triu(information, 1).T,
            kind="odometry" if target == source + 1 else "closure",
        )
        links.append(link)
    return poses, links
