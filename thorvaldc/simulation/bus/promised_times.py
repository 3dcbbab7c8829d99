"""How soon the base driver stops a robot after a fault.

Two judges use these times: the fault matrix, for single faults, and the random missions of the
tests, for combinations of faults.  ``thorvaldc.model.stopping`` states how long a stop then takes.
"""

from __future__ import annotations

import math

from thorvaldc.model import Bus, FrameDefinition, Node, Robot, stopping
from thorvaldc.model.bus_timing import reading_time

FROZEN_STEERING, FROZEN_WHEEL = 1.8, 0.7
"""Longest time (s) until a frozen encoder of a turning motor is detected."""
SWINGING = 5.0
"""Longest time (s) in which a steering joint that swings about a wrong angle is noticed."""
RANDOM_SPEEDS = 1.2
"""Longest time (s) in which random speeds among those that a wheel reports are noticed."""
NOT_FOLLOWING = 1.8
"""Longest time (s) until a drive that ignores its commands is detected."""
CREEPING = 1.2
"""Longest time (s) until a wheel that turns at rest is detected."""
CLIMB = 0.5
"""Longest time (s) from the stop by the base driver until the next rung of ``stop_ladder``, for a
motor that is seen to disobey, or whose motion is unknown."""
SECOND_DEVICE = 0.6
"""Longest time (s) until a second device or false reports are detected."""
SLOW = 3.0
"""Longest time (s) until a state that is read now and then is detected."""


def rest_after(robot: Robot, delay: float, kind: str) -> tuple[float, float]:
    """Returns the longest time (s) and distance (m) until a robot stands after a fault.

    - ``delay``: time (s) in which the robot may drive on at its top speed;
    - ``kind``: kind of the stop that follows, one of ``stopping.KINDS``.
    """
    stop = {bound.kind: bound for bound in stopping.stop_bounds(robot)}[kind]
    choices = [robot.driver, *(parameters.driver for parameters in robot.parameter_sets)]
    speed = max(choice.max_linear_velocity for choice in choices)
    return delay + stop.time, speed * delay + stop.distance


class PromisedTimes:
    """Longest times (s) that depend on the robot, for a fault of one motor controller.

    - ``prompt``: until a frame that reports the fault has an effect;
    - ``silence``, ``beats``: until missing reports, missing heartbeats have one;
    - ``reading``: until an object with another value has been read;
    - ``watchdog``: until the drives brake by themselves; infinite if motors only coast;
    - ``timeout``: until the wheels brake after the last command of a client.
    """

    def __init__(self, robot: Robot, bus: Bus, node: Node) -> None:
        self._sent = [frame for frame in bus.frames if frame.producer == node.name]
        self.cycle = min(b.sync_period for b in robot.buses)
        bounds = {bound.kind: bound for bound in stopping.stop_bounds(robot)}
        heartbeats = [frame.period for frame in self.sent("heartbeat") if frame.period]
        self.prompt = bounds[stopping.DETECTED_FAULT].reaction + self.cycle
        self.beats = stopping.HEARTBEAT_TIMEOUT * max(heartbeats, default=0.0) + self.prompt
        self.silence = bounds[stopping.DRIVE_DEAD].reaction
        coasts = math.isinf(bounds[stopping.DRIVER_DEAD].time)
        self.watchdog = math.inf if coasts else bounds[stopping.DRIVER_DEAD].reaction
        self.timeout = bounds[stopping.COMMAND_TIMEOUT].reaction
        self.reading = reading_time(bus, self.cycle) + self.prompt

    def sent(self, kind: str) -> list[FrameDefinition]:
        """Returns the frames of a kind that the motor controller sends."""
        return [frame for frame in self._sent if frame.kind == kind]
