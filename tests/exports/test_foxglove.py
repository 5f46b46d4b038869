"""The MCAP for Foxglove, decoded by mcap and protobuf with the schemas that it carries itself.

These are compared with those of Foxglove's SDK.
"""

import math
import weakref
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader

from specmap_cli.core.geometry import Pose2
from specmap_cli.core.records import PlanarScan
from specmap_cli.exports.foxglove import description
from specmap_cli.exports.table import export_map
from specmap_cli.grids.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.maps.store import Map
from tests.exports.conftest import BEARINGS
from tests.exports.consumers import consumer

OVER_TIME = ("/tf", "/pose", "/scan")
SCHEMAS = ("Grid", "SceneUpdate", "PoseInFrame", "PosesInFrame", "FrameTransform", "LaserScan")

Found = dict[str, list[tuple[int, Any]]]


def messages(stored: Map, out: Path) -> Found:
    """The decoded messages of each topic, in the order of their log times."""
    support = consumer("mcap_protobuf.decoder")
    export_map(stored, "foxglove", out)
    found = defaultdict(list)
    with out.open("rb") as file:
        reader = make_reader(file, decoder_factories=[support.DecoderFactory()])
        for schema, channel, message, decoded in reader.iter_decoded_messages():
            assert schema is not None
            assert (schema.encoding, channel.message_encoding) == ("protobuf", "protobuf")
            assert schema.name == f"foxglove.{type(decoded).__name__}"
            found[channel.topic].append((message.log_time, decoded))
    return found


@pytest.fixture
def found(home: Map, tmp_path: Path) -> Found:
    """What the house gives."""
    return messages(home, tmp_path / "home.mcap")


def pose_of(message: Any) -> Pose2:
    turn = message.orientation
    return Pose2(message.position.x, message.position.y, 2.0 * math.atan2(turn.z, turn.w))


def points(line: Any) -> list[tuple[float, float]]:
    return [(point.x, point.y) for point in line.points]


def test_grids_have_the_cells_and_the_colours_of_the_map(home: Map, found: Found) -> None:
    whole, owner = home.map_grid, home.regions.owner
    layers = {}
    for topic in ("/map", "/regions"):
        ((_, grid),) = found[topic]
        assert [field.name for field in grid.fields] == ["red", "green", "blue", "alpha"]
        assert grid.cell_size.x == whole.resolution
        assert pose_of(grid.pose) == pytest.approx((*whole.origin, 0.0))
        layers[topic] = np.frombuffer(grid.data, dtype=np.uint8).reshape(-1, grid.column_count, 4)
        assert layers[topic].shape[:2] == whole.cells.shape
    assert (layers["/map"][whole.cells == FREE] == 255).all()
    assert (layers["/map"][whole.cells == OCCUPIED][:, :3] < 60).all()
    assert (layers["/map"][whole.cells == UNKNOWN] == 0).all()
    fills = [np.unique(layers["/regions"][owner == id_], axis=0) for id_ in home.ids]
    assert all(len(fill) == 1 for fill in fills)
    assert len({tuple(fill[0]) for fill in fills}) == len(home.ids)
    assert (layers["/regions"][owner < 0] == 0).all()


def test_submaps_and_graph_are_the_map_s(home: Map, found: Found) -> None:
    ((_, submaps),), ((_, graph),) = found["/submaps"], found["/graph"]
    record = home.record
    for entity, node in zip(submaps.entities, record.nodes, strict=True):
        assert points(entity.lines[0]) == list(node.polygon)
        assert entity.texts[0].text == node.name
        assert (entity.texts[0].pose.position.x, entity.texts[0].pose.position.y) == node.anchor
        facts = {pair.key: pair.value for pair in entity.metadata}
        assert len(facts) == len(entity.metadata)
        assert facts["kind"] == node.kind
        assert float(facts["area_m2"]) == node.area_m2
    assert facts.keys().isdisjoint({"property.owner"})
    entities = {entity.id: entity for entity in graph.entities}
    assert len(entities) == len(graph.entities)
    assert len([id_ for id_ in entities if id_.startswith("anchor")]) == 3
    assert len([id_ for id_ in entities if id_.startswith("door")]) == len(record.graph.doors)
    for edge in record.edges:
        (line,) = entities[f"link {edge.source}-{edge.target}"].lines
        assert not edge.corners or points(line) == edge.corners
    (door,) = entities["door 0"].lines
    assert math.dist(*points(door)) == pytest.approx(0.9)


def test_every_keyframe_has_its_pose_and_its_scan(home: Map, found: Found) -> None:
    labels = home.labels
    for topic in OVER_TIME:
        stamps = [message.timestamp.ToNanoseconds() for _, message in found[topic]]
        assert stamps == list(labels.stamps_ns)
        times = [time_ns for time_ns, _ in found[topic]]
        assert times == sorted(set(times))
    poses = np.array([pose_of(message.pose) for _, message in found["/pose"]])
    assert np.allclose(poses[:, :2], labels.poses[:, :2], atol=1e-6)
    assert np.allclose(np.exp(1j * poses[:, 2]), np.exp(1j * labels.poses[:, 2]), atol=1e-6)
    for (_, transform), (_, pose) in zip(found["/tf"], found["/pose"], strict=True):
        assert pose.frame_id == "map"
        assert (transform.parent_frame_id, transform.child_frame_id) == ("map", "base_link")
        assert str(transform.rotation) == str(pose.pose.orientation)
    _, scan = found["/scan"][4]
    assert scan.frame_id == "base_link"
    assert pose_of(scan.pose) == pytest.approx((0.2, 0.0, 0.0))
    bearings = np.linspace(scan.start_angle, scan.end_angle, len(scan.ranges))
    assert np.allclose(bearings, BEARINGS, atol=1e-5)
    assert math.isnan(scan.ranges[0])
    assert math.isinf(scan.ranges[1])
    assert scan.ranges[-1] == pytest.approx(2.04, abs=1e-3)
    ((_, path),) = found["/trajectory"]
    way = np.array([pose_of(pose)[:2] for pose in path.poses])
    assert np.allclose(way, labels.poses[:, :2], atol=1e-5)


def test_a_plan_is_whole_with_nothing_over_time(rooms: Map, flat: GridMap, tmp_path: Path) -> None:
    found = messages(rooms, tmp_path / "rooms.mcap")
    assert not {*OVER_TIME, "/trajectory"} & found.keys()
    for topic, cells in (("/map", flat.cells >= 0), ("/regions", flat.free)):
        ((_, grid),) = found[topic]
        shown = np.frombuffer(grid.data, dtype=np.uint8).reshape(*flat.cells.shape, 4)[..., 3] > 0
        assert np.array_equal(shown, cells)


def test_scans_are_read_singly(home: Map, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    taken: list[weakref.ref[np.ndarray]] = []
    alive: list[int] = []
    read = KeyframeStore.scan

    def counted(store: KeyframeStore, number: int) -> PlanarScan:
        scan = read(store, number)
        taken.append(weakref.ref(scan.ranges))
        alive.append(sum(ref() is not None for ref in taken))
        return scan

    monkeypatch.setattr(KeyframeStore, "scan", counted)
    export_map(home, "foxglove", tmp_path / "home.mcap")
    assert len(taken) == 30
    assert max(alive) <= 2


def files(data: bytes) -> dict[str, Any]:
    """The files of a description by name, without their names in JSON and the order of imports."""
    descriptors = consumer("google.protobuf.descriptor_pb2")
    found = {}
    for file in descriptors.FileDescriptorSet.FromString(data).file:
        for field in file.message_type[0].field:
            field.ClearField("json_name")
        types = [str(message) for message in file.message_type]
        found[file.name] = (file.package, sorted(file.dependency), file.syntax, types)
    return found


@pytest.mark.parametrize("name", SCHEMAS)
def test_the_schema_is_that_of_the_sdk(name: str) -> None:
    sdk = getattr(consumer("foxglove.messages"), name).get_schema()
    assert (sdk.name, sdk.encoding) == (f"foxglove.{name}", "protobuf")
    assert files(description(name)) == files(sdk.data)
