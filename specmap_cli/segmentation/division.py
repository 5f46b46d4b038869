"""A finished grid map divided into regions: section II-B of the paper, and what stands around it.

With the settings of `--preset paper` this is the visibility graph, Algorithm 2 and the nearest
node's label. docs/segmentation.md says what each step of the default settings adds, and why.

Rooms end at walls. What a laser sees through windows, glass, railings and the doors of rooms that
nobody entered lies open to the unknown. Corridors that go round are cut into their sides.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from itertools import zip_longest

import cv2
import numpy as np

from specmap_cli.core.arrays import Packed, carried_on, windows_of
from specmap_cli.core.errors import NoResultError
from specmap_cli.core.geometry import FloatArray, step_lengths
from specmap_cli.core.process import give_memory_back
from specmap_cli.core.records import IntArray
from specmap_cli.core.settings import SegmentationConfig
from specmap_cli.core.worker import ahead
from specmap_cli.grids.gridmap import (
    FREE,
    OCCUPIED,
    UNKNOWN,
    BoolArray,
    CellArray,
    GridMap,
    LengthArray,
    Piece,
    bands_of,
    clearance_of,
    joined,
    looked_up,
)
from specmap_cli.segmentation.cells import (
    border_widths,
    components,
    consensus,
    flood_labels,
    joined_wide,
    labels_near,
    local_widths,
    nearest_labels,
    relief_of,
    spread_labels,
    without_dead_ends,
)
from specmap_cli.segmentation.obstacles import (
    FURNITURE_THICK_M,
    fill_cupboards,
    furniture,
    pieces_at_walls,
    with_narrow_doors,
)
from specmap_cli.segmentation.spectral import Spectrum, spectral_clusters, split_again
from specmap_cli.segmentation.visibility import (
    IndexArray,
    LabelArray,
    sample_nodes,
    visibility_graph,
)
from specmap_cli.segmentation.working_grid import upright_map

_WIDTH_PERCENTILE = 60.0  # of the local widths in a room is the room's width
_ALCOVE_M2 = 2.0  # a dead end smaller than this is a part of the room it opens into
_LARGE_CELLS = 1 << 17  # free ones of a map, of which a placement takes longer than a new process
_WALL_CELLS = 2  # obstacles this near belong to the picture of a region: a wall drawn in cells

_ROBOT_RADIUS_M, _REACH_M = 0.15, 0.5  # of the smallest robot, and how far beside it a room goes
_BESIDE = np.ones((3, 3), dtype=np.uint8)  # a border beside an obstacle is a wall


@dataclass(frozen=True, slots=True, kw_only=True)
class Segmentation:
    """A labelled map and what led to it.

    `labels` (H, W) int16: -1 unlabelled, otherwise 0, 1, ... by falling area; `nodes` (n, 2) x and
    y in metres with their `node_labels` (n,); `pairs` (m, 2) mutually visible nodes; `spectrum` the
    eigenpairs and the clusters they gave.
    """

    labels: LabelArray
    nodes: FloatArray
    node_labels: LabelArray
    pairs: IndexArray
    spectrum: Spectrum

    @property
    def count(self) -> int:
        """Number of regions."""
        return int(self.labels.max(initial=-1)) + 1


def segment(grid: GridMap, config: SegmentationConfig, *, rooms: bool = False) -> Segmentation:
    """Divide the free space of `grid` into regions.

    Where a region ends is decided by these steps, in this order:

    1. which obstacles are furniture, and which openings are as good as doors;
    2. for each placement of the nodes (`_placement`): the clusters of their graph, the halves of
       these, the flood that carries them to cells, and which borders are too wide to be any;
    3. what most placements agree on;
    4. which regions are rings, and end at their corners; which are alcoves of others;
    5. with `rooms`, which regions were seen only, and are no rooms (`entered`).

    After that no border moves: cells without a label, and cupboards, take one.

    The result depends neither on where the map lies on its grid nor on quarter turns of it: the
    work is done on the map cropped, with its walls along the rows and columns. After a turn by
    another angle almost all of the regions are found again: its cells are others.
    """
    upright = upright_map(grid, config.cell_m, config.node_step_m)
    work, cell_m = upright.grid, upright.grid.resolution
    cells, first = _divided(work, config, upright.block)
    least = config.clearance_m / cell_m
    if rooms:  # step 5
        cells = entered(cells, work, least)
    if config.fill:
        cells = fill_cupboards(cells, pieces_at_walls(work, FURNITURE_THICK_M), cell_m)
    else:
        cells = np.where(work.free, cells, np.int16(-1))
    fine = upright.cells_in(grid, cells, -1)
    fine[~grid.free & upright.cells_in(grid, work.free, False)] = -1  # furniture alone has a label
    spread_labels(fine, grid.free, upright.step + 1, everywhere=not rooms)
    sizes = np.bincount(fine[fine >= 0], minlength=int(cells.max(initial=0)) + 1)
    names = np.full(len(sizes) + 1, -1, dtype=np.int16)  # the last is that of no region
    names[np.argsort(-sizes, kind="stable")] = np.arange(len(sizes))
    return Segmentation(
        labels=looked_up(names, fine),
        nodes=upright.places(grid, first.nodes),
        node_labels=names[cells[tuple(first.nodes.T)]],
        pairs=first.pairs,
        spectrum=first.spectrum,
    )


def _divided(work: GridMap, config: SegmentationConfig, block: int) -> tuple[LabelArray, _Clusters]:
    """Steps 1 to 4 of `segment`: regions (h, w); and what the first placement led to."""
    cell_m = work.resolution
    small = furniture(work.free, cell_m, config)  # step 1
    opened = space = work.free | small
    if config.wide_door_m:
        opened, space = with_narrow_doors(work.free, small, cell_m, config.wide_door_m)
    waiting = Packed.of(opened)  # until labels are spread to it
    del small, opened
    give_memory_back()
    clearance = clearance_of(space)
    del space
    relief = relief_of(clearance)
    divisions, first = _divisions(clearance, relief, cell_m, config, block)  # step 2
    cells = np.full(relief.shape, -1, dtype=np.int16)
    cells[relief > 0] = consensus(divisions)  # step 3
    del divisions, clearance
    give_memory_back()
    if config.merge:  # step 4
        open_rings(cells)
        least, alcove = config.clearance_m / cell_m, _ALCOVE_M2 / cell_m**2
        cells = without_dead_ends(cells, clearance_of(relief > 0), least, alcove)
    spread_labels(cells, waiting.array)
    return cells, first


@dataclass(frozen=True, slots=True, kw_only=True)
class _Clusters:
    """The nodes (n, 2) of a placement, the pairs (m, 2) in sight, what Algorithm 2 says of them."""

    nodes: IndexArray
    pairs: IndexArray
    spectrum: Spectrum


def _divisions(
    clearance: LengthArray, relief: CellArray, cell_m: float, config: SegmentationConfig, block: int
) -> tuple[list[LabelArray], _Clusters]:
    """The labels (n,) of the free cells by each placement of the nodes; the clusters of the first.

    Of a large map every other placement is made in a second process, where there can be one.
    """
    place = partial(_placement, clearance, relief, cell_m, config, block)
    large = int(np.count_nonzero(relief)) >= _LARGE_CELLS
    odd, even = range(1, config.placements, 2), range(2, config.placements, 2)
    with ahead(lambda: (Packed.of(place(k)[0]) for k in odd), worthwhile=large) as meanwhile:
        others = [Packed.of(place(k)[0]) for k in even]
        labels, first = place(0)
        between = list(meanwhile)
    give_memory_back()
    in_order = (one for pair in zip_longest(between, others) for one in pair if one)
    return [labels, *(one.array for one in in_order)], first


def _placement(
    clearance: LengthArray,
    relief: CellArray,
    cell_m: float,
    config: SegmentationConfig,
    block: int,
    number: int,
) -> tuple[LabelArray, _Clusters]:
    """The labels (n,) of the free cells by one placement of the nodes, and its clusters."""
    give_memory_back()
    least, sight = config.clearance_m / cell_m, config.sight_m / cell_m
    before = round(number / config.placements * block)
    nodes = sample_nodes(clearance, block, least, config.nodes, before)
    if config.merge:  # of where rooms end a node says nothing that has no obstacle in sight
        along_walls = least + 2.0 * math.hypot(block, block)  # no piece of free space has none
        nodes = nodes[clearance[tuple(nodes.T)] <= max(sight, along_walls)]
    graph = visibility_graph(clearance, nodes, sight, least)
    spectrum = spectral_clusters(graph, config)
    labels = spectrum.labels
    if config.halve:
        labels = split_again(graph, labels, config.neighbours, config.halve_eigenvalue)
    # no wider than the disc that the longest sight line spans
    across = local_widths(clearance[tuple(nodes.T)], graph.lengths, graph.pairs, 0.5 * sight)
    pairs = graph.pairs
    del graph  # the most memory of all this
    give_memory_back()
    names = np.arange(int(labels.max(initial=-1)) + 1, dtype=np.int16)
    carry = nearest_labels if config.labels == "nearest" else flood_labels
    cells = carry(relief, nodes, labels)
    if config.merge:  # joined where no narrowing separates them
        widths = [float(np.percentile(across[labels == k], _WIDTH_PERCENTILE)) for k in names]
        names = joined_wide(border_widths(cells, clearance), widths, config.merge_ratio)
    free = np.append(names, np.int16(-1))[cells[relief > 0]]  # the last is that of no cluster
    return free, _Clusters(nodes=nodes, pairs=pairs, spectrum=spectrum)


def regions_of(
    grid: GridMap, division: LabelArray | IntArray, poses: FloatArray, least_m: float
) -> IntArray:
    """The region (n,) that each keyframe at `poses` (n, 3) was taken in.

    `division` (H, W) has the region of each cell of `grid`, or -1. Regions the robot only grazed,
    on less than `least_m` of way in all, go to the region that it came from.
    """
    labels = _regions_at(grid, division, poses)
    if (labels < 0).all():
        return np.zeros_like(labels)
    way = np.bincount(labels[1:], weights=step_lengths(poses), minlength=int(labels.max()) + 1)
    stays = way[labels] >= least_m
    if not stays.any():
        return np.full_like(labels, np.bincount(labels).argmax())
    return carried_on(labels, stays)


def driven(grid: GridMap, division: LabelArray | IntArray, poses: FloatArray) -> list[Piece]:
    """The regions with a keyframe, as in `regions_of`: where each is, and its cells there.

    The others are what the robot saw through doors and windows, and never drove into.
    """
    there = set(_regions_at(grid, division, poses).tolist())
    windows = {region: w for region, w in windows_of(division).items() if region in there}
    return [(window, division[window] == region) for region, window in windows.items()]


def _regions_at(grid: GridMap, division: LabelArray | IntArray, poses: FloatArray) -> IntArray:
    """The region (n,) of the cell that is nearest to each pose and has one; -1 if none has."""
    cells = np.clip(grid.cells_of(poses[:, :2]), 0, np.array(division.shape) - 1)
    found: IntArray = division[tuple(cells.T)].astype(np.int64)
    nowhere = found < 0
    if nowhere.any() and (division >= 0).any():
        found[nowhere] = labels_near(division, cells[nowhere])
    return found


def segment_floorplan(grid: GridMap, config: SegmentationConfig) -> Segmentation:
    """Divide `grid` into regions of one piece, the largest of each; scraps have no label.

    NoResultError when no free space holds a node.
    """
    found = segment(grid, config, rooms=config.rooms_only)
    if not found.count:
        raise NoResultError(
            f"no free space wider than {2 * config.clearance_m:g} m in the map "
            f"({grid.free_area_m2:.1f} m2 free)",
            "check the resolution and the thresholds",
        )
    labels = np.full_like(found.labels, -1)
    for label, window in windows_of(found.labels).items():
        mine = (found.labels[window] == label).astype(np.uint8)
        _, piece, stats, _ = cv2.connectedComponentsWithStats(mine, connectivity=8)
        largest = 1 + int(stats[1:, cv2.CC_STAT_AREA].argmax())
        labels[window][piece == largest] = label
    return replace(found, labels=labels)


def region_grid(grid: GridMap, region: BoolArray) -> GridMap:
    """The cells `region` (H, W) of a grid with the obstacles round them, cropped; else unknown.

    At least one cell is of the region.
    """
    reach = np.ones((2 * _WALL_CELLS + 1, 2 * _WALL_CELLS + 1), dtype=np.uint8)
    shown = cv2.dilate(region.astype(np.uint8), reach).astype(bool)
    cells: CellArray = np.full(grid.cells.shape, UNKNOWN, dtype=np.uint8)
    cells[shown & (grid.cells == OCCUPIED)] = OCCUPIED
    cells[region & (grid.cells == FREE)] = FREE
    return GridMap(cells, grid.resolution, grid.origin).cropped(shown)


def entered(labels: LabelArray, grid: GridMap, least: float) -> LabelArray:
    """The regions (h, w) of a map that are rooms; -1 what was only seen.

    Seen only is, in this order:

    1. what is not within reach of any place where the smallest robot finds room: single rays;
    2. a region that borders on the unknown more than on walls, unless all do;
    3. a region that a robot of the radius `least`, in cells, cannot reach from the largest part of
       all that it hangs together with, what was seen only included.
    """
    free = labels >= 0
    if not free.any():
        return labels
    clearance = clearance_of(free)
    roomy = clearance * grid.resolution >= _ROBOT_RADIUS_M
    away = cv2.distanceTransform((~roomy).astype(np.uint8), cv2.DIST_L2, 5) * grid.resolution
    found = np.where(joined(free & (away <= _REACH_M), roomy), labels, np.int16(-1))
    walled = np.where(_open_to_the_unknown(found, grid)[found], np.int16(-1), found)
    found = walled if (walled >= 0).any() else found
    count = int(labels.max(initial=0)) + 1
    size = np.bincount(found[found >= 0], minlength=count)
    borders = border_widths(found, clearance)
    part = components(count, [pair for pair, border in borders.items() if border >= least])
    glimpsed = [pair for pair in border_widths(labels, clearance) if not size[list(pair)].all()]
    piece = components(count, [*borders, *glimpsed])
    area = np.bincount(part, weights=size)[part]
    largest = np.zeros(count)
    np.maximum.at(largest, piece, area)
    return np.where((area < largest[piece])[found], np.int16(-1), found)


def _open_to_the_unknown(labels: LabelArray, grid: GridMap) -> BoolArray:
    """(k,) which regions (h, w) have more sides of cells on the unknown than on walls."""
    wall = cv2.dilate((grid.cells == OCCUPIED).astype(np.uint8), _BESIDE) > 0
    unknown = (grid.cells == UNKNOWN) & ~wall
    count = int(labels.max(initial=0)) + 1
    more = np.zeros(count, dtype=np.int64)
    for one, other in (
        (np.s_[:-1], np.s_[1:]),
        (np.s_[1:], np.s_[:-1]),
        (np.s_[:, :-1], np.s_[:, 1:]),
        (np.s_[:, 1:], np.s_[:, :-1]),
    ):
        inside, beyond = labels[one], labels[other] < 0
        inside = np.where(beyond, inside, np.int16(-1))
        for kind, sign in ((unknown[other], 1), (wall[other], -1)):
            sides = inside[(inside >= 0) & kind]
            more += sign * np.bincount(sides, minlength=count)
    return np.asarray(more > 0)


def open_rings(labels: LabelArray) -> None:
    """Divide, in place, the regions (h, w) of an upright map that are rings into their sides."""
    count = int(labels.max(initial=-1)) + 1
    if not count:
        return
    labelled = labels >= 0
    for label, window in windows_of(labels).items():
        region = np.pad(labels[window] == label, 1)
        beyond = (~region).view(np.uint8)
        holes, around, stats, _ = cv2.connectedComponentsWithStats(beyond, connectivity=4)
        del beyond
        around = around.astype(np.min_scalar_type(holes), copy=False)
        cuts, size = np.zeros_like(region), stats[:, cv2.CC_STAT_AREA]
        for number, (left, top, wide, high, _) in enumerate(stats.tolist()):
            if number not in (0, around[0, 0]):
                large = 2 * size >= size[number]  # an obstacle that is smaller is passed over
                large[[0, around[0, 0]]] = False, True
                rows = slice(max(0, top - high), top + 2 * high)
                near = rows, slice(max(0, left - wide), left + 2 * wide)
                _cut_round(around[near] == number, looked_up(large, around[near]), cuts[near])
        cuts &= region
        if not cuts.any():
            continue
        del around
        rest = (region & ~cuts).view(np.uint8)
        pieces, piece, stats, _ = cv2.connectedComponentsWithStats(rest, connectivity=8)
        beside = np.unique(piece[(cv2.dilate(cuts.view(np.uint8), _BESIDE) & rest).view(np.bool_)])
        scrap = stats[beside, cv2.CC_STAT_AREA] <= np.count_nonzero(cuts)
        names = np.full(pieces, label, dtype=labels.dtype)
        names[beside[scrap]] = -1
        more = beside[~scrap][1:]
        names[more] = count + np.arange(len(more))
        count += len(more)
        names[0] = -1  # the cuts, of all that is of the region
        inner = slice(1, -1), slice(1, -1)
        for rows in bands_of(labels[window].shape):
            own = region[inner][rows]
            labels[window][rows][own] = names[piece[inner][rows][own]]
    spread_labels(labels, labelled)


def _cut_round(hole: BoolArray, solid: BoolArray, cuts: BoolArray) -> None:
    """Mark in `cuts` (h, w) where a region is cut that is a ring round a hole (h, w).

    It is one when the hole is larger than the floor round it. The longer sides own the corners.
    """
    sides = [int(np.ptp(_extent(hole.sum(axis=axis)))) + 1 for axis in (0, 1)]
    whole = 1
    for across in (sides[0] >= sides[1], sides[0] < sides[1]):  # the last are the cuts
        views = [one.T if across else one for one in (hole, solid, cuts)]
        corners = [[one[::up, ::left] for one in views] for up in (1, -1) for left in (1, -1)]
        ends = [_cut(*one[:2]) for one in corners]
        widths = [stop - start for _, start, stop in ends]
        beside = max(widths[0] + widths[1], widths[2] + widths[3])
        if beside >= sides[across]:  # the floor is larger, whatever is on the other two sides
            return
        whole *= sides[across] + beside
    if 2 * sides[0] * sides[1] > whole:
        for (_, _, view), (row, start, stop) in zip(corners, ends, strict=True):
            view[row, start:stop] = True


def _cut(hole: BoolArray, solid: BoolArray) -> tuple[int, int, int]:
    """Row, first column and end of the shortest cut from the left of a hole to what is solid."""
    first, last = _extent(hole.sum(axis=1))
    cuts = []
    for row in range(first, (first + last) // 2 + 1):
        stop = int(hole[row].argmax())
        start = 1 + int(np.flatnonzero(solid[row, :stop])[-1:].max(initial=-1))
        cuts.append((row, start, stop))
    return min(cuts, key=lambda cut: cut[2] - cut[1] + cut[0])


def _extent(counts: IntArray) -> tuple[int, int]:
    """The first and the last place where a hole is at least half as wide as at its widest."""
    wide = np.flatnonzero(2 * counts >= counts.max())
    return int(wide[0]), int(wide[-1])
