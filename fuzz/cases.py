"""A case by its number: which input, and how it is damaged. Same seed and number, same case."""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from fuzz.byte_changes import change_bytes
from fuzz.changes import Change
from fuzz.compression_changes import FORMATS, change_compressed, packed
from fuzz.containers import Variant
from fuzz.drives import SCAN_TOPIC, Drive
from fuzz.map_changes import Files, bound, change_map, without_digests
from fuzz.message_changes import change_messages
from fuzz.record_changes import change_records
from fuzz.row_changes import change_rows
from fuzz.seeds import Seeds
from fuzz.token_changes import change_tokens
from specmap_cli.logs.readers.encoding import SCAN_TYPES
from specmap_cli.logs.readers.recording import Message

MAP_EVERY, BUILD_EVERY, CONVERT_EVERY = 20, 20, 20  # every so many cases
KEEPERS = ("compare", "update", "merge", "edit", "like")  # what maps that are kept go through
_NEEDLE_BYTES = 24  # from the middle of a scan: where they are left, so is most of the scan


@dataclass(frozen=True, slots=True, kw_only=True)
class LogCase:
    """A damaged recording.

    `stamps_ns` are of the scans in the intact one. `excused` are scans that may be missing without
    a word, as the damaged file holds no trace of them. `must_tell` is set where something foreign
    was added.
    """

    number: int
    name: str
    notes: tuple[str, ...]
    data: bytes
    stamps_ns: tuple[int, ...]
    excused: int
    must_tell: bool
    build: bool
    convert: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class MapCase:
    """A damaged map directory; `deeds` are done to its files once they are written.

    `keeper` is the command that it is given to of those that make another map of it. `foreign`
    tells that a file is whole, but of another map.
    """

    number: int
    name: str
    notes: tuple[str, ...]
    files: Files
    deeds: tuple[str, ...]
    plot: bool
    keeper: str = KEEPERS[0]
    foreign: bool = False


Case = LogCase | MapCase


def case_of(seeds: Seeds, seed: int, number: int) -> Case:
    """The case of this number."""
    rng = random.Random(f"{seed}/{number}")
    if seeds.map_files and number % MAP_EVERY == 1:
        return _map_case(seeds, rng, number)
    return _log_case(seeds, rng, number)


def _map_case(seeds: Seeds, rng: random.Random, number: int) -> MapCase:
    intact: Files = dict(seeds.map_files)
    foreign = rng.random() < 0.1
    if not foreign and rng.random() < 0.5:
        intact = without_digests(intact)
    files = dict(intact)
    deeds: list[str] = []
    notes: list[str] = []
    if foreign:
        name = rng.choice(sorted(bound(intact, seeds.other_files)))
        files[name] = seeds.other_files[name]
        notes.append(f"{name} of another map")
    for _ in range(0 if foreign else rng.choice([1, 1, 1, 2])):
        files, done, note = change_map(rng, files, intact)
        deeds += [deed for deed in done if not deeds]  # one is enough: the file may be gone
        notes.append(note)
    return MapCase(
        number=number,
        name="map",
        notes=tuple(notes),
        files=files,
        deeds=tuple(deeds),
        plot=rng.random() < 0.3,
        keeper=KEEPERS[number // MAP_EVERY % len(KEEPERS)],
        foreign=foreign,
    )


def _log_case(seeds: Seeds, rng: random.Random, number: int) -> LogCase:
    variant = seeds.variants[rng.choice(sorted(seeds.variants))]
    drive = seeds.drives[rng.choice(variant.drives)]
    data, notes = seeds.files[variant.name, drive.name], []
    messages: Sequence[Message] = drive.messages
    plan = rng.choices(["messages", "file", "both", "compression"], [30, 50, 10, 10])[0]
    if plan in ("messages", "both"):
        for _ in range(rng.choice([1, 1, 2])):
            messages, note = change_messages(rng, messages)
            notes.append(note)
        data = variant.encode(messages)
    changes = _file_changes(rng, data, variant) if plan in ("file", "both") else []
    data = changes[-1].data if changes else data
    excused = _excused(drive, messages, variant, changes, data)
    if plan == "compression":
        changes.append(change_compressed(rng, data, rng.choice(FORMATS)))
        data = changes[-1].data
    elif rng.random() < 0.05:
        data = packed(data, rng.choice(FORMATS))
        notes.append("compressed")
    return LogCase(
        number=number,
        name=f"{variant.name} {drive.name}",
        notes=(*notes, *(change.note for change in changes)),
        data=data,
        stamps_ns=drive.stamps_ns,
        excused=excused,
        must_tell=any(change.foreign for change in changes),
        build=number % BUILD_EVERY == 0,
        convert=number % CONVERT_EVERY == CONVERT_EVERY // 2,
    )


def _file_changes(rng: random.Random, data: bytes, variant: Variant) -> list[Change]:
    """One to three changes of a file, the first of them in the terms of its format, perhaps."""
    changes: list[Change] = []
    for turn in range(rng.choice([1, 1, 1, 2, 3])):
        last = changes[-1].data if changes else data
        in_terms = turn == 0 and rng.random() < 0.6
        changes.append(_in_terms(rng, last, variant) if in_terms else change_bytes(rng, last))
    return changes


def _in_terms(rng: random.Random, data: bytes, variant: Variant) -> Change:
    if variant.family == "db3":
        return change_rows(rng, data)
    if variant.family == "carmen":
        return change_tokens(rng, data)
    return change_records(rng, data, variant.family)


def _excused(
    drive: Drive,
    messages: Sequence[Message],
    variant: Variant,
    changes: Sequence[Change],
    data: bytes,
) -> int:
    """How many scans may be missing without a word.

    A clean cut is only seen where the file counts its messages, and where nothing else was done to
    what counts them. Where nothing is counted, a scan whose middle is in the file no more is gone.
    """
    clean = any(change.clean for change in changes)
    if clean and (not variant.counts or len(changes) > 1):
        return len(drive.stamps_ns)
    if variant.counts:
        return sum(map(_is_another, drive.messages, messages))
    before = Counter(_needles(variant, variant.encode(messages), messages))
    unwritten = max(len(drive.stamps_ns) - before.total(), 0)  # in this format
    return unwritten + sum(count for needle, count in before.items() if needle not in data)


def _is_another(before: Message, after: Message) -> bool:
    """Whether a scan was recorded on another topic as something that is no scan."""
    return before.topic == SCAN_TOPIC != after.topic and after.type not in SCAN_TYPES


def _needles(variant: Variant, data: bytes, messages: Sequence[Message]) -> list[bytes]:
    """A piece from the middle of every scan, as it stands in the intact file `data`."""
    if variant.family == "carmen":
        scans = [line for line in data.split(b"\n") if b"LASER" in line[:12]]
    else:
        scans = [message.data for message in messages if message.topic == SCAN_TOPIC]
    return [scan[len(scan) // 2 :][:_NEEDLE_BYTES] for scan in scans]
