"""Parameter files of the robot's ROS 2 nodes: base driver, multiplexer, teleop, description.

The page docs/ros2.md describes each ROS 2 parameter.
"""

from __future__ import annotations

from collections.abc import Callable

from thorvaldc.backends import Backend
from thorvaldc.backends.ros2_parameter_file import Value, parameter_file
from thorvaldc.backends.urdf import urdf_text
from thorvaldc.model import Robot
from thorvaldc.model.robot import Actuator, Joint, Wheel

# Diagonal of the covariance matrix of the measured twist, with the default values of the original
# base driver.
TWIST_COVARIANCE = (0.001, 0.001, 0.001, 0.001, 0.001, 0.03)
TELEOP_SHARE = 0.5  # speed without the turbo button, as a fraction of the robot's limits

Parameters = dict[str, Value]


class Ros2(Backend):
    name = "ros2"
    summary = "parameter files of the base driver, twist_mux, teleop and robot_state_publisher"

    def emit(self, robot: Robot) -> dict[str, bytes]:
        nodes: dict[str, tuple[str, Callable[[Robot], Parameters]]] = {
            "base_driver": ("base_driver", base_driver),
            "twist_mux": ("twist_mux", twist_mux),
            "teleop_twist_joy": ("teleop_twist_joy_node", teleop),
            "robot_state_publisher": ("robot_state_publisher", robot_state_publisher),
        }
        space = f"/{robot.namespace}/" if robot.namespace else ""
        return {
            f"ros2/config/{file}.yaml": parameter_file({space + node: make(robot)}).encode()
            for file, (node, make) in nodes.items()
        }


def base_driver(robot: Robot) -> Parameters:
    """Return the ROS 2 parameters of the base driver.

    A list parameter of the base driver has one value for each wheel.
    """
    driver, prefix = robot.driver, _prefix(robot)
    parameters: Parameters = {
        "robot_name": robot.name,
        "rate": driver.rate,
        "command_timeout": driver.command_timeout,
        "simple_sim": False,
        "tf_prefix": robot.namespace,
        "base_frame_id": "base_link",
        "odom_frame_id": "odom",
        "enable_odom_tf": True,
        "twist_covariance": TWIST_COVARIANCE,
        "max_linear_velocity": driver.max_linear_velocity,
        "max_angular_velocity": driver.max_angular_velocity,
        "max_linear_acceleration": driver.max_linear_acceleration,
        "max_angular_acceleration": driver.max_angular_acceleration,
        "base_calculator": robot.calculator.name,
    }
    if robot.calculator.options:
        parameters["base_calculator_options"] = dict(robot.calculator.options)
    sets: dict[str, Parameters] = {}
    for parameter_set in robot.parameter_sets:
        limits = parameter_set.driver
        values: Parameters = {
            "max_linear_velocity": limits.max_linear_velocity,
            "max_angular_velocity": limits.max_angular_velocity,
            "max_linear_acceleration": limits.max_linear_acceleration,
            "max_angular_acceleration": limits.max_angular_acceleration,
        }
        if parameter_set.radii is not None:
            values["radii"] = parameter_set.radii
        sets[parameter_set.name] = values
    if sets:
        parameters["parameter_sets"] = sets
    if robot.buses:
        parameters["can_interface_type"] = "socketcan"
        parameters["can_interface_name"] = "can0"
    if len(robot.buses) > 1:
        parameters["can_bus_names"] = [bus.name for bus in robot.buses]
        parameters["can_interface_names"] = [f"can{i}" for i, _ in enumerate(robot.buses)]
    if robot.wheels:
        parameters["wheels"] = _wheels(robot, prefix)
    return parameters


def _wheels(robot: Robot, prefix: str) -> Parameters:
    wheels = robot.wheels
    joints = {joint.name: joint for joint in robot.joints}
    actuators = {actuator.joint: actuator for actuator in robot.actuators}

    def of_actuator(joint: str | None, read: Callable[[Actuator], float]) -> float:
        actuator = actuators.get(joint) if joint is not None else None
        return read(actuator) if actuator is not None else 0.0

    def limit(wheel: Wheel, read: Callable[[Joint], float | None]) -> float:
        joint = joints.get(wheel.steering_joint or "")
        return (read(joint) if joint is not None else None) or 0.0

    def is_limited(wheel: Wheel) -> bool:
        joint = joints.get(wheel.steering_joint or "")
        return joint is not None and joint.lower is not None and joint.upper is not None

    parameters: Parameters = {
        "names": [w.name for w in wheels],
        "propulsion_joints": [prefix + w.spin_joint for w in wheels],
        "steering_joints": [prefix + w.steering_joint if w.steering_joint else "" for w in wheels],
        "driven": [w.driven for w in wheels],
        "steered": [w.steered for w in wheels],
        "swivel": [w.swivel_joint is not None for w in wheels],
        "x": [w.x for w in wheels],
        "y": [w.y for w in wheels],
        "heading": [w.heading for w in wheels],
        "steering_sign": [w.steering_sign for w in wheels],
        "trail": [w.trail for w in wheels],
        "lateral_offset": [w.lateral_offset for w in wheels],
        "radius": [w.radius for w in wheels],
        "width": [w.width for w in wheels],
        "max_velocity": [of_actuator(w.spin_joint, lambda a: a.max_velocity) for w in wheels],
        "max_acceleration": [
            of_actuator(w.spin_joint, lambda a: a.max_acceleration) for w in wheels
        ],
        "steering_limited": [is_limited(w) for w in wheels],
        "steering_lower": [limit(w, lambda j: j.lower) for w in wheels],
        "steering_upper": [limit(w, lambda j: j.upper) for w in wheels],
        "steering_max_velocity": [
            of_actuator(w.steering_joint, lambda a: a.max_velocity) for w in wheels
        ],
        "steering_max_acceleration": [
            of_actuator(w.steering_joint, lambda a: a.max_acceleration) for w in wheels
        ],
    }
    names = dict.fromkeys(name for wheel in wheels for name, _ in wheel.radii)
    if names:
        parameters["radii"] = {name: [w.radius_named(name) for w in wheels] for name in names}
    return parameters


def twist_mux(robot: Robot) -> Parameters:
    """Return the ROS 2 parameters of twist_mux: the twist sources and the stop locks of the robot.

    The parameters of twist_mux contain no empty lists.
    """
    lists = {"topics": robot.twist_sources, "locks": robot.twist_locks}
    parameters: Parameters = {"use_stamped": False}
    for key, inputs in lists.items():
        if inputs:
            parameters[key] = {
                i.name: {"topic": i.topic, "timeout": i.timeout, "priority": i.priority}
                for i in inputs
            }
    return parameters


def teleop(robot: Robot) -> Parameters:
    """Return the ROS 2 parameters of teleop_twist_joy.

    The scales of the joystick axes come from the velocity limits of the robot. The robot moves
    sideways only if every wheel can steer or swivel.
    """
    linear, angular = robot.driver.max_linear_velocity, robot.driver.max_angular_velocity
    turns = [w.steered or w.swivel_joint is not None for w in robot.wheels]
    sideways = linear if turns and all(turns) else 0.0

    def scales(share: float) -> tuple[dict[str, float], dict[str, float]]:
        return {"x": share * linear, "y": share * sideways}, {"yaw": share * angular}

    slow, fast = scales(TELEOP_SHARE), scales(1.0)
    return {
        "publish_stamped_twist": False,
        "require_enable_button": True,
        "enable_button": 4,
        "enable_turbo_button": 5,
        "inverted_reverse": False,
        "axis_linear": {"x": 1, "y": 0},
        "axis_angular": {"yaw": 3},
        "scale_linear": slow[0],
        "scale_linear_turbo": fast[0],
        "scale_angular": slow[1],
        "scale_angular_turbo": fast[1],
    }


def robot_state_publisher(robot: Robot) -> Parameters:
    """Return the ROS 2 parameters of robot_state_publisher.

    The parameter ``frame_prefix`` is empty, because the names in the URDF already begin with the
    name space of the robot.
    """
    return {
        "robot_description": urdf_text(robot),
        "frame_prefix": "",
        "publish_frequency": robot.driver.rate,
        "ignore_timestamp": False,
    }


def _prefix(robot: Robot) -> str:
    return robot.prefix
