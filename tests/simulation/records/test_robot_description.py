"""The robot in an MCAP file, read from the file alone by packages of others.

`mcap` reads the file and decodes its messages by the definitions in it. Its meshes are read by the
specification of glTF 2.0 alone, because `trimesh` writes them; it reads those of the model.
"""

from __future__ import annotations

import base64
import dataclasses
import io
import json
import struct
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from tests.examples import SAMPLED_ROBOTS
from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.model import Fleet, Robot
from thorvaldc.model.robot import Mimic
from thorvaldc.model.scenario import GROUPS
from thorvaldc.runtime.se2 import Twist
from thorvaldc.simulation.control_loop import Segment
from thorvaldc.simulation.records.mcap_writer import McapRecorder
from thorvaldc.simulation.records.recorder import RunHash, record_ticks
from thorvaldc.simulation.records.robot_description import LinkFrames
from thorvaldc.simulation.simulation_run import Simulation

EXAMPLES = Path(__file__).resolve().parents[3] / "examples"
NAMES = SAMPLED_ROBOTS
GLB = "data:model/gltf-binary;base64,"


@dataclass(frozen=True)
class Record:
    """The messages of an MCAP file by topic, and the metadata of its channels."""

    messages: dict[str, list[Any]]
    metadata: dict[str, dict[str, str]]

    def urdf(self, topic: str = "/robot_description") -> ElementTree.Element:
        (message,) = self.messages[topic]
        return ElementTree.fromstring(message.data)

    def frames(self, *, first: bool = False) -> dict[str, tuple[str, np.ndarray]]:
        """Returns parent and 4x4 pose of each frame at the end or the beginning of the record."""
        static = self.messages["/tf_static"][-1]
        messages = self.messages.get("/tf", [])
        moving = {
            t.child_frame_id: t for m in messages[: 1 if first else None] for t in m.transforms
        }
        frames = {}
        for stamped in (*static.transforms, *moving.values()):
            assert stamped.child_frame_id not in frames
            t, q = stamped.transform.translation, stamped.transform.rotation
            assert np.linalg.norm([q.x, q.y, q.z, q.w]) == pytest.approx(1.0, abs=1e-9)
            matrix = trimesh.transformations.quaternion_matrix((q.w, q.x, q.y, q.z))
            matrix[:3, 3] = (t.x, t.y, t.z)
            frames[stamped.child_frame_id] = (stamped.header.frame_id, matrix)
        return frames


def read(path: Path) -> Record:
    messages: dict[str, list[Any]] = {}
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        summary = reader.get_summary()
        assert summary is not None
        metadata = {channel.topic: channel.metadata for channel in summary.channels.values()}
        for _, channel, _, message in reader.iter_decoded_messages():
            messages.setdefault(channel.topic, []).append(message)
    return Record(messages, metadata)


def model_of(name: str) -> Any:
    compilation = compile_file(EXAMPLES / name)
    assert compilation.model is not None
    return compilation.model


def drive(model: Robot | Fleet, path: Path, seconds: float, groups: Any = GROUPS) -> RunHash:
    simulation = Simulation(model)
    run_hash = RunHash()
    recorder = McapRecorder(path, [*simulation.robots.items()], groups)
    plan = [Segment(0.0, Twist(0.4, 0.0, 0.3))]
    simulation.run(seconds, plan, None, record_ticks([recorder, run_hash]))
    recorder.close()
    return run_hash


def in_frame(frames: dict[str, tuple[str, np.ndarray]], frame: str, root: str) -> np.ndarray:
    pose = np.eye(4)
    while frame != root:
        frame, step = frames[frame]
        pose = step @ pose
    return pose


def origin(element: ElementTree.Element | None) -> np.ndarray:
    numbers = {} if element is None else element.attrib
    xyz, rpy = (
        [float(number) for number in numbers.get(key, "0 0 0").split()] for key in ("xyz", "rpy")
    )
    pose = trimesh.transformations.euler_matrix(*rpy)
    pose[:3, 3] = xyz
    return pose


def surface(url: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns points (n, 3), normal vectors (n, 3) and triangles (m, 3) of a binary glTF file."""
    assert url.startswith(GLB)
    data = base64.b64decode(url.removeprefix(GLB), validate=True)
    magic, version, size, length, kind = struct.unpack("<4sIII4s", data[:20])
    assert (magic, version, size, kind) == (b"glTF", 2, len(data), b"JSON")
    gltf, content = json.loads(data[20 : 20 + length]), data[28 + length :]
    assert data[24 + length : 28 + length] == b"BIN\0"
    assert [sorted(node) for node in gltf["nodes"]] == [["mesh", "name"]]  # no transform
    ((primitive,),) = (mesh["primitives"] for mesh in gltf["meshes"])

    def array(number: int) -> np.ndarray:
        accessor = gltf["accessors"][number]
        view = gltf["bufferViews"][accessor["bufferView"]]
        kind = {5125: "<u4", 5126: "<f4"}[accessor["componentType"]]
        count = accessor["count"] * {"SCALAR": 1, "VEC3": 3}[accessor["type"]]
        start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
        return np.frombuffer(content, kind, count, start).reshape(-1, 3)

    attributes = primitive["attributes"]
    return array(attributes["POSITION"]), array(attributes["NORMAL"]), array(primitive["indices"])


def mesh_vertices(mesh: ElementTree.Element) -> np.ndarray:
    """Returns the vertices of a mesh before its scale, z up."""
    points, _, _ = surface(mesh.attrib["filename"])
    return points[:, (0, 2, 1)] * (1, -1, 1)  # glTF has y up


@pytest.mark.parametrize("name", NAMES)
def test_the_record_of_an_example_draws_a_robot_that_stands_and_moves(
    name: str, tmp_path: Path
) -> None:
    robot = model_of(f"{name}/robot.yaml")
    drive(robot, tmp_path / "a.mcap", 0.6)
    record = read(tmp_path / "a.mcap")
    urdf = record.urdf()
    links = {link.attrib["name"]: link for link in urdf.iter("link")}
    first, last = record.frames(first=True), record.frames()
    # The frames are the links of the URDF, and those of the poses.
    assert set(first) == set(last) == {*links, "odom", "base_link_true"}
    joints = {joint.find("child").attrib["link"]: joint for joint in urdf.iter("joint")}
    assert {child: joint.find("parent").attrib["link"] for child, joint in joints.items()} == {
        link: last[link][0] for link in joints
    }
    assert np.linalg.norm(last["base_link"][1] - first["base_link"][1]) > 0.01
    # The wheels touch the ground, up to the treads of the meshes and the compressed tyre.
    lowest = np.inf
    for link, element in links.items():
        pose = in_frame(last, link, "map")
        for visual in element.iter("visual"):
            for mesh in visual.iter("mesh"):
                local = pose @ origin(visual.find("origin"))
                scale = [float(number) for number in mesh.get("scale", "1 1 1").split()]
                points = mesh_vertices(mesh) * scale @ local[:3, :3].T + local[:3, 3]
                lowest = min(lowest, points[:, 2].min())
    assert abs(lowest) < 0.03


def test_moving_frames_are_those_of_the_joint_readings(tmp_path: Path) -> None:
    """T(parent, child) of the URDF, turned about the axis by the position in `joint_states`."""
    drive(model_of("4wd4ws_wide/robot.yaml"), tmp_path / "a.mcap", 1.0)
    record = read(tmp_path / "a.mcap")
    states = record.messages["/joint_states"][-1]
    positions = dict(zip(states.name, states.position, strict=True))
    assert len(positions) == 8
    assert max(map(abs, positions.values())) > 0.2
    frames = record.frames()
    for joint in record.urdf().iter("joint"):
        child = joint.find("child").attrib["link"]
        expected = origin(joint.find("origin"))
        if joint.attrib["name"] in positions:
            axis = [float(number) for number in joint.find("axis").attrib["xyz"].split()]
            angle = positions[joint.attrib["name"]]
            expected = expected @ trimesh.transformations.rotation_matrix(angle, axis)
        elif joint.attrib["type"] == "prismatic":
            continue  # springs: at the position of the standing robot
        assert frames[child][1] == pytest.approx(expected, abs=1e-9), child


def test_a_coupled_joint_follows_its_leader() -> None:
    robot = model_of("4wd4ws_slim/robot.yaml")
    coupling = Mimic("fl_steering_joint", 2.0, 0.1)
    joints = tuple(
        dataclasses.replace(joint, type="continuous", mimic=coupling)
        if joint.child == "camera_body"
        else joint
        for joint in robot.joints
    )
    robot = dataclasses.replace(robot, joints=joints)
    frames = LinkFrames(robot, ["fr_steering_joint", "fl_steering_joint"])
    assert ("frame_body", "camera_body") in frames.moving
    assert ("frame_body", "camera_body") not in frames.fixed
    numbers = np.reshape(frames.moving_numbers([0.0, 0.3]), (-1, 7))
    x, y, z, i, j, k, w = numbers[frames.moving.index(("frame_body", "camera_body"))]
    joint = next(joint for joint in joints if joint.child == "camera_body")
    assert (x, y, z) == joint.pose.xyz
    expected = trimesh.transformations.quaternion_multiply(
        joint.pose.quat, trimesh.transformations.quaternion_about_axis(0.7, joint.axis)
    )
    assert (w, i, j, k) == pytest.approx(expected, abs=1e-12)


def test_meshes_are_those_of_the_model(tmp_path: Path) -> None:
    robot = model_of("4wd4ws_slim/robot.yaml")
    drive(robot, tmp_path / "a.mcap", 0.1)
    meshes = list(read(tmp_path / "a.mcap").urdf().iter("mesh"))
    assert len(meshes) == 99
    recorded = {mesh.attrib["filename"]: mesh_vertices(mesh) for mesh in meshes}
    assert len(recorded) == len(robot.meshes)
    bounds = {tuple(np.round((*p.min(axis=0), *p.max(axis=0)), 6)) for p in recorded.values()}
    expected = set()
    for mesh in robot.meshes:
        points = trimesh.load(io.BytesIO(mesh.data), file_type=mesh.name[-3:]).vertices
        expected.add(tuple(np.round((*points.min(axis=0), *points.max(axis=0)), 6)))
    assert bounds == expected


def test_normals_point_outside(tmp_path: Path) -> None:
    drive(model_of("4wd4ws_slim/robot.yaml"), tmp_path / "a.mcap", 0.1)
    for url in {m.attrib["filename"] for m in read(tmp_path / "a.mcap").urdf().iter("mesh")}:
        points, normals, triangles = surface(url)
        a, b, c = points.astype(float)[triangles].swapaxes(0, 1)
        assert np.einsum("ij,ij->", a, np.cross(b, c)) > 0.0  # six times the volume
        across = np.cross(b - a, c - a)
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        assert np.einsum("ijk,ik->ij", normals[triangles], across).min() > 0.999


def test_a_late_subscriber_gets_the_robot(tmp_path: Path) -> None:
    drive(model_of("4wd4ws_slim/robot.yaml"), tmp_path / "a.mcap", 0.1)
    metadata = read(tmp_path / "a.mcap").metadata
    for topic in ("/robot_description", "/tf_static"):
        assert "durability: transient_local" in metadata[topic]["offered_qos_profiles"]
    assert metadata["/odom"]["offered_qos_profiles"] == "[]"


@pytest.mark.parametrize("groups", [("truth",), ("joints",), ("twist",), ("odometry", "truth")])
def test_the_robot_is_whole_in_records_of_a_part(tmp_path: Path, groups: tuple[str, ...]) -> None:
    drive(model_of("4wd4ws_slim/robot.yaml"), tmp_path / "a.mcap", 0.1, groups)
    record = read(tmp_path / "a.mcap")
    links = {link.attrib["name"] for link in record.urdf().iter("link")}
    frames = record.frames()
    root = "map" if {"truth", "odometry"} & set(groups) else "base_link"
    for link in links:
        in_frame(frames, link, root)
    if groups == ("truth",):
        assert frames["base_link"][0] == "base_link_true"
        assert (frames["base_link"][1] == np.eye(4)).all()


def test_robots_of_a_fleet_have_descriptions_and_frames_of_their_own(tmp_path: Path) -> None:
    fleet = model_of("fleet_of_four/fleet.yaml")
    drive(fleet, tmp_path / "a.mcap", 0.1)
    record = read(tmp_path / "a.mcap")
    frames = record.frames()
    for placement in fleet.placements:
        urdf = record.urdf(f"/{placement.name}/robot_description")
        links = {link.attrib["name"] for link in urdf.iter("link")}
        assert links == {f"{placement.name}/{link.name}" for link in placement.robot.links}
        assert links < set(frames)
        for link in links:
            in_frame(frames, link, "map")


def test_a_record_does_not_change_the_run(tmp_path: Path) -> None:
    robot = model_of("4wd4ws_slim/robot.yaml")
    recorded = drive(robot, tmp_path / "a.mcap", 0.5)
    plain = RunHash()
    plan = [Segment(0.0, Twist(0.4, 0.0, 0.3))]
    Simulation(robot).run(0.5, plan, None, record_ticks([plain]))
    assert recorded.hexdigest() == plain.hexdigest()
