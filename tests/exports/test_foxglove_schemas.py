"""The protobuf of Foxglove's schemas against Foxglove's SDK and Google's library."""

from __future__ import annotations

import math
from typing import Any

import pytest

from specmap_cli.exports.foxglove_schemas import description, encode
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


def test_a_message_is_what_the_sdk_encodes() -> None:
    """Byte by byte: scalars, lists, messages within messages, text."""
    messages = consumer("foxglove.messages")
    place, turn = {"x": 1.5, "y": -2.0, "z": 0.25}, dict.fromkeys("xyzw", 0.5)
    pose = messages.Pose(
        position=messages.Vector3(**place), orientation=messages.Quaternion(**turn)
    )
    scan = {"start_angle": -1.5, "end_angle": 1.5, "ranges": [1.0, math.inf, 2.5]}
    stamp = messages.Timestamp(sec=1700000000, nsec=123456789)
    theirs = messages.LaserScan(timestamp=stamp, frame_id="base_link", pose=pose, **scan)
    ours = {
        "timestamp": {"seconds": 1700000000, "nanos": 123456789},
        "frame_id": "base_link",
        "pose": {"position": place, "orientation": turn},
        **scan,
    }
    assert encode("LaserScan", ours) == theirs.encode()


def test_a_scene_is_what_the_sdk_encodes() -> None:
    messages = consumer("foxglove.messages")
    point, colour = {"x": 1.0, "y": 2.0, "z": 3.0}, {"r": 1.0, "g": 0.5, "b": 0.25, "a": 1.0}
    drawn = {"thickness": 2.0, "scale_invariant": True, "indices": [1, 70000]}
    said = {"key": "width", "value": "0.9 m"}
    line = messages.LinePrimitive(
        type=messages.LinePrimitiveLineType.LineLoop,
        points=[messages.Point3(**point)],
        color=messages.Color(**colour),
        **drawn,
    )
    called = {"frame_id": "map", "id": "door 3"}
    entity = messages.SceneEntity(metadata=[messages.KeyValuePair(**said)], lines=[line], **called)
    lines = [{"type": 1, "points": [point], "color": colour, **drawn}]
    ours = {"metadata": [said], "lines": lines, **called}
    scene = messages.SceneUpdate(entities=[entity])
    assert encode("SceneUpdate", {"entities": [ours]}) == scene.encode()


def test_a_field_that_is_none_of_a_message_is_refused() -> None:
    with pytest.raises(ValueError, match="colour"):
        encode("Color", {"colour": 1.0})
