"""Watchdogs of the drives, which stop the motors if the base driver falls silent."""

from __future__ import annotations

from thorvaldc.model.bus import Node
from thorvaldc.model.robot import Robot

SCRIPT_WATCHDOG = 0.5
"""Time (s) after which the Thorvald script on a Roboteq controller stops the motors, if no motor
command with a new sequence number has arrived."""
_SCRIPT_PROTOCOL = "thorvald_roboteq"


def watchdog_time(node: Node) -> float | None:
    """Returns the time (s) of silence after which a motor controller stops its motors by itself.

    The watchdog of a CANopen node is its heartbeat consumer (object 0x1016).  Returns ``None`` if
    the node has no watchdog.
    """
    if node.heartbeat_consumer_time is not None:
        return node.heartbeat_consumer_time
    return SCRIPT_WATCHDOG if node.protocol.startswith(_SCRIPT_PROTOCOL) else None


def shortest_watchdog(robot: Robot) -> float | None:
    """Returns the shortest watchdog time (s) of all motor controllers of a robot.

    Returns ``None`` if no motor controller of the robot has a watchdog.
    """
    times = [
        time
        for bus in robot.buses
        for node in bus.nodes
        if any(channel.actuator is not None for channel in node.channels)
        and (time := watchdog_time(node)) is not None
    ]
    return min(times, default=None)
