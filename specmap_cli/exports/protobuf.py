"""Messages in the encoding of Protocol Buffers, and their description for who reads them.

A schema is a table of messages by full name: a line of text each, `name:kind` for the fields 1, 2,
3 and so on. A kind is a scalar, the name of a message, or `enum/NAME`; `*` before it is for a list.
That is all of the encoding that Foxglove's schemas need; a library for the whole of it would be a
dependency larger than this program.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from specmap_cli.core.text import encodable

# How values are laid out, and the numbers by which descriptions call labels and kinds.
_VARINT, _EIGHT_BYTES, _COUNTED, _FOUR_BYTES = 0, 1, 2, 5
_OPTIONAL, _REPEATED, _MESSAGE, _ENUM = 1, 3, 11, 14
_TYPES = {"double": 1, "int64": 3, "int32": 5, "fixed32": 7, "bool": 8, "string": 9, "bytes": 12}
_64_BITS = 0xFFFFFFFFFFFFFFFF

# The messages that describe messages, in their own terms; what is not needed is `bytes`.
_DESCRIPTOR = {
    "FileDescriptorSet": "file:*FileDescriptorProto",
    "FileDescriptorProto": "name:string package:string dependency:*string "
    "message_type:*DescriptorProto enum_type:bytes service:bytes extension:bytes options:bytes "
    "source_code_info:bytes public_dependency:bytes weak_dependency:bytes syntax:string",
    "DescriptorProto": "name:string field:*FieldDescriptorProto nested_type:bytes "
    "enum_type:*EnumDescriptorProto",
    "FieldDescriptorProto": "name:string extendee:bytes number:int32 label:int32 type:int32 "
    "type_name:string",
    "EnumDescriptorProto": "name:string value:*EnumValueDescriptorProto",
    "EnumValueDescriptorProto": "name:string number:int32",
}


@dataclass(frozen=True, slots=True)
class Field:
    """One field of a message: `kind` is a scalar, `enum`, or the full name of a message."""

    number: int
    name: str
    kind: str
    repeated: bool
    enum: str = ""


class Schema:
    """Messages by full name, and the values of their enumerations by `MESSAGE.NAME`."""

    def __init__(
        self, messages: Mapping[str, str], enums: Mapping[str, Sequence[str]] | None = None
    ) -> None:
        self._fields = {name: list(_fields(line)) for name, line in messages.items()}
        self._enums = {} if enums is None else enums

    def encode(self, message: str, value: Mapping[str, Any]) -> bytes:
        """A message; what `value` lacks has its default. Raises KeyError for an unknown name."""
        known = {field.name: field for field in self._fields[message]}
        return b"".join(self._field(known[name], inner) for name, inner in value.items())

    def _field(self, field: Field, value: Any) -> bytes:
        if not field.repeated:
            return self._one(field, value)
        if field.kind == "double":  # numbers of one size stand side by side
            return _counted(field.number, np.asarray(value, dtype="<f8").tobytes())
        if field.kind == "fixed32":
            return _counted(field.number, np.asarray(value, dtype="<u4").tobytes())
        return b"".join(self._one(field, item) for item in value)

    def _one(self, field: Field, value: Any) -> bytes:
        if field.kind in self._fields:
            return _counted(field.number, self.encode(field.kind, value))
        return _SCALARS[field.kind](field.number, value)

    def description(self, message: str) -> bytes:
        """The FileDescriptorSet of a message and of all that it is made of, a file each."""
        files = [self._file(name) for name in self._needed(message)]
        return _DESCRIPTIONS.encode("FileDescriptorSet", {"file": files})

    def _needed(self, message: str) -> list[str]:
        """The messages that one is made of, each after those that it needs."""
        found: list[str] = []
        for name in self._parts(message):
            found += [each for each in self._needed(name) if each not in found]
        return [*found, message]

    def _parts(self, message: str) -> list[str]:
        kinds = {field.kind for field in self._fields[message]}
        return sorted(kinds & self._fields.keys())

    def _file(self, message: str) -> dict[str, Any]:
        package, _, name = message.rpartition(".")
        return {
            "name": _file_name(message),
            "package": package,
            "dependency": [_file_name(part) for part in self._parts(message)],
            "message_type": [
                {
                    "name": name,
                    "field": [self._described(message, field) for field in self._fields[message]],
                    "enum_type": list(self._enums_of(message)),
                }
            ],
            "syntax": "proto3",
        }

    def _described(self, message: str, field: Field) -> dict[str, Any]:
        found: dict[str, Any] = {
            "name": field.name,
            "number": field.number,
            "label": _REPEATED if field.repeated else _OPTIONAL,
        }
        if field.kind in _TYPES:
            return {**found, "type": _TYPES[field.kind]}
        if field.enum:
            return {**found, "type": _ENUM, "type_name": f".{message}.{field.enum}"}
        return {**found, "type": _MESSAGE, "type_name": f".{field.kind}"}

    def _enums_of(self, message: str) -> Iterator[dict[str, Any]]:
        for field in self._fields[message]:
            if field.enum:
                names = self._enums[f"{message}.{field.enum}"]
                values = [{"name": name, "number": k} for k, name in enumerate(names)]
                yield {"name": field.enum, "value": values}


def _fields(line: str) -> Iterator[Field]:
    for number, word in enumerate(line.split(), start=1):
        name, kind = word.split(":")
        kind, _, enum = kind.removeprefix("*").partition("/")
        yield Field(number, name, kind, word.split(":")[1].startswith("*"), enum)


def _file_name(message: str) -> str:
    package, _, name = message.rpartition(".")
    # those of Google's own messages are written small
    plain = name.lower() if package == "google.protobuf" else name
    return f"{package.replace('.', '/')}/{plain}.proto"


def _varint(value: int) -> bytes:
    """Seven bits a byte, the lowest first; negative numbers as in 64 bits."""
    rest, found = value & _64_BITS, bytearray()
    while rest > 0x7F:
        found.append(rest & 0x7F | 0x80)
        rest >>= 7
    return bytes([*found, rest])


def _key(number: int, layout: int) -> bytes:
    return _varint(number << 3 | layout)


def _counted(number: int, data: bytes) -> bytes:
    return _key(number, _COUNTED) + _varint(len(data)) + data


def _whole(number: int, value: int) -> bytes:
    return _key(number, _VARINT) + _varint(int(value))


def _text(number: int, value: str) -> bytes:
    return _counted(number, encodable(value).encode("utf-8"))


def _double(number: int, value: float) -> bytes:
    return _key(number, _EIGHT_BYTES) + struct.pack("<d", value)


def _fixed32(number: int, value: int) -> bytes:
    return _key(number, _FOUR_BYTES) + struct.pack("<I", value)


_SCALARS: Mapping[str, Callable[[int, Any], bytes]] = {
    **dict.fromkeys(("int32", "int64", "bool", "enum"), _whole),
    "string": _text,
    "bytes": _counted,
    "double": _double,
    "fixed32": _fixed32,
}
_DESCRIPTIONS = Schema(_DESCRIPTOR)
