"""Which frames a log has and how the laser sits on the base, found before the scans are read."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from itertools import islice

import numpy as np

from specmap_cli.core.errors import UsageError
from specmap_cli.core.geometry import FloatArray
from specmap_cli.logs.messages import BadMessageError, decode_transforms
from specmap_cli.logs.readers.recording import Log, Message, TopicInfo
from specmap_cli.logs.readers.typestore import TF_MESSAGE
from specmap_cli.logs.transforms import TransformTree, tilt_of

USUAL_BASES = ("base_link", "base_footprint", "base")
_FLOOR_FRAME = "base_footprint"
_STATIC_LIMIT = 2_000  # messages
_DYNAMIC_LIMIT = 2_000  # messages, enough for every frame to have been heard of
_SEARCH_LIMIT = 50_000  # messages, while the laser is still unconnected
_TILT_LIMIT_RAD = 0.175


@dataclass(frozen=True, slots=True)
class Placement:
    """The base frame, the laser on it, and what was assumed."""

    base_frame: str
    base_from_laser: FloatArray
    floor_m: float | None  # height of the floor in the base frame, None when unknown
    warnings: list[str] = field(default_factory=list)


def static_topics(topics: Iterable[TopicInfo]) -> list[str]:
    """Topics of transforms that never change."""
    return [t.name for t in topics if t.type == TF_MESSAGE and t.name.endswith("tf_static")]


def dynamic_topics(topics: Iterable[TopicInfo]) -> list[str]:
    """Topics of transforms that may change."""
    return [t.name for t in topics if t.type == TF_MESSAGE and not t.name.endswith("tf_static")]


def read_tree(log: Log, laser_frame: str, bases: Iterable[str]) -> TransformTree:
    """The frames of a log: all static transforms, and the dynamic ones of its beginning.

    Dynamic ones are searched further while none of `bases` is joined to the laser's frame. Reads
    only the topics of transforms, a bounded number of messages, and stops early.
    """
    tree = TransformTree()
    topics = log.topics()
    for message in islice(log.messages(static_topics(topics)), _STATIC_LIMIT):
        _take(tree, message, dynamic=False)
    dynamic = dynamic_topics(topics)
    wanted = [*bases, *USUAL_BASES]
    if not dynamic:
        return tree
    for number, message in enumerate(islice(log.messages(dynamic), _SEARCH_LIMIT)):
        _take(tree, message, dynamic=True)
        if number >= _DYNAMIC_LIMIT and any(_joined(tree, base, laser_frame) for base in wanted):
            break
    return tree


def _take(tree: TransformTree, message: Message, *, dynamic: bool) -> None:
    try:
        for record in decode_transforms(message):
            tree.add(record, dynamic=dynamic)
    except BadMessageError:
        return  # counted when the message comes by again


def _joined(tree: TransformTree, base: str, laser_frame: str) -> bool:
    return tree.lookup(base, laser_frame) is not None


def place_laser(
    tree: TransformTree, laser_frame: str, asked: str | None, odometry_child: str | None
) -> Placement:
    """Choose the base frame and look up the laser's place on it.

    `asked` is the frame the user named; otherwise it is the frame that moves in the odometry, or
    one of the usual names, whichever is joined to the laser's frame. Raises UsageError for an
    asked frame that the log does not have.
    """
    if asked is not None:
        return _asked_base(tree, laser_frame, asked.lstrip("/"))
    candidates = [frame for frame in (odometry_child, *USUAL_BASES) if frame]
    for base in candidates:
        if _joined(tree, base, laser_frame):
            return _placement(tree, base, laser_frame)
    base = odometry_child or next((b for b in USUAL_BASES if b in tree.frames), laser_frame)
    if base == laser_frame:
        return Placement(base, np.eye(4), None)
    warning = (
        f"no transform from {base!r} to the laser's frame {laser_frame!r}: "
        f"the laser is taken to sit at the origin of {base!r}, looking ahead"
    )
    return Placement(base, np.eye(4), None, [warning])


def _asked_base(tree: TransformTree, laser_frame: str, base: str) -> Placement:
    if _joined(tree, base, laser_frame):
        return _placement(tree, base, laser_frame)
    above = sorted({laser_frame, *tree.ancestors(laser_frame)})
    raise UsageError(
        f"--base-frame {base}: no transform joins it to the laser's frame {laser_frame!r}; "
        f"choose from {', '.join(above)}"
    )


def _placement(tree: TransformTree, base: str, laser_frame: str) -> Placement:
    base_from_laser = tree.lookup(base, laser_frame)
    assert base_from_laser is not None  # the caller has asked
    base_from_floor = tree.lookup(base, _FLOOR_FRAME)
    floor = 0.0 if base != laser_frame else None
    if base_from_floor is not None:
        floor = float(base_from_floor[2, 3])
    warnings = []
    tilt = tilt_of(base_from_laser)
    if _TILT_LIMIT_RAD < tilt < np.pi - _TILT_LIMIT_RAD:
        warnings.append(
            f"the laser's frame {laser_frame!r} is tilted by {np.degrees(tilt):.0f} degrees "
            f"against {base!r}: a planar scan is read as if it were level"
        )
    return Placement(base, base_from_laser, floor, warnings)
