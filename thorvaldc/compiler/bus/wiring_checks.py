"""Checks the connections between the motors and the motor controllers of a robot."""

from __future__ import annotations

from collections.abc import Sequence

from thorvaldc.compiler.bus.device_sections import (
    Device,
    Wire,
    entries,
    listed,
)
from thorvaldc.compiler.modules.module_tree import Instance, name_prefix
from thorvaldc.diagnostics import Label, Report
from thorvaldc.diagnostics.suggest import did_you_mean
from thorvaldc.model import Actuator, Robot
from thorvaldc.model.statics.contact_point import contact_point

_SIDES = (("left", "right", 1), ("front", "rear", 0))
"""Words in the names of channels, and the coordinate that is greater for the first of them."""
_SIDE_TOLERANCE = 1e-3
"""Difference of positions (m) below which two wheels are on the same side."""


def check_wiring(devices: Sequence[Device], actuators: Sequence[Actuator], report: Report) -> None:
    """Checks the connections between motors and motor controllers.

    A motor can be connected to only one motor controller channel, and the channel must have the
    role of the motor.  Reports motors without a motor controller, and motor controllers without a
    motor.
    """
    owners: dict[str, tuple[Device, Wire]] = {}
    for device in devices:
        roles = _roles(device)
        for wire in device.wires:
            motor = wire.actuator
            if wire.channel not in roles:
                report.add(
                    "channel-unknown",
                    f"`{device.path}` has no channel `{wire.channel}`",
                    wire.span,
                    hint=did_you_mean(wire.channel, roles, listed(roles)),
                )
                continue
            if motor.name in owners:
                other, first = owners[motor.name]
                report.add(
                    "motor-conflict",
                    f"the motor `{motor.name}` is on two channels, `{first.channel}` of "
                    f"`{other.path}` and `{wire.channel}` of `{device.path}`",
                    wire.span,
                    labels=[Label(first.span, "first used here")],
                    hint="give each motor one channel",
                )
                continue
            owners[motor.name] = (device, wire)
            if roles[wire.channel] != motor.role:
                report.add(
                    "channel-role",
                    f"the channel `{wire.channel}` of `{device.path}` is for "
                    f"{roles[wire.channel]}, the motor `{motor.name}` for {motor.role}",
                    wire.span,
                    labels=[Label(motor.span, "the motor")],
                )
        if roles and not device.wires:
            report.add(
                "controller-without-motor",
                f"`{device.path}` drives no motor",
                device.span,
                hint="connect one: `channels: {" + next(iter(roles)) + ": <module>.<motor>}`",
            )
    if not any(_roles(device) for device in devices):
        if actuators:
            report.add(
                "robot-without-controller",
                f"none of the {len(actuators)} motors has a controller: "
                "the robot can be simulated, but not driven on a bus",
                actuators[0].span,
            )
        return
    for motor in actuators:
        if motor.name not in owners:
            report.add(
                "motor-without-controller",
                f"the motor `{motor.name}` is on no controller's channel: "
                "it moves in simulation, but not on the bus",
                motor.span,
                hint="add a controller, or connect one that has a free channel",
            )


def check_sides(robot: Robot, root: Instance, report: Report) -> None:
    """Checks that channels named after two sides drive wheels on these sides.

    ``root``: root of the tree of module instances, with the entries of the channels.
    """
    motors = {(motor.node, motor.channel): motor for motor in robot.actuators}
    wheels = {wheel.spin_joint: contact_point(wheel) for wheel in robot.wheels}
    for leaf in root.leaves():
        node = name_prefix(leaf.path)
        for channel, entry in leaf.wiring.items():
            for positive, negative, axis in _SIDES:
                other = channel.replace(positive, negative)
                pair = [motors.get((node, name)) for name in (channel, other)]
                here, there = (wheels.get(m.joint) if m is not None else None for m in pair)
                if here is None or there is None or here[axis] >= there[axis] - _SIDE_TOLERANCE:
                    continue
                report.add(
                    "channel-side",
                    f"the channel `{channel}` of `{leaf.path}` drives the wheel on the {negative} "
                    f"side, and `{other}` that on the {positive} side",
                    entry.where,
                    labels=[Label(leaf.wiring[other].where, "the other channel")],
                    hint="swap the two motors, also on the real controller",
                )


def _roles(device: Device) -> dict[str, str]:
    return {n: device.scope.text(node.get("role")) for n, node in entries(device.channels)}
