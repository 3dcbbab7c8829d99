"""The robots that the ROS 2 node drives: simulated in the process, or on CAN buses.

The node waits until the next control cycle is due, and handles messages meanwhile::

    messages   | m |m|        | m |    m                       m: one callback of ROS
    cycles     [##]           [##]           [##]              never two at the same time

All work is done in one thread, so that a message never changes the robot within a cycle.
"""

from __future__ import annotations

import abc
import contextlib
import math
import time
from collections.abc import Callable, Mapping
from typing import Any

from thorvaldc.can.interface import CanInterface
from thorvaldc.model import Robot
from thorvaldc.model.robot import AUTOMATIC, SAFETY_STOP
from thorvaldc.runtime.base_interface import BaseHandle, JointCommands, JointStates
from thorvaldc.runtime.control.driver_services import FORCE, driver_state, driving_services
from thorvaldc.runtime.control.service_table import Caller, Service, ServiceError, Services
from thorvaldc.runtime.driver import BaseDriver, DriveMode
from thorvaldc.runtime.multiplexer import Multiplexer
from thorvaldc.runtime.run_session import RunSession
from thorvaldc.runtime.se2 import ZERO_TWIST
from thorvaldc.runtime.time_gap import Gap, gap_text

OWNER = "ROS"
"""Name of all ROS programs as owners of twist sources and stops: ROS does not tell who sends."""
SETTLING = 0.5
"""Real time (s) after a gap in which messages do not count, as they may have waited.

The ROS middleware delivers what has waited in a thread of its own, later on a busy computer.
"""
LONGEST_STOP = 10.0
"""Longest simulated time (s) in which a simulated robot comes to rest before it is removed."""

_RESTING = 1e-3
"""Speed (m/s, rad/s) at which a simulated robot has come to rest."""


class DrivenRobot(abc.ABC):
    """A running robot: its base driver, its twist multiplexer and its services.

    Commands that waited while no control cycle ran are void, also those that arrive during
    ``SETTLING`` after the gap.  Then each source must command a zero twist before it moves the
    robot.
    """

    driver: BaseDriver
    multiplexer: Multiplexer
    services: Services
    armed: bool

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._settled = -math.inf
        self._void_reason = ""

    @property
    @abc.abstractmethod
    def now(self) -> float:
        """Time (s) of the base driver."""

    @property
    def input_time(self) -> float:
        """Time (s) of a twist that arrives now, later than a service that was called before."""
        return self.now

    @abc.abstractmethod
    def wait(self) -> float:
        """Returns the real time (s) until the next control cycle is due."""

    @abc.abstractmethod
    def cycle(self) -> None:
        """Runs the control cycle that is due."""

    @abc.abstractmethod
    def stop(self) -> None:
        """Stops the robot and releases it.  The robot cannot be used afterwards."""

    @abc.abstractmethod
    def _gap(self) -> str:
        """Returns the present gap in time as text, or an empty text."""

    def void(self, reason: str) -> None:
        """Voids all commands; each source must publish a zero twist before the robot moves."""
        self.multiplexer.void(reason)
        self.driver.void_commands(reason)

    def void_reason(self) -> str:
        """Returns the reason why inputs that arrive now do not count, or an empty text."""
        gap = self._gap()
        if gap:
            self._settled = self._clock() + SETTLING
            self._void_reason = f"{gap}; commands that waited do not count, send them again"
        return self._void_reason if self._clock() < self._settled else ""

    def call(self, service: str, owner: str = OWNER, **arguments: Any) -> Any:
        """Calls a service.  Raises ``ServiceError`` if it is refused."""
        caller = Caller(owner, void=self.void_reason())
        return self.services.call(service, arguments, self.now, caller)

    def state(self) -> dict[str, Any]:
        """Returns the state of the robot as JSON values."""
        state: dict[str, Any] = self.services.call("state", {}, self.now)
        return state


class ArmedBase(BaseHandle):
    """A simulated base that accepts no motion until it is armed, as a robot on its buses."""

    def __init__(self, base: BaseHandle) -> None:
        self.base = base
        self.armed = False

    @property
    def hold_reason(self) -> str:
        return self.base.hold_reason

    @property
    def waiting_reason(self) -> str:
        return self.base.waiting_reason if self.armed else "disarmed"

    def read(self, now: float) -> JointStates:
        return self.base.read(now)

    def write(self, commands: JointCommands, now: float) -> None:
        self.base.write(commands, now)

    def close(self) -> None:
        self.base.close()


class SimulatedRobotInProcess(DrivenRobot):
    """A robot with ideal joints or in MuJoCo, whose time advances by one period in each cycle.

    ``factor``: speed of the simulation relative to the real time; 0: as fast as possible.  Missed
    cycles are not caught up: the simulated time falls behind, and the simulated robot stands still
    meanwhile.
    """

    def __init__(
        self,
        robot: Robot,
        base: BaseHandle,
        factor: float = 1.0,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__(clock)
        self._base = ArmedBase(base)
        self.driver = BaseDriver(robot, self._base)
        self.multiplexer = Multiplexer.from_robot(robot)
        self.services = Services(
            [*driving_services(self.driver, self.multiplexer), *self._arming_services()]
        )
        self.period = 1.0 / self.driver.settings.rate
        self._real_period = self.period / factor if factor else 0.0
        self._due = clock()
        self._cycles = 0
        self._arms_automatically = robot.driver.arming == AUTOMATIC
        self.paused = False

    @property
    def now(self) -> float:
        return self._cycles * self.period

    @property
    def input_time(self) -> float:
        return self.now + 0.5 * self.period

    @property
    def armed(self) -> bool:  # type: ignore[override]
        return self._base.armed

    def wait(self) -> float:
        return math.inf if self.paused else self._due - self._clock()

    def cycle(self) -> None:
        gap = self.void_reason() and self._gap()
        if gap:
            self.void(gap)
        self._cycles += 1
        now = self.now
        self.multiplexer.feed(self.driver, now)
        if self._arms_automatically and not self.armed and not self._refusal(now):
            self._arm(now)
        state = self.driver.tick(now)
        if state.mode is DriveMode.FAULT:
            self._base.armed = False
        self._due = max(self._due + self._real_period, self._clock())

    def pause(self, paused: bool) -> None:
        """Stops the simulated time, or lets it run on.  Commands from before or during the pause
        are void."""
        if self.paused and not paused:
            self._due = self._clock()
        self.paused = paused
        self.void("the simulation was paused")

    def stop(self) -> None:
        self._base.armed = self._arms_automatically = False
        self.paused = False
        limit = self.now + LONGEST_STOP
        while self.now < limit:
            self.cycle()
            measured = self.driver.state.odometry.twist
            if self.driver.state.ramped == ZERO_TWIST and max(map(abs, measured)) < _RESTING:
                break
        self._base.close()

    def _gap(self) -> str:
        late = self._clock() - self._due
        if self.paused or not self._cycles or not self._real_period:
            return ""  # as fast as possible, only the simulated time counts
        return gap_text(late) if self.driver.time_gaps.judge(late) is Gap.LONG else ""

    def _refusal(self, now: float) -> str:
        """Returns the reasons why the robot cannot be armed, or an empty text."""
        reasons = []
        if self.paused:
            reasons.append("the simulation is paused")
        if self.driver.state.fault:
            reasons.append(self.driver.state.fault)
        multiplexer = self.multiplexer
        reasons += [f"the stop lock `{n}` is active" for n in multiplexer.active_stop_locks(now)]
        reasons += [f"`{name}` commands a motion" for name in multiplexer.requests(now)]
        if not reasons and self.driver.commanded_twist(now) != ZERO_TWIST:
            reasons.append("a motion is commanded; command zero first")
        return "; ".join(reasons)

    def _arm(self, now: float) -> None:
        self._base.armed = True
        self.driver.accept_motion()
        self.multiplexer.accept_motion(now)

    def _arming_services(self) -> list[Service]:
        """Returns the services of a robot on its buses that simulated joints need too."""

        def arm(now: float) -> None:
            if self.armed:
                return
            if refusal := self._refusal(now):
                raise ServiceError(refusal)
            self._arm(now)

        def disarm(now: float) -> None:
            self._base.armed = self._arms_automatically = False

        def safety_stop(now: float, caller: Caller) -> None:
            self.multiplexer.lock(SAFETY_STOP, True, now, caller.name)
            self._base.armed = False

        def release_safety_stop(now: float, caller: Caller, force: bool) -> None:
            self.multiplexer.lock(SAFETY_STOP, False, now, caller.name, force=force)

        def state(now: float) -> dict[str, Any]:
            values = driver_state(self.driver, self.multiplexer, now)
            return {**values, "armed": self.armed, "paused": self.paused}

        return [
            Service("arm", "Accept motion.", arm),
            Service("disarm", "Accept no motion until `arm`.", disarm, valid_late=True),
            Service(
                "safety_stop", "Stop, and disarm.", safety_stop, with_caller=True, valid_late=True
            ),
            Service(
                "release_safety_stop",
                "Release the safety stop.",
                release_safety_stop,
                (FORCE,),
                with_caller=True,
            ),
            Service("state", "Return the state.", state, valid_late=True),
        ]


class RobotOnBuses(DrivenRobot):
    """A robot on its CAN buses, with the same session as the command ``run``.

    ``factor``: speed of buses that are simulated in this process relative to the real time, 0 for
    as fast as possible, or ``None`` for buses that run by themselves.
    """

    def __init__(
        self,
        robot: Robot,
        interfaces: Mapping[str, CanInterface],
        factor: float | None = None,
        clock: Callable[[], float] = time.monotonic,
        locks: contextlib.ExitStack | None = None,
    ) -> None:
        super().__init__(clock)
        self._locks = locks or contextlib.ExitStack()
        self.session = RunSession(robot, interfaces, threaded=factor is None)
        self.runner = self.session.runner
        self.driver = self.runner.driver
        self.multiplexer = self.session.control.multiplexer
        self.services = self.session.control.services
        self._factor = factor
        self._real_period = self.runner.period / factor if factor else 0.0
        self._due = clock()

    @property
    def now(self) -> float:
        return self.runner.clock.now

    @property
    def input_time(self) -> float:
        return self.now if self._factor is None else self.now + 0.5 * self.runner.period

    @property
    def armed(self) -> bool:  # type: ignore[override]
        return self.runner.base.armed

    @property
    def lost(self) -> str:
        """Reason why the robot cannot be reached any more, or an empty text."""
        connections = self.runner.base.connections
        lost = [c.bus.name for c in connections if c.receiver.lost]
        return f"the bus {' and '.join(lost)} is lost" if lost else ""

    def wait(self) -> float:
        if self._factor is None:
            return self.runner.deadline - self.runner.clock.now
        return self._due - self._clock()

    def cycle(self) -> None:
        gap = self.void_reason() and self._gap()
        if self._factor is not None:
            if gap:  # the virtual time did not advance meanwhile
                self.void(gap)
            self.runner.clock.sleep_until(self.runner.deadline)
            self._due = max(self._due + self._real_period, self._clock())
        self.runner.run_due_cycle()

    def stop(self) -> None:
        try:
            self.runner.shutdown()
        finally:
            self.session.control.close()
            self._locks.close()

    def close(self) -> None:
        """Closes the buses after an error, without a frame: the drives stop by their time-outs."""
        self.runner.base.close()
        self.session.control.close()
        self._locks.close()

    def _gap(self) -> str:
        if self._factor is None:
            now, last = self.runner.clock.now, self.driver.state.time
            return gap_text(now - last) if self.driver.gap_at(now) is not Gap.NONE else ""
        late = self._clock() - self._due
        long = self.driver.time_gaps.judge(late) is Gap.LONG and self._factor > 0.0
        return gap_text(late) if long and self.runner.timing.cycles else ""
