"""Masks for Nav2's costmap filters: where no robot may go, and how fast it may be elsewhere.

Both lie on the grid of `map.yaml`, cell by cell. Nav2 reads a cell of a mask as 0 to 100. To its
keepout filter 100 is a wall. Its speed filter takes 0 for no limit, and any other value times
`multiplier`, plus `base`, for metres a second.
"""

from __future__ import annotations

import math
from typing import IO

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.files import write_zip
from specmap_cli.core.progress import Progress
from specmap_cli.core.records import BoolArray
from specmap_cli.core.text import counted
from specmap_cli.core.yaml import yaml_text
from specmap_cli.exports.routes import SPEED_LIMIT, misnoted, noted
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.maps.store import Map
from specmap_cli.topology.regions import borders_of, drawn

_KEEPOUT, _ABSOLUTE_SPEED = 0, 2  # of Nav2's filters
_FULL = 100  # the largest value of a cell


class Masks:
    """`keepout.pgm` and `speed.pgm`, a YAML beside each, and the parameters of their servers."""

    description = "a zip of keepout and speed masks with their parameters, for Nav2's filters"
    ending = ".zip"

    def write(self, stored: Map, target: IO[bytes], progress: Progress) -> None:
        """Write the masks of a map; a map without anything to mask gets empty ones."""
        record, grid = stored.record, stored.regions.grid
        for warning in misnoted(record):
            progress.warn(warning)
        limits = noted(record, SPEED_LIMIT)
        keepout, speed = np.zeros((2, *grid.cells.shape), dtype=np.uint8)
        keepout[_forbidden(stored)] = _FULL
        multiplier = max(limits.values(), default=float(_FULL)) / _FULL
        for id_, limit in limits.items():  # never faster than was said, if it can be
            value = math.floor(limit / multiplier + 1e-9)
            if value < 1:
                progress.warn(
                    f"submap {id_}: {SPEED_LIMIT} {limit:g} is written as {multiplier:g}, "
                    "a hundredth of the largest one: a mask holds nothing smaller"
                )
            speed[stored.regions.owner == id_] = max(value, 1)
        progress.note(
            f"{counted(int(np.count_nonzero(keepout)), 'cell')} shut, "
            f"{counted(int(np.count_nonzero(speed)), 'cell')} with a limit"
        )
        parameters = {
            **_servers("keepout", _KEEPOUT, 1.0),
            **_servers("speed", _ABSOLUTE_SPEED, multiplier),
        }
        files = {
            "keepout.pgm": _pgm(keepout),
            "keepout.yaml": _sidecar("keepout.pgm", grid),
            "speed.pgm": _pgm(speed),
            "speed.yaml": _sidecar("speed.pgm", grid),
            "nav2_params.yaml": yaml_text(parameters).encode(),
        }
        write_zip(target, files)


def _forbidden(stored: Map) -> BoolArray:
    """(H, W) the cells of forbidden doors, and both sides of where submaps of such a link touch."""
    record, regions = stored.record, stored.regions
    shut = drawn([door.sides for door in stored.doors if door.forbidden], regions.grid)
    apart = {(edge.source, edge.target) for edge in record.edges if edge.forbidden}
    for border in borders_of(regions.owner) if apart else ():
        if border.pair in apart:
            shut[tuple(border.low.T)] = shut[tuple(border.high.T)] = True
    return shut


def _pgm(values: NDArray[np.uint8]) -> bytes:
    """Values (H, W), row 0 the lowest, as a picture of Netpbm."""
    height, width = values.shape
    return b"P5\n%d %d\n255\n" % (width, height) + values[::-1].tobytes()


def _sidecar(image: str, grid: GridMap) -> bytes:
    """In the mode `raw` the grey of a pixel is the value of its cell."""
    told = {
        "image": image,
        "mode": "raw",
        "resolution": float(grid.resolution),
        "origin": [*map(float, grid.origin), 0.0],
        "negate": 0,
        "occupied_thresh": 1.0,
        "free_thresh": 0.0,
    }
    return yaml_text(told).encode()


def _servers(name: str, kind: int, multiplier: float) -> dict[str, object]:
    """The parameters of the two servers of a mask, under the names of Nav2's own launch files."""
    mask = f"{name}_filter_mask"
    of_mask = {"yaml_filename": f"{name}.yaml", "topic_name": mask}
    info = {
        "type": kind,
        "filter_info_topic": f"{name}_costmap_filter_info",
        "mask_topic": mask,
        "base": 0.0,
        "multiplier": multiplier,
    }
    return {
        f"{name}_filter_mask_server": {"ros__parameters": of_mask},
        f"{name}_costmap_filter_info_server": {"ros__parameters": info},
    }
