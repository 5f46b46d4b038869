"""Mutations of messages: their fields, types, topics and serialised counts."""

from __future__ import annotations

import copy
import math
import random
import struct
from collections.abc import Sequence
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
from rosbags.serde import SerdeError

from fuzz.changes import replaced
from specmap_cli.logs.readers.encoding import (
    LASER_SCAN,
    ODOMETRY,
    POINT_CLOUD,
    TF_MESSAGE,
    typestore,
)
from specmap_cli.logs.readers.recording import Message

_FLOATS = (
    math.nan,
    math.inf,
    -math.inf,
    0.0,
    -0.0,
    -1.0,
    -100.0,
    100.0,
    1e-320,
    1e-30,
    1e7,
    1e9,
    1e20,
    3e38,
    1e300,
    -1e300,
    1.7e308,
)
_INTEGERS = (0, 1, 2, 7, 8, 255, 1000, 65_535, 2**31 - 1, 2**32 - 1, -1, -(2**31))
_NAMES = (
    "",
    "/",
    "laser",
    "base_link",
    "odom",
    "map",
    "\x1b]0;title\x07\x1b[31mred",
    "two\nlines\r\ttabs",
    "nul\x00nul",
    "\u202egnp.scan",  # turns what follows round on a terminal
    "\x9b31m",
    "a" * 2000,
    "/scan",
)
_TYPES = (LASER_SCAN, POINT_CLOUD, ODOMETRY, TF_MESSAGE, "std_msgs/msg/String")
_COUNTS = (0, 1, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 100_000_000)


def change_messages(rng: random.Random, messages: Sequence[Message]) -> tuple[list[Message], str]:
    """The messages with one of them changed, or with a field changed in all of a topic."""
    place = _place(rng, messages)
    message, kind = messages[place], rng.random()
    if kind < 0.1:
        other = message._replace(type=rng.choice(_TYPES))
        return replaced(messages, place, other), f"message {place} is a {other.type}"
    if kind < 0.2:
        other = message._replace(topic=rng.choice(_NAMES))
        return replaced(messages, place, other), f"message {place} is on {other.topic[:20]!r}"
    if kind < 0.3:
        data, note = _with_count(rng, message.data)
        return replaced(messages, place, message._replace(data=data)), f"message {place}: {note}"
    if kind < 0.38:
        time = rng.choice([0, 1, 2**62, 2**63 - 1, max(message.time_ns - 10**13, 0)])
        other = message._replace(time_ns=time)
        return replaced(messages, place, other), f"message {place} recorded at {time}"
    if kind < 0.5:
        return _changed_alike(rng, messages, message.topic)
    changed, note = _with_field(rng, message)
    return replaced(messages, place, changed), f"message {place}: {note}"


def _place(rng: random.Random, messages: Sequence[Message]) -> int:
    """Any message, or the first, the mounting of the laser."""
    return 0 if rng.random() < 0.15 else rng.randrange(len(messages))


def _changed_alike(
    rng: random.Random, messages: Sequence[Message], topic: str
) -> tuple[list[Message], str]:
    """The same change in every message of a topic, as a wrong setting of a driver makes it."""
    seed, note, found = rng.random(), "", []
    for message in messages:
        if message.topic == topic:
            changed, note = _with_field(random.Random(seed), message)
            found.append(changed)
        else:
            found.append(message)
    return found, f"all on {topic}: {note}"


def _with_count(rng: random.Random, data: bytes) -> tuple[bytes, str]:
    """Four bytes of the serialised message, where a count may stand, with another number."""
    place = 4 * rng.randrange(1, max(min(len(data) // 4, 30), 2))
    count = rng.choice(_COUNTS)
    return data[:place] + struct.pack("<I", count) + data[place + 4 :], f"{count} at byte {place}"


def _with_field(rng: random.Random, message: Message) -> tuple[Message, str]:
    """One field, however deep, with another value; as it is where that cannot be serialised."""
    try:
        record = copy.deepcopy(typestore().deserialize_cdr(message.data, message.type))
    except (SerdeError, KeyError):
        return message, "no such type"
    note = _change_field(rng, record)
    try:
        data = bytes(typestore().serialize_cdr(record, message.type))
    except (SerdeError, struct.error, OverflowError, ValueError, TypeError, AttributeError):
        return _refilled(message, rng)
    return message._replace(data=data), note


def _refilled(message: Message, rng: random.Random) -> tuple[Message, str]:
    data, note = _with_count(rng, message.data)
    return message._replace(data=data), note


def _change_field(rng: random.Random, record: Any) -> str:
    """Change a field of a record in place; says which."""
    names = [field.name for field in fields(record) if not field.name.startswith("__")]
    name = rng.choice(names)
    value = getattr(record, name)
    if is_dataclass(value):
        return f"{name}.{_change_field(rng, value)}"
    if isinstance(value, list) and value and is_dataclass(value[0]) and rng.random() < 0.7:
        place = rng.randrange(len(value))
        return f"{name}[{place}].{_change_field(rng, value[place])}"
    new = _other(rng, value)
    object.__setattr__(record, name, new)
    shown = f"{len(new)} values" if isinstance(new, (list, np.ndarray)) else repr(new)[:40]
    return f"{name} = {shown}"


def _other(rng: random.Random, value: Any) -> Any:
    """A value of the same kind that no honest message has."""
    if isinstance(value, bool):
        return not value
    if isinstance(value, float):
        return rng.choice(_FLOATS)
    if isinstance(value, int):
        return rng.choice(_INTEGERS)
    if isinstance(value, str):
        return rng.choice(_NAMES)
    if isinstance(value, np.ndarray):
        return _other_array(rng, value)
    return rng.choice([[], value * 2, value[:1], value[::-1]])


def _other_array(rng: random.Random, value: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    if rng.random() < 0.4 or not value.size:
        shape = rng.choice(["empty", "half", "double", "one"])
        shapes = {"empty": value[:0], "half": value[: len(value) // 2], "one": value[:1]}
        return np.concatenate([value, value]) if shape == "double" else shapes[shape]
    other = value.copy()
    count = rng.choice([1, len(other)])
    places = rng.sample(range(len(other)), count)
    with np.errstate(all="ignore"):
        if other.dtype.kind == "f":
            other[places] = np.array(rng.choice(_FLOATS)).astype(other.dtype)
        else:
            other[places] = rng.randrange(256)
    return other
