"""Launch files, executed against a double of the launch system."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
import yaml

from tests.backends.rcl_parameters import read
from tests.backends.ros2.launch_double import LaunchError, Started, run
from tests.backends.ros2.packages import (
    DISTROS,
    install,
    install_fleet,
    launch,
    named,
    package_of,
    variant,
    write,
)
from tests.examples import SAMPLED_ROBOTS, example_fleet, example_robot
from tests.slow import mostly_slow
from thorvaldc.model import Robot
from thorvaldc.ros.parameters import PARAMETERS

# Executables of each ROS package in Jazzy and Kilted.
EXECUTABLES = {
    "diagnostic_aggregator": {"aggregator_node"},
    "nav2_amcl": {"amcl"},
    "nav2_map_server": {"map_server"},
    "nav2_behaviors": {"behavior_server"},
    "nav2_bt_navigator": {"bt_navigator"},
    "nav2_collision_monitor": {"collision_monitor"},
    "nav2_controller": {"controller_server"},
    "nav2_lifecycle_manager": {"lifecycle_manager"},
    "nav2_planner": {"planner_server"},
    "nav2_smoother": {"smoother_server"},
    "nav2_velocity_smoother": {"velocity_smoother"},
    "nav2_waypoint_follower": {"waypoint_follower"},
    "controller_manager": {"ros2_control_node", "spawner"},
    "mujoco_ros2_control": {"ros2_control_node"},
    "ros_gz_bridge": {"parameter_bridge"},
    "ros_gz_sim": {"create"},
    "twist_mux": {"twist_mux"},
    "joy": {"game_controller_node", "joy_node"},
    "robot_state_publisher": {"robot_state_publisher"},
    "robot_localization": {"ekf_node", "navsat_transform_node"},
    "rviz2": {"rviz2"},
    "slam_toolbox": {"async_slam_toolbox_node"},
    "teleop_twist_joy": {"teleop_node"},
    "tf2_ros": {"static_transform_publisher"},
    "topic_tools": {"drop"},
}

# Nodes in the process of another node.
CHILDREN = {"planner_server": ["/global_costmap/global_costmap"]}


def launch_names(robot: Robot) -> list[str]:
    paths = [path for path in package_of(robot) if path.startswith("launch/")]
    return [Path(path).name.removesuffix(".launch.py") for path in paths]


def started(robot: Robot, folder: Path, file: str, **arguments: str) -> dict[str, Started]:
    context = launch(robot, folder, file, **arguments)
    nodes = {node.name: node for node in context.started}
    assert len(nodes) == len(context.started), "two nodes have one name"
    return nodes


def full_name(node: Started) -> str:
    return f"/{node.namespace}/{node.name}" if node.namespace else f"/{node.name}"


def depends(robot: Robot) -> set[str | None]:
    manifest = ElementTree.fromstring(package_of(robot)["package.xml"])
    return {element.text for element in manifest.iter("exec_depend")}


@pytest.mark.parametrize("name", SAMPLED_ROBOTS)
def test_everything_that_a_launch_file_names_exists(name: str, tmp_path: Path) -> None:
    """Packages are dependencies, executables exist, and each parameter file has its node."""
    robot = example_robot(name)
    declared = depends(robot)
    setup = package_of(robot)["setup.py"].decode()
    for file in launch_names(robot):
        context = launch(robot, tmp_path, file)
        for node in context.started:
            if node.package == robot.ros.package:
                assert f'"{node.executable} = {node.package}.' in setup
            else:
                assert node.package in declared
                assert node.executable in EXECUTABLES[node.package]
            for path in node.files:
                nodes = read(path.read_text(encoding="utf-8"))
                assert {full_name(node), *CHILDREN.get(node.name, ())} & set(nodes)


@pytest.mark.parametrize("name", mostly_slow(["4wd4ws_wide", "car"]))
@pytest.mark.parametrize("namespace", ["", "r1"])
def test_all_launch_files_start_in_the_name_space(
    name: str, namespace: str, tmp_path: Path
) -> None:
    robot = variant(name, namespace=namespace)
    for file in launch_names(robot):
        for node in launch(robot, tmp_path, file, **extra_arguments(file)).started:
            assert node.namespace == namespace


def extra_arguments(file: str) -> dict[str, str]:
    return (
        {"rviz": "true", "diagnostics": "true"}
        if file in ("base", "ideal", "mujoco", "robot", "virtual")
        else {}
    )


@pytest.mark.parametrize(
    ("file", "base", "simulated_time"),
    [
        ("ideal", "ideal", False),
        ("mujoco", "mujoco", True),
        ("virtual", "virtual", False),
        ("robot", "bus", False),
        ("joint_states", "topics", True),
    ],
)
def test_bases(file: str, base: str, simulated_time: bool, tmp_path: Path) -> None:
    """Each node gets the time from /clock, or none does; the base driver publishes it."""
    robot = example_robot("4wd4ws_wide")
    nodes = started(robot, tmp_path, file, rviz="true")
    guard = {"joint_guard"} if base == "topics" else set()
    assert set(nodes) == {"base_driver", "robot_state_publisher", "rviz2", *guard}
    driver = nodes["base_driver"].parameters
    assert driver["base"] == base
    assert driver["publish_clock"] is (base == "mujoco")
    assert all(node.parameters["use_sim_time"] is simulated_time for node in nodes.values())
    assert Path(driver["model_file"]).is_file()
    assert driver["real_time_factor"] == 1.0


@pytest.mark.parametrize("required", ["true", "false"])
def test_a_launch_ends_with_its_base_driver_and_its_guard(required: str, tmp_path: Path) -> None:
    """Its exit status lets a supervisor start it again after a failure."""
    robot = example_robot("4wd4ws_wide")
    count = 0
    others = {"teleop", "gnss", "slam", "amcl", "navigation"}
    for file in set(launch_names(robot)) - others:
        for node in launch(robot, tmp_path, file, required=required).started:
            ends = required == "true" and node.executable in ("base_driver", "joint_guard")
            count += ends
            assert node.status_of_launch(0) == (0 if ends else None)
            assert node.status_of_launch(-9) == (1 if ends else None)
    assert count == (11 if required == "true" else 0)


def test_arguments_reach_the_base_driver(tmp_path: Path) -> None:
    robot = example_robot("4wd4ws_wide")
    nodes = started(robot, tmp_path, "robot", bus="pcan:PCAN_USBBUS1", enable_odom_tf="false")
    driver = nodes["base_driver"].parameters
    assert driver["bus"] == "pcan:PCAN_USBBUS1"
    assert driver["enable_odom_tf"] is False
    assert "rviz2" not in nodes
    with pytest.raises(LaunchError, match="choices"):
        launch(robot, tmp_path, "base", base="real")
    with pytest.raises(LaunchError, match="declares no argument"):
        launch(robot, tmp_path, "ideal", basis="ideal")


@pytest.mark.parametrize("owners", [("driver", "ekf"), ("ekf", "driver")])
def test_a_package_starts_the_robot_of_another_build(
    owners: tuple[str, str], tmp_path: Path
) -> None:
    """All files, arguments and names are those of the other build, the programs of this one."""
    built = variant("4wd4ws_slim", namespace="r7", odom_tf=owners[0])
    other = write(tmp_path / "build" / "ros2", package_of(built))
    model = str(other / "config" / "model.json")
    installed = variant("4wd4ws_wide", odom_tf=owners[1])
    for file in launch_names(built):
        folder = tmp_path / file
        nodes = started(installed, folder, file, model=model, **extra_arguments(file))
        for node in nodes.values():
            assert node.namespace == "r7"
            assert node.package != built.ros.package
            for path in (*node.sources, node.parameters.get("model_file", other)):
                assert Path(path).is_relative_to(other)
        if driver := nodes.get("base_driver"):
            assert driver.package == "thorvald_4wd4ws_wide"
            assert driver.parameters["model_file"] == model
            assert driver.parameters["enable_odom_tf"] is (owners[0] == "driver")
            assert ("ekf_odom" in nodes) is (owners[0] == "ekf")
            text = nodes["robot_state_publisher"].parameters["robot_description"]
            assert "r7/base_link" in text
            files = {
                str(mesh.get("filename")) for mesh in ElementTree.fromstring(text).iter("mesh")
            }
            assert files
            assert all(Path(name.removeprefix("file://")).is_file() for name in files)
        if file == "gazebo":
            _, name, _, sdf, *_ = nodes["create"].arguments
            assert name == "r7"
            meshes = [str(uri.text) for uri in ElementTree.fromstring(sdf).iter("uri")]
            assert meshes
            assert all(Path(uri.removeprefix("file://")).is_file() for uri in meshes), meshes[0]


def test_a_model_that_is_none_of_a_build_is_an_error(tmp_path: Path) -> None:
    wrong = write(tmp_path / "wrong" / "config", {"model.json": b"{}"}) / "model.json"
    with pytest.raises(RuntimeError, match="of a build that has the launch file ideal"):
        started(example_robot("car"), tmp_path / "car", "ideal", model=str(wrong))
    built = write(tmp_path / "ros2", package_of(example_robot("1wd1ws_front")))
    model = str(built / "config" / "model.json")
    with pytest.raises(RuntimeError, match=r"gnss\.launch\.py"):
        started(example_robot("4wd4ws_wide"), tmp_path / "wide", "gnss", model=model)


@pytest.mark.parametrize("owner", ["driver", "ekf"])
def test_one_node_publishes_the_transform_from_odom(owner: str, tmp_path: Path) -> None:
    nodes = started(variant("4wd4ws_wide", odom_tf=owner), tmp_path, "ideal")
    driver = nodes["base_driver"]
    assert driver.parameters["enable_odom_tf"] is (owner == "driver")
    file = read(driver.files[0].read_text(encoding="utf-8"))["/base_driver"]
    assert file["enable_odom_tf"] is (owner == "driver")


def test_description_is_the_urdf_of_the_package(tmp_path: Path) -> None:
    robot = variant("4wd4ws_wide", namespace="r1")
    nodes = started(robot, tmp_path, "ideal")
    text = nodes["robot_state_publisher"].parameters["robot_description"]
    root = ElementTree.fromstring(text)
    files = package_of(robot)
    meshes = {mesh.get("filename") for mesh in root.iter("mesh")}
    assert meshes
    start = f"package://{robot.ros.package}/"
    assert all(mesh is not None and mesh.removeprefix(start) in files for mesh in meshes)
    assert "r1/base_link" in {link.get("name") for link in root.iter("link")}


@pytest.mark.parametrize("distro", DISTROS)
def test_the_pad_moves_the_robot(distro: str, tmp_path: Path) -> None:
    """The pad's twists arrive at a source of the driver, with the type that it subscribes to."""
    robot = variant("4wd4ws_wide", distro=distro, namespace="r1")
    nodes = started(robot, tmp_path, "teleop")
    teleop = nodes["teleop_twist_joy_node"]
    topic = teleop.remappings["cmd_vel"]
    assert topic in {source.topic for source in robot.twist_sources}
    values = read(teleop.files[0].read_text(encoding="utf-8"))
    stamped = robot.ros.stamped
    assert values["/r1/teleop_twist_joy_node"]["publish_stamped_twist"] is stamped
    driver = read(named(robot, "config/base_driver.yaml"))["/r1/base_driver"]
    assert driver["stamped"] is stamped
    # A twist with the time of another clock would be refused.
    nodes = started(robot, tmp_path, "teleop", use_sim_time="true")
    assert all(node.parameters["use_sim_time"] is True for node in nodes.values())
    # The pad is silent for less than the time-out of the source.
    rate = values["/r1/game_controller_node"]["autorepeat_rate"]
    assert all(source.timeout > 2.0 / rate for source in robot.twist_sources)


def test_several_buses_have_an_interface_each(tmp_path: Path) -> None:
    robot = example_robot("4wd4ws_wide")
    second = dataclasses.replace(robot.buses[0], name="implement")
    robot = dataclasses.replace(robot, buses=(*robot.buses, second))
    driver = started(robot, tmp_path, "robot")["base_driver"].parameters
    assert driver["bus"] == "main=socketcan:can0,implement=socketcan:can1"


def test_a_robot_without_a_bus_has_no_launch_file_for_it() -> None:
    robot = dataclasses.replace(example_robot("4wd4ws_wide"), buses=())
    assert {"robot", "virtual"}.isdisjoint(launch_names(robot))


def test_fleet(tmp_path: Path) -> None:
    """One launch file starts all robots, each with its own arguments, frames and place."""
    fleet = example_fleet("fleet_of_four")
    shares = install_fleet(fleet, tmp_path)
    context = run(shares["fleet_of_four_fleet"] / "launch" / "fleet.launch.py", shares)
    nodes = {full_name(node): node for node in context.started}
    assert len(nodes) == len(context.started) == 3 * len(fleet.placements)
    for placement in fleet.placements:
        driver = nodes[f"/{placement.name}/base_driver"]
        assert driver.package == placement.robot.ros.package
        assert driver.parameters["base"] == "ideal"
        assert str(shares[driver.package]) in driver.parameters["model_file"]
        pose = nodes[f"/{placement.name}/map_to_odom"].arguments
        options = dict(zip(pose[::2], pose[1::2], strict=True))
        assert float(options["--x"]) == placement.pose.xyz[0]
        assert float(options["--y"]) == placement.pose.xyz[1]
        assert float(options["--qw"]) == placement.pose.quat[0]
        assert options["--child-frame-id"] == f"{placement.name}/odom"
    assert all(node.status_of_launch(-9) is None for node in nodes.values())
    without = run(
        shares["fleet_of_four_fleet"] / "launch" / "fleet.launch.py",
        shares,
        poses="false",
        base="virtual",
    )
    assert len(without.started) == 2 * len(fleet.placements)


def test_a_fleet_in_mujoco_has_one_clock(tmp_path: Path) -> None:
    """The robot with the shortest control cycle publishes it, and all nodes use it."""
    fleet = example_fleet("fleet_of_four")
    first, second, *others = fleet.placements
    driver = dataclasses.replace(second.robot.driver, rate=2.0 * first.robot.driver.rate)
    fast = dataclasses.replace(second, robot=dataclasses.replace(second.robot, driver=driver))
    fleet = dataclasses.replace(fleet, placements=(first, fast, *others))
    shares = install_fleet(fleet, tmp_path)
    file = shares["fleet_of_four_fleet"] / "launch" / "fleet.launch.py"
    nodes = [n for n in run(file, shares, base="mujoco").started if n.name != "map_to_odom"]
    assert all(node.parameters["use_sim_time"] is True for node in nodes)
    drivers = {n.namespace: n.parameters for n in nodes if n.executable == "base_driver"}
    assert list(drivers) == [placement.name for placement in fleet.placements]
    assert {parameters["base"] for parameters in drivers.values()} == {"mujoco"}
    clocks = [name for name, parameters in drivers.items() if parameters["publish_clock"]]
    assert clocks == [second.name]


def test_a_fleet_in_a_group_has_its_name_space(tmp_path: Path) -> None:
    """The names of the robots are those of the fleet, whatever `namespace` is before."""
    shares = install_fleet(example_fleet("fleet_of_four"), tmp_path)
    file = shares["fleet_of_four_fleet"] / "launch" / "fleet.launch.py"
    text = (
        "from launch import LaunchDescription\n"
        "from launch.actions import IncludeLaunchDescription, SetLaunchConfiguration\n"
        "from launch.launch_description_sources import PythonLaunchDescriptionSource\n"
        "from launch_ros.actions import PushRosNamespace\n"
        "def generate_launch_description():\n"
        f"    fleet = IncludeLaunchDescription(PythonLaunchDescriptionSource({str(file)!r}))\n"
        "    other = SetLaunchConfiguration('namespace', 'other')\n"
        "    return LaunchDescription([other, PushRosNamespace('farm'), fleet])\n"
    )
    path = write(tmp_path, {"farm.launch.py": text.encode()}) / "farm.launch.py"
    for node in run(path, shares).started:
        assert re.fullmatch("farm/(tall|slim|wide|six)", node.namespace)
        if node.name == "map_to_odom":
            assert node.arguments[-1] == f"{node.namespace}/odom"


GZ_SIM_NODE = b"""\
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
def generate_launch_description():
    arguments = [LaunchConfiguration("gz_args")]
    return LaunchDescription(
        [
            DeclareLaunchArgument("gz_args", default_value="", description="options of gz sim"),
            Node(package="gz", executable="sim", arguments=arguments),
        ]
    )
"""


def test_a_fleet_in_one_gazebo(tmp_path: Path) -> None:
    """One world and one clock, and for each robot its model, its bridge, its driver and a guard."""
    fleet = example_fleet("fleet_of_four")
    shares = install_fleet(fleet, tmp_path)
    shares["ros_gz_sim"] = write(tmp_path / "gz", {"launch/gz_sim.launch.py": GZ_SIM_NODE})
    file = shares["fleet_of_four_fleet"] / "launch" / "fleet.launch.py"
    context = run(file, shares, base="gazebo")
    (sim,) = (node for node in context.started if node.package == "gz")
    nodes = {full_name(node): node for node in context.started if node is not sim}
    assert len(nodes) == len(context.started) - 1
    assert [name.rpartition("/")[2] for name in nodes].count("gz_bridge_clock") == 1
    world = Path(sim.arguments[0].removeprefix("-r "))
    assert world.parent.parent == shares["fleet_of_four_fleet"]
    models = {str(model.get("name")) for model in ElementTree.parse(world).iter("model")}
    assert not models & {placement.name for placement in fleet.placements}
    for placement in fleet.placements:
        create = nodes[f"/{placement.name}/create"].arguments
        options = dict(zip(create[::2], create[1::2], strict=True))
        assert options["-name"] == placement.name
        assert float(options["-x"]) == placement.pose.xyz[0]
        assert float(options["-Y"]) == pytest.approx(placement.pose.rpy()[2])
        for name in ("base_driver", "joint_guard"):
            parameters = nodes[f"/{placement.name}/{name}"].parameters
            assert parameters["joint_topics"] == "gazebo"
            assert parameters["use_sim_time"] is True
    assert all(node.status_of_launch(-9) is None for node in nodes.values())


def test_rviz_shows_the_frames_and_topics_of_the_robot() -> None:
    robot = variant("4wd4ws_wide", namespace="r1")
    text = named(robot, "rviz/robot.rviz")
    config: Any = yaml.safe_load(text)
    manager = config["Visualization Manager"]
    assert manager["Global Options"]["Fixed Frame"] == "r1/odom"
    topics = re.findall(r'Value: "(\S+)"', text)
    assert {"/r1/robot_description", "/r1/odometry/base_raw", "/r1/lidar_front/scan"} <= set(topics)
    assert {"/r1/goal_pose", "/r1/initialpose"} <= set(topics)
    assert all(topic.startswith("/r1/") for topic in topics)


# -- the double ---------------------------------------------------------------------


@pytest.mark.parametrize(
    "text",
    [
        'Node(package="a", executable="b", namespaces="c")',
        'Node(package="a", executable="b", parameters=["/no/such/file.yaml"])',
        'Node(package="a", executable="b", parameters=[{"text": "1"}])',
        'Node(package="a", executable="b", output="console")',
        'Node(package="a", executable="b", name="@NAME@")',
        'Node(package="a", executable="b", namespace="/a b")',
        'Node(package="a", executable="b", remappings=[("cmd_vel", "@TOPIC@")])',
        'Node(package="a", executable="b", parameters=[{"input_topic": "@TOPIC@"}])',
        'Node(package="a", executable="b", arguments=[f"{LaunchConfiguration(\'c\')}"])',
        'Node(package="a", executable="spawner", arguments=["a", "-c", "@MANAGER@"])',
        'Node(package="a", executable="spawner", arguments=["a", "--manager", "b"])',
        'Node(package="a", executable="spawner", arguments=["-c", "b"])',
        'DeclareLaunchArgument("a")',
        'IncludeLaunchDescription(PythonLaunchDescriptionSource("/no/such.launch.py"))',
    ],
)
def test_the_double_refuses_what_the_launch_system_refuses(text: str, tmp_path: Path) -> None:
    path = tmp_path / "a.launch.py"
    path.write_text(
        "from launch import LaunchDescription\n"
        "from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription\n"
        "from launch.launch_description_sources import PythonLaunchDescriptionSource\n"
        "from launch.substitutions import LaunchConfiguration\n"
        "from launch_ros.actions import Node\n"
        f"def generate_launch_description():\n    return LaunchDescription([{text}])\n",
        encoding="utf-8",
    )
    with pytest.raises((LaunchError, TypeError)):
        run(path, {})


def test_installed_packages_are_those_of_the_test(tmp_path: Path) -> None:
    shares = install(example_robot("car"), tmp_path)
    with pytest.raises(LaunchError, match="not found"):
        run(next(iter(shares.values())) / "launch" / "gazebo.launch.py", {})


@pytest.mark.parametrize("owner", ["driver", "ekf"])
def test_the_node_declares_every_parameter_of_the_base_driver(owner: str, tmp_path: Path) -> None:
    """Names and types are those of the table of the node; the defaults are those of the robot."""
    table = {parameter.name: parameter for parameter in PARAMETERS}
    robot = variant("4wd4ws_wide", odom_tf=owner, namespace="r1")
    for file in ("ideal", "mujoco", "virtual", "robot", "joint_states"):
        driver = started(robot, tmp_path, file)["base_driver"]
        values = read(driver.files[0].read_text(encoding="utf-8"))["/r1/base_driver"]
        for name, value in {**values, **driver.parameters}.items():
            if name != "use_sim_time":
                assert type(value) is type(table[name].default_for(robot)), name
        assert driver.parameters["base"] in table["base"].choices
    for name in ("stamped", "enable_odom_tf"):
        assert values[name] == table[name].default_for(robot)
