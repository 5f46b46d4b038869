"""A comparison of two maps of a building, for what is made of one."""

from typing import Any

from specmap_cli.maps.comparison import ComparisonRecord

_EMPTY = ("same", "split", "merged", "new", "unseen", "gone", "redrawn_old", "redrawn_new")


def comparison(
    *,
    names: tuple[str, str, str] = ("Hall", "1", "2"),
    areas_m2: tuple[float, float] = (40.0, 20.0),
    submaps: dict[str, Any],
    **things: list[Any],
) -> ComparisonRecord:
    """Two maps of three submaps; what differs are `closed`, `opened`, `appeared` and `vanished`."""
    side = {
        **{"names": dict(enumerate(names)), "submaps": 3, "edges": 2, "keyframes": 30},
        **{"path_m": 10.0, "duration_s": 30.0, "verdict": "good"},
    }
    old, new = (
        {**side, "map": which, "area_m2": area}
        for which, area in zip(("old", "new"), areas_m2, strict=True)
    )
    return ComparisonRecord.model_validate(
        {
            **{"schema_version": 1, "old": old, "new": new, "identical": False},
            "alignment": {
                **{"old_from_new": (0.0, 0.0, 0.0), "votes": 2, "submaps": 3, "area_m2": 20.0},
                **{"walls_m": 9.0, "residual_m": 0.02, "rival": 0.1},
            },
            "submaps": {**{name: [] for name in _EMPTY}, **submaps},
            "doors": {which: things.get(which, []) for which in ("closed", "opened")},
            "things": {which: things.get(which, []) for which in ("appeared", "vanished")},
        }
    )


def thing(x: float, y: float, width_m: float) -> dict[str, Any]:
    """A thing a metre long."""
    left, right, low, high = x - 0.5, x + 0.5, y - width_m / 2, y + width_m / 2
    return {
        **{"x": x, "y": y, "length_m": 1.0, "width_m": width_m, "area_m2": width_m},
        "corners": [(left, low), (right, low), (right, high), (left, high)],
        **{"old_submap": 0, "new_submap": 1},
    }


def way(x: float, y: float) -> dict[str, Any]:
    """A way between the first two submaps."""
    return {"between": (0, 1), "x": x, "y": y, "width_m": 0.9}
