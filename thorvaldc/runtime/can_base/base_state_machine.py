"""The states of a base on its buses, and what leads from one to the other."""

from __future__ import annotations

import enum
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from thorvaldc.can.error_state import ErrorState
from thorvaldc.runtime.can_base.bus_health import (
    OPERATIONAL,
    PRE_OPERATION,
    PRE_OPERATIONAL,
    RESET_NODE,
    START,
    BusLink,
)
from thorvaldc.runtime.can_base.motor_controller import Intent, MotorController


class State(enum.Enum):
    """``INIT`` listens, ``PREOP`` gathers the nodes, ``CONFIG`` compares them with the
    robot's file, ``HOMING`` powers the motors, finds the steerings' zero and turns them
    straight ahead, ``READY`` stands, ``ACTIVE`` drives, ``STOPPING`` ramps to rest.  ``FAULT``
    and ``ESTOP`` stop all at once and stay until they are reset.
    """

    INIT = "init"
    PREOP = "preop"
    CONFIG = "config"
    HOMING = "homing"
    READY = "ready"
    ACTIVE = "active"
    STOPPING = "stopping"
    FAULT = "fault"
    ESTOP = "estop"

    @property
    def drives(self) -> bool:
        return self in (State.READY, State.ACTIVE, State.STOPPING)

    @property
    def starts(self) -> bool:
        return self in (State.INIT, State.PREOP, State.CONFIG, State.HOMING)


@dataclass(frozen=True, slots=True)
class Times:
    """s.  How long it listens before it sends anything, and how long the rest may take."""

    listen: float = 0.25
    gather: float = 5.0
    configure: float = 8.0
    home: float = 30.0
    enable: float = 2.0
    stop: float = 2.0
    repeat: float = 0.5


class Supervisor:
    """What all controllers are to do, from how each of them is.

    ``reason`` says why it is in ``FAULT`` or ``ESTOP``; ``was_ready``: it has once got as far
    as ``READY``; ``mismatch``: what is on the bus is not what the robot's file says.
    ``changed`` is called with the time (s), the new state and the reason.
    """

    def __init__(self, links: Sequence[BusLink], times: Times | None = None) -> None:
        self.links = links
        self.times = times or Times()
        self.state = State.INIT
        self.since = -math.inf
        self.reason = ""
        self.stop_engaged = False
        self.ending = False
        self.was_ready = False
        self.mismatch = False
        self.changed: Callable[[float, State, str], None] | None = None
        self._commanded = -math.inf
        self._repeat_at = -math.inf
        self._speaks = False
        self._checked = False
        self._started = False
        self._enabling: float | None = None
        self._finds_home = False
        self._restart: list[tuple[BusLink, MotorController]] = []
        self._wants_stop = ""

    @property
    def controllers(self) -> list[MotorController]:
        return [c for link in self.links for c in link.controllers]

    # -- what is asked of it -----------------------------------------------------------------------

    def safety_stop(self, engaged: bool) -> None:
        """Stop all at once; released, it takes a reset to go on."""
        self.stop_engaged = engaged

    def fail(self, reason: str) -> None:
        """A fault that others have found; taken up at the next update."""
        self._wants_stop = self._wants_stop or reason

    def reset(self, now: float, commanded: bool) -> str:
        """Leave ``FAULT`` or ``ESTOP``; returns why not.  ``commanded``: a motion is asked for."""
        if self.state not in (State.FAULT, State.ESTOP):
            return "there is nothing to reset"
        if self.stop_engaged:
            return "the safety stop is engaged; release it first"
        if commanded:
            return "a motion is being commanded; command zero first"
        for link in self.links:
            if link.receiver.lost:
                return f"the interface to the bus `{link.bus.name}` is gone"
        self._restart = [
            (link, c) for link in self.links for c in link.controllers if c.needs_restart
        ]
        for link in self.links:
            link.foreign_master = ""
            link.failures_in_a_row = 0
            if link.port.state is ErrorState.BUS_OFF:
                link.port.restart()
        self._wants_stop = ""
        self._go(State.PREOP, now)
        return ""

    def home(self, now: float) -> str:
        """Find the steerings' zero again; why not, or empty."""
        if self.state is not State.READY:
            return f"the base is {self.state.value}, not ready"
        for controller in self.controllers:
            controller.home_again(now)
        self._go(State.HOMING, now)
        return ""

    def end(self) -> None:
        """Stop, disable, pre-operational: the way out.  ``ended`` tells when it is over."""
        self.ending = True

    @property
    def ended(self) -> bool:
        off = all(c.is_off and c.standing for c in self.controllers)
        return self.ending and (off or self.state.starts or not self._started)

    # -- a cycle -----------------------------------------------------------------------------------

    def update(self, now: float) -> Intent:
        """Once in a cycle, after all that has come is taken in."""
        if self.since == -math.inf:
            self._go(State.INIT, now)
        self._guard(now)
        step = {
            State.INIT: self._init,
            State.PREOP: self._preop,
            State.CONFIG: self._config,
            State.HOMING: self._homing,
        }.get(self.state)
        if step is not None and not self.ending:
            step(now)
        return self.intent

    def drive(self, now: float, moves: bool, stale: bool) -> None:
        """What the driver is about: whether it moves, and whether its command is too old."""
        if not self.state.drives:
            return
        wanted = State.READY
        if moves:
            wanted = State.STOPPING if stale or self.ending else State.ACTIVE
        if wanted is not self.state:
            self._go(wanted, now)

    @property
    def intent(self) -> Intent:
        if self.ending or self.state in (State.FAULT, State.ESTOP):
            return Intent.QUICK_STOP
        if self.state.drives or self._enabling is not None:
            return Intent.FOLLOW
        return Intent.HOME if self.state is State.HOMING else Intent.OFF

    @property
    def sends(self) -> bool:
        """Whether anything may be sent: not before it has listened who is there."""
        return self._speaks

    @property
    def operational(self) -> bool:
        """Whether the nodes are, and take commands."""
        return self._started

    @property
    def commands(self) -> bool:
        """Whether commands may be sent: all controllers are those of the robot's file."""
        return self._checked

    # -- inside --------------------------------------------------------------------------------

    def _go(self, state: State, now: float, reason: str = "") -> None:
        self.state, self.since, self.reason = state, now, reason
        self._enabling, self._finds_home = None, False
        if state in (State.INIT, State.PREOP):
            self._started = self._checked = self.mismatch = False
            for link in self.links:
                link.unwatch()
        if state is State.PREOP:
            self._speaks = True
            for controller in self.controllers:
                controller.allow_reset()
            self._commanded, self._repeat_at = now, -math.inf
        elif state is State.CONFIG:
            for link in self.links:
                link.check()
        elif state is State.READY:
            self.was_ready = True
        if self.changed is not None:
            self.changed(now, state, reason)

    def _guard(self, now: float) -> None:
        """What stops everything, in every state."""
        if self.stop_engaged:
            if self.state is not State.ESTOP:
                self._go(State.ESTOP, now, "the safety stop is engaged")
            return
        if self.state in (State.FAULT, State.ESTOP):
            return
        wrong, self._wants_stop = self._wants_stop, ""
        for link in self.links:
            wrong = wrong or link.foreign_master or link.receiver.lost
        if wrong:
            self._go(State.FAULT, now, wrong)
            return
        if self.ending or not (self.state.drives or self.state is State.HOMING):
            return
        for controller in self.controllers:
            if controller.unpowered:
                self._go(State.ESTOP, now, f"{controller.node.name}: {controller.unpowered}")
                return
        for link in self.links:
            wrong = link.problem(now)
            if not wrong and self.state.drives:
                wrong = next(
                    (
                        f"{c.node.name}: it does not follow any more"
                        for c in link.controllers
                        if not c.follows or not c.homed
                    ),
                    "",
                )
            if wrong:
                self._go(State.FAULT, now, wrong)
                return

    def _late(self, now: float, limit: float) -> bool:
        return now - self.since > limit

    def _init(self, now: float) -> None:
        if self._late(now, self.times.listen):
            self._go(State.PREOP, now)

    def _preop(self, now: float) -> None:
        restarting, self._restart = self._restart, []
        for link, controller in restarting:
            link.nmt(RESET_NODE, [controller])
            self._repeat_at = now + 4.0 * self.times.repeat
            self._commanded = now
        missing = [
            (link, c)
            for link in self.links
            for c in link.controllers
            if not link.in_state(c, PRE_OPERATIONAL, self._commanded)
        ]
        if now >= self._repeat_at and not restarting:
            self._repeat_at = now + self.times.repeat
            for link, controller in missing:
                link.nmt(PRE_OPERATION, [controller])
        if not missing and not restarting:
            self._go(State.CONFIG, now)
        elif self._late(now, self.times.gather):
            names = ", ".join(c.node.name for _, c in missing)
            silent = all(c.node.name in link.silent for link, c in missing)
            if silent and len(missing) == len(self.controllers):
                why = "no controller answers; is the robot switched on, and the bitrate right?"
            elif silent:
                why = f"no sign of {names}; is it connected, and its id right?"
            else:
                why = f"does not become pre-operational: {names}"
            self._go(State.FAULT, now, why)

    def _config(self, now: float) -> None:
        for link in self.links:
            for name, check in link.checks.items():
                if check.problem:
                    self.mismatch = True
                    self._go(State.FAULT, now, f"{name}: {check.problem}")
                    return
        if not all(check.done for link in self.links for check in link.checks.values()):
            if self._late(now, self.times.configure):
                self._go(State.FAULT, now, "the controllers' objects could not be read in time")
            return
        if not self._started:
            self._started = True
            self._commanded = now
            self._repeat_at = now + self.times.repeat
            for link in self.links:
                link.nmt(START)
        waiting = []
        for link in self.links:
            for controller in link.controllers:
                name = controller.node.name
                who = controller.identity()
                if who:
                    self.mismatch = True
                    self._go(State.FAULT, now, f"{name}: {who}")
                    return
                up = link.in_state(controller, OPERATIONAL, self._commanded)
                if not up and now >= self._repeat_at:
                    link.nmt(START, [controller])
                if not up or who is None or not link.heard(controller):
                    waiting.append(name)
        if now >= self._repeat_at:
            self._repeat_at = now + self.times.repeat
        if not waiting:
            for link in self.links:
                link.watch(now)
            self._checked = True
            self._go(State.HOMING, now)
        elif self._late(now, self.times.configure):
            why = f"does not tell what it is and does: {', '.join(waiting)}"
            self._go(State.FAULT, now, why)

    def _homing(self, now: float) -> None:
        unhomed = [c.node.name for c in self.controllers if not c.homed]
        if unhomed:
            self._finds_home = True
            if self._late(now, self.times.home):
                why = f"the steering does not find its home: {', '.join(unhomed)}"
                self._go(State.FAULT, now, why)
            return
        if self._enabling is None:
            self._enabling = now
            for controller in self.controllers:
                controller.hold()
                if self._finds_home:
                    controller.straighten()
        enabled = all(c.follows and c.standing for c in self.controllers)
        if enabled and all(c.arrived for c in self.controllers):
            self._go(State.READY, now)
        elif enabled and not self._late(now, self.times.home):
            self._enabling = now
        elif now - self._enabling > self.times.enable:
            names = ", ".join(c.node.name for c in self.controllers if not c.follows)
            why = f"is not enabled: {names}" if names else "the wheels do not come to rest"
            self._go(State.FAULT, now, why)
