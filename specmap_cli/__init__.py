"""Topological maps from robot laser logs, offline and without ROS.

What a program needs is here; docs/library.md shows it at work::

    from specmap_cli import build_map, read_map

    build_map("log.mcap", "out")
    print(read_map("out").route("kitchen", "lab").length_m)

`build_map`, `localize_log`, `segment_map`, `update_map`, `merge_maps`, `compare_maps` and
`export_map` do what the commands of the same names do. `read_map` opens a map directory, which is
a `Map`, `open_log` a recording, whose scans a `SweepStream` has. A `Localizer` is fed one `Scan`
after another. `load_config` makes the settings. Whatever goes wrong with the input is a
`SpecmapError`.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from specmap_cli.core.config import load_config
    from specmap_cli.core.errors import SpecmapError
    from specmap_cli.exports.table import export_map
    from specmap_cli.logs.opening import open_log
    from specmap_cli.logs.stream import SweepStream
    from specmap_cli.maps.store import Map, read_map
    from specmap_cli.pipelines.build import build_map
    from specmap_cli.pipelines.compare import compare_maps
    from specmap_cli.pipelines.localize import localize_log
    from specmap_cli.pipelines.localizer import Localizer, Scan
    from specmap_cli.pipelines.merge import merge_maps
    from specmap_cli.pipelines.segment import segment_map
    from specmap_cli.pipelines.update import update_map

__version__ = "1.0.0"

__all__ = [
    "Localizer",
    "Map",
    "Scan",
    "SpecmapError",
    "SweepStream",
    "build_map",
    "compare_maps",
    "export_map",
    "load_config",
    "localize_log",
    "merge_maps",
    "open_log",
    "read_map",
    "segment_map",
    "update_map",
]

# Loaded when first asked for: `specmap --help` needs none of them.
_HOMES = {
    "Localizer": "pipelines.localizer",
    "Map": "maps.store",
    "Scan": "pipelines.localizer",
    "SpecmapError": "core.errors",
    "SweepStream": "logs.stream",
    "build_map": "pipelines.build",
    "compare_maps": "pipelines.compare",
    "export_map": "exports.table",
    "load_config": "core.config",
    "localize_log": "pipelines.localize",
    "merge_maps": "pipelines.merge",
    "open_log": "logs.opening",
    "read_map": "maps.store",
    "segment_map": "pipelines.segment",
    "update_map": "pipelines.update",
}


def __getattr__(name: str) -> Any:
    """A public name, from the module that it lives in."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    """The public names."""
    return sorted([*globals(), *__all__])
