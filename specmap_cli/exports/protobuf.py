"""Protobuf messages from a table of their fields, and their description for who reads them.

A schema is a table of messages by full name: a line of text each, `name:kind` for the fields 1, 2,
3 and so on. A kind is a scalar, the name of a message, or `enum/NAME`; `*` before it is for a list.
So no file needs to be compiled: Google's library builds the messages from their description.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from google.protobuf.descriptor_pb2 import (
    DescriptorProto,
    EnumDescriptorProto,
    EnumValueDescriptorProto,
    FieldDescriptorProto,
    FileDescriptorProto,
    FileDescriptorSet,
)
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass


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
        self._pool = DescriptorPool()
        for name in self._fields:
            for file in self._files(name):
                self._pool.AddSerializedFile(file.SerializeToString())

    def encode(self, message: str, value: Mapping[str, Any]) -> bytes:
        """A message; what `value` lacks has its default. ValueError for a field that is none."""
        kind = GetMessageClass(self._pool.FindMessageTypeByName(message))
        return bytes(kind(**value).SerializeToString())

    def description(self, message: str) -> bytes:
        """The FileDescriptorSet of a message and of all that it is made of, a file each."""
        return bytes(FileDescriptorSet(file=self._files(message)).SerializeToString())

    def _files(self, message: str) -> list[FileDescriptorProto]:
        """A file for each message that one is made of, after those that it needs."""
        return [self._file(name) for name in self._needed(message)]

    def _needed(self, message: str) -> list[str]:
        found: list[str] = []
        for name in self._parts(message):
            found += [each for each in self._needed(name) if each not in found]
        return [*found, message]

    def _parts(self, message: str) -> list[str]:
        kinds = {field.kind for field in self._fields[message]}
        return sorted(kinds & self._fields.keys())

    def _file(self, message: str) -> FileDescriptorProto:
        package, _, name = message.rpartition(".")
        described = DescriptorProto(
            name=name,
            field=[self._described(message, field) for field in self._fields[message]],
            enum_type=list(self._enums_of(message)),
        )
        return FileDescriptorProto(
            name=_file_name(message),
            package=package,
            dependency=[_file_name(part) for part in self._parts(message)],
            message_type=[described],
            syntax="proto3",
        )

    def _described(self, message: str, field: Field) -> FieldDescriptorProto:
        proto = FieldDescriptorProto
        found = proto(
            name=field.name,
            number=field.number,
            label=proto.LABEL_REPEATED if field.repeated else proto.LABEL_OPTIONAL,
        )
        if field.enum:
            found.type, found.type_name = proto.TYPE_ENUM, f".{message}.{field.enum}"
        elif field.kind in self._fields:
            found.type, found.type_name = proto.TYPE_MESSAGE, f".{field.kind}"
        else:
            found.type = proto.Type.Value(f"TYPE_{field.kind.upper()}")
        return found

    def _enums_of(self, message: str) -> Iterator[EnumDescriptorProto]:
        for field in self._fields[message]:
            if field.enum:
                names = self._enums[f"{message}.{field.enum}"]
                values = [EnumValueDescriptorProto(name=n, number=k) for k, n in enumerate(names)]
                yield EnumDescriptorProto(name=field.enum, value=values)


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
