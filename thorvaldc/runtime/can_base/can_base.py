"""A robot's base on its CAN buses."""

from __future__ import annotations

import math
from collections.abc import Mapping

from thorvaldc.can.interface import CanInterface
from thorvaldc.diagnostics.error import DiagnosticError
from thorvaldc.model.buses import require_bus
from thorvaldc.model.robot import Robot
from thorvaldc.runtime.base_interface import BaseHandle, JointCommands, JointStates
from thorvaldc.runtime.can_base.base_state_machine import State, Supervisor, Times
from thorvaldc.runtime.can_base.bus_health import MISS, MISSES, BusLink, unconnected
from thorvaldc.runtime.can_base.motor_controller import Intent

SEND_TIME = 0.25
"""Share of a cycle that may be spent waiting for room in the send queue."""


class CanBase(BaseHandle):
    """The joints over CAN: ``read`` takes in what has come, ``write`` sends a cycle's frames.

    ``write`` sends the commands of every controller in the order of their identifiers,
    then SYNC, then what there is besides, and the master's heartbeat only where all of that
    went out: a loop that hangs or fails falls silent, and the drives stop by themselves.

    Whether the base drives is its ``supervisor``'s to say.  A stop in software is not a safety
    function.
    """

    def __init__(
        self,
        robot: Robot,
        ports: Mapping[str, CanInterface],
        *,
        threaded: bool = True,
        times: Times | None = None,
    ) -> None:
        """``ports`` by the bus's name, on one clock.

        ``threaded``: each port is received from by a thread; in virtual time none may be.
        Raises ``DiagnosticError`` (``bus-driver-unknown``, ``bus-motor-unconnected``,
        ``bus-missing``) for a robot that cannot be driven by its buses.
        """
        require_bus(robot)
        fault = unconnected(robot)
        if fault is not None:
            raise fault
        self.robot = robot
        self.period = min(bus.sync_period for bus in robot.buses)
        """s of a control cycle."""
        self.links: list[BusLink] = []
        try:
            for bus in robot.buses:
                self.links.append(BusLink(robot, bus, ports[bus.name], threaded=threaded))
        except DiagnosticError:
            for link in self.links:
                link.receiver.stop()
            raise
        self.supervisor = Supervisor(self.links, times)
        self.armed = False
        """Whether a command of zero, or none, was seen since it became ready."""
        self.cycles = 0
        """Cycles in which all was sent."""
        self.incomplete = 0
        """Cycles in which it was not."""
        self._axes = [a for link in self.links for c in link.controllers for a in c.axes]
        self._wheels = len(robot.wheels)
        self._moves = False
        self._wait = SEND_TIME * self.period

    @property
    def hold_reason(self) -> str:
        supervisor = self.supervisor
        if supervisor.state in (State.FAULT, State.ESTOP):
            return f"{supervisor.state.value}: {supervisor.reason}"
        if supervisor.ending:
            return "the driver is ending"
        if not supervisor.state.drives:
            return str(supervisor.state.value)
        return "" if self.armed else "a motion was commanded before it was ready"

    @property
    def standing(self) -> bool:
        """Whether no wheel turns and none shall."""
        return not self._moves and all(c.standing for link in self.links for c in link.controllers)

    def read(self, now: float) -> JointStates:
        """All that has come, decoded; joints whose reports are too old are NaN.

        ``time`` is the mean of the times at which the motors were measured.
        """
        for link in self.links:
            link.take(now)
        self.supervisor.update(now)
        if not self.supervisor.state.drives:
            self.armed = False
        n = self._wheels
        speeds, angles, rates = [0.0] * n, [0.0] * n, [0.0] * n
        oldest = now - (MISS + MISSES - 1) * self.period
        total = 0.0
        for axis in self._axes:
            known = axis.time >= oldest
            total += axis.time if known else now
            if axis.steering:
                angles[axis.wheel] = axis.position if known else math.nan
                rates[axis.wheel] = axis.velocity if known else math.nan
            else:
                speeds[axis.wheel] = axis.velocity if known else math.nan
        return JointStates(total / max(len(self._axes), 1), speeds, angles, rates)

    def arm(self, commanded: bool) -> None:
        """Take note of whether a motion is commanded: it may begin only from none."""
        if self.supervisor.state.drives and not commanded:
            self.armed = True

    def write(self, commands: JointCommands, now: float) -> None:
        supervisor = self.supervisor
        follows = supervisor.state.drives and not supervisor.ending
        if follows and not self._aim(commands):
            supervisor.fail("a command was not a finite number")
            supervisor.update(now)
        intent = supervisor.intent
        self._moves = intent is Intent.FOLLOW and any(
            axis.target for axis in self._axes if not axis.steering
        )
        if not supervisor.sends:
            return
        complete = True
        for link in self.links:
            complete = self._send(link, intent, now) and complete
        if complete:
            self.cycles += 1
            for link in self.links:
                link.send_heartbeat(now, supervisor.operational)
        else:
            self.incomplete += 1

    def close(self) -> None:
        """Let go of the ports; nothing is sent any more."""
        for link in self.links:
            link.close()

    # -- inside --------------------------------------------------------------------------------

    def _aim(self, commands: JointCommands) -> bool:
        """Take over the targets; ``False``, and none of them, where one is not finite."""
        finite = math.isfinite
        for axis in self._axes:
            wanted = commands.angles if axis.steering else commands.speeds
            if not finite(wanted[axis.wheel]):
                return False
        for axis in self._axes:
            wanted = commands.angles if axis.steering else commands.speeds
            axis.target = wanted[axis.wheel]
        return True

    def _send(self, link: BusLink, intent: Intent, now: float) -> bool:
        supervisor = self.supervisor
        complete = True
        if supervisor.operational:
            try:
                cyclic = link.cyclic(intent, now) if supervisor.commands else []
            except ValueError as fault:
                supervisor.fail(str(fault))
                return False
            for message in cyclic:
                if not link.send(message, self._wait):
                    complete = False
                    break
            # Half of the commands must not become valid together with SYNC.
            complete = complete and link.send_sync(self._wait)
        for message in link.sporadic(intent, now, supervisor.commands, supervisor.state.drives):
            complete = link.send(message, self._wait) and complete
        link.send_relayed()
        link.failures_in_a_row = 0 if complete else link.failures_in_a_row + 1
        return complete
