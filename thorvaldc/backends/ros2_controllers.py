"""The controllers of ros2_control that drive a robot, and their parameters.

The controllers are those of ros2_controllers. Only parameters that exist in every distribution of
``RosSettings`` are used.

Which controller drives the base depends on the wheels (see ``base_controllers``):

- two sides of fixed driven wheels: ``diff_drive_controller``;
- two steered wheels that are not driven, and two fixed driven wheels: the controller
  ``ackermann_steering_controller``;
- all others: no released controller of ros2_controllers computes the joints from a twist. Forward
  controllers pass on the commands of the base driver for each joint.

Both controllers take ``base_link`` to be in the middle of the axle of the fixed wheels. On robots
where it is not, the forward and angular velocity are right, and the pose is that of the axle.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from thorvaldc.backends.ros2_parameters import Parameters
from thorvaldc.backends.ros2_parts import node_space
from thorvaldc.model import Robot, Wheel, wheel_joints
from thorvaldc.model.joint_topics import ANGLE_CONTROLLER, BROADCASTER, SPEED_CONTROLLER
from thorvaldc.model.settings import DRIVER
from thorvaldc.model.sums import float_sum

CONTROLLER_FILE = "config/controllers.yaml"
"""Path of the parameters relative to the shared folder of the package."""
TWIST_COVARIANCE = (0.001, 0.001, 0.001, 0.001, 0.001, 0.03)
"""Diagonal of the covariance of the measured twist, in (m/s)^2 and (rad/s)^2: x, y, z, roll, pitch,
yaw. These are the default values of the original base driver."""
_SAME_LENGTH = 1e-3  # m
_SAME_RADIUS = 0.02  # largest difference of radii that counts as calibration, as a share
_SAME_ANGLE = 1e-3  # rad


class Controller(NamedTuple):
    """A controller of ros2_control.

    - ``name``: name of its node, in the name space of the robot.
    - ``type``: name of its plug-in.
    - ``parameters``: parameters of its node; an empty dictionary for the defaults.
    - ``command_topic``: topic of the twists (TwistStamped) or of the joint commands, relative to
      the name space, or empty.
    - ``odometry_topic``: topic of its odometry, relative to the name space, or empty.
    - ``note``: what the user must know, or empty.
    - ``is_released``: false for a controller that no release of ros2_controllers contains.
    """

    name: str
    type: str
    parameters: Parameters
    command_topic: str = ""
    odometry_topic: str = ""
    note: str = ""
    is_released: bool = True

    @property
    def package(self) -> str:
        """The ROS package with the plug-in."""
        return self.type.partition("/")[0]


def controllers(robot: Robot) -> tuple[Controller, ...]:
    """Return the controllers of a robot: joint states, base, joints of extras.

    Controllers that are not released come last. Do not start them together with the controllers of
    the base: both command the same joints.
    """
    base, swerve = base_controllers(robot)
    # The topic `joint_states` is that of the base driver, where it drives the forward controllers.
    is_standard = any(controller.odometry_topic for controller in base)
    broadcaster = Controller(
        BROADCASTER,
        "joint_state_broadcaster/JointStateBroadcaster",
        {} if is_standard else {"use_local_topics": True},
    )
    return (broadcaster, *base, *_extra_controllers(robot), *swerve)


def controller_parameters(robot: Robot) -> dict[str, dict[str, Parameters]]:
    """Return the parameters of the controller manager and of the controllers.

    The result maps the path of the file in the package to the nodes, and each node to its
    parameters, see ``ros2_parameters.parameter_file``.
    """
    space = node_space(robot)
    manager: Parameters = {"update_rate": max(1, round(robot.driver.rate))}
    nodes: dict[str, Parameters] = {f"{space}controller_manager": manager}
    for controller in controllers(robot):
        manager[controller.name] = {"type": controller.type}
        if controller.parameters:
            nodes[f"{space}{controller.name}"] = controller.parameters
    return {CONTROLLER_FILE: nodes}


def base_controllers(robot: Robot) -> tuple[list[Controller], list[Controller]]:
    """Return the released controllers of the base, and those that are not released."""
    if not any(wheel.driven or wheel.steered for wheel in robot.wheels):
        return [], []
    for problem, make in (
        (diff_drive_problem(robot), _diff_drive),
        (ackermann_problem(robot), _ackermann),
    ):
        if problem is None:
            return [make(robot)], []
    swerve = [_swerve(robot)] if swerve_problem(robot) is None else []
    return _forward(robot), swerve


def twist_controller(robot: Robot) -> Controller | None:
    """Return the released controller that computes the joints of the robot from a twist."""
    for controller in controllers(robot):
        if controller.is_released and controller.odometry_topic:
            return controller
    return None


def control_packages(robot: Robot) -> set[str]:
    """Return the ROS packages with the plug-ins of the controllers and the hardware."""
    packages = {c.package for c in controllers(robot) if c.is_released}
    packages |= {"controller_manager", "mujoco_ros2_control"}
    return packages | ({"gz_ros2_control"} if twist_controller(robot) is not None else set())


# -- which controller ---------------------------------------------------------------


def diff_drive_problem(robot: Robot) -> str | None:
    """Return why ``diff_drive_controller`` cannot drive the robot, or ``None`` if it can."""
    driven = [wheel for wheel in robot.wheels if wheel.driven]
    if any(wheel.steered for wheel in robot.wheels):
        return "it has steered wheels"
    if any(wheel.swivel_joint is not None for wheel in driven):
        return "it has driven casters"
    fixed = [wheel for wheel in robot.wheels if wheel.swivel_joint is None]
    if any(_turned(wheel) for wheel in fixed):
        return "its fixed wheels do not all roll forward"
    left, right = _sides(driven)
    if not left or len(left) != len(right):
        return f"it has {len(left)} driven wheels on the left and {len(right)} on the right"
    distances = [abs(wheel.y) for wheel in driven]
    if max(distances) - min(distances) > _SAME_LENGTH:
        return "its driven wheels have different distances to the centre line"
    if not (_same_radius(left) and _same_radius(right)):
        return "the driven wheels of one side have different radii"
    return None


def ackermann_problem(robot: Robot) -> str | None:
    """Return why ``ackermann_steering_controller`` cannot drive the robot, or ``None`` if it
    can."""
    steered = [wheel for wheel in robot.wheels if wheel.steered]
    driven = [wheel for wheel in robot.wheels if wheel.driven]
    both = [wheel.name for wheel in steered if wheel.driven]
    if both:
        return f"it gives no command to the drives of the steered wheels {', '.join(both)}"
    for what, axle in (("steered", steered), ("driven", driven)):
        left, right = _sides(axle)
        if len(left) != 1 or len(right) != 1:
            return f"it needs one {what} wheel on each side"
        if abs(left[0].x - right[0].x) > _SAME_LENGTH or abs(left[0].y + right[0].y) > _SAME_LENGTH:
            return f"the two {what} wheels are not symmetrical"
    if any(_turned(wheel) or wheel.steering_sign < 0.0 for wheel in (*steered, *driven)):
        return "its wheels do not all roll forward"
    if any(abs(w.trail) > _SAME_LENGTH or abs(w.lateral_offset) > _SAME_LENGTH for w in steered):
        return "the contact points of the steered wheels are beside the steering axes"
    if steered[0].x - driven[0].x < _SAME_LENGTH:
        return "the steered axle is not in front"
    if not _same_radius(driven):
        return "the driven wheels have different radii"
    return None


def swerve_problem(robot: Robot) -> str | None:
    """Return why ``swerve_drive_controller`` cannot drive the robot, or ``None`` if it can."""
    wheels = robot.wheels
    if len(wheels) != 4 or not all(wheel.driven and wheel.steered for wheel in wheels):
        return "it needs four wheels, each driven and steered"
    corners = sorted((wheel.x > 0.0, wheel.y > 0.0) for wheel in wheels)
    first = wheels[0]
    if corners != [(False, False), (False, True), (True, False), (True, True)] or any(
        abs(abs(w.x) - abs(first.x)) > _SAME_LENGTH or abs(abs(w.y) - abs(first.y)) > _SAME_LENGTH
        for w in wheels
    ):
        return "its wheels are not the corners of a rectangle around base_link"
    if any(_turned(wheel) or wheel.steering_sign < 0.0 for wheel in wheels):
        return "its wheels do not all roll forward"
    if any(abs(w.trail) > _SAME_LENGTH or abs(w.lateral_offset) > _SAME_LENGTH for w in wheels):
        return "the contact points of its wheels are beside the steering axes"
    return None if _same_radius(wheels) else "its wheels have different radii"


def _turned(wheel: Wheel) -> bool:
    return abs(math.remainder(wheel.heading, math.tau)) > _SAME_ANGLE


def _sides(wheels: Sequence[Wheel]) -> tuple[list[Wheel], list[Wheel]]:
    left = [wheel for wheel in wheels if wheel.y > _SAME_LENGTH]
    right = [wheel for wheel in wheels if wheel.y < -_SAME_LENGTH]
    return left, right


def _same_radius(wheels: Sequence[Wheel]) -> bool:
    radii = [wheel.radius for wheel in wheels]
    return max(radii) - min(radii) <= _SAME_RADIUS * max(radii)


def _radius(wheels: Sequence[Wheel]) -> float:
    return float_sum(wheel.radius for wheel in wheels) / len(wheels)


# -- their parameters ---------------------------------------------------------------


def _diff_drive(robot: Robot) -> Controller:
    left, right = _sides([wheel for wheel in robot.wheels if wheel.driven])
    radius = _radius(left)
    driver = robot.driver
    (linear, angular), (slowing, angular_slowing) = driver.top_speeds, driver.decelerations
    parameters: Parameters = {
        "left_wheel_names": _spin_joints(robot, left),
        "right_wheel_names": _spin_joints(robot, right),
        "wheel_separation": 2.0 * float_sum(abs(w.y) for w in (*left, *right)) / (2 * len(left)),
        "wheel_radius": radius,
        "right_wheel_radius_multiplier": _radius(right) / radius,
        # The names of the frames begin with the name space already.
        "tf_frame_prefix_enable": False,
        **_odometry(robot),
        "cmd_vel_timeout": driver.command_timeout,
        "linear": {"x": _limits(linear, driver.max_linear_acceleration, slowing)},
        "angular": {"z": _limits(angular, driver.max_angular_acceleration, angular_slowing)},
    }
    notes = []
    fixed = [wheel for wheel in robot.wheels if wheel.swivel_joint is None]
    axle = float_sum(wheel.x for wheel in fixed) / len(fixed)
    if any(abs(wheel.x - axle) > _SAME_LENGTH for wheel in fixed):
        notes.append(
            "the robot turns by skidding, more slowly than the wheels say: set "
            "wheel_separation_multiplier from a turn on your ground"
        )
    notes += _axle_note(robot, axle)
    return Controller(
        "diff_drive_controller",
        "diff_drive_controller/DiffDriveController",
        parameters,
        "diff_drive_controller/cmd_vel",
        "diff_drive_controller/odom",
        "; ".join(notes),
    )


def _odometry(robot: Robot) -> Parameters:
    return {
        "odom_frame_id": f"{robot.prefix}odom",
        "base_frame_id": robot.prefix + robot.links[0].name,
        "enable_odom_tf": robot.ros.odom_tf == DRIVER,
        "position_feedback": True,
        "open_loop": False,
        "twist_covariance_diagonal": TWIST_COVARIANCE,
    }


def _limits(speed: float, acceleration: float, deceleration: float) -> Parameters:
    return {
        "max_velocity": speed,
        "min_velocity": -speed,
        "max_acceleration": acceleration,
        "max_deceleration": -deceleration,
        "max_acceleration_reverse": -acceleration,
        "max_deceleration_reverse": deceleration,
    }


def _ackermann(robot: Robot) -> Controller:
    # The first joint of each pair is the right one.
    steered = sorted((w for w in robot.wheels if w.steered), key=lambda wheel: wheel.y)
    driven = sorted((w for w in robot.wheels if w.driven), key=lambda wheel: wheel.y)
    parameters: Parameters = {
        "traction_joints_names": _spin_joints(robot, driven),
        "steering_joints_names": _steering_joints(robot, steered),
        "wheelbase": steered[0].x - driven[0].x,
        "steering_track_width": steered[1].y - steered[0].y,
        "traction_track_width": driven[1].y - driven[0].y,
        "traction_wheels_radius": _radius(driven),
        "reference_timeout": robot.driver.command_timeout,
        **_odometry(robot),
    }
    return Controller(
        "ackermann_steering_controller",
        "ackermann_steering_controller/AckermannSteeringController",
        parameters,
        "ackermann_steering_controller/reference",
        "ackermann_steering_controller/odometry",
        "; ".join(_axle_note(robot, driven[0].x)),
    )


def _axle_note(robot: Robot, axle: float) -> list[str]:
    if abs(axle) <= _SAME_LENGTH:
        return []
    return [
        f"its pose is that of the middle of the axle, at x = {axle:.3g} m in "
        f"{robot.prefix}{robot.links[0].name}"
    ]


def _swerve(robot: Robot) -> Controller:
    corners = {
        f"{'front' if w.x > 0.0 else 'rear'}_{'left' if w.y > 0.0 else 'right'}": w
        for w in robot.wheels
    }
    parameters: Parameters = {}
    for corner, wheel in corners.items():
        parameters[f"{corner}_wheel_joint"] = robot.prefix + wheel.spin_joint
        parameters[f"{corner}_axle_joint"] = robot.prefix + (wheel.steering_joint or "")
        actuator = robot.actuator_of(wheel.spin_joint)
        if actuator is not None:
            parameters[f"{corner}_velocity_threshold"] = actuator.max_velocity * wheel.radius
    first = robot.wheels[0]
    parameters |= {
        "wheelbase": 2.0 * abs(first.x),
        "trackwidth": 2.0 * abs(first.y),
        "wheel_radius": _radius(robot.wheels),
        "cmd_vel_timeout": robot.driver.command_timeout,
        "odom": f"{robot.prefix}odom",
        "base_footprint": robot.prefix + robot.links[0].name,
        "enable_odom_tf": robot.ros.odom_tf == DRIVER,
        "open_loop": False,
        "twist_covariance_diagonal": TWIST_COVARIANCE,
    }
    return Controller(
        "swerve_drive_controller",
        "swerve_drive_controller/SwerveController",
        parameters,
        "swerve_drive_controller/cmd_vel",
        "swerve_drive_controller/odom",
        "pull request 1694 of ros2_controllers, not released (as of 2026-08); it does not know the "
        "limits of the steering joints",
        is_released=False,
    )


def _forward(robot: Robot) -> list[Controller]:
    """Return the controllers that pass on joint commands: speeds of the drives in rad/s, angles of
    the steering joints in rad, in the order of the wheels."""
    forward = []
    drives, steering = wheel_joints(robot)
    for name, interface, motors in (
        (SPEED_CONTROLLER, "velocity", drives),
        (ANGLE_CONTROLLER, "position", steering),
    ):
        joints = [robot.prefix + joint for joint in motors]
        if joints:
            note = f"diff_drive_controller: {diff_drive_problem(robot)}; "
            note += f"ackermann_steering_controller: {ackermann_problem(robot)}"
            forward.append(_forward_controller(name, interface, joints, note))
    return forward


def _extra_controllers(robot: Robot) -> list[Controller]:
    """Return the controllers of the joints of extras: a trajectory controller for the joints with
    position servos of each extra, and a forward controller for those with velocity servos."""
    groups: dict[tuple[str, str], list[str]] = {}
    for servo in robot.joint_servos:
        module = robot.joint(servo.joint).module.rpartition(".")[2]
        groups.setdefault((module, servo.interface), []).append(robot.prefix + servo.joint)
    additional = []
    for (module, interface), joints in groups.items():
        if interface == "velocity":
            additional.append(
                _forward_controller(f"{module}_velocity_controller", interface, joints)
            )
            continue
        parameters: Parameters = {
            "joints": joints,
            "command_interfaces": [interface],
            "state_interfaces": ["position", "velocity"],
        }
        name = f"{module}_trajectory_controller"
        plugin = "joint_trajectory_controller/JointTrajectoryController"
        additional.append(Controller(name, plugin, parameters, f"{name}/joint_trajectory"))
    return additional


def _forward_controller(name: str, interface: str, joints: list[str], note: str = "") -> Controller:
    # The classes JointGroupVelocityController and JointGroupPositionController, which do the same,
    # are no longer part of ros2_controllers 6.
    plugin = "forward_command_controller/ForwardCommandController"
    parameters: Parameters = {"joints": joints, "interface_name": interface}
    return Controller(name, plugin, parameters, f"{name}/commands", note=note)


def _spin_joints(robot: Robot, wheels: Sequence[Wheel]) -> list[str]:
    return [robot.prefix + wheel.spin_joint for wheel in wheels]


def _steering_joints(robot: Robot, wheels: Sequence[Wheel]) -> list[str]:
    return [robot.prefix + wheel.steering_joint for wheel in wheels if wheel.steering_joint]
