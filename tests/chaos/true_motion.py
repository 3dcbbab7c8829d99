"""The true motion of the simulated robot, from its motors and not from its reports."""

from __future__ import annotations

import math
from typing import Any

from thorvaldc.can.canopen import NmtState
from thorvaldc.model import Robot
from thorvaldc.runtime.se2 import Twist
from thorvaldc.simulation.bus.canopen_device import CanopenDevice
from thorvaldc.simulation.bus.simulated_robot import SimulatedRobot


class TrueMotion:
    """The wheels of a robot with their simulated motors and drives."""

    def __init__(self, robot: Robot, simulated: SimulatedRobot) -> None:
        self._timeline = simulated.timeline
        self.retaken_speed = 0.0
        """Speed (m/s) of the fastest wheel that rolled out until its drive took it again, between
        the last two calls of ``driven_speed``."""
        self._rolling: set[str] = set()
        nodes = {c.actuator: n.name for b in robot.buses for n in b.nodes for c in n.channels}

        def motor_of(joint: str | None) -> Any:
            actuator = robot.actuator_of(joint) if joint is not None else None
            return simulated.motors[actuator.name] if actuator is not None else None

        self._motors = [
            (
                wheel,
                simulated.motors[spin.name],
                motor_of(wheel.steering_joint),
                simulated.devices[nodes[spin.name]],
            )
            for wheel in robot.wheels
            if (spin := robot.actuator_of(wheel.spin_joint)) is not None
        ]

    def driven_speed(self) -> float:
        """Returns the speed (m/s) of the fastest wheel that its drive moves or should brake.

        A wheel whose drive has no power, or has left the NMT state operational, only rolls out,
        until its motor has torque again.
        """
        now = self._timeline.seconds
        driven, rolling = 0.0, set()
        self.retaken_speed = 0.0
        for wheel, motor, _, drive in self._motors:
            speed = abs(motor.read(now).velocity) * wheel.radius
            has_rolled = wheel.name in self._rolling
            if not motor.has_power and (has_rolled or not _is_operational(drive)):
                rolling.add(wheel.name)
                continue
            driven = max(driven, speed)
            if has_rolled:
                self.retaken_speed = max(self.retaken_speed, speed)
        self._rolling = rolling
        return driven

    def twist(self) -> Twist:
        """Returns the twist of the robot that fits the motion of the wheels best."""
        now, n = self._timeline.seconds, len(self._motors)
        sx = sy = squares = sum_c = sum_s = moment = 0.0
        for wheel, motor, steering, _ in self._motors:
            angle = wheel.heading
            if steering is not None:
                angle += wheel.steering_sign * steering.read(now).position
            speed = motor.read(now).velocity * wheel.radius
            c, s = speed * math.cos(angle), speed * math.sin(angle)
            x, y = wheel.x, wheel.y
            sx, sy, squares = sx + x, sy + y, squares + x * x + y * y
            sum_c, sum_s, moment = sum_c + c, sum_s + s, moment + x * s - y * c
        wz = (moment + sy * sum_c / n - sx * sum_s / n) / (squares - (sx * sx + sy * sy) / n)
        return Twist((sum_c + sy * wz) / n, (sum_s - sx * wz) / n, wz)


def _is_operational(device: object) -> bool:
    return (
        isinstance(device, CanopenDevice)
        and device.powered
        and device.state is NmtState.OPERATIONAL
    )
