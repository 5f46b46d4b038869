"""Passes: places the robot came by again, found and matched along the path.

A nearby pass is a pair of nodes that the layout in the making puts near each other though the path
between them is long. The walls seen around the newer one are matched against those seen around the
older, within what the path may have drifted between the two: as far as matches tie it to itself.

Where no pass has tied the path for long, a place may lie metres away from where it was seen before,
along a bare corridor more than across. Its walls are looked for as far as the path's error reaches.
What is found is a claim as a closure is: walls that look alike are found, too, and several claims
must agree.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from specmap_cli.core.geometry import FloatArray, Pose2, compose, invert, wrap_angles
from specmap_cli.core.shortcuts import Shortcuts
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.grids.matching import PRIOR_SIGMAS, Prior, within_ellipse
from specmap_cli.layout.consistency import DRIFT_SHARE, path_error
from specmap_cli.layout.path_graph import (
    LOOP_EVERY_M,
    LOOP_PATH_M,
    Bridge,
    Draft,
    Graph,
    RowPair,
    graph_of,
    rows_every,
    solved,
)
from specmap_cli.layout.pose_graph import Link, LinkArrays, errors
from specmap_cli.layout.walls import PLACE_NODES, Surroundings, Walls, link_to_nearest, match_passes

LOOPS_PER_NODE = 2  # passes tried until one fits
_NEAR_M = 3.0  # two passes nearer than this are matched
LOOP_SEARCH_M = 0.3  # a pass is searched this far at the least
LOOP_SEARCH_MAX_M = 2.0  # a pass is searched this far at the most
_SOLVE_EVERY = 12  # edges found before the layout is renewed
_NEWER_NODES = 3  # as PLACE_NODES, for the newer pass: its own drift must not blur it
METRES_A_RADIAN = 0.7  # of distance that are as bad as a turn, for the overlap of two scans
_NODES_A_LINK = 150  # a solution of more nodes costs more, and waits for more links
_MOVED_M = 1.0  # a guess that moved this far is worth another search
_FIRST_STRETCH, _STRETCH_GROWTH = 200, 1.2  # of the path while it is driven, in keyframes
_NEWS = 1 / 3  # share of the least search by which a link must miss the draft to be news to it

_WIDE_EVERY_M = 2.5  # path between searches as far as its error reaches
_WIDE_SEARCH_MAX_M = 15.0  # such a search reaches this far at the most
_MOST_ROWS = 80  # whose walls make one search: some 25 m of path, or every other of more


@dataclass(frozen=True, slots=True, kw_only=True)
class Search:
    """A search for nearby passes along the path: what was found, and how far it has come.

    It goes on at row `row`, and looks at the path again from `due_m` along it on. `news` links say
    what the draft did not say when it was solved.
    """

    draft: Draft
    row: int = 0
    due_m: float = LOOP_EVERY_M
    news: int = 0


def find_passes(graph: Graph, draft: Draft, walls: Walls, first: int = 0) -> Draft:
    """The draft with the nearby passes from row `first` on, solved again as they come in."""
    way_m = float(graph.path[first])
    begun = Search(draft=draft, row=first, due_m=way_m + LOOP_EVERY_M)
    return searched(graph, begun, walls, len(graph.nodes)).draft


def searched(graph: Graph, search: Search, walls: Walls, end: int) -> Search:
    """A search that has gone on along the path, up to row `end`.

    Parts that hang on the others by a guess only are left out. Nodes that the draft was matched at
    are asked again, but matched only when they moved. Links that say what the draft says anyway are
    no reason to solve it.
    """
    draft, due_m, news = search.draft, search.due_m, search.news
    ties = tied(graph, draft.loops)
    matched = dict(draft.matched)
    linked = {
        (graph.row[loop.source], graph.row[loop.target])
        for loop in draft.loops
        if loop.kind == "nearby"
    }
    asked = {newer for _, newer in matched}
    safe_m = 0.5 * LOOP_SEARCH_M / DRIFT_SHARE  # on it the path drifts by half of the least search
    renew_after = max(_SOLVE_EVERY, len(graph.nodes) // _NODES_A_LINK)
    for node in range(search.row, end):
        way_m = float(graph.path[node])
        if way_m < due_m and node not in asked:
            continue
        due_m = way_m + LOOP_EVERY_M
        if int(graph.parts[node]) not in draft.tied:
            continue
        passes = passes_at(node, graph, draft.poses, walls, matched, linked, ties)
        links = passes.links
        matched.update(passes.guesses)
        if passes.is_tied:
            # n passes err by one over the root of n: the more, the less one match can add
            spacing_m = math.sqrt(passes.older) * LOOP_EVERY_M
            due_m = way_m + max(LOOP_EVERY_M, min(spacing_m, safe_m))
        if links:
            tied(graph, links, ties)
            draft = draft.adding(links)
            edges = LinkArrays.of(links, graph.row, {})
            missed = errors(draft.poses, edges.i, edges.j, edges.z)
            news += int(np.count_nonzero(np.hypot(*missed[:, :2].T) > _NEWS * LOOP_SEARCH_M))
        if news >= renew_after:
            draft, news = solved(graph, draft, roughly=True), 0
    draft = replace(draft, matched=matched)
    return Search(draft=draft, row=end, due_m=due_m, news=news)


class PassesOnTheWay:
    """The search for nearby passes of a path that is still driven, a stretch at a time.

    A stretch ends where the path has grown by a share: each makes the graph anew.
    """

    def __init__(self, store: KeyframeStore) -> None:
        self._store = store
        self._known: dict[int, FloatArray] = {}
        self._due = _FIRST_STRETCH
        self._last: tuple[Graph, Walls, Search] | None = None

    def go_on(self, breaks: Mapping[int, Bridge | None]) -> None:
        """Search the path so far, if it has grown by enough; `breaks` are as in `graph_of`."""
        if len(self._store) >= self._due:
            self._due = math.ceil(_STRETCH_GROWTH * len(self._store))
            # the walls around the last nodes have not all been seen
            self._search(breaks, _NEWER_NODES + 1)

    def ended(
        self, breaks: Mapping[int, Bridge | None], ends: Collection[int]
    ) -> tuple[Graph, Walls, Draft]:
        """The graph of the whole path, with nodes at the `ends` of closures, and what was found."""
        before, walls, search = self._search(breaks)
        nodes = {*before.nodes.tolist(), *ends}
        graph = graph_of(self._store, nodes, breaks, self._known)
        return graph, Walls(self._store, graph, walls), search.draft.carried(before, graph)

    def _search(
        self, breaks: Mapping[int, Bridge | None], left: int = 0
    ) -> tuple[Graph, Walls, Search]:
        """Search the path so far, but for the `left` last nodes."""
        graph = graph_of(self._store, (), breaks, self._known)
        if self._last is None:
            walls, search = Walls(self._store, graph), Search(draft=Draft(poses=graph.poses))
        else:
            before, walls, search = self._last
            walls = Walls(self._store, graph, walls)
            search = replace(search, draft=search.draft.carried(before, graph))
        end = max(search.row, len(graph.nodes) - left)
        self._last = graph, walls, searched(graph, search, walls, end)
        return self._last


@dataclass(frozen=True, slots=True, kw_only=True)
class Passes:
    """The links found at one node, and the pairs of rows that were matched from which `guesses`.

    `is_tied` says that the node is tied to an older pass, by these links or from before; `older`
    counts the passes that came by.
    """

    links: tuple[Link, ...]
    guesses: Mapping[RowPair, Pose2]
    is_tied: bool
    older: int


def passes_at(
    node: int,
    graph: Graph,
    poses: FloatArray,
    walls: Walls,
    matched: Mapping[RowPair, Pose2],
    linked: Collection[RowPair],
    ties: Shortcuts,
) -> Passes:
    """Row `node` matched with older ones at the poses (M, 3), as far as the path has drifted.

    One after the other until it is tied to one: what the next would add is little. Pairs that were
    `matched` are matched again only from a guess that differs; some of them are `linked`.
    """
    most_m = (LOOP_SEARCH_MAX_M - LOOP_SEARCH_M) / DRIFT_SHARE
    links: list[Link] = []
    guesses: dict[RowPair, Pose2] = {}
    is_tied = False
    near = candidates(node, poses, graph.path)
    for old in near[:LOOPS_PER_NODE]:
        pair = old, node
        guesses[pair] = guess = Pose2(*compose(invert(poses[old]), poses[node]).tolist())
        before = matched.get(pair)
        if before is None or (before.inverse() @ guess).distance > _MOVED_M:
            way_m = ties.between(float(graph.path[node]), float(graph.path[old]), most_m)
            drift_m = LOOP_SEARCH_M + DRIFT_SHARE * way_m
            found = match_passes(graph, walls, poses, pair, guess, drift_m, _NEWER_NODES)
            links += [] if found is None else [found]
        is_tied = bool(links) or pair in linked
        if is_tied:
            break
    return Passes(links=tuple(links), guesses=guesses, is_tied=is_tied, older=len(near))


def tied(graph: Graph, links: Iterable[Link], ties: Shortcuts | None = None) -> Shortcuts:
    """What ties the path of a graph to itself, `ties` and some more links: ways of no length.

    So is a link to an older pass for all rows near by, but not for a third pass, which that older
    one met long ago.
    """
    ties = Shortcuts() if ties is None else ties
    for link in links:
        ties.add(*(float(graph.path[graph.row[end]]) for end in (link.source, link.target)))
    return ties


def candidates(node: int, poses: FloatArray, path: FloatArray) -> list[int]:
    """Older rows near row `node`, one a pass, the best to match with first.

    They lie far from it along the path, and from each other.
    """
    older = int(np.searchsorted(path, path[node] - LOOP_PATH_M))
    away = poses[:older, :2] - poses[node, :2]
    distance = np.sqrt((away**2).sum(axis=1))
    old = np.flatnonzero(distance < _NEAR_M)
    turn = np.abs(wrap_angles(poses[old, 2] - poses[node, 2]))
    rank = distance[old] + METRES_A_RADIAN * turn
    chosen: list[int] = []
    for k in old[np.argsort(rank, kind="stable")].tolist():
        if all(abs(path[k] - path[c]) > _NEAR_M for c in chosen):
            chosen.append(k)
    return chosen


def far_passes(graph: Graph, draft: Draft, walls: Walls, first: int = 0) -> tuple[Link, ...]:
    """Where walls are found, every `_WIDE_EVERY_M` from row `first` on, as far as the path's error.

    Where passes tie the path well, that is nowhere. Nor is it where a guess alone does: a few views
    fit in many places, and whole parts are laid where they fit (`pipelines/pieces.py`).
    """
    newer = [max(graph.row[link.source], graph.row[link.target]) for link in draft.loops]
    ties, spread = np.unique(np.array([0, *newer])), path_error(graph, draft.poses)
    links: list[Link] = []
    for row in rows_every(graph.path, _WIDE_EVERY_M):
        last = int(ties[np.searchsorted(ties, row, side="right") - 1])
        part = int(graph.parts[row])
        if row < first or part not in draft.tied or graph.parts[last] != part:
            continue
        error = spread.between(np.array([last]), np.array([row]))[0]
        turn = Pose2(*spread.poses[row].tolist()).rotation()  # of the place: in the map's axes
        error[:2, :2] = np.einsum("ab,bc,dc->ad", turn, error[:2, :2], turn)
        longest = float(np.sqrt(np.linalg.eigvalsh(error[:2, :2])[-1]))
        if PRIOR_SIGMAS * longest <= LOOP_SEARCH_MAX_M:
            continue
        error[:2, :2] *= min(1.0, _WIDE_SEARCH_MAX_M / (PRIOR_SIGMAS * longest)) ** 2
        reach = PRIOR_SIGMAS**2 * error[:2, :2] + _NEAR_M**2 * np.eye(2)
        # among walls that the path cannot have drifted from, a view is found where it is
        drifted = spread.between(np.arange(row), np.full(row, row))[:, :2, :2]
        drifted_m = PRIOR_SIGMAS * np.sqrt(np.linalg.eigvalsh(drifted)[:, -1])
        old = np.flatnonzero(drifted_m > LOOP_SEARCH_MAX_M)
        old = old[within_ellipse(draft.poses[old, :2] - draft.poses[row, :2], reach)]
        old = old[:: max(1, -(-len(old) // _MOST_ROWS))]
        if len(old):
            around = Surroundings.of(walls.of_all(old.tolist(), draft.poses))
            seen = partial(walls.seen_of_all, old.tolist(), draft.poses)
            view = walls.around(row, PLACE_NODES, draft.poses).points
            fit = around.find(view, seen, Prior(Pose2(*draft.poses[row].tolist()), error))
            links += [] if fit is None else [link_to_nearest(graph, draft.poses, old, row, fit)]
    return tuple(links)
