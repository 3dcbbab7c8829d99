"""ROS 2 parameters of the nodes that every robot has: base driver, multiplexer, teleoperation and
robot_state_publisher.

The page docs/ros2.md describes each ROS 2 parameter.
"""

from __future__ import annotations

from thorvaldc.backends.ros2_parameter_file import Value
from thorvaldc.backends.ros2_parts import Parts, base_frame, odom_frame
from thorvaldc.model import Robot
from thorvaldc.model.settings import DRIVER, FOR_FILTERS

TELEOP_SHARE = 0.5  # speed without the turbo button, as a fraction of the robot's limits

Parameters = dict[str, Value]


def base_driver(robot: Robot, parts: Parts) -> Parameters:
    """Return the ROS 2 parameters of the base driver.

    The launch files set the base, the bus and the path of the model file. The base driver reads
    everything else from the model file.
    """
    # An EKF takes the errors of the twists as independent.
    covariance = {"twist_covariance": FOR_FILTERS} if parts.localization else {}
    return {
        "stamped": robot.ros.stamped,
        "enable_odom_tf": robot.ros.odom_tf == DRIVER,
        "odom_frame_id": odom_frame(robot),
        "base_frame_id": base_frame(robot),
        "publish_description": False,  # robot_state_publisher publishes it
        "autostart": True,
        **covariance,
    }


def twist_mux(robot: Robot) -> Parameters:
    """Return the ROS 2 parameters of twist_mux: the twist sources and the stop locks of the robot.

    Only robots that the controllers of ros2_control drive need the node twist_mux. These
    controllers take stamped twists in every distribution. The parameters of twist_mux contain no
    empty lists.
    """
    lists = {"topics": robot.twist_sources, "locks": robot.twist_locks}
    parameters: Parameters = {"use_stamped": True}
    for key, inputs in lists.items():
        if inputs:
            parameters[key] = {
                i.name: {"topic": i.topic, "timeout": i.timeout, "priority": i.priority}
                for i in inputs
            }
    return parameters


def is_holonomic(robot: Robot) -> bool:
    """Return whether the robot can move sideways: every wheel can steer or swivel."""
    turns = [wheel.steered or wheel.swivel_joint is not None for wheel in robot.wheels]
    return bool(turns) and all(turns)


def teleop(robot: Robot, stamped: bool) -> Parameters:
    """Return the ROS 2 parameters of teleop_twist_joy.

    The axes and buttons are those of the node ``game_controller_node``, which has one layout for
    all pads. The scales of the axes come from the velocity limits of the robot. Pads of every make
    have the buttons for the enabling switch, the upper left and right shoulder buttons.

    ``stamped`` is true for twists of the type TwistStamped.
    """
    linear, angular = robot.driver.max_linear_velocity, robot.driver.max_angular_velocity
    sideways = linear if is_holonomic(robot) else 0.0

    def scales(share: float) -> tuple[dict[str, float], dict[str, float]]:
        return {"x": share * linear, "y": share * sideways}, {"yaw": share * angular}

    slow, fast = scales(TELEOP_SHARE), scales(1.0)
    return {
        "publish_stamped_twist": stamped,
        "frame": base_frame(robot),
        "require_enable_button": True,
        "enable_button": 9,
        "enable_turbo_button": 10,
        "inverted_reverse": False,
        "axis_linear": {"x": 1, "y": 0},
        "axis_angular": {"yaw": 2},
        "scale_linear": slow[0],
        "scale_linear_turbo": fast[0],
        "scale_angular": slow[1],
        "scale_angular_turbo": fast[1],
    }


def game_controller(robot: Robot) -> Parameters:
    """Return the ROS 2 parameters of the node that reads the pad.

    The node repeats the state of the pad often enough that the source does not time out.
    """
    source = next((s for s in robot.twist_sources if s.name == "teleop_joy"), None)
    timeout = source.timeout if source is not None else robot.driver.command_timeout
    return {"deadzone": 0.1, "autorepeat_rate": min(max(20.0, 5.0 / timeout), 1000.0)}


def robot_state_publisher(robot: Robot) -> Parameters:
    """Return the ROS 2 parameters of robot_state_publisher.

    The parameter ``frame_prefix`` is empty, because the names in the URDF already begin with the
    name space of the robot. The launch file reads the URDF.
    """
    return {
        "frame_prefix": "",
        "publish_frequency": robot.driver.rate,
        "ignore_timestamp": False,
    }
