"""A complete run of a robot on its buses, from the start to the shutdown and the summary.

The command ``thorvaldc run`` uses ``RunSession``.  Example of a run in a Python program::

    interfaces = open_interfaces("socketcan:can0", robot)
    session = RunSession(robot, interfaces, twist=Twist(0.5, 0.0, 0.0), duration=10.0)
    diagnostic = session.run(lambda driven, state: print(state.mode))
    print(session.summary())
"""

from __future__ import annotations

import contextlib
import gc
import math
import time
from collections.abc import Callable, Mapping
from typing import Any

from thorvaldc.can.frame import CanInterface
from thorvaldc.diagnostics import CODES, Diagnostic, DiagnosticError
from thorvaldc.model import Robot, TwistInput
from thorvaldc.runtime.base_interface import RequestRefused
from thorvaldc.runtime.can_base.base_fault import Cause
from thorvaldc.runtime.can_base.base_state_machine import BaseState, StateChange
from thorvaldc.runtime.can_base.can_base import CanBase
from thorvaldc.runtime.driven_robot import DrivenRobot, Watch
from thorvaldc.runtime.driver import BaseDriver, DriverState
from thorvaldc.runtime.pace import end_signals
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist
from thorvaldc.runtime.service_notify import LowBattery, ServiceNotifier

UNTESTED = (
    "thorvaldc's driver was never tried on physical hardware. Lift the wheels off the ground first,"
    " keep the emergency stop in reach, and do not rely on any stop in software."
)
"""Safety warning that a program shows before it drives a real robot."""
ARM_TIME = 5.0
"""Longest time (s) for which a session with a twist tries to arm the robot."""
SOURCE = "run"
"""Name of the twist source of a session, below all sources of the robot file."""


class RunSession:
    """A run of a robot on its buses, with its control channel.

    - ``driven``: the driven robot, over the base ``base``.
    - ``twist``: twist that the session commands until it is ineffective for whatever reason.  The
      session arms the robot once for this twist.
    - ``twist_ended``: reason why the twist has ended, or an empty text.
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
        self._end_signalled: Callable[[], bool] = lambda: False
        self.refusal = ""
        """Reasons why the robot cannot be armed for ``twist``; empty: it is armed, or not ready."""
        self.refused_since = math.nan
        """Time (s) since which the robot cannot be armed."""
        self.waits_for = ""
        """Why the start-up begins again and again: drives get their power after the computer."""
        self.twist_ended = ""
        self._was_armed = False
        clock = interfaces[robot.buses[0].name]
        factor = (1.0 if paced else None) if not threaded else None
        try:
            self.base = CanBase(robot, interfaces, threaded=threaded)
            self.driven = DrivenRobot(
                robot, self.base, clock, factor=factor, parameters=parameters, channel=channel
            )
        except (DiagnosticError, OSError):
            for interface in interfaces.values():
                interface.close()
            raise
        if twist is not None:
            self.driven.multiplexer.add_source(
                TwistInput(SOURCE, "", 0, self.driven.driver.settings.command_timeout)
            )
            self.driven.feed = self._feed
        self.start_time = self.driven.start_time
        self.ready_time = math.nan

    @property
    def elapsed(self) -> float:
        """Time since the start of the session in s, measured by the clock of the first CAN bus."""
        return self.driven.now - self.start_time

    def run(self, watch: Watch | None = None) -> Diagnostic | None:
        """Runs the robot until the end of the run, then stops it and closes the CAN interfaces.

        The run ends after its duration, after a fault, or at one of the signals ``END_SIGNALS``.
        The function ``watch`` is called after each control cycle.  Returns the diagnostic of the
        fault that ended the run, or ``None`` if no fault ended the run.
        """
        # A pause of the garbage collector delays the control loop.  The function gc.freeze excludes
        # all present objects from later garbage collections.
        gc.collect()
        gc.freeze()
        gc.enable()
        notifier, low_battery = ServiceNotifier(), LowBattery(self.robot)

        def after_cycle(driven: DrivenRobot, state: DriverState) -> None:
            notifier.cycle_done(time.monotonic())
            low_battery.cycle_done(driven)
            if watch is not None:
                watch(driven, state)

        with end_signals() as self._end_signalled, contextlib.closing(notifier):
            try:
                self.driven.run(watch=after_cycle, stop=self._is_over)
                diagnostic = self._verdict()
                notifier.close()  # no cycle follows while the robot stops, which may take longer
                self.driven.shutdown()
            except BaseException:
                # After an exception, no CAN frame is sent, so the motor controllers stop by their
                # own time-outs.
                self.driven.close()
                raise
        return diagnostic

    def request_stop(self) -> None:
        """Ends the run after the present control cycle."""
        self.stop_requested = True

    def _feed(self, driver: BaseDriver, now: float) -> None:
        """Publishes the twist of the session as the source of the lowest priority.

        As every source it commands zero first.  Nobody repeats the request of the command line, so
        that it ends as soon as another zero would be required: after a gap in time, a lock, another
        source, or an arming by another program.
        """
        driven = self.driven
        if not driven.armed:
            if not self._was_armed and (driven.ready or not self.base.is_homed):
                self._arm()
            return
        twist = self.twist if self._was_armed and self.twist is not None else ZERO_TWIST
        self._was_armed = True
        driven.multiplexer.publish(SOURCE, twist, now)
        if reason := driven.multiplexer.awaited_zeros(now).get(SOURCE):
            self.twist, self.twist_ended = ZERO_TWIST, reason
            driven.note(f"the twist has ended: {reason}")

    def _arm(self) -> None:
        """Arms the robot, because the person has commanded the twist of the session."""
        try:
            self.driven.arm()
            self.refusal = ""
        except RequestRefused as error:
            if not self.refusal:
                self.refused_since = self.driven.now
            self.refusal = str(error)

    def _is_over(self) -> bool:
        base, now = self.base, self.driven.now
        waits = self.twist is None and not self.driven.channel
        started = self.driven.ready or (waits and base.state is BaseState.STANDBY)
        if started and math.isnan(self.ready_time):
            self.ready_time = now
        if self.stop_requested or self._end_signalled():
            return True
        if self.refusal and now - self.refused_since > ARM_TIME:
            return True
        if self._waits():
            return False
        if self.twist_ended and not self.driven.channel:
            return True  # no program can command another twist
        if base.state in (BaseState.FAULT, BaseState.ESTOP):
            # With a control channel, an operator can reset a fault, so the run continues after the
            # fault.  A fault ends the run if the run has no control channel, if a CAN bus is lost,
            # or if the robot was never ready.
            return self._is_unattended or bool(base.lost) or not base.state_machine.was_started
        return now - self.ready_time >= self.duration - 1e-9

    @property
    def _is_unattended(self) -> bool:
        return self.twist is not None or self.duration < math.inf

    def _waits(self) -> bool:
        """Begins the start-up again while controllers send nothing yet; the robot is disarmed.

        A run that drives by itself does not wait: nobody expects the motion when the power comes.
        """
        base, fault = self.base, self.base.state_machine.fault
        if self._is_unattended or base.lost or fault is None or fault.cause is not Cause.ABSENT:
            if base.state not in (BaseState.INIT, BaseState.PREOP):
                self.waits_for = ""
            return False
        again, self.waits_for = fault.text == self.waits_for, fault.text
        with contextlib.suppress(RequestRefused):  # a motion is commanded: wait for zero, too
            self.driven.reset()
            if again:
                del base.changes[-2:]  # the same fault and the same start as before
        return True

    def is_news(self, change: StateChange) -> bool:
        """Checks whether a change of the state is not one of a start-up that begins again."""
        again = change.state is BaseState.PREOP or change.reason == self.waits_for
        return not (self.waits_for and again)

    def _verdict(self) -> Diagnostic | None:
        state_machine = self.base.state_machine
        code = self.base.fault_code
        if code is None:
            if self.refusal:
                message = f"the robot cannot be armed: {self.refusal}"
                return Diagnostic(CODES["bus-start"], message, self.robot.span)
            if self.twist_ended and not self.driven.channel:
                message = f"the twist has ended: {self.twist_ended}"
                return Diagnostic(CODES["bus-stopped"], message, self.robot.span)
            return None
        hint = None
        if state_machine.mismatch:
            hint = (
                "is it this robot's file? `thorvaldc can plan` shows the differences, and"
                " `thorvaldc can identify FOLDER` finds the file of this robot"
            )
        return Diagnostic(code, state_machine.reason, self.robot.span, hint)

    def status_line(self) -> str:
        """Returns a line of text with the state, twist, pose, battery and timing of the robot.

        With the time before it, the line of an armed robot fits in 79 columns.
        """
        driven, base = self.driven, self.base
        state = driven.driver.state
        twist, pose = state.odometry.twist, state.pose
        if self.waits_for:
            return f"waits: {self.waits_for}"
        parts = [base.state.value]
        waits = base.state is BaseState.STANDBY and not base.state_machine.ending
        if waits or (driven.ready and not driven.armed):
            # The operator needs to know how to go on, and the robot stands where it was.
            arm = f": `thorvaldc call {driven.channel.name} arm`" if driven.channel else ""
            parts.append(f"{'not homed' if waits else 'disarmed'}{arm}")
        else:
            parts += [
                f"{twist.vx:+z.2f} {twist.vy:+z.2f} m/s {twist.wz:+z.2f} rad/s",
                f"{pose.x:z.1f} {pose.y:z.1f} m {math.degrees(pose.yaw):z.0f} deg",
            ]
        charges = [s.charge for s in base.sources() if not math.isnan(s.charge)]
        if charges:
            parts.append(f"battery {100.0 * min(charges):.0f} %")
        if state.not_followed:
            parts.append(state.not_followed)
        if driven.timing.overruns:
            parts.append(f"{driven.timing.overruns} overruns")
        drops = sum(base.nodes.relay_drops().values())
        if drops:
            parts.append(f"{drops} frames not relayed")
        return "  ".join(parts)

    def summary(self) -> dict[str, Any]:
        """Returns a summary of the run as a dictionary with values in SI units.

        The pose in the summary is relative to the pose at the start of the run.
        """
        driven, base = self.driven, self.base
        state_machine, timing = base.state_machine, driven.timing
        pose = driven.driver.state.pose
        return {
            "robot": self.robot.name,
            "state": base.state.value,
            "reason": state_machine.reason,
            "was_ready": state_machine.was_ready,
            "armed": driven.armed,
            "seconds": self.elapsed,
            "pose": pose._asdict(),
            "timing": {
                name: getattr(timing, name)
                for name in ("cycles", "overruns", "skipped", "latest", "longest", "gaps")
            },
            "buses": {c.bus.name: c.counters for c in base.connections},
            "changes": [
                {
                    "time": change.time - self.start_time,
                    "state": change.state.value,
                    "reason": change.reason,
                }
                for change in base.changes
            ],
            "events": [
                {"time": event.time - self.start_time, "text": event.text}
                for event in driven.events
            ],
            "batteries": {name: battery.source for name, battery in base.batteries().items()},
            "supply": None if (supply := base.supply()) is None else supply.source,
            "warnings": base.warnings(driven.now),
            "not_relayed": base.nodes.relay_drops(),
        }
