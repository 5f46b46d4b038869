"""The protobuf of Foxglove's schemas against Foxglove's SDK: Google's library encodes by them."""

from __future__ import annotations

from typing import Any

import pytest

from specmap_cli.exports.foxglove import description
from tests.exports.consumers import consumer

TOPICS = ("Grid", "SceneUpdate", "PoseInFrame", "PosesInFrame", "FrameTransform", "LaserScan")


def files(data: bytes) -> dict[str, Any]:
    """The files of a description by name, without their names in JSON and the order of imports."""
    descriptors = consumer("google.protobuf.descriptor_pb2")
    found = {}
    for file in descriptors.FileDescriptorSet.FromString(data).file:
        for field in file.message_type[0].field:
            field.ClearField("json_name")
        found[file.name] = (
            file.package,
            sorted(file.dependency),
            file.syntax,
            [str(message) for message in file.message_type],
        )
    return found


@pytest.mark.parametrize("name", TOPICS)
def test_the_schema_is_that_of_the_sdk(name: str) -> None:
    messages = consumer("foxglove.messages")
    sdk = getattr(messages, name).get_schema()
    assert (sdk.name, sdk.encoding) == (f"foxglove.{name}", "protobuf")
    assert files(description(name)) == files(sdk.data)
