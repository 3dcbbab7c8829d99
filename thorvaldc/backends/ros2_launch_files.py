"""The launch files of a ROS 2 package, from the templates in ``templates/ros2/launch``.

``base.launch.py`` starts the robot's description and its base driver; the launch files of
simulations and of the real robot include it with other arguments. The launch files contain the
names of the package, of its name space and of topics; the parameter files have all other values.
"""

from __future__ import annotations

import json
from typing import Any

from thorvaldc.backends.gazebo_topics import GAZEBO_CLOCK
from thorvaldc.backends.ros2_control_files import twist_controller
from thorvaldc.backends.ros2_controllers import controllers
from thorvaldc.backends.ros2_navigation import Motion
from thorvaldc.backends.ros2_parts import (
    Parts,
    full_topic,
    node_space,
    sensor_topic,
    source_topic,
)
from thorvaldc.backends.templates import Templates
from thorvaldc.model import Fleet, Robot
from thorvaldc.model.settings import EKF

_TEMPLATES = Templates("ros2/launch")
_CLOCK = {"use_sim_time": "true", "publish_clock": "true"}
# The launch files that include ``base.launch.py``: what they start, and their arguments.
_BASES = {
    "ideal": ("Simulation with ideal joints, without physics.", {"base": "ideal"}),
    "mujoco": (
        "Simulation in MuJoCo, which gives the time of all nodes by /clock.",
        {"base": "mujoco", **_CLOCK},
    ),
    "virtual": ("The real driver on a simulated bus with simulated drives.", {"base": "virtual"}),
    "robot": ("The real robot on its CAN bus.", {"base": "bus"}),
}


def fleet_launch_file(fleet: Fleet) -> str:
    """Return the text of the launch file that starts all robots of a fleet at their places.

    MuJoCo is not among the bases: each base driver would have its own world and its own clock.
    """
    robots = []
    for placement in fleet.placements:
        robot, pose = placement.robot, placement.pose
        w, *xyz = pose.quat
        robots.append((robot.ros.package, robot.namespace, [*pose.xyz, *xyz, w]))
    return _TEMPLATES.render("fleet.launch.py", fleet=fleet.name, robots=robots)


def launch_files(robot: Robot, parts: Parts) -> dict[str, str]:
    """Return the launch files of a robot by their path in the package."""
    names = ["base", "ideal", "mujoco", "teleop"]
    if robot.buses:
        names += ["virtual", "robot"]
    if parts.gnss is not None:
        names.append("gnss")
    if parts.slam is not None:
        names.append("slam")
    if parts.navigation:
        names.append("navigation")
    if robot.actuators:
        names += ["gazebo", "ros2_control"]
    values = _values(robot, parts)
    texts = {}
    for name in names:
        summary, arguments = _BASES.get(name, ("", {}))
        template = "include_base" if name in _BASES else name
        texts[f"launch/{name}.launch.py"] = _TEMPLATES.render(
            f"{template}.launch.py", summary=summary, arguments=arguments, **values
        )
    return texts


def _values(robot: Robot, parts: Parts) -> dict[str, Any]:
    """Return the values that the templates of a robot name."""
    controller = twist_controller(robot)
    odometry = ""
    if controller is not None:
        topics = (controller.odometry_topic, "odometry/base_raw")
        odometry = "({}, {})".format(*(json.dumps(full_topic(robot, topic)) for topic in topics))
    return {
        "package": robot.ros.package,
        "namespace": robot.namespace,
        "model_name": robot.namespace or robot.name,
        "bus": ",".join(f"{bus.name}=socketcan:can{i}" for i, bus in enumerate(robot.buses))
        if len(robot.buses) > 1
        else "socketcan:can0",
        "odom_tf": "false" if robot.ros.odom_tf == EKF else "true",
        "stamped": str(robot.ros.stamped).lower(),
        "teleop_topic": source_topic(robot, "teleop_joy"),
        "local_ekf": parts.local_ekf,
        "gnss_topic": sensor_topic(robot, parts.gnss) if parts.gnss is not None else "",
        "imu_topic": sensor_topic(robot, parts.imu) if parts.imu is not None else "",
        "map_sources": parts.map_sources,
        "localizations": parts.map_sources or ("none",),
        "turns_on_the_spot": Motion(robot).kind != "ackermann",
        "controllers": [c.name for c in controllers(robot) if c.is_released],
        "controller_manager": f"{node_space(robot)}controller_manager",
        "command_topic": controller.command_topic if controller is not None else "",
        "odometry_remapping": odometry,
        "urdf": "robot_gazebo.urdf" if controller is not None else "robot.urdf",
        "gazebo_clock": GAZEBO_CLOCK,
    }
