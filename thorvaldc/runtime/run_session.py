"""A complete run of a robot on its buses, from the start to the shutdown and the summary.

The command ``thorvaldc run`` uses ``RunSession``.  Example of a run in a Python program::

    interfaces = open_interfaces("socketcan:can0", robot)
    session = RunSession(robot, interfaces, twist=Twist(0.5, 0.0, 0.0), duration=10.0)
    diagnostic = session.run(lambda runner, state: print(runner.state))
    print(session.summary())
"""

from __future__ import annotations

import gc
import math
import signal
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from thorvaldc.can.interface import CanInterface
from thorvaldc.diagnostics import CODES, Diagnostic
from thorvaldc.diagnostics.error import DiagnosticError
from thorvaldc.model.robot import Robot
from thorvaldc.runtime.can_base.base_state import BaseState
from thorvaldc.runtime.can_base.can_base import CanBase
from thorvaldc.runtime.control.runner_services import RunnerControl
from thorvaldc.runtime.driver import BaseDriver
from thorvaldc.runtime.runner import BaseRunner, RequestRefused, Watch
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist
from thorvaldc.runtime.time_gap import Gap

UNTESTED = (
    "thorvaldc's driver was never tried on physical hardware. Lift the wheels off the ground first,"
    " keep the emergency stop in reach, and do not rely on any stop in software."
)
"""Safety warning that a program shows before it drives a real robot."""
ARM_TIME = 5.0
"""Longest time (s) from the state READY until a session with a twist has armed the robot."""


class RunSession:
    """A run of a robot, with its runner and its control channel.

    - ``twist``: twist that the session commands while no twist source of the control channel is
      active.  The session arms the robot once for this twist.
    - ``duration``: duration of the run in s, from the time when the robot is ready.
    - ``channel``: name of the control channel, or empty for a run without a control channel.
    """

    def __init__(
        self,
        robot: Robot,
        interfaces: Mapping[str, CanInterface],
        *,
        parameters: str | None = None,
        twist: Twist | None = None,
        duration: float = math.inf,
        channel: str = "",
        threaded: bool = True,
        paced: bool = False,
    ) -> None:
        """Prepares the run with the CAN interfaces of the robot's buses.

        - ``interfaces``: CAN interface of each bus, by the name of the bus.
        - ``threaded``: if ``True``, a thread for each bus reads the received frames.  A robot that
          is simulated in the same process needs ``threaded=False``.
        - ``paced``: if ``True``, the loop waits so that virtual time does not run faster than real
          time.

        The session closes the CAN interfaces at the end of the run.  Raises ``DiagnosticError`` if
        the base cannot be created, and ``OSError`` if the control channel is in use.  The CAN
        interfaces are also closed after an error.
        """
        self.robot = robot
        self.twist = twist
        self.duration = duration
        self.stop_requested = False
        self.refusal = ""
        """Reasons why the robot cannot be armed for ``twist``; empty: it is armed, or not ready."""
        self._unarmed = True
        self._rests = False
        clock = interfaces[robot.buses[0].name]
        try:
            base = CanBase(robot, interfaces, threaded=threaded)
            self.runner: BaseRunner = BaseRunner(robot, base, clock, parameters=parameters)
            self.control = RunnerControl(self.runner, channel)
        except (DiagnosticError, OSError):
            for interface in interfaces.values():
                interface.close()
            raise
        self.runner.feed = self._feed
        self.start_time = clock.now
        self.ready_time = math.nan
        if paced:
            offset = time.monotonic() - clock.now
            self.runner.pace = lambda at: time.sleep(max(offset + at - time.monotonic(), 0.0))

    @property
    def elapsed(self) -> float:
        """Time since the start of the session in s, measured by the clock of the first CAN bus."""
        return self.runner.clock.now - self.start_time

    def run(self, watch: Watch | None = None) -> Diagnostic | None:
        """Runs the robot until the end of the run, then stops it and closes the CAN interfaces.

        The run ends after its duration, after a fault, or at the signal SIGINT or SIGTERM.
        The function ``watch`` is called after each control cycle.  Returns the diagnostic of the
        fault that ended the run, or ``None`` if no fault ended the run.
        """
        # A pause of the garbage collector delays the control loop.  The function gc.freeze excludes
        # all present objects from later garbage collections.
        gc.collect()
        gc.freeze()
        gc.enable()
        with self._signals_handled():
            try:
                self.runner.run(watch=watch, stop=self._is_over)
                diagnostic = self._verdict()
                self.runner.shutdown()
            except BaseException:
                # After an exception, no CAN frame is sent, so the motor controllers stop by their
                # own time-outs.
                self.runner.base.close()
                raise
            finally:
                self.control.close()
        return diagnostic

    def request_stop(self) -> None:
        """Ends the run after the present control cycle.

        A signal handler may call ``request_stop``.
        """
        self.stop_requested = True

    @contextmanager
    def _signals_handled(self) -> Iterator[None]:
        if threading.current_thread() is not threading.main_thread():
            yield
            return
        previous_handlers = {
            number: signal.signal(number, lambda *_: self.request_stop())
            for number in (signal.SIGINT, signal.SIGTERM)
        }
        try:
            yield
        finally:
            for number, handler in previous_handlers.items():
                signal.signal(number, handler)

    def _feed(self, driver: BaseDriver, now: float) -> None:
        """Commands the twist that the control channel selects.

        If no twist source of the control channel is active, the twist of the session is commanded.
        """
        runner = self.runner
        # After a gap in time the robot comes to rest before it follows the twist again.
        if driver.gap_at(now) is not Gap.NONE:
            self._rests = True
        selection = self.control.feed(driver, now)
        if self.twist is None or not runner.ready:
            return
        if self._unarmed:
            self._arm()
        is_free = not selection.source and not selection.locks
        if is_free and runner.base.armed:
            self._rests = self._rests and not runner.base.standing
            driver.command(ZERO_TWIST if self._rests else self.twist, now)

    def _arm(self) -> None:
        """Arms the robot once, because the person has commanded the twist of the session."""
        try:
            self.runner.arm()
            self._unarmed = False
            self.refusal = ""
        except RequestRefused as error:
            self.refusal = str(error)

    def _is_over(self) -> bool:
        runner, now = self.runner, self.runner.clock.now
        if runner.ready and math.isnan(self.ready_time):
            self.ready_time = now
        if self.stop_requested:
            return True
        if self.refusal and now - self.ready_time > ARM_TIME:
            return True
        if runner.state in (BaseState.FAULT, BaseState.ESTOP):
            # With a control channel, an operator can reset a fault, so the run continues after the
            # fault.  A fault ends the run if the run has no control channel, if a CAN bus is lost,
            # or if the robot was never ready.
            unattended = self.twist is not None or self.duration < math.inf
            bus_lost = any(c.receiver.lost for c in runner.base.connections)
            return unattended or bus_lost or not runner.base.state_machine.was_ready
        return now - self.ready_time >= self.duration - 1e-9

    def _verdict(self) -> Diagnostic | None:
        state_machine = self.runner.base.state_machine
        if state_machine.state not in (BaseState.FAULT, BaseState.ESTOP):
            if not self.refusal:
                return None
            message = f"the robot cannot be armed: {self.refusal}"
            return Diagnostic(CODES["bus-start"], message, self.robot.span)
        code, hint = "bus-stopped", None
        if state_machine.mismatch:
            code = "bus-mismatch"
            hint = "is it this robot's file? `thorvaldc can plan` shows the differences"
        elif not state_machine.was_ready:
            code = "bus-start"
        return Diagnostic(CODES[code], state_machine.reason, self.robot.span, hint)

    def status_line(self) -> str:
        """Returns a line of text with the state, twist, pose, battery and timing of the robot."""
        runner = self.runner
        state = runner.driver.state
        twist, pose = state.odometry.twist, state.pose
        parts = [
            f"{runner.state.value:8}",
            *([] if runner.base.armed or not runner.ready else ["disarmed"]),
            f"{twist.vx:+.2f} {twist.vy:+.2f} m/s {twist.wz:+.2f} rad/s",
            f"at {pose.x:.2f} {pose.y:.2f} m {math.degrees(pose.yaw):.0f} deg",
        ]
        batteries = runner.batteries().values()
        charges = [battery.charge for battery in batteries if not math.isnan(battery.charge)]
        if charges:
            parts.append(f"battery {100.0 * min(charges):.0f} %")
        if runner.timing.overruns:
            parts.append(f"{runner.timing.overruns} overruns")
        drops = sum(runner.relay_drops().values())
        if drops:
            parts.append(f"{drops} frames not relayed")
        return "  ".join(parts)

    def summary(self) -> dict[str, Any]:
        """Returns a summary of the run as a dictionary with values in SI units.

        The pose in the summary is relative to the pose at the start of the run.
        """
        runner = self.runner
        state_machine, timing = runner.base.state_machine, runner.timing
        pose = runner.driver.state.pose
        return {
            "robot": self.robot.name,
            "state": runner.state.value,
            "reason": state_machine.reason,
            "was_ready": state_machine.was_ready,
            "armed": runner.base.armed,
            "seconds": self.elapsed,
            "pose": {"x": pose.x, "y": pose.y, "yaw": pose.yaw},
            "timing": {
                "cycles": timing.cycles,
                "overruns": timing.overruns,
                "skipped": timing.skipped,
                "latest": timing.latest,
                "longest": timing.longest,
                "gaps": timing.gaps,
            },
            "buses": {
                connection.bus.name: {
                    "received": connection.receiver.received,
                    "dropped": connection.receiver.dropped,
                    "malformed": connection.malformed,
                    "not_sent": connection.not_sent,
                }
                for connection in runner.base.connections
            },
            "changes": [
                {
                    "time": change.time - self.start_time,
                    "state": change.state.value,
                    "reason": change.reason,
                }
                for change in runner.changes
            ],
            "events": [
                {"time": event.time - self.start_time, "text": event.text}
                for event in runner.events
            ],
            "batteries": {
                name: {
                    "voltage": battery.voltage,
                    "current": battery.current,
                    "charge": battery.charge,
                }
                for name, battery in runner.batteries().items()
            },
            "warnings": runner.warnings(),
            "not_relayed": runner.relay_drops(),
        }
