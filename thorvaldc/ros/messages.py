"""Converts states of the base driver to ROS messages, and to the statuses on /diagnostics."""

from __future__ import annotations

import importlib
import math
from collections.abc import Mapping
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import Odometry
from sensor_msgs.msg import BatteryState, JointState

from thorvaldc.model import Robot, wheel_joints
from thorvaldc.runtime import se2
from thorvaldc.runtime.base_interface import JointCommands
from thorvaldc.runtime.can_base.base_state_machine import BaseState
from thorvaldc.runtime.can_base.battery_and_io_drivers import BatteryState as ReportedBattery
from thorvaldc.runtime.driven_robot import DrivenRobot
from thorvaldc.runtime.driver import DriveMode, DriverState

OK, WARN, ERROR = (b"\x00", b"\x01", b"\x02")
_MOVABLE = ("continuous", "revolute", "prismatic")


def optional_type(package: str, name: str) -> Any | None:
    """Returns a message type, or ``None`` if its ROS package is not installed."""
    try:
        return getattr(importlib.import_module(f"{package}.msg"), name)
    except ImportError:
        return None


def odometry_message(
    state: DriverState, twist_covariance: se2.Cov3, stamp: Any, odom_frame: str, base_frame: str
) -> Any:
    """Returns the odometry: the pose in ``odom_frame``, the twist in ``base_frame``.

    The covariance of the pose is in the axes of ``odom_frame``, that of the twist in the axes of
    ``base_frame``.
    """
    message = Odometry()
    message.header.stamp, message.header.frame_id = stamp, odom_frame
    message.child_frame_id = base_frame
    _set_pose(message.pose.pose.position, message.pose.pose.orientation, state)
    message.pose.covariance = se2.covariance_numbers(state.pose_covariance, state.pose.yaw)
    twist = message.twist.twist
    linear, angular = twist.linear, twist.angular
    numbers = se2.twist_numbers(state.odometry.twist)
    linear.x, linear.y, linear.z, angular.x, angular.y, angular.z = numbers
    message.twist.covariance = se2.covariance_numbers(twist_covariance)
    return message


def transform_message(state: DriverState, stamp: Any, odom_frame: str, base_frame: str) -> Any:
    """Returns the transform from ``odom_frame`` to ``base_frame``."""
    message = TransformStamped()
    message.header.stamp, message.header.frame_id = stamp, odom_frame
    message.child_frame_id = base_frame
    transform = message.transform
    _set_pose(transform.translation, transform.rotation, state)
    return message


def _set_pose(position: Any, rotation: Any, state: DriverState) -> None:
    numbers = se2.pose_numbers(state.pose)
    position.x, position.y, position.z = numbers[:3]
    rotation.x, rotation.y, rotation.z, rotation.w = numbers[3:]


class JointMessages:
    """Makes joint states of all joints that can move.

    The base does not measure all of them: joints without encoder stand at 0.  Where the base does
    not report positions of the drive joints, they are the integral of the speeds.
    """

    def __init__(self, robot: Robot) -> None:
        drives, steering = wheel_joints(robot)
        joints = [j.name for j in robot.joints if j.type in _MOVABLE]
        self._names = [robot.prefix + name for name in joints]
        self._index = index = {name: i for i, name in enumerate(joints)}
        self._drives = [(index[name], wheel) for name, wheel in drives.items()]
        self._steering = [(index[name], wheel) for name, wheel in steering.items()]
        self._turned = [0.0] * len(robot.wheels)
        self._time = math.nan

    def message(
        self, state: DriverState, stamp: Any, others: Mapping[str, tuple[float, float]] = {}
    ) -> Any | None:
        """Returns a JointState message, or ``None`` while a measurement is missing.

        ``others``: position and speed of joints that the driver does not command.
        """
        joints = state.joints
        if joints is None:
            return None
        dt = state.time - self._time
        self._time = state.time
        measured = joints.positions
        positions, velocities = [0.0] * len(self._names), [0.0] * len(self._names)
        for i, wheel in self._drives:
            speed = velocities[i] = float(joints.speeds[wheel])
            if measured is not None:
                positions[i] = float(measured[wheel])
                continue
            if 0.0 < dt < 1.0:
                self._turned[wheel] += speed * dt
            positions[i] = self._turned[wheel]
        for i, wheel in self._steering:
            positions[i] = float(joints.angles[wheel])
            velocities[i] = float(joints.angle_rates[wheel])
        for name, (position, speed) in others.items():
            if (index := self._index.get(name)) is not None:
                positions[index], velocities[index] = position, speed
        if not all(map(math.isfinite, positions + velocities)):
            return None
        message = JointState()
        message.header.stamp = stamp
        message.name, message.position, message.velocity = self._names, positions, velocities
        return message


def joint_commands_message(robot: Robot, command: JointCommands, stamp: Any) -> Any:
    """Returns the commanded speeds of the drives (rad/s) and angles of the steering (rad).

    A joint has one of the two; the other one is NaN.
    """
    drives, steering = wheel_joints(robot)
    message = JointState()
    message.header.stamp = stamp
    message.name = [robot.prefix + joint for joint in (*drives, *steering)]
    speeds = [float(command.speeds[wheel]) for wheel in drives.values()]
    angles = [float(command.angles[wheel]) for wheel in steering.values()]
    message.velocity = [*speeds, *[math.nan] * len(angles)]
    message.position = [*[math.nan] * len(speeds), *angles]
    return message


def device_message(
    types: tuple[Any, Any], data: Mapping[str, Mapping[str, float]], stamp: Any
) -> Any:
    """Returns the values that devices report: a group for each device, with its values by name.

    ``types``: the types DynamicInterfaceGroupValues and InterfaceValue of control_msgs.
    """
    group_values, interface_value = types
    message = group_values()
    message.header.stamp = stamp
    message.interface_groups = list(data)
    message.interface_values = [
        interface_value(interface_names=list(values), values=list(map(float, values.values())))
        for values in data.values()
    ]
    return message


def battery_message(name: str, battery: ReportedBattery, stamp: Any, frame: str) -> Any:
    """Returns the state of a battery; unknown values are NaN, and a discharge is negative."""
    message = BatteryState()
    message.header.stamp, message.header.frame_id = stamp, frame
    message.location = name
    message.voltage, message.percentage = battery.voltage, battery.charge
    message.current = -battery.current
    message.charge = message.capacity = message.design_capacity = math.nan
    temperatures = battery.temperatures
    message.temperature = max(temperatures) if temperatures else math.nan
    message.present = math.isfinite(battery.time)
    current = battery.current
    if math.isnan(current):
        message.power_supply_status = BatteryState.POWER_SUPPLY_STATUS_UNKNOWN
    elif current > 0.0:
        message.power_supply_status = BatteryState.POWER_SUPPLY_STATUS_DISCHARGING
    elif current < 0.0:
        message.power_supply_status = BatteryState.POWER_SUPPLY_STATUS_CHARGING
    else:
        message.power_supply_status = BatteryState.POWER_SUPPLY_STATUS_NOT_CHARGING
    return message


def diagnostic_status(name: str, hardware: str, level: bytes, text: str, values: Any) -> Any:
    """Returns a status with nested values as one line for each value, such as ``pose.x``."""
    pairs = [KeyValue(key=key, value=value) for key, value in _flat(values)]
    return DiagnosticStatus(
        name=name, hardware_id=hardware, level=level, message=text, values=pairs
    )


def _flat(values: Any, prefix: str = "") -> list[tuple[str, str]]:
    if isinstance(values, dict):
        pairs = [_flat(v, f"{prefix}.{k}" if prefix else str(k)) for k, v in values.items()]
        return [pair for group in pairs for pair in group]
    if isinstance(values, list | tuple):
        return [(prefix, "; ".join(map(str, values)))]
    if isinstance(values, bool):
        return [(prefix, str(values).lower())]
    return [(prefix, f"{values:.6g}" if isinstance(values, float) else str(values))]


# -- the statuses of the node on /diagnostics ---------------------------------------------------

_FAULTS = (BaseState.FAULT.value, BaseState.ESTOP.value)
_LEVELS = {"ok": OK, "warning": WARN, "error": ERROR}
_REFUSING = (DriveMode.TIMED_OUT, DriveMode.WAITING, DriveMode.HELD)


def diagnostic_statuses(name: str, node: Any, robot: DrivenRobot | None) -> list[Any]:
    """Returns the statuses of a ``BaseDriverNode``: driver, commands, timing, nodes of the buses.

    ``name``: full name of the node, which each status begins with.
    """
    hardware = node.model.name
    commands = node.inputs.summary()
    refuses = any(values["reason"] for values in commands.values())
    if node.clock_watch.problem:
        commands["clock"] = node.clock_watch.problem
    commands_text = "some twists were refused" if refuses else "ok"
    if robot is None:
        level, text = (ERROR, node.problem) if node.problem else (WARN, "inactive")
        statuses = [diagnostic_status(f"{name}: driver", hardware, level, text, {})]
    else:
        state = robot.state()
        left_out = ("batteries", "supply", "outputs", "bus_load", "cycles", "overruns", "joints")
        for key in left_out:
            state.pop(key, None)
        state["base"] = node.values["base"]
        state["parameter_set"] = node.values["parameter_set"]
        level, text = _verdict(robot, state)
        statuses = [diagnostic_status(f"{name}: driver", hardware, level, text, state)]
    statuses.append(
        diagnostic_status(
            f"{name}: commands", hardware, WARN if refuses else OK, commands_text, commands
        )
    )
    if robot is not None:
        statuses += _component_statuses(name, hardware, robot)
    return statuses


def _verdict(robot: DrivenRobot, state: dict[str, Any]) -> tuple[bytes, str]:
    mode = robot.driver.state.mode
    if state["fault"]:
        return ERROR, str(state["fault"])
    if state.get("supervisor") in _FAULTS:
        return ERROR, str(state["supervisor"])
    if warnings := state.get("warnings"):
        return WARN, "; ".join(warnings)
    if state.get("paused"):
        return WARN, "the simulation is paused"
    if mode in _REFUSING:
        return WARN, ": ".join(filter(None, (mode.value, state["held"])))
    if state["not_followed"]:
        return WARN, str(state["not_followed"])
    return OK, mode.value


def _component_statuses(name: str, hardware: str, robot: DrivenRobot) -> list[Any]:
    """Returns the statuses of the control loop and of the parts of the base."""
    timing = robot.timing
    times = {
        "cycles": timing.cycles,
        "overruns": timing.overruns,
        "skipped": timing.skipped,
        "latest": timing.latest,
        "longest": timing.longest,
        "gaps": timing.gaps,
        "events": [f"{e.time:.2f} s {e.text}" for e in robot.events[-5:]],
    }
    level, text = WARN if timing.overruns else OK, f"{timing.overruns} overruns"
    return [
        diagnostic_status(f"{name}: timing", hardware, level, text, times),
        *(
            diagnostic_status(
                f"{name}: {part.name}", hardware, _LEVELS[part.level], part.text, dict(part.values)
            )
            for part in robot.base.component_statuses(robot.now)
        ),
    ]
