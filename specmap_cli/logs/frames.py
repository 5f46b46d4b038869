"""The tree of frames of a log, and how the laser sits on the base, found before scans are read."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from specmap_cli.core.errors import UsageError
from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.settings import LogConfig
from specmap_cli.core.text import legible
from specmap_cli.logs.messages import BadMessageError, TransformRecord, decode_transforms
from specmap_cli.logs.opening import Log
from specmap_cli.logs.readers.encoding import TF_MESSAGE

_MAX_DEPTH = 100  # a longer chain of frames is a loop


class TransformTree:
    """The latest transform of every frame from its parent; frames form a forest."""

    def __init__(self) -> None:
        self._parent: dict[str, str] = {}
        self._parent_from: dict[str, FloatArray] = {}
        self._moving: set[str] = set()

    def add(self, record: TransformRecord, *, dynamic: bool) -> None:
        """Take in one transform; a later one of the same child replaces it."""
        if record.parent == record.child:
            return
        self._parent[record.child] = record.parent
        self._parent_from[record.child] = record.parent_from_child
        if dynamic:
            self._moving.add(record.child)

    def copy(self) -> TransformTree:
        """A tree that can change on its own."""
        tree = TransformTree()
        tree._parent, tree._parent_from = dict(self._parent), dict(self._parent_from)
        tree._moving = set(self._moving)
        return tree

    @property
    def frames(self) -> set[str]:
        """Every frame that occurs."""
        return set(self._parent) | set(self._parent.values())

    def edges(self) -> list[tuple[str, str, FloatArray, bool]]:
        """(parent, child, parent_from_child, whether it came on a dynamic topic), by child."""
        return [
            (self._parent[child], child, self._parent_from[child], child in self._moving)
            for child in sorted(self._parent)
        ]

    def ancestors(self, frame: str) -> Iterator[str]:
        """The frame and its parents up to the root."""
        for _ in range(_MAX_DEPTH):
            yield frame
            if frame not in self._parent:
                return
            frame = self._parent[frame]

    def lookup(self, target: str, source: str) -> FloatArray | None:
        """target_from_source (4, 4), None when no chain of transforms joins the frames."""
        above = list(self.ancestors(target))
        common = next((frame for frame in self.ancestors(source) if frame in above), None)
        if common is None:
            return None
        from_common = [np.eye(4), np.eye(4)]
        for number, frame in enumerate((target, source)):
            while frame != common:
                from_common[number] = self._parent_from[frame] @ from_common[number]
                frame = self._parent[frame]
        up, down = from_common
        return np.asarray(np.linalg.inv(up) @ down)


_TILT_MAX_RAD = 0.175  # a laser tilted more is warned of: it is read as level
USUAL_BASES = ("base_link", "base_footprint", "base")  # by REP 105 and by custom
_FLOOR_FRAME = "base_footprint"  # by REP 120 the base's projection on the floor
_ENOUGH_MESSAGES = 2_000  # some seconds of transforms, in which every frame is heard of


@dataclass(frozen=True, slots=True, kw_only=True)
class Frames:
    """The frames of a log; `complete` unless the search for the laser's place was given up.

    `absurd` are (parent, child) of transforms that were left out, as no robot can have them;
    `unreadable` is the number of messages that hold no transforms at all.
    """

    tree: TransformTree
    complete: bool
    absurd: tuple[tuple[str, str], ...] = ()
    unreadable: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Placement:
    """The base frame, base_from_laser (4, 4) on it, and what was assumed.

    `floor_m` is the height of the floor in the base frame, None when it is unknown.
    """

    base_frame: str
    base_from_laser: FloatArray
    floor_m: float | None
    warnings: tuple[str, ...] = ()


def read_frames(log: Log, laser_frame: str, bases: Iterable[str], config: LogConfig) -> Frames:
    """The frames of a log: the first static and the first dynamic transforms.

    The search goes on while none of `bases` is joined to the laser's frame, up to
    `config.transform_messages` of each kind. Reads only the topics of transforms.
    """
    tree = TransformTree()
    wanted = list(bases)
    given_up, unreadable = False, 0
    absurd: dict[tuple[str, str], None] = {}  # in the order they were met
    for dynamic in (False, True):
        of_tf = [topic.name for topic in log.topics() if topic.type == TF_MESSAGE]
        names = [name for name in of_tf if name.endswith("tf_static") != dynamic]
        for number, message in enumerate(log.messages(names) if names else ()):
            if number >= config.transform_messages:
                given_up = True
                break
            try:
                transforms = decode_transforms(message)
            except BadMessageError:
                unreadable += 1
            else:
                for record in transforms.records:
                    tree.add(record, dynamic=dynamic)
                absurd.update(dict.fromkeys(transforms.absurd))
            if number >= _ENOUGH_MESSAGES and _any_joined(tree, wanted, laser_frame):
                break
    complete = not given_up or _any_joined(tree, wanted, laser_frame)
    return Frames(tree=tree, complete=complete, absurd=tuple(absurd), unreadable=unreadable)


def _any_joined(tree: TransformTree, bases: Iterable[str], laser_frame: str) -> bool:
    return any(tree.lookup(base, laser_frame) is not None for base in bases)


def place_laser(
    tree: TransformTree, laser_frame: str, odometry_child: str | None, config: LogConfig
) -> Placement:
    """Choose the base frame and look up the laser's place on it.

    The base is the frame that the settings name; otherwise the frame that moves in the odometry, or
    one of the usual names, whichever is joined to the laser's frame. Raises UsageError for a named
    frame that the log does not join to it.
    """
    asked = config.base_frame
    bases = (odometry_child, *USUAL_BASES) if asked is None else (asked.lstrip("/"),)
    for base in bases:
        base_from_laser = None if base is None else tree.lookup(base, laser_frame)
        if base is None or base_from_laser is None:
            continue
        base_from_floor = tree.lookup(base, _FLOOR_FRAME)
        floor = 0.0 if base != laser_frame else None
        if base_from_floor is not None:
            floor = float(base_from_floor[2, 3])
        tilt = math.acos(float(np.clip(base_from_laser[2, 2], -1.0, 1.0)))
        tilted = (
            f"the laser's frame {laser_frame!r} is tilted by {np.degrees(tilt):.0f} degrees "
            f"against {base!r}: a planar scan is read as if it were level"
        )
        return Placement(
            base_frame=base,
            base_from_laser=base_from_laser,
            floor_m=floor,
            warnings=(tilted,) if _TILT_MAX_RAD < tilt < np.pi - _TILT_MAX_RAD else (),
        )
    if asked is not None:
        above = sorted({laser_frame, *tree.ancestors(laser_frame)})
        none = f"no transform joins it to the laser's frame {laser_frame!r}"
        hint, where = f"choose from {', '.join(above)}", f"--base-frame {bases[0]}"
        raise UsageError(none, legible(hint), mark=";", where=legible(where))
    base = odometry_child or next((b for b in USUAL_BASES if b in tree.frames), laser_frame)
    unknown = (
        f"no transform from {base!r} to the laser's frame {laser_frame!r}: "
        f"the laser is taken to sit at the origin of {base!r}, looking ahead"
    )
    warnings = (unknown,) if base != laser_frame else ()
    return Placement(base_frame=base, base_from_laser=np.eye(4), floor_m=None, warnings=warnings)
