"""A reader of masks by the rules of Nav2's map server and costmap filters, in our words.

Of navigation2: map_io.cpp (000b462), speed_filter.cpp (01f8d13), keepout_filter.cpp (0285c5f),
costmap_filter_info_server.cpp (0537cb2). A mask of the mode `raw` has the greys 0 to 100 as they
are, others are unknown; the keepout filter wants base 0 and multiplier 1; to the speed filter an
unknown cell is an error, 0 no limit, and type 2 metres a second.
"""

import zipfile
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import yaml

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import BoolArray


class Masks(NamedTuple):
    """(H, W) each, row 0 the lowest: what is shut, and the limit in metres a second, 0 for none."""

    shut: BoolArray
    limits: FloatArray
    resolution: float
    origin: tuple[float, float]


def load(path: Path) -> Masks:
    with zipfile.ZipFile(path) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    servers = yaml.safe_load(files["nav2_params.yaml"])
    told = {name: server["ros__parameters"] for name, server in servers.items()}
    values, sidecars = {}, []
    for name, kind in (("keepout", 0), ("speed", 2)):
        mask, info = (told[f"{name}_{of}_server"] for of in ("filter_mask", "costmap_filter_info"))
        assert info["mask_topic"] == mask["topic_name"]
        assert (info["type"], info["base"]) == (kind, 0.0)
        assert all(isinstance(info[key], float) for key in ("base", "multiplier"))
        sidecar = yaml.safe_load(files[mask["yaml_filename"]])
        cells = _cells(files, sidecar)
        assert (cells >= 0).all(), "unknown to the speed filter"
        values[name] = cells * info["multiplier"]
        sidecars.append({key: sidecar[key] for key in ("resolution", "origin")})
    assert told["keepout_costmap_filter_info_server"]["multiplier"] == 1.0
    assert sidecars[0] == sidecars[1]
    assert set(np.unique(values["keepout"])) <= {0.0, 100.0}
    origin = sidecars[0]["origin"]
    assert (len(origin), origin[2]) == (3, 0.0)
    place = (origin[0], origin[1])
    return Masks(values["keepout"] == 100.0, values["speed"], sidecars[0]["resolution"], place)


def _cells(files: dict[str, bytes], sidecar: dict[str, Any]) -> FloatArray:
    needed = {"image", "resolution", "origin", "negate", "occupied_thresh", "free_thresh"}
    assert needed <= sidecar.keys()
    assert sidecar["mode"] == "raw"
    data = np.frombuffer(files[sidecar["image"]], dtype=np.uint8)
    picture = cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
    assert picture is not None
    assert picture.dtype == np.uint8
    return np.where(picture <= 100, picture.astype(np.float64), -1.0)[::-1]
