"""The loop of teleoperation: sends the operator's commands to the robot and shows the robot's
status.
"""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

from thorvaldc.diagnostics.text_layout import paragraph
from thorvaldc.runtime.control_channel import ControlClient
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist
from thorvaldc.runtime.service_table import ServiceError

FIRST_SHARE = 0.5
"""Initial share of the robot's top speed."""
SMALLEST_SHARE = 0.05
"""Smallest share of the top speed that an operator can select."""


@dataclass(frozen=True, slots=True)
class Limits:
    """The top speeds of a robot, forward, sideways and turning.

    - ``linear``: top speed in m/s.
    - ``angular``: top angular speed in rad/s.
    - ``sideways``: true if the robot can move sideways.
    """

    linear: float
    angular: float
    sideways: bool

    @staticmethod
    def of(description: Mapping[str, Any]) -> Limits:
        """Returns the top speeds of a robot from the result of the service ``description``."""
        return Limits(
            description["max_linear_velocity"],
            description["max_angular_velocity"],
            description["sideways"],
        )

    def twist(self, x: float, y: float, yaw: float, share: float) -> Twist:
        """Returns the twist for the joystick or keyboard inputs ``x``, ``y`` and ``yaw``, each
        between -1 and 1.

        ``share`` is the fraction of the top speeds that the operator has selected.
        """
        lateral = self.linear if self.sideways else 0.0
        return Twist(x * share * self.linear, y * share * lateral, yaw * share * self.angular)


class Request(NamedTuple):
    """A call of a base driver service that the operator requests."""

    service: str
    arguments: Mapping[str, Any]


class Operator(Protocol):
    """A person who drives a robot with a keyboard or a joystick."""

    finished: bool
    """True if the operator has ended the teleoperation."""

    @property
    def share(self) -> float:
        """Fraction of the top speed that the operator has selected, 0 to 1."""

    @share.setter
    def share(self, share: float) -> None: ...

    @property
    def message(self) -> str:
        """A message for the operator, empty if there is no message."""

    def poll(self, now: float) -> list[Request]:
        """Reads all waiting input of the keyboard or joystick and returns the requested service
        calls.

        ``now`` is the monotonic time in s. The method returns immediately if no input is waiting.
        """

    def twist(self, now: float) -> Twist | None:
        """Returns the twist that the operator commands.

        Returns ``None`` if the operator commands no twist, so that another twist source may drive
        the robot.
        """

    def close(self) -> None: ...


WIDTH = 79
INDENT = " " * 7


def status_lines(
    state: Mapping[str, Any], commanded: Twist | None, share: float, message: str
) -> list[str]:
    """Returns the status lines for the operator of a robot, of at most ``WIDTH`` columns.

    The lines are the commanded twist, the twist that the base driver applies with the limit that
    scales it, the pose of the robot, the state of the base driver, the fault, and a message.

    - ``state``: result of the service ``state``.
    - ``commanded``: twist that the operator commands, or ``None``.
    """
    command = _twist_text(commanded) if commanded is not None else "nothing"
    source = state.get("source") or "nobody"
    x, y, yaw = (state["pose"][name] for name in ("x", "y", "yaw"))
    in_force = _twist_text(Twist(**state["in_force"]))
    limit, not_followed = state.get("limited_by"), state.get("not_followed")
    parts = [str(state.get("supervisor") or state["mode"]), f"drives: {source}"]
    if state["locks"]:
        parts.append(f"locked: {', '.join(state['locks'])}")
    if not state["fault"] and state["held"] == "disarmed":
        parts.append("disarmed: press g")
    elif not state["fault"] and state["held"] and state["held"] != parts[0]:
        parts.append(f"held: {state['held']}")
    return [
        f"{share * 100:3.0f} %  commanded {command}",
        f"{INDENT}in force  {in_force}",
        *(_wrapped(f"limited by {limit}") if limit else []),
        *(_wrapped(not_followed) if not_followed and not limit else []),
        f"{INDENT}x {x:z.2f} m  y {y:z.2f} m  yaw {math.degrees(yaw):z.1f} deg",
        *_wrapped("  ".join(parts)),
        *(_wrapped(f"FAULT {state['fault']}") if state["fault"] else []),
        *(_wrapped(message) if message else []),
    ]


def _wrapped(text: str) -> list[str]:
    return paragraph(text, WIDTH, INDENT)


def _twist_text(twist: Twist) -> str:
    return f"{twist.vx:+z.2f} {twist.vy:+z.2f} m/s {twist.wz:+z.2f} rad/s"


REMOTE_PERIOD = 0.05
"""Time in s between two commands to a driver in another process."""


class Vehicle(Protocol):
    """A robot that an operator can drive: a ``DrivenRobot`` of this process, or a remote one."""

    def call(self, service: str, **arguments: Any) -> Any:
        """Calls a service of the base driver and returns the result of the service.

        Raises ``ServiceError`` if the service fails. Raises ``ConnectionError`` if the base driver
        has ended.
        """

    def step(self) -> None:
        """Waits until the next control cycle of the base driver is due and runs the control
        cycle."""

    def shutdown(self) -> None:
        """Stops a robot of this process, and closes the connection to it."""


class RemoteVehicle:
    """A base driver in another process, connected through its control channel."""

    def __init__(self, client: ControlClient, sleep: Callable[[float], None] = time.sleep) -> None:
        self._client = client
        self._sleep = sleep

    def call(self, service: str, **arguments: Any) -> Any:
        return self._client.call(service, **arguments)

    def step(self) -> None:
        self._sleep(REMOTE_PERIOD)

    def shutdown(self) -> None:
        self._client.close()


DRAW_PERIOD = 0.1
"""Time in s between two updates of the status lines."""
STOP_TIME = 2.0
"""Longest time in s that the loop waits at the end until the robot is at rest."""
MESSAGE_TIME = 4.0
"""Time in s for which a message is shown."""
_AT_REST = 1e-3
"""Speed in m/s or rad/s below which the robot counts as at rest."""


class Operation:
    """An operator who drives a robot, one control cycle after the other.

    A source must command zero before it moves the robot.  The operation commands this zero in the
    cycle in which the operator begins: a pressed key or dead-man button is a new command of a
    person.

    - ``source``: name of the operator's twist source in the base driver.
    - ``show``: function that shows the status lines.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        operator: Operator,
        source: str,
        show: Callable[[list[str]], None],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._vehicle, self._operator, self._source = vehicle, operator, source
        self._show, self._clock = show, clock
        self._last_draw = self._message_time = clock() - DRAW_PERIOD
        self._message, self._silent = "", True

    def cycle(self) -> None:
        """Executes the operator's requests, commands the twist, and waits for one control cycle."""
        vehicle, operator = self._vehicle, self._operator
        now = self._clock()
        for request in operator.poll(now):
            self._tell(request.service.replace("_", " "), now)
            try:
                result = vehicle.call(request.service, **request.arguments)
                if isinstance(result, str):
                    self._tell(result, now)
            except ServiceError as error:
                self._tell(str(error), now)
        commanded = operator.twist(now)
        if commanded is not None:
            try:
                publish(vehicle, self._source, ZERO_TWIST if self._silent else commanded)
            except ServiceError as error:  # such as a source that another program publishes
                self._tell(str(error), now)
        self._silent = commanded is None
        vehicle.step()
        if now - self._last_draw >= DRAW_PERIOD:
            self._last_draw = now
            if now - self._message_time > MESSAGE_TIME:
                self._message = ""
            text = operator.message or self._message
            self._show(status_lines(vehicle.call("state"), commanded, operator.share, text))

    def _tell(self, message: str, now: float) -> None:
        self._message, self._message_time = message, now


def operate(
    vehicle: Vehicle,
    operator: Operator,
    source: str,
    show: Callable[[list[str]], None],
    ended: Callable[[], bool] = lambda: False,
    clock: Callable[[], float] = time.monotonic,
) -> None:
    """Drives the robot until the operator finishes or ``ended`` returns true.

    When the operation ends, even with an exception, the robot is commanded to stop.  If the base
    driver runs in this process, its control cycles go on until the robot is at rest.
    """
    operation = Operation(vehicle, operator, source, show, clock)
    try:
        while not (operator.finished or ended()):
            operation.cycle()
    finally:
        stop(vehicle, source, clock)
        with contextlib.suppress(ConnectionError, ServiceError):
            show(status_lines(vehicle.call("state"), None, operator.share, ""))


def publish(vehicle: Vehicle, source: str, twist: Twist) -> None:
    """Sends a commanded twist to the base driver."""
    vehicle.call("twist", source=source, vx=twist.vx, vy=twist.vy, wz=twist.wz)


def stop(vehicle: Vehicle, source: str, clock: Callable[[], float]) -> None:
    """Commands a zero twist until the robot is at rest, for at most ``STOP_TIME`` s."""
    end = clock() + STOP_TIME
    with contextlib.suppress(ConnectionError, ServiceError):
        while clock() < end:
            state = vehicle.call("state")
            at_rest = all(abs(value) < _AT_REST for value in state["in_force"].values())
            # The zero twist must not override another twist source that drives the robot.
            if at_rest or state["source"] not in ("", source):
                return
            publish(vehicle, source, ZERO_TWIST)
            vehicle.step()
