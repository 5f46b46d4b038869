"""Mutations of the records of MCAP files and ROS 1 bags, in chunks and outside them."""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TypeVar

from fuzz import bag_records, mcap_records
from fuzz.bag_records import BagRecord
from fuzz.changes import Change, replaced, spot
from fuzz.mcap_records import McapRecord

Record = TypeVar("Record", BagRecord, McapRecord)

# What a length says instead of the truth; 1 << 40 is more than any file, the rest overflows.
_LENGTHS = (0, 1, 7, 0xFFFF, 0x7FFFFFFF, 0xFFFFFFFF, 1 << 40, (1 << 63) - 1, (1 << 64) - 1)
_OFF_BY = (-16, -8, -1, 1, 8, 16)
_OPCODES = (0, *range(1, 0x10), 0x10, 0x7F, 0x80, 0x85, 0xFF)


def change_records(rng: random.Random, data: bytes, family: str) -> Change:
    """A record dropped, repeated, swapped, or with another kind, length or header."""
    return _change_mcap(rng, data) if family == "mcap" else _change_bag(rng, data)


def _change_mcap(rng: random.Random, data: bytes) -> Change:
    magic = mcap_records.MAGIC
    records = mcap_records.split(data[len(magic) : -len(magic)])
    chunks = [i for i, record in enumerate(records) if record.opcode == mcap_records.CHUNK]
    if not chunks or rng.random() < 0.4:
        found, note, clean = _change_one(rng, records, _change_mcap_header)
    else:
        place = rng.choice(chunks)
        chunk = mcap_records.opened(records[place].body)
        inner, note, clean = _change_one(
            rng, mcap_records.split(chunk.records), _change_mcap_header
        )
        policy = rng.choice(["stale", "none", "right"])
        changed = mcap_records.with_crc(chunk, mcap_records.join(inner), policy)
        size = rng.choice([None, None, None, len(chunk.records), 0, 1 << 62])
        record = replace(records[place], body=changed.body(size))
        found = replaced(records, place, record)
        note = f"chunk {chunks.index(place)}: {note}; checksum {policy}"
    return Change(magic + mcap_records.join(found) + magic, note, clean)


def _change_mcap_header(rng: random.Random, record: McapRecord) -> tuple[McapRecord, str]:
    if rng.random() < 0.4:
        opcode = rng.choice(_OPCODES)
        return replace(record, opcode=opcode), f"kind {record.opcode} -> {opcode}"
    if rng.random() < 0.5:
        stated = _length(rng, len(record.body))
        return replace(record, stated=stated), f"length told as {stated}"
    place = min(rng.randrange(24), max(len(record.body) - 1, 0))
    body = _bit_flipped(rng, record.body, place)
    return replace(record, body=body), f"byte {place} of its body"


def _change_bag(rng: random.Random, data: bytes) -> Change:
    first = bag_records.FIRST_LINE
    records = bag_records.split(data[len(first) :])
    plain = [i for i, record in enumerate(records) if b"compression=none" in record.header]
    if not plain or rng.random() < 0.4:
        found, note, clean = _change_one(rng, records, _change_bag_header)
    else:
        place = rng.choice(plain)
        inner, note, clean = _change_one(
            rng, bag_records.split(records[place].data), _change_bag_header
        )
        record = replace(records[place], data=bag_records.join(inner))
        found = replaced(records, place, record)
        note = f"chunk {plain.index(place)}: {note}"
    return Change(first + bag_records.join(found), note, clean)


def _change_bag_header(rng: random.Random, record: BagRecord) -> tuple[BagRecord, str]:
    if rng.random() < 0.3:
        stated = _length(rng, len(record.data))
        return replace(record, stated=stated), f"length told as {stated}"
    if rng.random() < 0.3 and b"op=" in record.header:
        place, opcode = record.header.index(b"op=") + 3, rng.choice(_OPCODES)
        header = record.header[:place] + bytes([opcode]) + record.header[place + 1 :]
        return replace(record, header=header), f"kind {record.opcode} -> {opcode}"
    place = spot(rng, len(record.header))
    header = _bit_flipped(rng, record.header, place)
    return replace(record, header=header), f"byte {place} of its header"


def _bit_flipped(rng: random.Random, data: bytes, place: int) -> bytes:
    if not data:
        return b"\x01"
    return data[:place] + bytes([data[place] ^ (1 << rng.randrange(8))]) + data[place + 1 :]


def _length(rng: random.Random, true: int) -> int:
    return rng.choice([*_LENGTHS, *(max(true + off, 0) for off in _OFF_BY)])


def _change_one(
    rng: random.Random,
    records: Sequence[Record],
    change_header: Callable[[random.Random, Record], tuple[Record, str]],
) -> tuple[list[Record], str, bool]:
    """The records with one changed, what was done, and whether that took it out cleanly."""
    if not records:
        return [], "an empty list of records", False
    place = rng.randrange(len(records))
    record, kind = records[place], rng.random()
    if kind < 0.15:
        return replaced(records, place), f"record {place} taken out", True
    if kind < 0.3:
        times = rng.choice([2, 2, 3, 40])
        return replaced(records, place, *[record] * times), f"record {place} {times} times", False
    if kind < 0.45:
        other = rng.randrange(len(records))
        swapped = list(records)
        swapped[place], swapped[other] = records[other], record
        return swapped, f"records {place} and {other} swapped", False
    changed, note = change_header(rng, record)
    return replaced(records, place, changed), f"record {place}: {note}", "kind" in note
