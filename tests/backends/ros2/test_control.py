"""Robots that controllers of ros2_control or of Gazebo drive, without the base driver."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import pytest
import yaml

from tests.backends.rcl_parameters import read
from tests.backends.ros2.launch_double import Started, spawned_controllers
from tests.backends.ros2.packages import braking_gently, launch, named, package_of, variant
from tests.backends.ros2.test_launch_files import depends
from tests.examples import SAMPLED_ROBOTS, example_robot
from thorvaldc.backends.sdf import STEP

DRIVEN = "2wd0ws_greenhouse"  # a robot that diff_drive_controller drives
OTHER = "4wd4ws_wide"


@pytest.mark.parametrize("hardware", ["mock", "mujoco"])
@pytest.mark.parametrize("name", SAMPLED_ROBOTS)
def test_ros2_control(name: str, hardware: str, tmp_path: Path) -> None:
    """The started controllers exist, with joints of the URDF, and their packages are declared."""
    robot = variant(name, namespace="r1")
    context = launch(robot, tmp_path, "ros2_control", hardware=hardware)
    nodes = {n.executable: n for n in context.started}
    description = nodes["robot_state_publisher"].parameters["robot_description"]
    root = ElementTree.fromstring(description)
    assert len(root.findall("ros2_control")) == 1
    assert "$(find" not in description
    for path in root.iterfind("ros2_control/hardware/param[@name='mujoco_model']"):
        assert Path(path.text or "").is_file()
    parameters = read(nodes["ros2_control_node"].files[0].read_text(encoding="utf-8"))
    manager = parameters["/r1/controller_manager"]
    spawned_by, names = spawned_controllers(nodes["spawner"])
    assert spawned_by == "/r1/controller_manager"
    joints = {joint.get("name") for joint in root.iter("joint")}
    for controller in names:
        plugin = manager[f"{controller}.type"]
        assert plugin.partition("/")[0] in depends(robot)
        for key, value in parameters.get(f"/r1/{controller}", {}).items():
            if key in ("joints", "left_wheel_names", "right_wheel_names"):
                assert set(value) <= joints
    assert {n.parameters.get("use_sim_time", hardware == "mujoco") for n in context.started} == {
        hardware == "mujoco"
    }


def test_twists_reach_the_controller_with_the_sources_of_the_driver(tmp_path: Path) -> None:
    robot = variant(DRIVEN, namespace="r1")
    nodes = {n.executable: n for n in launch(robot, tmp_path, "ros2_control").started}
    mux = nodes["twist_mux"]
    assert mux.remappings == {"cmd_vel_out": "diff_drive_controller/cmd_vel"}
    values = read(mux.files[0].read_text(encoding="utf-8"))["/r1/twist_mux"]
    assert values["use_stamped"] is True  # controllers take stamped twists only
    topics = {values[f"topics.{source.name}.topic"] for source in robot.twist_sources}
    assert topics == {source.topic for source in robot.twist_sources}
    assert nodes["ros2_control_node"].remappings == {
        "diff_drive_controller/odom": "odometry/base_raw"
    }
    pad = launch(robot, tmp_path, "teleop", stamped="true").started
    assert [n.parameters["publish_stamped_twist"] for n in pad if n.package != "joy"] == [True]


def test_the_controller_brakes_with_the_decelerations_of_the_driver() -> None:
    robot = braking_gently(example_robot(DRIVEN))
    values = read(named(robot, "config/controllers.yaml"))["/diff_drive_controller"]
    linear, angular = robot.driver.top_speeds
    axes = ("linear.x", linear, 1.2, 0.25), ("angular.z", angular, 1.6, 0.9)
    for axis, speed, acceleration, deceleration in axes:
        assert values[f"{axis}.max_velocity"] == -values[f"{axis}.min_velocity"] == speed
        # Deceleration has the sign opposite to the motion.
        assert values[f"{axis}.max_acceleration"] == acceleration
        assert values[f"{axis}.max_acceleration_reverse"] == -acceleration
        assert values[f"{axis}.max_deceleration"] == -deceleration
        assert values[f"{axis}.max_deceleration_reverse"] == deceleration


def test_the_one_owner_of_the_transform_from_odom() -> None:
    for owner in ("driver", "ekf"):
        text = named(variant(DRIVEN, odom_tf=owner), "config/controllers.yaml")
        values = read(text)["/diff_drive_controller"]
        assert values["enable_odom_tf"] is (owner == "driver")


def test_a_robot_without_a_controller_has_no_twist_mux(tmp_path: Path) -> None:
    robot = example_robot(OTHER)
    started = launch(robot, tmp_path, "ros2_control").started
    assert "twist_mux" not in {n.executable for n in started}
    assert "config/twist_mux.yaml" not in package_of(robot)


@pytest.mark.parametrize(
    ("file", "dialect"), [("ros2_control", "ros2_control"), ("gazebo", "gazebo")]
)
def test_the_base_driver_moves_a_robot_that_no_controller_moves(
    file: str, dialect: str, tmp_path: Path
) -> None:
    """Its guard has the same topics, and no other node owns the topic of the joint states."""
    robot = variant(OTHER, namespace="r1")
    nodes = {n.executable: n for n in launch(robot, tmp_path, file).started}
    for name in ("base_driver", "joint_guard"):
        assert nodes[name].parameters["joint_topics"] == dialect
    assert nodes["base_driver"].parameters["base"] == "topics"
    values = read(named(robot, "config/controllers.yaml"))
    assert values["/r1/joint_state_broadcaster"]["use_local_topics"] is True


@pytest.mark.parametrize(
    ("name", "arguments"),
    [(DRIVEN, {"controller": "standard"}), (DRIVEN, {}), (OTHER, {})],
    ids=["controllers of ros2_control", "base driver", "base driver, steered"],
)
def test_gazebo(name: str, arguments: dict[str, str], tmp_path: Path) -> None:
    """Gazebo gets the model of the package, the bridge its topics, and all nodes its time."""
    robot = variant(name, namespace="r1")
    context = launch(robot, tmp_path, "gazebo", **arguments)
    nodes = {n.name: n for n in context.started}
    create = nodes["create"].arguments
    options = dict(zip(create[::2], create[1::2], strict=True))
    assert {options[f"-{axis}"] for axis in "xyzRPY"} == {"0.0"}
    model = ElementTree.fromstring(options["-string"])
    share = f"model://{robot.ros.package}/"
    uris = {uri.text or "" for uri in model.iter("uri")}
    assert uris
    assert all(uri.removeprefix(share) in package_of(robot) for uri in uris)
    topics = {entry["ros_topic_name"] for entry in bridged(nodes["gz_bridge"])}
    for parameter_node in ("robot_state_publisher", "gz_bridge"):
        assert nodes[parameter_node].parameters["use_sim_time"] is True
    (gazebo,) = (file for file in context.included if file.path.name == "gz_sim.launch.py")
    assert str(tmp_path) in gazebo.environment["GZ_SIM_RESOURCE_PATH"]
    assert gazebo.configurations["gz_args"].startswith("-r ")
    assert Path(gazebo.configurations["gz_args"].removeprefix("-r ")).is_file()
    plugins = [str(plugin.get("name")) for plugin in model.iter("plugin")]
    assert "joint_states" not in topics  # of the base driver or of joint_state_broadcaster
    has_controllers = any("ros2_control" in plugin for plugin in plugins)
    assert has_controllers is ("twist_mux" in nodes) is ("spawner" in nodes) is bool(arguments)
    assert ("base_driver" in nodes) is ("joint_guard" in nodes) is not has_controllers
    if arguments:
        files = [p.text or "" for p in model.iter("parameters")]
        parameters = read(Path(files[0]).read_text(encoding="utf-8"))
        spawned_by, names = spawned_controllers(nodes["spawner"])
        assert model.findtext(".//plugin/ros/namespace") == "/r1"
        assert spawned_by == "/r1/controller_manager"
        assert names
        assert all(f"{controller}.type" in parameters[spawned_by] for controller in names)
    else:
        assert "engine/joint_states" in topics
        assert nodes["base_driver"].parameters["joint_topics"] == "gazebo"


def bridged(bridge: Started) -> list[dict[str, str]]:
    text = Path(bridge.parameters["config_file"]).read_text(encoding="utf-8")
    entries: list[dict[str, str]] = yaml.safe_load(text)
    return entries


@pytest.mark.parametrize("name", [DRIVEN, OTHER])
def test_nodes_get_the_time_of_gazebo_100_times_per_second(name: str, tmp_path: Path) -> None:
    """Gazebo sends the time at each step; a message of /clock costs a Python node 0.7 ms."""
    robot = variant(name, namespace="r1")
    nodes = {n.name: n for n in launch(robot, tmp_path, "gazebo").started}
    entries = [*bridged(nodes["gz_bridge"]), *bridged(nodes["gz_bridge_clock"])]
    assert "/clock" not in {entry["ros_topic_name"] for entry in entries}
    (clock,) = (entry for entry in entries if entry["gz_topic_name"] == "/clock")
    drop = nodes["clock_drop"]
    assert drop.parameters["input_topic"] == clock["ros_topic_name"]
    assert drop.parameters["output_topic"] == "/clock"
    assert "use_sim_time" not in drop.parameters
    steps = drop.parameters["Y"]
    assert drop.parameters["X"] == steps - 1  # of each Y messages, it leaves out the first X
    assert 1.0 / (steps * STEP) == pytest.approx(100.0)
    assert "topic_tools" in depends(robot)
