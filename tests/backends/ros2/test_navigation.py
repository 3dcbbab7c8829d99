"""Localization and navigation: every file agrees with every other and with the robot."""

from __future__ import annotations

import ast
import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.backends.ros2.packages import (
    DISTROS,
    braking_gently,
    launch,
    package_of,
    parameter_files,
    parameters,
    variant,
    write,
)
from tests.backends.ros2.test_declared_parameters import car_with_lidar
from tests.examples import SAMPLED_ROBOTS, example_robot
from thorvaldc.backends.ros2_navigation import Motion
from thorvaldc.model import Robot
from thorvaldc.model.sensor_numbers import sensor_numbers
from thorvaldc.model.statics.occupied_space import footprint
from thorvaldc.runtime.se2 import Twist
from thorvaldc.runtime.twist_ramp import Ramp

FRAMES = {
    *("global_frame", "robot_base_frame", "local_frame", "base_frame_id", "odom_frame_id"),
    *("global_frame_id", "frame_id"),
    *("map_frame", "odom_frame", "base_link_frame", "world_frame", "base_frame", "frame"),
}


def last(name: str) -> str:
    return name.rpartition(".")[2]


@pytest.mark.parametrize("namespace", ["", "r1"])
@pytest.mark.parametrize("owner", ["driver", "ekf"])
def test_frames_and_topics_of_all_files_agree(namespace: str, owner: str) -> None:
    """Frames are those of the URDF, odom and map; topics are in the name space of the robot."""
    robot = variant("4wd4ws_wide", namespace=namespace, odom_tf=owner)
    prefix = robot.prefix
    frames = {prefix + name for name in ("base_link", "odom", "map")}
    topics = set()
    for nodes in parameter_files(robot).values():
        for node, values in nodes.items():
            assert node.startswith(f"/{prefix}")
            for name, value in values.items():
                if last(name) in FRAMES:
                    assert value in frames, f"{node} {name}"
                if isinstance(value, str) and value.startswith("/"):
                    assert value.startswith(f"/{prefix}"), f"{node} {name}"
                    topics.add(value.removeprefix(f"/{prefix}"))
    sensors = {"lidar_front/scan", "gnss_main/fix", "imu/data"}
    known = {"odometry/base_raw", "odometry/filtered", "odometry/gps", "map", "cmd_vel_smoothed"}
    known |= {"auto_nav/cmd_vel", "local_costmap/published_footprint", *sensors}
    assert topics <= known


@pytest.mark.parametrize("owner", ["driver", "ekf"])
def test_one_node_publishes_each_transform(owner: str, tmp_path: Path) -> None:
    """odom to base_link: the base driver or the EKF; map to odom: slam_toolbox or the EKF."""
    robot = variant("4wd4ws_wide", odom_tf=owner)
    values = parameters(robot)
    base = {node.name for node in launch(robot, tmp_path, "ideal").started}
    local = [values["/ekf_odom"]] if "ekf_odom" in base else []
    assert values["/base_driver"]["enable_odom_tf"] is (owner == "driver")
    assert len(local) == (owner == "ekf")
    assert all(ekf["world_frame"] == ekf["odom_frame"] == "odom" for ekf in local)
    for source, owner_of_map in (("slam", "slam_toolbox"), ("gnss", "ekf_map"), ("amcl", "amcl")):
        nodes = launch(robot, tmp_path, "navigation", localization=source).started
        names = {node.name for node in nodes}
        assert names & {"slam_toolbox", "ekf_map", "amcl"} == {owner_of_map}
        assert "ekf_odom" not in names
    assert values["/ekf_map"]["world_frame"] == "map"
    topic = "/odometry/base_raw" if owner == "driver" else "/odometry/filtered"
    for node in ("/controller_server", "/bt_navigator", "/velocity_smoother"):
        assert values[node]["odom_topic"] == topic


def test_the_launch_argument_moves_the_transform_to_the_driver(tmp_path: Path) -> None:
    robot = variant("4wd4ws_wide", odom_tf="ekf")
    nodes = launch(robot, tmp_path, "ideal", enable_odom_tf="true").started
    assert {node.name for node in nodes} == {"base_driver", "robot_state_publisher"}


@pytest.mark.parametrize("distro", DISTROS)
def test_twists_of_nav2_pass_smoother_and_collision_monitor(distro: str, tmp_path: Path) -> None:
    """Follows the twists from the controller to a source of the base driver."""
    robot = variant("4wd4ws_wide", distro=distro, namespace="r1")
    nodes = {n.name: n for n in launch(robot, tmp_path, "navigation").started}
    values = parameters(robot)
    for sender in ("controller_server", "behavior_server"):
        assert nodes[sender].remappings == {"cmd_vel": "cmd_vel_nav"}
    assert nodes["velocity_smoother"].remappings == {"cmd_vel": "cmd_vel_nav"}
    monitor = values["/r1/collision_monitor"]
    # The velocity smoother publishes this topic.
    assert monitor["cmd_vel_in_topic"] == "/r1/cmd_vel_smoothed"
    sources = {f"/r1/{source.topic}" for source in robot.twist_sources}
    assert monitor["cmd_vel_out_topic"] in sources
    stamped = [v for name, v in _all(values, "enable_stamped_cmd_vel")]
    assert len(stamped) == 4
    assert set(stamped) == {robot.ros.stamped} == {values["/r1/base_driver"]["stamped"]}
    manager = nodes["lifecycle_manager_navigation"].parameters
    assert set(manager["node_names"]) == set(nodes) - {
        *("lifecycle_manager_navigation", "lifecycle_manager_slam", "slam_toolbox"),
    }
    # They are silent for less than the time-outs of the next ones.
    smoother = values["/r1/velocity_smoother"]
    assert all(s.timeout > 2.0 / smoother["smoothing_frequency"] for s in robot.twist_sources)


def _all(values: dict[str, dict[str, Any]], name: str) -> list[tuple[str, Any]]:
    return [(node, v[name]) for node, v in values.items() if name in v]


@pytest.mark.parametrize("simulated", ["true", "false"])
def test_all_nodes_have_the_same_clock(simulated: str, tmp_path: Path) -> None:
    robot = example_robot("4wd4ws_wide")
    for file in ("navigation", "slam", "gnss", "amcl"):
        nodes = launch(robot, tmp_path, file, use_sim_time=simulated).started
        assert {node.parameters["use_sim_time"] for node in nodes} == {simulated == "true"}


def test_limits_are_those_of_the_driver() -> None:
    robot = example_robot("4wd4ws_wide")
    values, driver = parameters(robot), robot.driver
    speeds = [driver.max_linear_velocity, driver.max_linear_velocity, driver.max_angular_velocity]
    smoother, mppi = values["/velocity_smoother"], values["/controller_server"]
    assert smoother["max_velocity"] == speeds
    assert [mppi[f"FollowPath.{name}_max"] for name in ("vx", "vy", "wz")] == speeds
    assert smoother["max_accel"][0] == mppi["FollowPath.ax_max"] == driver.max_linear_acceleration
    # MPPI needs steps of the period of the controller.
    assert mppi["FollowPath.model_dt"] * mppi["controller_frequency"] == pytest.approx(1.0)


@pytest.mark.parametrize("distro", DISTROS)
def test_nav2_brakes_with_the_decelerations_of_the_driver(distro: str) -> None:
    """Where Nav2 has one limit for speeding up and slowing down, it is the smaller one."""
    values = parameters(braking_gently(variant("4wd4ws_wide", distro=distro)))
    smoother, behaviors = values["/velocity_smoother"], values["/behavior_server"]
    assert smoother["max_accel"] == [1.2, 1.2, 1.6]
    assert smoother["max_decel"] == [-0.25, -0.25, -0.9]
    mppi = values["/controller_server"]
    limits = {name: mppi[f"FollowPath.{name}"] for name in ("ax_max", "ax_min", "ay_max", "ay_min")}
    assert limits == {"ax_max": 1.2, "ax_min": -0.25, "ay_max": 1.2, "ay_min": -0.25}
    assert mppi["FollowPath.az_max"] == behaviors["rotational_acc_lim"] == 0.9
    # In Jazzy, these behaviours have no limits of their own.
    straight = {name: value for name, value in behaviors.items() if "eration_limit" in name}
    expected = {
        f"{behavior}.{name}": limit
        for behavior in ("backup", "drive_on_heading")
        for name, limit in (("acceleration_limit", 1.2), ("deceleration_limit", -0.25))
    }
    assert straight == ({} if distro == "jazzy" else expected)


def test_the_collision_monitor_stops_a_robot_that_brakes_gently_before_an_obstacle() -> None:
    """Its rule ``approach`` multiplies the twist by the time to the collision, in whole steps,
    over time_before_collision; the base driver follows with its ramps."""
    robot = braking_gently(example_robot("4wd4ws_wide"))
    monitor, speed = parameters(robot)["/collision_monitor"], robot.driver.max_linear_velocity
    horizon = monitor["FootprintApproach.time_before_collision"]
    step = monitor["FootprintApproach.simulation_time_step"]
    ramp, period = Ramp(robot.driver, 1.0, smoothing=0.3), 1.0 / robot.driver.rate
    ramp.restart(Twist(speed, 0.0, 0.0))
    distance = speed * horizon + 1.0
    while distance > 0.0 and ramp.twist.vx > 0.001:
        seconds = math.floor(distance / speed / step) * step
        goal = Twist(speed * min(seconds / horizon, 1.0), 0.0, 0.0)
        distance -= ramp.step(goal, period).vx * period
    assert distance > 0.0


@pytest.mark.parametrize(
    ("robot", "kind"),
    [
        (example_robot("4wd4ws_wide"), "omni"),
        (example_robot("2wd0ws_greenhouse"), "diff"),
        (car_with_lidar(), "ackermann"),
    ],
    ids=["omni", "diff", "ackermann"],
)
@pytest.mark.parametrize("distro", DISTROS)
def test_motion_model(robot: Robot, kind: str, distro: str, tmp_path: Path) -> None:
    robot = dataclasses.replace(robot, ros=dataclasses.replace(robot.ros, distro=distro))
    motion, values = Motion(robot), parameters(robot)
    mppi, planner = values["/controller_server"], values["/planner_server"]
    assert motion.kind == kind
    names = {"omni": "Omni", "diff": "DiffDrive", "ackermann": "Ackermann"}
    keys = {"omni": "omni", "diff": "diff_drive", "ackermann": "ackermann"}
    model = mppi["FollowPath.motion_model"]
    if distro == "lyrical":
        assert model == keys[kind]
        assert mppi[f"FollowPath.{model}.plugin"] == f"mppi::{names[kind]}MotionModel"
        radius = mppi.get("FollowPath.ackermann.min_turning_r")
    else:
        assert model == names[kind]
        radius = mppi.get("FollowPath.AckermannConstraints.min_turning_r")
    assert (mppi["FollowPath.vy_max"] > 0.0) is (kind == "omni")
    nodes = {node.name: node for node in launch(robot, tmp_path, "navigation").started}
    tree = nodes["bt_navigator"].parameters.get("default_nav_to_pose_bt_xml")
    if kind != "ackermann":
        assert radius is None
        assert tree is None
        return
    assert radius == planner["GridBased.minimum_turning_radius"] == motion.turning_radius
    # It has no recoveries that turn on the spot, and no behaviour tree that asks for them.
    assert "spin" not in values["/behavior_server"]["behavior_plugins"]
    assert values["/bt_navigator"]["navigators"] == ["navigate_to_pose"]
    assert Path(str(tree)).name == "navigate_w_replanning_time.xml"


def test_turning_radius_of_a_car() -> None:
    """Wheelbase L, half track d, limit q: R = L / tan(q) + d for the inner wheel."""
    car = example_robot("car")
    front = [wheel for wheel in car.wheels if wheel.steered]
    rear = [wheel for wheel in car.wheels if not wheel.steered]
    joint = car.joint(front[0].steering_joint or "")
    assert joint.upper is not None
    expected = (front[0].x - rear[0].x) / math.tan(joint.upper) + abs(front[0].y)
    assert Motion(car).turning_radius == pytest.approx(expected)


# -- footprint ----------------------------------------------------------------------


def inside(point: tuple[float, float], corners: list[tuple[float, float]]) -> bool:
    return all(
        (bx - ax) * (point[1] - ay) - (by - ay) * (point[0] - ax) >= -1e-9
        for (ax, ay), (bx, by) in zip(corners, [*corners[1:], *corners[:1]], strict=True)
    )


@pytest.mark.parametrize("name", SAMPLED_ROBOTS)
def test_footprint_contains_every_wheel_in_every_direction(name: str) -> None:
    """In every direction to which it can steer."""
    robot = example_robot(name)
    corners = footprint(robot)
    for wheel in robot.wheels:
        lower, upper = 0.0, 0.0
        if wheel.steering_joint is not None:
            joint = robot.joint(wheel.steering_joint)
            lower, upper = (
                math.degrees(limit) if limit is not None else end
                for limit, end in ((joint.lower, -180.0), (joint.upper, 180.0))
            )
        for degrees in np.linspace(lower, upper, 73):
            angle = wheel.heading + math.radians(degrees)
            along, across = (math.cos(angle), math.sin(angle)), (-math.sin(angle), math.cos(angle))
            for a in (-wheel.radius, wheel.radius):
                for b in (-wheel.width / 2, wheel.width / 2):
                    x, y = wheel.trail + a, wheel.lateral_offset + b
                    if wheel.swivel_joint is None:
                        point = (
                            wheel.x + x * along[0] + y * across[0],
                            wheel.y + x * along[1] + y * across[1],
                        )
                        assert inside(point, corners)


def test_footprint_is_the_same_in_both_costmaps() -> None:
    robot = example_robot("4wd4ws_wide")
    values = parameters(robot)
    local = values["/local_costmap/local_costmap"]["footprint"]
    assert local == values["/global_costmap/global_costmap"]["footprint"]
    corners = [tuple(corner) for corner in ast.literal_eval(local)]
    assert corners == footprint(robot)


# -- what is left out -----------------------------------------------------------------


def test_each_robot_has_only_what_it_can_use() -> None:
    def files(robot: Robot) -> set[str]:
        return {path for path in package_of(robot) if path.startswith(("launch/", "config/"))}

    bare = files(example_robot("9wd9ws"))
    assert not any("nav" in path or "slam" in path or "gnss" in path for path in bare)
    car = files(example_robot("car"))
    assert "launch/gnss.launch.py" in car
    assert "launch/navigation.launch.py" not in car
    slim = files(example_robot("4wd4ws_slim"))
    assert {"launch/slam.launch.py", "launch/amcl.launch.py", "launch/navigation.launch.py"} <= slim
    assert "config/gnss.yaml" not in slim
    wide = files(example_robot("4wd4ws_wide"))
    assert {"config/global_costmap_slam.yaml", "config/global_costmap_gnss.yaml"} <= wide
    assert "config/ekf_odom.yaml" not in wide


def test_a_saved_map(tmp_path: Path) -> None:
    """AMCL and the costmap get it; a file that is not there is an error."""
    robot = variant("4wd4ws_wide", namespace="r1")
    nodes = {n.name: n for n in launch(robot, tmp_path, "navigation", localization="amcl").started}
    assert nodes["map_server"].parameters["yaml_filename"] == str(
        tmp_path / robot.ros.package / "field.yaml"
    )
    managed = nodes["lifecycle_manager_amcl"].parameters["node_names"]
    assert set(managed) <= set(nodes)
    values = parameter_files(robot)
    costmap = values["global_costmap_amcl"]["/r1/global_costmap/global_costmap"]
    assert costmap == values["global_costmap_slam"]["/r1/global_costmap/global_costmap"]
    assert costmap["static_layer.map_topic"] == values["amcl"]["/r1/amcl"]["map_topic"] == "/r1/map"
    assert values["amcl"]["/r1/amcl"]["robot_model_type"] == "nav2_amcl::OmniMotionModel"
    with pytest.raises(RuntimeError, match="expected a saved map"):
        launch(robot, tmp_path, "amcl", map="")


def test_parameters_of_the_user_replace_those_of_nav2(tmp_path: Path) -> None:
    robot = variant("4wd4ws_wide", namespace="r1")
    text = "/r1/planner_server:\n  ros__parameters: {expected_planner_frequency: 5.0}\n"
    own = write(tmp_path, {"own.yaml": text.encode()}) / "own.yaml"
    context = launch(robot, tmp_path, "navigation", params_file=str(own))
    nodes = [node for node in context.started if node.package.startswith("nav2_")]
    for node in nodes:
        if not node.name.startswith("lifecycle_manager"):
            assert node.sources[-1] == own, node.name
            assert node.sources[0].name == "nav2.yaml"
    assert len(nodes) > 8


def test_a_ray_without_an_echo_clears_the_costmaps_and_marks_nothing() -> None:
    """With `inf_is_valid`, Nav2 takes it as an echo 0.1 mm before the range of the lidar."""
    robot = example_robot("4wd4ws_wide")
    (lidar,) = (sensor for sensor in robot.sensors if sensor.type == "lidar_2d")
    for costmap in ("/local_costmap/local_costmap", "/global_costmap/global_costmap"):
        values = {k: v for k, v in parameters(robot)[costmap].items() if "lidar_front" in k}
        values = {last(name): value for name, value in values.items()}
        assert values["inf_is_valid"] is True
        assert values["obstacle_max_range"] < sensor_numbers(lidar)["range"] - 0.1
        assert values["raytrace_max_range"] > values["obstacle_max_range"]


def test_navigation_without_a_map_uses_the_frame_of_the_odometry() -> None:
    robot = example_robot("4wd4ws_slim")
    sensors = tuple(dataclasses.replace(sensor, type="lidar_3d") for sensor in robot.sensors[:1])
    values = parameters(dataclasses.replace(robot, sensors=sensors))
    costmap = values["/global_costmap/global_costmap"]
    assert costmap["global_frame"] == values["/bt_navigator"]["global_frame"] == "odom"
    assert costmap["rolling_window"] is True
    assert costmap["obstacle_layer.lidar_front.data_type"] == "PointCloud2"
    assert values["/collision_monitor"]["lidar_front.type"] == "pointcloud"
