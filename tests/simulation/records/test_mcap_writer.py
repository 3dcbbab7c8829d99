"""MCAP records: contents as other readers see them, and records of interrupted runs."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from tests.full_disk import full_disk
from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.model import Fleet, Robot
from thorvaldc.model.scenario import GROUPS
from thorvaldc.runtime.se2 import Twist
from thorvaldc.simulation.control_loop import ControlLoop, Sample, Segment
from thorvaldc.simulation.records.mcap_writer import McapRecorder
from thorvaldc.simulation.records.recorder import record_ticks
from thorvaldc.simulation.simulation_run import Simulation

EXAMPLES = Path(__file__).resolve().parents[3] / "examples"
TURN = [Segment(0.0, Twist(0.5, 0.0, 0.4))]


def compiled(name: str) -> Any:
    compilation = compile_file(EXAMPLES / name)
    assert compilation.model is not None
    return compilation.model


@pytest.fixture(scope="module")
def robot() -> Robot:
    robot = compiled("4wd4ws_slim/robot.yaml")
    assert isinstance(robot, Robot)
    return robot


def drive(
    model: Robot | Fleet, path: Path, seconds: float = 1.0, **options: Any
) -> dict[str, list[Sample]]:
    simulation = Simulation(model)
    samples: dict[str, list[Sample]] = {}
    groups = options.pop("groups", GROUPS)
    recorder = McapRecorder(path, [*simulation.robots.items()], groups, **options)
    pass_on = record_ticks([recorder])

    def on_tick(loop: ControlLoop) -> None:
        samples.setdefault(loop.name, []).append(loop.sample())
        pass_on(loop)

    try:
        simulation.run(seconds, TURN, None, on_tick)
    finally:
        recorder.close()
    return samples


def messages(path: Path) -> Iterator[tuple[str, int, Any]]:
    with AnyReader([path]) as reader:
        for connection, time, data in reader.messages():
            yield connection.topic, time, reader.deserialize(data, connection.msgtype)


def by_topic(path: Path) -> dict[str, list[tuple[int, Any]]]:
    topics: dict[str, list[tuple[int, Any]]] = {}
    for topic, time, message in messages(path):
        topics.setdefault(topic, []).append((time, message))
    return topics


def test_messages_have_the_values_of_the_samples(robot: Robot, tmp_path: Path) -> None:
    samples = drive(robot, tmp_path / "a.mcap")[robot.name]
    topics = by_topic(tmp_path / "a.mcap")
    assert {topic: len(got) for topic, got in topics.items()} == {
        "/tf_static": 1,
        "/robot_description": 1,
        **dict.fromkeys(("/odom", "/ground_truth/odom", "/cmd_vel", "/cmd_vel_limited"), 51),
        **dict.fromkeys(("/joint_states", "/joint_commands", "/tf"), 51),
    }
    time, odom = topics["/odom"][-1]
    last = samples[-1]
    assert time == odom.header.stamp.sec * 10**9 + odom.header.stamp.nanosec == 10**9
    assert (odom.header.frame_id, odom.child_frame_id) == ("odom", "base_link")
    position, orientation = odom.pose.pose.position, odom.pose.pose.orientation
    assert (position.x, position.y) == last.pose_estimated[:2]
    assert 2.0 * math.atan2(orientation.z, orientation.w) == pytest.approx(last.pose_estimated.yaw)
    assert (odom.twist.twist.linear.x, odom.twist.twist.angular.z) == (
        last.estimated.vx,
        last.estimated.wz,
    )
    (_, commanded), (_, limited) = topics["/cmd_vel"][0], topics["/cmd_vel_limited"][0]
    assert commanded.twist.linear.x == 0.5
    assert limited.twist.linear.x < 0.1
    joints = topics["/joint_states"][-1][1]
    assert last.joints is not None
    assert joints.name[:4] == [wheel.spin_joint for wheel in robot.wheels]
    assert list(joints.position[:4]) == list(last.joints.positions or ())
    assert list(joints.velocity[:4]) == list(last.joints.speeds)
    assert list(joints.position[4:]) == list(last.joints.angles)
    frames = {t.child_frame_id: t for _, tf in topics["/tf"] for t in tf.transforms}
    joint_frames = {j.child: j.parent for j in robot.joints if j.name in joints.name}
    assert {name: t.header.frame_id for name, t in frames.items()} == {
        "base_link": "odom",
        "base_link_true": "map",
        **joint_frames,
    }
    assert topics["/tf_static"][0][1].transforms[0].child_frame_id == "odom"


def test_covariances_are_in_the_frames_of_ros(robot: Robot, tmp_path: Path) -> None:
    """The covariance of the pose is in the frame `odom`, that of a sample in `base_link`."""
    last = drive(robot, tmp_path / "a.mcap", 4.0)[robot.name][-1]
    odom = by_topic(tmp_path / "a.mcap")["/odom"][-1][1]
    full = np.array(odom.pose.covariance).reshape(6, 6)
    assert (full == full.T).all()
    planar = full[np.ix_((0, 1, 5), (0, 1, 5))]
    yaw = last.pose_estimated.yaw
    c, s = math.cos(yaw), math.sin(yaw)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    assert planar == pytest.approx(turn @ np.array(last.pose_covariance) @ turn.T, abs=1e-15)
    assert planar[0, 0] > 0.0


def test_another_reader_than_rosbags_reads_profile_schemas_and_index(
    robot: Robot, tmp_path: Path
) -> None:
    samples = drive(robot, tmp_path / "a.mcap")[robot.name]
    with (tmp_path / "a.mcap").open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert {c.message_encoding for c in summary.channels.values()} == {"cdr"}
        schemas = {s.name: s for s in summary.schemas.values()}
        assert {s.encoding for s in schemas.values()} == {"ros2msg"}
        assert b"MSG: geometry_msgs/PoseWithCovariance" in schemas["nav_msgs/msg/Odometry"].data
        times = [message.log_time for _, _, message in reader.iter_messages()]
        assert len(times) == summary.statistics.message_count == 51 * 7 + 2
        assert times == sorted(times)
        # The decoder uses only the message definitions in the file.
        decoded = [m for *_, m in reader.iter_decoded_messages(topics=["/odom"])]
        topics = [(m.pose.pose.position.x, m.twist.twist.angular.z) for m in decoded]
        assert topics == [(s.pose_estimated.x, s.estimated.wz) for s in samples]


def test_topics_of_a_fleet_have_name_spaces(tmp_path: Path) -> None:
    fleet = compiled("fleet_of_four/fleet.yaml")
    samples = drive(fleet, tmp_path / "a.mcap", 0.2, groups=("odometry",))
    topics = by_topic(tmp_path / "a.mcap")
    assert set(topics) == {
        "/tf",
        "/tf_static",
        *(f"/{name}/{topic}" for name in samples for topic in ("odom", "robot_description")),
    }
    # A late subscriber gets only the last message.
    last = {t.child_frame_id for t in topics["/tf_static"][-1][1].transforms}
    assert last > {f"{name}/odom" for name in samples}
    moved = {t.child_frame_id for _, tf in topics["/tf"] for t in tf.transforms}
    assert moved >= {f"{name}/base_link" for name in samples}
    (odom,) = {m.header.frame_id for _, m in topics["/wide/odom"]}
    assert odom == "wide/odom"
    first = topics["/wide/odom"][0][1].pose.pose.position
    assert (first.x, first.y) == (0.0, 0.0)


def test_equal_runs_give_equal_bytes_with_any_file_name(robot: Robot, tmp_path: Path) -> None:
    for name in ("a", "b"):
        drive(robot, tmp_path / f"{name}.mcap")
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()
    assert (tmp_path / "a.foxglove.json").read_bytes() == (
        tmp_path / "b.foxglove.json"
    ).read_bytes()
    assert sorted(os.listdir(tmp_path)) == [
        f"{name}.{suffix}" for name in "ab" for suffix in ("foxglove.json", "mcap")
    ]


def test_groups_and_times_are_those_requested(robot: Robot, tmp_path: Path) -> None:
    drive(robot, tmp_path / "a.mcap", groups=("truth",), every=0.1)
    topics = by_topic(tmp_path / "a.mcap")
    assert set(topics) == {"/ground_truth/odom", "/tf", "/tf_static", "/robot_description"}
    assert [time for time, _ in topics["/ground_truth/odom"]] == [k * 10**8 for k in range(11)]


def test_an_interrupted_run_leaves_a_complete_file(robot: Robot, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    simulation = Simulation(robot)
    recorder = McapRecorder(path, [*simulation.robots.items()], GROUPS)
    pass_on = record_ticks([recorder])

    def on_tick(loop: ControlLoop) -> None:
        pass_on(loop)
        if loop.driver.state.time >= 0.5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        simulation.run(1.0, TURN, None, on_tick)
    assert not path.exists()
    recorder.close()
    recorder.close()
    assert by_topic(path)["/odom"][-1][0] == 5 * 10**8


def test_a_full_disk_is_reported_and_leaves_the_incomplete_file(
    robot: Robot, tmp_path: Path
) -> None:
    with full_disk(1 << 16), pytest.raises(OSError, match=r"a\.mcap"):
        drive(robot, tmp_path / "a.mcap", 20.0)
    assert os.listdir(tmp_path) == ["a.mcap.incomplete"]
    assert (tmp_path / "a.mcap.incomplete").stat().st_size > 1000


@pytest.mark.parametrize("where", ["none/a.mcap", "folder.mcap"])
def test_a_path_that_cannot_be_written_is_an_error_before_the_run(
    robot: Robot, tmp_path: Path, where: str
) -> None:
    (tmp_path / "folder.mcap").mkdir()
    with pytest.raises(OSError, match=where):
        McapRecorder(tmp_path / where, [(robot.name, robot)], GROUPS)
    assert os.listdir(tmp_path) == ["folder.mcap"]
