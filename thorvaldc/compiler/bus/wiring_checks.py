"""Checks the connections between the motors and the motor controllers of a robot."""

from __future__ import annotations

from collections.abc import Sequence

from thorvaldc.compiler.bus.device_sections import (
    Device,
    Wire,
    entries,
    listed,
)
from thorvaldc.diagnostics import Label, Report
from thorvaldc.diagnostics.suggest import did_you_mean
from thorvaldc.model.robot import Actuator


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


def _roles(device: Device) -> dict[str, str]:
    return {n: device.scope.text(node.get("role")) for n, node in entries(device.channels)}
