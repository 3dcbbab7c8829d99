"""The base driver on its bus: the loop, and all that can be asked of a robot that runs."""

from __future__ import annotations

import math
import queue
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field
from typing import Any, NamedTuple, TypeVar

from thorvaldc.can.frame import CanFrame
from thorvaldc.can.interface import CanInterface
from thorvaldc.model.robot import Robot
from thorvaldc.runtime.can_base.base_state_machine import State
from thorvaldc.runtime.can_base.battery_and_io_drivers import BatteryState, IoBoardDriver
from thorvaldc.runtime.can_base.bus_health import BusLink
from thorvaldc.runtime.can_base.can_base import CanBase
from thorvaldc.runtime.can_base.foreign_frame_relay import Relayed
from thorvaldc.runtime.can_base.motor_controller import MotorController
from thorvaldc.runtime.control.service_table import ServiceError
from thorvaldc.runtime.driver import BaseDriver, DriveMode, DriverState
from thorvaldc.runtime.se2 import ORIGIN, ZERO_TWIST

Feed = Callable[[BaseDriver, float], object]
"""Called first in each cycle with the driver and the time (s): it commands, or does not.

A multiplexer's ``feed`` is one.
"""
Watch = Callable[["BaseRunner", DriverState], None]
T = TypeVar("T")


class Refused(ServiceError):
    """A service was not done; the message says why, and nothing was changed."""


class Change(NamedTuple):
    """A change of the supervisor's state: when (s), to which, and why."""

    time: float
    state: State
    reason: str


@dataclass(slots=True)
class Timing:
    """How the loop keeps its time.  s; counted from the start of the loop.

    ``overruns`` counts cycles that ended after their deadline, ``skipped`` the cycles
    that were left out for it: none is ever caught up.  ``latest`` is the longest time by which
    a cycle began after its deadline, ``longest`` the longest work of a cycle.
    """

    cycles: int = 0
    overruns: int = 0
    skipped: int = 0
    latest: float = 0.0
    longest: float = 0.0
    starts: list[float] = field(default_factory=list)
    """Times of the cycles' starts, where they are wanted (``keep_starts``)."""


class BaseRunner:
    """One robot that runs: its ``base`` on the buses, its ``driver``, and its services.

    Everything happens in the thread that calls ``cycle`` or ``run``.  Services raise
    ``Refused``; from another thread go through ``submit``.  Time is that of the first
    bus's port: virtual where that is.
    """

    def __init__(
        self,
        robot: Robot,
        base: CanBase,
        clock: CanInterface,
        *,
        parameters: str | None = None,
        keep_starts: bool = False,
    ) -> None:
        """``parameters`` names the parameter set to start with.  Raises ``DiagnosticError``."""
        self.robot = robot
        self.base = base
        self.clock = clock
        self.driver = BaseDriver(robot, base, parameters=parameters)
        self.period = base.period
        self.timing = Timing()
        self.changes: list[Change] = []
        self.feed: Feed | None = None
        self.pace: Callable[[float], None] | None = None
        """Called with the time of each cycle before it begins: virtual time waits here."""
        self._requests: queue.SimpleQueue[tuple[Future[Any], Callable[[], Any]]] = (
            queue.SimpleQueue()
        )
        self._keep_starts = keep_starts
        self._deadline: float | None = None
        self._started = False
        self._asked = ZERO_TWIST
        base.supervisor.changed = self._changed

    # -- the loop ----------------------------------------------------------------------------------

    @property
    def state(self) -> State:
        return self.base.supervisor.state

    @property
    def ready(self) -> bool:
        """Whether it stands and waits for a command, or drives."""
        return self.state.drives and not self.base.supervisor.ending

    def cycle(self, now: float) -> DriverState:
        """One turn: services, the command, health, driver, frames, and what state that makes."""
        self._serve()
        if self.feed is not None:
            self.feed(self.driver, now)
        asked = self.driver.commanded_twist(now) != ZERO_TWIST
        self.base.arm(asked)
        state = self.driver.tick(now)
        stale = state.mode is not DriveMode.DRIVING
        self.base.supervisor.drive(now, not self.base.standing, stale)
        if self.ready and not self._started:
            # What the joints did while they were set up was no way driven.
            self._started = True
            self.driver.reset_pose()
        return state

    def run(
        self,
        until: float = math.inf,
        *,
        watch: Watch | None = None,
        stop: Callable[[], bool] | None = None,
    ) -> None:
        """Cycle after cycle on absolute deadlines, to the time ``until`` (s) or ``stop()``.

        A cycle that takes too long is counted, and the next begins at the next deadline
        that is still to come.  Nothing is sent outside of cycles.
        """
        clock, timing, period = self.clock, self.timing, self.period
        deadline = self._deadline if self._deadline is not None else clock.now
        while not (stop is not None and stop()):
            clock.sleep_until(deadline)
            if self.pace is not None:
                self.pace(deadline)
            now = clock.now
            if now >= until - 1e-9:
                break
            timing.cycles += 1
            timing.latest = max(timing.latest, now - deadline)
            if self._keep_starts:
                timing.starts.append(now)
            state = self.cycle(now)
            if watch is not None:
                watch(self, state)
            ended = clock.now
            timing.longest = max(timing.longest, ended - now)
            deadline += period
            if ended > deadline:
                late = math.ceil((ended - deadline) / period)
                timing.overruns += 1
                timing.skipped += late
                deadline += late * period
            self._deadline = deadline

    def shutdown(self) -> None:
        """Quick stop, disable, pre-operational; then let go of the bus.

        It takes as long as the robot needs to come to rest, two seconds at most.
        """
        from thorvaldc.runtime.can_base.bus_health import PRE_OPERATION

        supervisor = self.base.supervisor
        supervisor.end()
        self.feed = None
        try:
            limit = self.clock.now + supervisor.times.stop
            self._deadline = None
            # At least two cycles: the first tells, the second hears what became of it.
            least = self.clock.now + 2.5 * self.period
            self.run(limit, stop=lambda: supervisor.ended and self.clock.now > least)
            if supervisor.sends:
                for link in self.base.links:
                    link.outbox.clear()
                    link.nmt(PRE_OPERATION)
                    while link.outbox:
                        link.send(link.outbox.popleft(), self.period)
                self.clock.sleep(self.period)
        finally:
            self.base.close()

    def _changed(self, now: float, state: State, reason: str) -> None:
        self.changes.append(Change(now, state, reason))

    # -- services ----------------------------------------------------------------------------------

    def submit(self, service: Callable[[], T]) -> Future[T]:
        """Have a service done by the loop's thread in its next cycle; from any thread."""
        future: Future[T] = Future()
        self._requests.put((future, service))
        return future

    def _serve(self) -> None:
        while True:
            try:
                future, service = self._requests.get_nowait()
            except queue.Empty:
                return
            if not future.set_running_or_notify_cancel():
                continue
            try:
                future.set_result(service())
            except Exception as fault:  # whoever asked for it is told
                future.set_exception(fault)

    def safety_stop(self, engaged: bool = True) -> None:
        """Stop all drives at once and take their torque; ``False`` releases the stop.

        To drive again it takes ``reset``.  It is a stop in software, no safety function.
        """
        self.base.supervisor.safety_stop(engaged)

    def reset(self) -> None:
        """Leave a fault or a stop: the stop released, a command of zero, and this."""
        now = self.clock.now
        commanded = self.driver.commanded_twist(now) != ZERO_TWIST
        _refuse(self.base.supervisor.reset(now, commanded))

    def home_steering(self) -> None:
        """Find the zero of every steering again.  The wheels turn in place."""
        _refuse(self.base.supervisor.home(self.clock.now))

    def set_home_count_current_position_zero(self, node: str = "") -> None:
        """Let the steering's present angle be 0 from the next homing on; of one node or all.

        The controllers keep it without power.  Only for controllers that count from a home
        switch, and only while the robot stands.
        """
        self._must_stand()
        told = 0
        for link, controller in self._controllers(node):
            if not controller.homed:
                raise Refused(f"{controller.node.name} has not been homed")
            message = controller.zero_here()
            if message is not None:
                link.outbox.append(message)
                told += 1
        if not told:
            raise Refused("no controller here counts from a home switch")

    def reset_odometry(self) -> None:
        """The pose is the origin from now on."""
        self.driver.reset_pose(ORIGIN)

    def set_drive_parameters(
        self,
        parameters: str | None = None,
        *,
        radii: Mapping[str, float] | None = None,
        limits: Mapping[str, float] | None = None,
    ) -> None:
        """Switch to a parameter set of the robot's file, or change wheel radii (m) and limits (SI).

        All or nothing, between two cycles.
        """
        from thorvaldc.diagnostics.error import DiagnosticError
        from thorvaldc.runtime.errors import ParameterError

        try:
            if radii or limits:
                self.driver.update(radii=radii, noise=None, **(limits or {}))
            else:
                self.driver.use(parameters)
        except (ParameterError, DiagnosticError) as fault:
            raise Refused(str(fault)) from None

    def setup_motor_controller(self, node: str, setting: str, value: float) -> None:
        """Set one of a controller's own values, by the names that its frame has, in its units.

        Only while the robot stands.
        """
        self._must_stand()
        found = list(self._controllers(node))
        for link, controller in found:
            try:
                link.outbox.append(controller.setting(setting, value))
            except ValueError as fault:
                known = ", ".join(controller.settings())
                raise Refused(f"{fault}; there are {known}" if known else str(fault)) from None

    def mute_devices(self, muted: bool = True) -> None:
        """Pass nothing on to foreign devices; ``False``: pass it on again."""
        for link in self.base.links:
            link.relay.mute(muted)

    def set_output(self, board: str, output: str, on: bool) -> None:
        """Switch an output of an IO board."""
        for link in self.base.links:
            for found in link.boards:
                if found.node.name == board:
                    try:
                        link.outbox.append(found.switch(output, on))
                    except KeyError:
                        known = ", ".join(found.outputs)
                        raise Refused(f"{board} has no output `{output}`; it has {known}") from None
                    return
        boards = ", ".join(b.node.name for b in self.boards)
        known = f"; there are {boards}" if boards else ""
        raise Refused(f"there is no IO board `{board}`{known}")

    def send_to_device(self, cob_id: int, data: bytes, bus: str = "") -> None:
        """Pass a frame on to a foreign device, if the robot's file allows it."""
        link = self._link(bus)
        reason = link.relay.offer(CanFrame(cob_id, data), self.clock.now)
        _refuse(f"{cob_id:#05x}: {reason}" if reason else "")

    def from_devices(self, bus: str = "") -> list[Relayed]:
        """What foreign devices have sent since it was asked last."""
        return self._link(bus).relay.received()

    # -- what can be looked at -------------------------------------------------------------------

    @property
    def boards(self) -> list[IoBoardDriver]:
        return [board for link in self.base.links for board in link.boards]

    def batteries(self) -> dict[str, BatteryState]:
        """By the node's name."""
        return {b.node.name: b.state for link in self.base.links for b in link.batteries}

    def warnings(self) -> list[str]:
        """What does not stop the robot, and somebody should know."""
        now = self.clock.now
        found = [
            f"{battery.node.name}: {battery.warning}"
            for link in self.base.links
            for battery in link.batteries
            if battery.warning
        ]
        found += [f"{name} is silent" for link in self.base.links for name in link.stale(now)]
        return found

    def relay_drops(self) -> dict[str, int]:
        """Frames of foreign devices that did not pass, by ``0x240 too often``."""
        return {
            f"{cob_id:#05x} {reason}": number
            for link in self.base.links
            for (cob_id, reason), number in sorted(link.relay.dropped.items())
        }

    # -- inside --------------------------------------------------------------------------------

    def _controllers(self, node: str) -> Sequence[tuple[BusLink, MotorController]]:
        every = [(link, c) for link in self.base.links for c in link.controllers]
        found = [(link, c) for link, c in every if node in ("", c.node.name)]
        if not found:
            known = ", ".join(c.node.name for _, c in every)
            raise Refused(f"there is no controller `{node}`; there are {known}")
        return found

    def _link(self, bus: str) -> BusLink:
        for link in self.base.links:
            if bus in ("", link.bus.name):
                return link
        raise Refused(f"there is no bus `{bus}`")

    def _must_stand(self) -> None:
        if self.state is State.ACTIVE or not self.base.standing:
            raise Refused("the robot drives; stop it first")


def _refuse(reason: str) -> None:
    if reason:
        raise Refused(reason)
