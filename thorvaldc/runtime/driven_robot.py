"""A driven robot: its driver, multiplexer, services, arming and the rule of gaps in time.

Every program that drives a robot uses this one class: ``run``, the ROS 2 node, teleoperation, the
preview and the tests.  What differs is the base (the joints) and the pace (when cycles are due).

One control cycle::

    gap in time?      void all commands
    requests          services that other threads and programs have called
    commands          the multiplexer selects a source for the driver
    arming            stop locks, batteries and silence disarm; a pending or automatic arming
    driver            reads the joints, writes the joint commands
"""

from __future__ import annotations

import contextlib
import math
import queue
import time
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any, NamedTuple, TypeVar

from thorvaldc.diagnostics.error import DiagnosticError
from thorvaldc.model.robot import AUTOMATIC, SAFETY_STOP, Robot
from thorvaldc.runtime.base_interface import BaseHandle
from thorvaldc.runtime.control.control_server import ControlServer
from thorvaldc.runtime.driver import BaseDriver, DriveMode, DriverState
from thorvaldc.runtime.errors import ParameterError, RequestRefused
from thorvaldc.runtime.multiplexer import Multiplexer
from thorvaldc.runtime.owned_stop import THIS_PROGRAM
from thorvaldc.runtime.pace import Clock, Pace, SimulatedTime, Timing
from thorvaldc.runtime.pre_arm_checks import PRE_ARM_CHECKS, PreArmCheck
from thorvaldc.runtime.robot_services import robot_services
from thorvaldc.runtime.se2 import ZERO_TWIST
from thorvaldc.runtime.service_table import Caller, Services
from thorvaldc.runtime.time_gap import Gap, gap_text

Feed = Callable[[BaseDriver, float], object]
"""Function that is called at the start of each control cycle with the driver and the time (s), and
may command a twist."""
Watch = Callable[["DrivenRobot", DriverState], None]
"""Function that is called after each control cycle with the robot and the driver's state."""
T = TypeVar("T")

SETTLING = 0.5
"""Real time (s) after a gap in which messages of ROS do not count, as they may have waited.

The ROS middleware delivers what has waited in a thread of its own, later on a busy computer.
"""
_RESTING = 1e-3
"""Speed (m/s, rad/s) at which a robot has come to rest."""


class RunEvent(NamedTuple):
    """An event of a run at the time ``time`` (s), such as ``armed``."""

    time: float
    text: str


class DrivenRobot:
    """A running robot, over a base and a pace.

    All work happens in the thread that calls ``cycle`` or ``run``.  Other threads use ``submit`` to
    call a service.  A service raises ``RequestRefused`` if it cannot be executed.

    - ``base``, ``driver``, ``multiplexer``, ``services``: parts of the robot;
    - ``pace``: when control cycles are due, with the statistics ``timing``;
    - ``feed``: function that commands a twist, in addition to the sources of the multiplexer;
    - ``before_cycle``: function that is called before each cycle of ``run`` with its time (s);
    - ``paused``: ``True`` while a simulation is paused;
    - ``events``: what has happened, such as ``armed``;
    - ``resources``: closed after the base.
    """

    def __init__(
        self,
        robot: Robot,
        base: BaseHandle,
        clock: Clock | None = None,
        *,
        factor: float | None = None,
        parameters: str | None = None,
        arming: str | None = None,
        channel: str = "",
        real_time: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
        keep_starts: bool = False,
    ) -> None:
        """Creates the base driver of the robot.

        - ``clock``: time of the base; ``None`` for a simulation, whose time this object advances;
        - ``factor``: speed of virtual time relative to the real time (0: as fast as possible), or
          ``None`` for a clock that goes on by itself; a simulation has 1 by default;
        - ``parameters``: name of the initial parameter set, ``None`` for the ordinary values;
        - ``arming``: replaces the setting of the robot file;
        - ``channel``: name of the control channel, or empty for no control channel.

        Raises ``DiagnosticError`` if the parameter set is unknown or the calculator cannot drive
        the robot, and ``OSError`` if another program uses the control channel.
        """
        self.robot = robot
        self.base = base
        self.driver = BaseDriver(robot, base, parameters=parameters)
        self.driver.permission.disarm()
        self.owns_clock = clock is None
        self.clock: Clock = clock or SimulatedTime()
        if self.owns_clock and factor is None:
            factor = 1.0
        period = base.period or 1.0 / self.driver.settings.rate
        self.pace = Pace(
            self.clock, period, factor, real_time=real_time, sleep=sleep, keep_starts=keep_starts
        )
        self.multiplexer = Multiplexer.from_robot(robot)
        self.feed: Feed | None = None
        self.before_cycle: Callable[[float], None] | None = None
        self.paused = False
        self.events: list[RunEvent] = []
        self.pre_arm_checks: list[PreArmCheck] = list(PRE_ARM_CHECKS)
        self.resources = contextlib.ExitStack()
        self.stop_engaged = False
        """``True`` from the service ``safety_stop`` until its release by all programs."""
        self._requests: queue.SimpleQueue[tuple[Future[Any], Callable[[], Any]]] = (
            queue.SimpleQueue()
        )
        self._automatic = (arming or robot.driver.arming) == AUTOMATIC
        self._arms_itself = self._automatic
        self._arming_owner: str | None = None
        """Program whose arming waits for the end of the homing."""
        self._armed_at = -math.inf
        self._was_ready = False
        self._settled = -math.inf
        self._void_reason = ""
        self.services = Services([*robot_services(self), *base.services()])
        self.channel: ControlServer | None = None
        if channel:
            self.open_channel(channel)

    def open_channel(self, name: str) -> ControlServer:
        """Opens the control channel ``name``, over which other programs call the services.

        Raises ``OSError`` if another program uses it.
        """
        gaps = self.driver.time_gaps
        longest_wait = gaps.normal if self.pace.factor is None else gaps.longest_short
        self.channel = ControlServer(name, self.services, longest_wait, self.end_program)
        return self.channel

    # -- the loop ----------------------------------------------------------------------------------

    @property
    def now(self) -> float:
        """Time (s) of the robot."""
        return self.clock.now

    @property
    def input_time(self) -> float:
        """Time (s) of a twist that arrives now, later than a service that was called before."""
        return self.now if self.pace.factor is None else self.now + 0.5 * self.pace.period

    @property
    def period(self) -> float:
        """Time (s) from one control cycle to the next."""
        return self.pace.period

    @property
    def timing(self) -> Timing:
        return self.pace.timing

    @property
    def armed(self) -> bool:
        """``True`` if the robot accepts motion."""
        return self.driver.permission.armed

    @property
    def arming(self) -> bool:
        """``True`` while an arming waits for the end of the homing."""
        return self._arming_owner is not None

    @property
    def ready(self) -> bool:
        """``True`` if the base follows joint commands."""
        return not self.base.hold_reason

    def wait(self) -> float:
        """Returns the real time (s) until the next control cycle is due."""
        return math.inf if self.paused else self.pace.wait()

    def cycle(self, now: float) -> DriverState:
        """Runs one control cycle at the time ``now`` (s) and returns the state of the driver."""
        self._note_gap(now)
        self._run_requests()
        if self.channel is not None:
            clock_time = now if self.pace.factor is None else self.pace.real_time()
            self.channel.poll(now, clock_time)
        if self.feed is not None:
            self.feed(self.driver, now)
        self.multiplexer.feed(self.driver, now)
        self.driver.speed_share = self.base.speed_share
        self._supervise_arming(now)
        state = self.driver.tick(now)
        self.base.note_cycle(now, stale=state.mode is not DriveMode.DRIVING)
        if state.mode is DriveMode.HELD or self.driver.permission.fault:
            self.driver.permission.disarm()
        if self.ready and not self._was_ready:
            # During homing, the odometry has measured motions of the steering joints although the
            # robot did not move.
            self._was_ready = True
            self.driver.reset_pose()
        return state

    def run_due_cycle(self, watch: Watch | None = None) -> None:
        """Runs the control cycle that is due.

        A program that has other work between two cycles waits for ``wait()`` seconds and calls
        ``run_due_cycle`` in place of ``run``.
        """
        self.void_reason()
        now = self.pace.begin()
        state = self.cycle(now)
        if watch is not None:
            watch(self, state)
        self.pace.end(now)

    def run(
        self,
        until: float = math.inf,
        *,
        watch: Watch | None = None,
        stop: Callable[[], bool] | None = None,
    ) -> None:
        """Runs control cycles until the time ``until`` (s) or until ``stop()`` returns ``True``.

        CAN frames are sent only during control cycles.
        """
        while not (stop is not None and stop()):
            self._wait_until_due()
            if max(self.clock.now, self.pace.deadline) >= until - 1e-9:
                break
            self.run_due_cycle(watch)

    def step(self) -> None:
        """Waits until the next control cycle is due, and runs it."""
        self._wait_until_due()
        self.run_due_cycle()

    def _wait_until_due(self) -> None:
        self.pace.sleep()
        if self.before_cycle is not None:
            self.before_cycle(self.pace.deadline)

    def shutdown(self) -> None:
        """Stops the robot, takes the torque of its motors away, and closes the base.

        The method returns when the robot stands still, at the latest after the longest stop of the
        base.
        """
        self.disarm()
        self.feed = None
        self.paused = False
        self.base.end()
        pace = self.pace
        if pace.factor is not None:
            pace.factor = 0.0
        pace.restart()
        try:
            # At least two cycles run: the first sends the stop commands, and the second reads the
            # answers of the motor controllers.
            earliest = self.now + 2.5 * self.period
            self.run(
                self.now + self.base.longest_stop,
                stop=lambda: self.now > earliest and self._at_rest(),
            )
            self.base.leave()
            self.clock.sleep_until(self.now + self.period)
        finally:
            self.close()

    def close(self) -> None:
        """Closes the base without a frame: the drives stop by their own time-outs."""
        self.base.close()
        if self.channel is not None:
            self.channel.close()
        self.resources.close()

    def _at_rest(self) -> bool:
        state = self.driver.state
        if state.mode is DriveMode.HELD:
            return self.base.ended
        return state.ramped == ZERO_TWIST and max(map(abs, state.odometry.twist)) < _RESTING

    # -- gaps in time ------------------------------------------------------------------------------

    def _note_gap(self, now: float) -> None:
        """Voids the commands that waited during a gap; a long gap is a fault of moving motors."""
        gap = self.driver.gap_at(now)
        if gap is Gap.NONE:
            return
        elapsed = now - self.driver.state.time
        self.timing.gaps += 1
        self.timing.latest_gap = (now, elapsed)
        self.multiplexer.notice_gap(self.driver, now)
        if gap is Gap.LONG and self.base.gaps_are_faults:
            self.base.fail(gap_text(elapsed))

    def _present_gap(self) -> str:
        """Returns the gap in time that lasts now as text, or an empty text."""
        if self.pace.factor is None:
            last = self.driver.state.time
            gap = self.driver.gap_at(self.now)
            return gap_text(self.now - last) if gap is not Gap.NONE else ""
        # The virtual time stands still meanwhile, so that only commands that waited are void.
        late = 0.0 if self.paused else self.pace.lateness
        return gap_text(late) if self.driver.time_gaps.judge(late) is Gap.LONG else ""

    def void_reason(self) -> str:
        """Returns the reason why inputs that arrive now do not count, or an empty text."""
        gap = self._present_gap()
        if gap:
            self._settled = self.pace.real_time() + SETTLING
            self._void_reason = f"{gap}; commands that waited do not count, send them again"
            if self.pace.factor is not None:
                self.void(gap)
        return self._void_reason if self.pace.real_time() < self._settled else ""

    def void(self, reason: str) -> None:
        """Voids all commands; each source must publish a zero twist before the robot moves."""
        self.multiplexer.void(reason)
        self.driver.void_commands(reason)

    def pause(self, paused: bool) -> None:
        """Stops the simulated time, or lets it run on.  Commands from before or during the pause
        are void.

        Raises ``RequestRefused`` if the time of the base goes on by itself.
        """
        if self.pace.factor is None:
            raise RequestRefused("the time of this robot cannot be paused")
        if self.paused and not paused:
            self.pace.restart()
        self.paused = paused
        self.void("the simulation was paused")

    # -- arming ------------------------------------------------------------------------------------

    def arming_reasons(self, now: float) -> list[str]:
        """Returns the reasons of all checks against arming the robot at ``now`` (s)."""
        reasons = [reason for check in self.pre_arm_checks for reason in check(self, now)]
        # Two checks can have the same reason, such as a motion that is commanded by a source.
        return list(dict.fromkeys(reasons))

    def arm(self, owner: str = THIS_PROGRAM) -> str:
        """Accepts motion of the robot, if all pre-arm checks pass; homes the steering first.

        The robot is disarmed at the start, after each fault, stop and homing, and after ``disarm``.
        If the steering has to be homed, the robot is armed at the end of the homing, if the program
        ``owner`` has not ended before and all checks pass again.

        Returns an empty text, or what the arming waits for.  Raises ``RequestRefused`` with the
        reasons of all checks that do not pass.
        """
        if self.armed:
            return ""
        now = self.now
        self._arms_itself = self._automatic
        if self._arming_owner is None:
            _raise_if("; ".join(self.arming_reasons(now)))
            if self.base.is_homed:
                self._accept_motion(now)
                return ""
            _raise_if(self.base.home(now))
            self._arming_owner = owner
            self.note("homing the steering")
        return "homing the steering; the robot is armed when it has ended"

    def disarm(self, reason: str = "") -> None:
        """Accepts no motion until ``arm`` is called.  A moving robot ramps to rest.

        ``reason``: reason why the robot disarms itself.  Without a reason a person disarms it, and
        automatic arming ends.
        """
        if self.armed:
            self.note(reason or "disarmed")
        self.driver.permission.disarm(reason)
        self._arming_owner = None
        if not reason:
            self._arms_itself = False

    def home_steering(self) -> None:
        """Homes all steering joints, also those that are homed.

        The steering joints turn during homing, and the robot is disarmed.
        """
        stops = self.multiplexer.active_stop_locks(self.now)
        _raise_if(f"the stop lock `{stops[0]}` is active" if stops else "")
        _raise_if(self.base.home(self.now, again=True))

    def _accept_motion(self, now: float) -> None:
        self.driver.permission.arm()
        self.multiplexer.accept_motion(now)
        self._armed_at = now
        self.note("armed")

    def _supervise_arming(self, now: float) -> None:
        """Disarms the robot for every reason to do so, and continues an arming that waits."""
        base = self.base
        stops = self.multiplexer.active_stop_locks(now)
        if stops:
            base.cancel_homing(now)
        if self.armed:
            if stops:
                self.disarm(f"disarmed: the stop lock `{stops[0]}` is active")
            elif base.disarming_reason:
                self.disarm(f"disarmed: {base.disarming_reason}")
            elif self._forgotten(now):
                timeout = self.driver.settings.arming_timeout
                self.disarm(f"disarmed: no source was heard for {timeout:g} s")
        elif self._arming_owner is not None:
            if not base.is_homing:
                self._arming_owner = None
                self._arm_if_allowed(now)
        elif self._arms_itself and (self.ready or not base.is_homed):
            # A homing moves the steering, so that it waits until somebody has commanded zero.
            if base.is_homed:
                self._arm_if_allowed(now)
            elif self.multiplexer.holders(now) or self.feed is not None:
                with contextlib.suppress(RequestRefused):
                    self.arm()

    def _arm_if_allowed(self, now: float) -> None:
        reasons = "; ".join(self.arming_reasons(now))
        if reasons:
            self.driver.permission.disarm(f"disarmed: {reasons}")
        else:
            self._accept_motion(now)

    def _forgotten(self, now: float) -> bool:
        """Checks whether no source was heard for the time after which an arming ends."""
        if self._automatic or self.feed is not None:
            return False
        heard = max(self._armed_at, self.multiplexer.last_heard)
        return now - heard > self.driver.settings.arming_timeout

    # -- stops and faults --------------------------------------------------------------------------

    def safety_stop(
        self, engaged: bool = True, *, owner: str = THIS_PROGRAM, force: bool = False
    ) -> None:
        """Stops all motors of the base and switches the motors off.

        With ``engaged=False``, releases the safety stop of the program ``owner``, or with ``force``
        of all programs.  Raises ``RequestRefused`` if another program has engaged it.

        After the release, the services ``reset`` and ``arm`` must be called before the robot can
        drive again.  A stop in software is not a safety function.
        """
        self.lock(SAFETY_STOP, engaged, owner=owner, force=force)
        self.stop_engaged = engaged
        if engaged:
            self.disarm("disarmed: the safety stop is engaged")
        self.base.safety_stop(engaged)

    @property
    def stop_owners(self) -> tuple[str, ...]:
        """Names of the programs that have engaged the safety stop, also those that have ended."""
        return self.multiplexer.lock_owners(SAFETY_STOP) if self.stop_engaged else ()

    def lock(
        self, name: str, locked: bool = True, *, owner: str = THIS_PROGRAM, force: bool = False
    ) -> None:
        """Sets a twist lock of the program ``owner``, or releases it, see ``Multiplexer.lock``.

        Raises ``RequestRefused`` if another program keeps it locked.
        """
        others = [name for name in self.multiplexer.lock_owners(name) if name != owner]
        try:
            self.multiplexer.lock(name, locked, self.now, owner, force=force)
        except ParameterError as error:
            raise RequestRefused(str(error)) from None
        if force and others and not locked:
            self.note(f"{owner} released by force `{name}` of {' and '.join(others)}")

    def reset(self) -> None:
        """Resets a fault or a stop.  After the reset, the robot is disarmed.

        Raises ``RequestRefused`` unless the safety stop is released and no motion is commanded.
        """
        now = self.now
        commanded = self.driver.commanded_twist(now) != ZERO_TWIST
        _raise_if(self.base.reset(now, commanded or bool(self.multiplexer.requests(now))))
        self.driver.reset()

    # -- services ----------------------------------------------------------------------------------

    def call(self, service: str, owner: str = THIS_PROGRAM, **arguments: Any) -> Any:
        """Calls a service and returns its result.  Raises ``ServiceError`` if it is refused."""
        caller = Caller(owner, void=self.void_reason() if owner != THIS_PROGRAM else "")
        return self.services.call(service, arguments, self.input_time, caller)

    def state(self) -> dict[str, Any]:
        """Returns the state of the robot as JSON values."""
        state: dict[str, Any] = self.services.call("state", {}, self.now)
        return state

    def submit(self, service: Callable[[], T]) -> Future[T]:
        """Requests that the control loop calls ``service`` in its next cycle.

        Any thread may call ``submit``.  The returned future contains the result or the exception of
        the service.
        """
        future: Future[T] = Future()
        self._requests.put((future, service))
        return future

    def _run_requests(self) -> None:
        while True:
            try:
                future, service = self._requests.get_nowait()
            except queue.Empty:
                return
            if not future.set_running_or_notify_cancel():
                continue
            try:
                future.set_result(service())
            except Exception as error:  # the future raises the exception when its result is read
                future.set_exception(error)

    def set_drive_parameters(
        self,
        parameters: str | None = None,
        *,
        radii: dict[str, float] | None = None,
        limits: dict[str, float] | None = None,
    ) -> None:
        """Switches to a parameter set of the robot file, or changes single parameters.

        - ``parameters``: name of a parameter set, or ``None`` for the ordinary parameters;
        - ``radii``: wheel radii (m) by wheel name;
        - ``limits``: limits in SI units by name.

        All parameter changes take effect together, between two control cycles.  Raises
        ``RequestRefused`` if a name or a value is invalid.  Then no parameter is changed.
        """
        try:
            if radii or limits:
                self.driver.update(radii=radii, noise=None, **(limits or {}))
            else:
                self.driver.use(parameters)
        except (ParameterError, DiagnosticError) as error:
            raise RequestRefused(str(error)) from None

    def note(self, text: str) -> None:
        """Records an event for the summary of the run, such as ``armed``."""
        self.events.append(RunEvent(self.now, text))

    def end_program(self, name: str) -> None:
        """Notes that a program has ended: its twists are void, its stops stay engaged."""
        self.multiplexer.release(name)
        if self._arming_owner == name:
            self._arming_owner = None
            self.note("not armed: the program that armed has ended during the homing")


def _raise_if(reason: str) -> None:
    """Raises ``RequestRefused`` with the text ``reason`` if ``reason`` is not empty."""
    if reason:
        raise RequestRefused(reason)
