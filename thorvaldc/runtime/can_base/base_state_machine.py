"""State machine of a robot base on CAN, with the conditions of each transition.

A motor controller node starts its own watchdog when it receives the first heartbeat of the base
driver.  The base driver starts its watchdog when it has received all reports of the motor
controllers.  Messages between the base driver and a motor controller node during the start-up:

    state    driver (master)                          node
    INIT     listens 0.25 s; sends nothing      <---  heartbeat 05, if it was running
             (any frame of a master: another master is on the bus, FAULT)
    PREOP    NMT enter pre-operational          --->
             heartbeat 7F every 100 ms          --->  its heartbeat consumer (0x1016) starts
                                                <---  heartbeat 7F
             (repeated every 0.5 s to nodes that are not pre-operational; FAULT after 5 s)
    CONFIG   SDO upload of each expected object --->
                                                <---  value   (a mismatch: FAULT)
             NMT start                          --->
             SYNC every cycle                   --->
                                                <---  heartbeat 05, reports (PDOs)
             all nodes operational, identities match, all reports have come: the driver's
             watchdog starts, commands are sent from now on
    STANDBY  (only with a steering joint that is not homed, unless the robot file homes at start)
             PDO: motors off            --->
             ``home``: the robot is armed, or the steering is homed on request
    HOMING   PDO: home the steering             --->
                                                <---  homed
             PDO: enable, hold or straighten    --->
                                                <---  enabled, in position
    READY    PDO: speed 0                       --->

In the states FAULT and ESTOP and at the end of the program, all motors are commanded to stop, and
those that do not obey are stopped by other means (``stop_ladder``).

The base can enter the states FAULT and ESTOP from every state.  The base leaves the states FAULT
and ESTOP only when ``reset`` is called.  After ``reset`` the base enters the state PREOP, so that
all start-up checks are repeated.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

from thorvaldc.can.canopen import NmtCommand, NmtState
from thorvaldc.can.frame import ErrorState
from thorvaldc.model import Robot
from thorvaldc.model.bus_identity import wrong_buses
from thorvaldc.model.bus_timing import start_reading_time
from thorvaldc.runtime.can_base.base_fault import Cause, Fault
from thorvaldc.runtime.can_base.bus_connection import BusConnection, hold_time
from thorvaldc.runtime.can_base.frame_receiver import OBSERVATION
from thorvaldc.runtime.can_base.motor_controller import Intent, MotorController
from thorvaldc.runtime.can_base.stop_ladder import StopLadder


class BaseState(enum.Enum):
    """State of a robot base whose motors are controlled over CAN.

    - ``INIT``: the driver listens to the bus and sends nothing;
    - ``PREOP``: the driver brings all nodes to the NMT state pre-operational;
    - ``CONFIG``: the driver compares the nodes with the robot file and starts the nodes;
    - ``STANDBY``: a steering joint is not homed; the motors are off until the robot is armed or the
      steering is homed on request;
    - ``HOMING``: the driver enables the motors, homes the steering and turns the wheels straight;
    - ``READY``: the robot stands and waits for a commanded twist;
    - ``ACTIVE``: the robot drives;
    - ``STOPPING``: the robot ramps to rest, because the commanded twist is too old;
    - ``FAULT``, ``ESTOP``: all motors are in quick stop until ``reset`` is called; motors that do
      not obey are stopped by other means, see ``stop_ladder``.
    """

    INIT = "init"
    PREOP = "preop"
    CONFIG = "config"
    STANDBY = "standby"
    HOMING = "homing"
    READY = "ready"
    ACTIVE = "active"
    STOPPING = "stopping"
    FAULT = "fault"
    ESTOP = "estop"

    @property
    def drives(self) -> bool:
        """Whether the wheels follow commands: in READY, ACTIVE and STOPPING."""
        return self in (BaseState.READY, BaseState.ACTIVE, BaseState.STOPPING)

    @property
    def starts(self) -> bool:
        """Whether this is one of the start-up states INIT, PREOP, CONFIG and HOMING."""
        return self in (BaseState.INIT, BaseState.PREOP, BaseState.CONFIG, BaseState.HOMING)


class StateChange(NamedTuple):
    """A change of the state of the base.

    - ``time``: time of the change, s.
    - ``state``: new state of the base.
    - ``reason``: reason for the state FAULT or ESTOP.
    """

    time: float
    state: BaseState
    reason: str


READING_SHARE: Final = 2.0
"""Longest time of the reading of all objects, as a multiple of the time without a lost frame."""


@dataclass(frozen=True, slots=True)
class Times:
    """Times and time limits (s) of the state machine of the base.

    - ``listen``: duration of INIT;
    - ``gather``: longest duration of PREOP;
    - ``configure``: longest duration of CONFIG, but not less than ``READING_SHARE`` times the time
      in which all objects are read, one of each motor controller per control cycle;
    - ``home``: longest duration of the homing;
    - ``enable``: longest time to enable all motors;
    - ``stop``: longest duration of the shutdown, but not less than the time that the ladder of the
      robot needs for a motor that does not obey (``StopTimes.longest``);
    - ``repeat``: time after which an NMT command is repeated.
    """

    listen: float = 0.25
    gather: float = 5.0
    configure: float = 8.0
    home: float = 30.0
    enable: float = 2.0
    stop: float = 2.0
    repeat: float = 0.5


class BaseStateMachine:
    """State machine of a robot base on CAN.

    - ``fault``: cause of the state FAULT or ESTOP, ``None`` in other states; ``reason``: its text,
      with the verdict of the ladder;
    - ``was_ready``: ``True`` if the base has been in READY at least once;
    - ``was_started``: ``True`` if the base has passed CONFIG at least once;
    - ``mismatch``: ``True`` if the state is FAULT because a node does not match the robot file;
    - ``straightens``: ``True`` if the steering turns straight ahead after its homing;
    - ``changed``: callback for each change of state, called with the time (s), the new state and
      the reason.
    """

    def __init__(
        self,
        robot: Robot,
        connections: Sequence[BusConnection],
        times: Times | None = None,
        *,
        homes_at_start: bool = False,
    ) -> None:
        """``homes_at_start``: ``True`` if the steering is homed without a request, see STANDBY."""
        self.connections = connections
        self.homes_at_start = homes_at_start
        self.ladder = StopLadder(robot, connections)
        times = times or Times()
        self.times = replace(
            times,
            configure=max(times.configure, READING_SHARE * start_reading_time(robot)),
            stop=max(times.stop, self.ladder.times.longest),
        )
        self.state = BaseState.INIT
        self.since = -math.inf
        """Time (s) at which the base entered its present state."""
        self.fault: Fault | None = None
        self.reason = ""
        self.stop_engaged = False
        self.ending = False
        self.was_ready = False
        self.was_started = False
        self.mismatch = False
        self.straightens = True
        self.changed: Callable[[float, BaseState, str], None] | None = None
        self._nmt_sent_at = -math.inf
        self._repeat_at = -math.inf
        self._may_send = False
        self._observed_since = -math.inf
        """Time (s) from which the frames of the nodes are counted."""
        self._operational = False
        self._verified = False
        self._enabling_since: float | None = None
        self._homed_now = False
        self._to_restart: list[tuple[BusConnection, MotorController]] = []
        self._reported_problem: Fault | None = None
        self._now = -math.inf
        self._hold_until = -math.inf
        """Time (s) until which the wheels keep their speed in FAULT; see ``hold_time``."""
        self._released = False
        """``True`` if all motors stand and need no torque any more."""
        self._verdict = ""
        """Part of ``reason``: the end of the ladder."""

    @property
    def controllers(self) -> list[MotorController]:
        return [c for connection in self.connections for c in connection.controllers]

    # -- requests ----------------------------------------------------------------------------------

    def safety_stop(self, engaged: bool) -> None:
        """Engages or releases the safety stop.

        After the release of the safety stop, the base stays in the state ESTOP until ``reset`` is
        called.
        """
        self.stop_engaged = engaged

    def fail(self, reason: str, cause: Cause = Cause.OTHER) -> None:
        """Reports a problem of the base; the next ``update`` enters the state FAULT."""
        self._reported_problem = self._reported_problem or Fault(cause, reason)

    def reset(self, now: float, commanded: bool) -> str:
        """Leaves the state FAULT or ESTOP, and restarts the start-up of the base at the state
        PREOP.  In other states, forgets suspicious devices that were noticed.

        ``commanded``: ``True`` if a motion of the robot is commanded, so that the reset is refused.
        Returns the reason if the reset is refused, or an empty text if the start-up begins.
        """
        if self.state not in (BaseState.FAULT, BaseState.ESTOP):
            # A second battery or IO board is no fault, but the robot is not armed beside it.
            forgotten = [c.forget_suspicious_devices() for c in self.connections]
            return "" if any(forgotten) else "there is nothing to reset"
        if self.stop_engaged:
            return "the safety stop is engaged; release it first"
        if commanded:
            return "a motion is commanded; command zero first"
        turning = [c.node.name for c in self.controllers if c.turns(now)]
        if turning:  # the start-up takes the torque, so that the wheels would roll on
            return f"wheels of {', '.join(turning)} turn; wait until they stand"
        for connection in self.connections:
            if connection.receiver.lost:
                return f"the CAN interface of the bus `{connection.bus.name}` is lost"
        self._to_restart = [
            (connection, controller)
            for connection in self.connections
            for controller in connection.controllers
            if controller.needs_restart
        ]
        for connection in self.connections:
            connection.foreign_master = ""
            connection.clear_counts(boot_ups=1)
            connection.failures_in_a_row = 0
            if connection.interface.state is ErrorState.BUS_OFF:
                connection.interface.restart()
        self._reported_problem = None
        self._observed_since = now
        self._enter(BaseState.PREOP, now)
        return ""

    def home(self, now: float, again: bool) -> str:
        """Starts a homing of the steering motors, with ``again`` also of those that are homed.

        Returns the reason if the homing is refused, or an empty text if the homing starts.
        """
        if self.stop_engaged:
            return "the safety stop is engaged"
        if self.state not in (BaseState.STANDBY, BaseState.READY):
            return f"the base is {self.state.value}, not ready"
        if again:
            if not any(axis.steering for c in self.controllers for axis in c.axes):
                return "the robot has no steering joints to home"
            for controller in self.controllers:
                controller.discard_home(now)
        self._enter(BaseState.HOMING, now)
        return ""

    def cancel_homing(self, now: float) -> None:
        """Stops a homing and switches the motors off; the steering has to be homed again."""
        if self.state is BaseState.HOMING:
            for controller in self.controllers:
                controller.discard_home(now)
            self._enter(BaseState.STANDBY, now)

    def end(self) -> None:
        """Starts the shutdown until ``ended``: a quick stop of all motors, then no torque."""
        self.ending = True

    @property
    def ended(self) -> bool:
        return self.ending and (not self._verified or self.ladder.is_finished)

    # -- the control cycle -------------------------------------------------------------------------

    def update(self, now: float) -> Intent:
        """Runs one step of the state machine and returns the ``Intent`` for the motor controllers.

        ``update`` must be called in each control cycle, after all received CAN frames are decoded.
        """
        self._now = now
        if self.since == -math.inf:
            self._enter(BaseState.INIT, now)
        self._supervise_motion(now)
        self._check_problems(now)
        step = {
            BaseState.INIT: self._step_init,
            BaseState.PREOP: self._step_preop,
            BaseState.CONFIG: self._step_config,
            BaseState.HOMING: self._step_homing,
        }.get(self.state)
        if step is not None and not self.ending:
            step(now)
        return self.intent

    def note_motion(self, now: float, moves: bool, stale: bool) -> None:
        """Changes between the base states READY, ACTIVE and STOPPING.

        - ``moves``: ``True`` if the robot moves or a motion is commanded;
        - ``stale``: ``True`` if the commanded twist is too old.
        """
        if not self.state.drives:
            return
        state = BaseState.READY
        if moves:
            state = BaseState.STOPPING if stale or self.ending else BaseState.ACTIVE
        if state is not self.state:
            self._enter(state, now)

    @property
    def stops(self) -> bool:
        """``True`` if all motors are commanded to stop and do not follow targets."""
        stopped = self.ending or self.state in (BaseState.FAULT, BaseState.ESTOP)
        return stopped and not self.holds_speed

    @property
    def intent(self) -> Intent:
        """Request of the base to all motor controllers in this control cycle."""
        if self.holds_speed:
            return Intent.FOLLOW
        if self.stops:
            return Intent.OFF if self._released else Intent.QUICK_STOP
        if self.state is BaseState.STANDBY:
            return Intent.QUICK_STOP
        if self.state.drives or self._enabling_since is not None:
            return Intent.FOLLOW
        return Intent.HOME if self.state is BaseState.HOMING else Intent.OFF

    @property
    def holds_speed(self) -> bool:
        """``True`` while the wheels keep their speed after the loss of a bus."""
        return self._now < self._hold_until

    @property
    def may_send(self) -> bool:
        """Whether the state INIT, in which the driver sends nothing, found no other master."""
        return self._may_send

    @property
    def operational(self) -> bool:
        """Whether the nodes were started, so that they accept PDOs and the driver sends SYNC."""
        return self._operational

    @property
    def may_command(self) -> bool:
        """Whether all motor controllers match the robot file; before, they get no commands."""
        return self._verified

    # -- inside ------------------------------------------------------------------------------------

    def _enter(self, state: BaseState, now: float, fault: Fault | None = None) -> None:
        if state is BaseState.FAULT and self.state in (BaseState.PREOP, BaseState.CONFIG):
            heard = {c.bus.name: c.heard() for c in self.connections}
            if exchange := wrong_buses([c.bus for c in self.connections], heard):
                self.mismatch, fault = True, Fault(Cause.START, exchange)
        self.state, self.since, self.fault, self._verdict = state, now, fault, ""
        self.reason = fault.text if fault else ""
        self._enabling_since, self._homed_now = None, False
        self._hold_until = -math.inf
        if state in (BaseState.INIT, BaseState.PREOP):
            self._operational = self._verified = self.mismatch = False
            for connection in self.connections:
                connection.watchdog.stop()
        if state is BaseState.INIT:
            self._observed_since = now
        elif state is BaseState.PREOP:
            self._may_send = True
            for controller in self.controllers:
                controller.allow_reset()
                controller.disobeyed = False
            self._nmt_sent_at, self._repeat_at = now, -math.inf
        elif state is BaseState.CONFIG:
            for connection in self.connections:
                connection.start_readback()
                connection.watchdog.allow_boot_ups(0)
        elif state is BaseState.HOMING:
            for controller in self.controllers:
                controller.stand()
        elif state is BaseState.READY:
            self.was_ready = True
        if self.changed is not None:
            self.changed(now, state, self.reason)

    def _supervise_motion(self, now: float) -> None:
        """Says which motors follow the commands of the last cycle, or stops them all."""
        if not self.stops:
            intent, self._released = self.intent, False
            self.ladder.leave()
            for controller in self.controllers:
                controller.note_intent(intent)
            return
        ladder = self.ladder
        ladder.stop(now, self._verified)
        if ladder.stands and (self.ending or ladder.holds_without_torque or self._has_power_loss):
            self._released = True
        verdict = ladder.verdict
        if verdict == self._verdict:
            return
        if self.state not in (BaseState.FAULT, BaseState.ESTOP):
            self._enter(BaseState.FAULT, now, Fault(Cause.MOTION, verdict))
        else:
            cause = self.fault.text if self.fault else ""
            self.reason = "; ".join(text for text in (cause, verdict) if text)
            if self.changed is not None:
                self.changed(now, self.state, self.reason)
        self._verdict = verdict

    @property
    def _has_power_loss(self) -> bool:
        """``True`` if a power stage is off; its motors get no torque when the power returns."""
        return any(controller.power_loss for controller in self.controllers)

    def _check_problems(self, now: float) -> None:
        """Puts the base into the state ESTOP if the safety stop is engaged, or into the state FAULT
        if a problem was detected."""
        if self.stop_engaged:
            if self.state is not BaseState.ESTOP:
                fault = Fault(Cause.STOP, "the safety stop is engaged")
                self._enter(BaseState.ESTOP, now, fault)
            return
        if self.state in (BaseState.FAULT, BaseState.ESTOP):
            return
        problem, self._reported_problem = self._reported_problem, None
        for connection in self.connections:
            problem = problem or connection.impostor()
            if not problem and connection.receiver.lost:
                problem = Fault(Cause.BUS, connection.receiver.lost)
        if problem:
            self._enter_fault(now, problem)
            return
        if not self._is_checked:
            return
        for controller in self.controllers:
            if controller.power_loss and self.state is not BaseState.STANDBY:
                fault = Fault(Cause.POWER, controller.power_loss, controller.node.name)
                self._enter(BaseState.ESTOP, now, fault)
                return
        for connection in self.connections:
            problem = connection.problem(now)
            if not problem and self.state.drives:
                problem = _not_following(connection.controllers)
            if problem:
                self._enter_fault(now, problem)
                return

    @property
    def _is_checked(self) -> bool:
        """``True`` in the states in which a problem of a drive is a fault."""
        checked = self.state.drives or self.state in (BaseState.STANDBY, BaseState.HOMING)
        return checked and not self.ending

    def disobeyed(self, fault: Fault, now: float) -> None:
        """Enters the state FAULT because of a motor that does not follow its target."""
        if self._is_checked:
            self._enter_fault(now, fault)

    def _enter_fault(self, now: float, fault: Fault) -> None:
        drove = self.state.drives
        self._enter(BaseState.FAULT, now, fault)
        if drove:
            self._hold_until = now + hold_time(self.connections)

    def _longer_than(self, limit: float, now: float) -> bool:
        """Whether the base has been in the present state for more than ``limit`` seconds."""
        return now - self.since > limit

    def _step_init(self, now: float) -> None:
        if self._longer_than(self.times.listen, now):
            self._enter(BaseState.PREOP, now)

    def _step_preop(self, now: float) -> None:
        """Sends NMT commands until every motor controller is in the NMT state pre-operational."""
        restarting, self._to_restart = self._to_restart, []
        for connection, controller in restarting:
            connection.queue_nmt(NmtCommand.RESET_NODE, [controller])
            # A motor controller node does not receive commands while it boots.
            self._repeat_at = now + 4.0 * self.times.repeat
            self._nmt_sent_at = now
        missing = [
            (connection, controller)
            for connection in self.connections
            for controller in connection.controllers
            if not connection.watchdog.is_in_state(
                controller, NmtState.PRE_OPERATIONAL, self._nmt_sent_at
            )
        ]
        if now >= self._repeat_at and not restarting:
            self._repeat_at = now + self.times.repeat
            for connection, controller in missing:
                connection.queue_nmt(NmtCommand.ENTER_PRE_OPERATIONAL, [controller])
        if not missing and not restarting:
            self._enter(BaseState.CONFIG, now)
        elif self._longer_than(self.times.gather, now):
            names = ", ".join(c.node.name for _, c in missing)
            silent = all(connection.watchdog.is_silent(c) for connection, c in missing)
            cause, reason = Cause.START, f"not pre-operational in time: {names}"
            if silent:
                cause = Cause.ABSENT
                reason = f"no heartbeat of {names}; is it connected, is its node id right?"
            if silent and len(missing) == len(self.controllers):
                reason = "no controller responds; is the robot switched on, is the bitrate right?"
            self._enter(BaseState.FAULT, now, Fault(cause, reason))

    def _step_config(self, now: float) -> None:
        """Compares the objects and identities of the motor controllers with the robot file, and
        starts the controllers.  The state CONFIG ends when they have sent all reports."""
        readbacks = [(n, r) for c in self.connections for n, r in c.readbacks.items()]
        for name, readback in readbacks:
            if readback.problem:
                self._enter_mismatch(now, name, readback.problem)
                return
        if not all(readback.finished for _, readback in readbacks):
            if self._longer_than(self.times.configure, now):
                reason = "the objects of the controllers could not be read in time"
                self._enter(BaseState.FAULT, now, Fault(Cause.START, reason))
            return
        if not self._operational:
            self._operational = True
            self._nmt_sent_at = now
            self._repeat_at = now + self.times.repeat
            for connection in self.connections:
                connection.queue_nmt(NmtCommand.START)
        incomplete = []
        for connection in self.connections:
            watchdog = connection.watchdog
            for controller in connection.controllers:
                name = controller.node.name
                mismatch = controller.identity_mismatch()
                if mismatch:
                    self._enter_mismatch(now, name, mismatch)
                    return
                started = watchdog.is_in_state(controller, NmtState.OPERATIONAL, self._nmt_sent_at)
                if not started and now >= self._repeat_at:
                    connection.queue_nmt(NmtCommand.START, [controller])
                if not started or mismatch is None or not watchdog.has_all_reports(controller):
                    incomplete.append(name)
        if now >= self._repeat_at:
            self._repeat_at = now + self.times.repeat
        if not incomplete and now - self._observed_since >= OBSERVATION:
            for connection in self.connections:
                connection.watchdog.start(now)
            self._verified = self.was_started = True
            homed = all(controller.homed for controller in self.controllers)
            turns = homed or self.homes_at_start
            self._enter(BaseState.HOMING if turns else BaseState.STANDBY, now)
        elif self._longer_than(self.times.configure, now):
            reason = f"no complete reports in time from {', '.join(incomplete)}"
            self._enter(BaseState.FAULT, now, Fault(Cause.START, reason))

    def _enter_mismatch(self, now: float, node: str, reason: str) -> None:
        self.mismatch = True
        self._enter(BaseState.FAULT, now, Fault(Cause.START, reason, node))

    def _step_homing(self, now: float) -> None:
        """Homes the steering motors, enables all motors, and waits until all steering joints have
        reached their target angles."""
        unhomed = [c.node.name for c in self.controllers if not c.homed]
        if unhomed:
            self._homed_now = True
            if self._longer_than(self.times.home, now):
                reason = f"the steering did not find its home position: {', '.join(unhomed)}"
                self._enter(BaseState.FAULT, now, Fault(Cause.HOMING, reason))
            return
        if self._enabling_since is None:
            self._enabling_since = now
            for controller in self.controllers:
                controller.hold()
                if self._homed_now and self.straightens:
                    controller.straighten()
        powered = [c for c in self.controllers if c.powered]
        enabled = all(c.follows and c.standing for c in powered)
        if enabled and all(c.in_position for c in self.controllers):
            self._enter(BaseState.READY, now)
        elif enabled and not self._longer_than(self.times.home, now):
            self._enabling_since = now
        elif now - self._enabling_since > self.times.enable:
            off = ", ".join(c.node.name for c in powered if not c.follows)
            reason = f"motors not enabled in time: {off}" if off else "the wheels do not stop"
            self._enter(BaseState.FAULT, now, Fault(Cause.MOTION, reason))


def _not_following(controllers: Sequence[MotorController]) -> Fault | None:
    """Returns the fault of a motor controller that is not enabled and homed, or ``None``."""
    for controller in controllers:
        if controller.powered and not (controller.follows and controller.homed):
            return Fault(Cause.DRIVE, "it is no longer enabled and homed", controller.node.name)
    return None
