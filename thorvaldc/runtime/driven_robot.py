"""A driven robot: its control cycle, its services, and the rule of gaps in time.

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
from typing import Any, TypeVar

from thorvaldc.diagnostics import CODES
from thorvaldc.diagnostics.files import finite
from thorvaldc.diagnostics.installation import program_version
from thorvaldc.model import Robot
from thorvaldc.runtime import service_table
from thorvaldc.runtime.arming import ArmableRobot
from thorvaldc.runtime.base_interface import BaseHandle, RequestRefused
from thorvaldc.runtime.control_channel import ControlServer, version_text
from thorvaldc.runtime.driver import BaseDriver, DriveMode, DriverState
from thorvaldc.runtime.pace import Clock, Gap, Pace, SimulatedTime, gap_text
from thorvaldc.runtime.permission import THIS_PROGRAM, Rules
from thorvaldc.runtime.run_time_parameters import LIMITS
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist

Watch = Callable[["DrivenRobot", DriverState], None]
"""Function that is called after each control cycle with the robot and the driver's state."""
T = TypeVar("T")

SETTLING = 0.5
"""Real time (s) after a gap in which messages of ROS do not count, as they may have waited.

The ROS middleware delivers what has waited in a thread of its own, later on a busy computer.
"""
MOST_VERSIONS = 20
"""Greatest number of versions of other programs that are reported."""
_RESTING = 1e-3
"""Speed (m/s, rad/s) at which a robot has come to rest."""


class DrivenRobot(ArmableRobot):
    """A running robot, over a base and a pace.

    All work happens in the thread that calls ``cycle`` or ``run``.  Other threads use ``submit`` to
    call a service.  A service raises ``RequestRefused`` if it cannot be executed.

    - ``services``: what other programs can request;
    - ``before_cycle``: function that is called before each cycle of ``run`` with its time (s);
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
        pace: Pace | None = None,
    ) -> None:
        """Creates the base driver of the robot.

        - ``clock``: time of the base; ``None`` for a simulation, whose time this object advances;
        - ``factor``: speed of virtual time relative to the real time (0: as fast as possible), or
          ``None`` for a clock that goes on by itself; a simulation has 1 by default;
        - ``parameters``: name of the initial parameter set, ``None`` for the ordinary values;
        - ``arming``: replaces the setting of the robot file;
        - ``channel``: name of the control channel, or empty for no control channel;
        - ``pace``: when cycles are due, where no fixed period says it.

        Raises ``DiagnosticError`` if the parameter set is unknown or the calculator cannot drive
        the robot, and ``OSError`` if another program uses the control channel.
        """
        driver = BaseDriver(robot, base, parameters=parameters)
        self.owns_clock = clock is None
        self.clock: Clock = clock or SimulatedTime()
        if self.owns_clock and factor is None:
            factor = 1.0
        period = base.period or 1.0 / driver.settings.rate
        pace = pace or Pace(
            self.clock, period, factor, real_time=real_time, sleep=sleep, keep_starts=keep_starts
        )
        super().__init__(base, driver, pace, arming)
        self.before_cycle: Callable[[float], None] | None = None
        self.resources = contextlib.ExitStack()
        self._requests: queue.SimpleQueue[tuple[Future[Any], Callable[[], Any]]] = (
            queue.SimpleQueue()
        )
        self._was_ready = False
        self._settled = -math.inf
        self._void_reason = ""
        self.services = service_table.Services([*robot_services(self), *base.services()])
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
    def input_time(self) -> float:
        """Time (s) of a twist that arrives now, later than a service that was called before."""
        return self.now if self.pace.factor is None else self.now + 0.5 * self.pace.period

    @property
    def period(self) -> float:
        """Time (s) from one control cycle to the next."""
        return self.pace.period

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
        self._select(now)
        self.driver.speed_share = self.base.speed_share
        state = self.driver.tick(now)
        self.base.note_cycle(now, stale=state.mode is not DriveMode.DRIVING)
        if state.mode is DriveMode.HELD or self.permission.value.fault:
            self.permission.step(Rules.hold)
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
        if self.base.lacks_joint_states and state.command is not None:
            return not any(state.command.joints.speeds)
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

    def void_reason(self, age: float = 0.0) -> str:
        """Returns the reason why inputs that were sent ``age`` s ago do not count, or no text."""
        gap = self._present_gap()
        if gap:
            self._settled = self.pace.real_time() + SETTLING
            self._void_reason = f"{gap}; commands that waited do not count, send them again"
            if self.pace.factor is not None:
                self.void(gap)
        return self._void_reason if self.pace.real_time() - age < self._settled else ""

    def void(self, reason: str) -> None:
        """Voids all commands; each source must publish a zero twist before the robot moves."""
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

    # -- services ----------------------------------------------------------------------------------

    def call(self, service: str, owner: str = THIS_PROGRAM, **arguments: Any) -> Any:
        """Calls a service and returns its result.  Raises ``ServiceError`` if it is refused."""
        caller = service_table.Caller(
            owner, void=self.void_reason() if owner != THIS_PROGRAM else ""
        )
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


# -- services, for other programs and for ROS ---------------------------------------------------


def robot_services(robot: ArmableRobot) -> list[service_table.Service]:
    """Returns the services that command twists, arm and stop the robot, return its state, reset the
    odometry and change parameters.

    The service ``safety_stop`` stops the robot by software and is not a safety function.
    """

    def twist(
        now: float,
        caller: service_table.Caller,
        source: str,
        vx: float = 0.0,
        vy: float = 0.0,
        wz: float = 0.0,
    ) -> None:
        published = now - caller.age
        if refusal := robot.multiplexer.publish(source, Twist(vx, vy, wz), published, caller.name):
            raise service_table.ServiceError(refusal)

    def set_drive_parameters(
        set: str | None = None,
        radii: dict[str, float] = {},  # noqa: B006
        **limits: float | None,
    ) -> None:
        changes = {name: value for name, value in limits.items() if value is not None}
        if set is None and not radii and not changes:
            raise service_table.ServiceError(
                "`set_drive_parameters` needs `set`, `radii` or a limit"
            )
        if set is not None and (radii or changes):
            raise service_table.ServiceError(
                "`set` cannot be combined; change single values in another call"
            )
        robot.set_drive_parameters(set or None, radii=radii, limits=changes)

    def hello(caller: service_table.Caller, version: str) -> dict[str, str]:
        version = version[:40]
        is_new = version not in robot.other_versions and len(robot.other_versions) < MOST_VERSIONS
        if version != program_version() and is_new:
            robot.other_versions[version] = version_text(caller.name, version)
            robot.note(robot.other_versions[version])
        return {"version": program_version()}

    return [
        service_table.Service(
            "hello",
            "State the caller's version of thorvaldc, and return the driver's; the driver reports a"
            " difference.",
            hello,
            valid_late=True,
        ),
        service_table.Service(
            "twist",
            "Command the twist of a source (m/s, m/s, rad/s); it is valid until the time-out of the"
            " source, while the connection is open.",
            twist,
        ),
        service_table.Service(
            "state",
            "Return the state of the robot.",
            lambda now: robot_state(robot, now),
            valid_late=True,
        ),
        service_table.Service(
            "description",
            "Return the robot's constants: names, top speeds, rate.",
            lambda: robot_description(robot),
            valid_late=True,
        ),
        service_table.Service(
            "reset_odometry",
            "Set the pose of the odometry to zero.",
            lambda: robot.driver.reset_pose(),
        ),
        service_table.Service(
            "set_drive_parameters",
            "Change to a parameter set (`set`; empty: the default values), or change radii (m, by"
            " wheel) and limits.",
            set_drive_parameters,
            tuple(service_table.Argument(name, "number", None) for name in LIMITS),
        ),
        *_permission_services(robot),
    ]


def _permission_services(robot: ArmableRobot) -> list[service_table.Service]:
    """Returns the services that let the robot move, stop it, and set and release locks."""

    def lock(
        caller: service_table.Caller, name: str, locked: bool = True, force: bool = False
    ) -> str | None:
        if caller.void and not locked:
            raise service_table.ServiceError(caller.void)
        return robot.lock(name, locked, owner=caller.name, force=force) or None

    def release_safety_stop(caller: service_table.Caller, force: bool = False) -> str | None:
        return robot.safety_stop(False, owner=caller.name, force=force) or None

    return [
        service_table.Service(
            "arm",
            "Accept motion, if all pre-arm checks pass; homes the steering first if needed, while"
            " the connection is open. Refused with every reason.",
            lambda caller: robot.arm(caller.name) or None,
        ),
        service_table.Service(
            "disarm",
            "Accept no motion until `arm`; a moving robot ramps to rest.",
            lambda: robot.disarm(),
            valid_late=True,
        ),
        service_table.Service(
            "home_steering", "Home all steering joints; they turn.", robot.home_steering
        ),
        service_table.Service(
            "reset_faults",
            "Leave a fault or a stop; the stop must be released, and zero commanded.",
            robot.reset,
        ),
        service_table.Service(
            "lock",
            "Set a lock, which blocks sources up to its priority, or release it.",
            lock,
            valid_late=True,  # the function refuses a late release
        ),
        service_table.Service(
            "safety_stop",
            "Stop all motors and switch them off, until release and reset.",
            lambda caller: robot.safety_stop(owner=caller.name) or None,
            valid_late=True,
        ),
        service_table.Service(
            "release_safety_stop",
            "Release the safety stop of this connection (`force`: of every connection); to drive"
            " again, call `reset_faults` and `arm`.",
            release_safety_stop,
        ),
    ]


def robot_state(robot: ArmableRobot, now: float) -> dict[str, Any]:
    """Returns the state of a robot as JSON values, in m, rad, m/s and rad/s.

    ``time``: time (s) of the last control cycle; ``uptime``: since the start of the driver;
    ``age``: since the joints were measured.  The base adds its own values, such as those of
    batteries; its ``fault`` replaces that of the driver.
    """
    driver, multiplexer = robot.driver, robot.multiplexer
    state, selected = driver.state, multiplexer.select(now)
    base = robot.base.values()
    values = {
        "robot": driver.robot.name,
        "time": state.time if state.time > 0.0 else 0.0,
        "uptime": now - robot.start_time,
        "mode": state.mode.value,
        "armed": robot.armed,
        "arming": robot.arming,
        "paused": robot.paused,
        "source": selected.source,
        "locks": list(selected.locks),
        "owners": multiplexer.holders(now),
        "zero_awaited": multiplexer.awaited_zeros(now),
        "asked": state.commanded_twist._asdict(),
        "in_force": state.ramped._asdict(),
        "infeasible": state.infeasible._asdict(),
        "odometry": state.odometry.twist._asdict(),
        "pose": state.pose._asdict(),
        "joints": _joints(robot),
        "age": None if state.joints is None else now - state.joints.time,
        "fault": (fault := base.get("fault") or state.fault),
        "fault_code": base.get("fault_code") or (CODES["bus-stopped"].number if fault else ""),
        "held": state.hold_reason,
        "limited_by": driver.limit_of(state.commanded_twist),
        "not_followed": state.not_followed,
        "stopped_by": list(robot.stop_owners),
        "warnings": [*robot.base.warnings(now), *driver.odometry.warnings],
        "cycles": robot.timing.cycles,
        "overruns": robot.timing.overruns,
    }
    return {**values, **base, **{key: values[key] for key in ("fault", "fault_code")}}


def _joints(robot: ArmableRobot) -> dict[str, dict[str, float | None]]:
    """Returns the measured speed (rad/s) of each driven wheel and the steering angle (rad) of each
    steered wheel, by the name of the wheel; ``None``: the newest report is too old."""
    joints = robot.driver.state.joints
    if joints is None:
        return {}
    return {
        wheel.name: finite(
            ({"speed": joints.speeds[i]} if wheel.driven else {})
            | ({"angle": joints.angles[i]} if wheel.steered else {})
        )
        for i, wheel in enumerate(robot.robot.wheels)
        if wheel.driven or wheel.steered
    }


def robot_description(robot: ArmableRobot) -> dict[str, Any]:
    """Returns the constants of a robot as JSON values.

    The constants are names, top speeds (m/s, rad/s) and the rate of the control cycle (Hz).
    """
    model, limits = robot.robot, robot.driver.settings
    steerable = [w.steered or w.swivel_joint is not None for w in model.wheels]
    return {
        "robot": model.name,
        "rate": limits.rate,
        "max_linear_velocity": limits.max_linear_velocity,
        "max_angular_velocity": limits.max_angular_velocity,
        "sideways": bool(steerable) and all(steerable),
        "sources": [source.name for source in model.twist_sources],
        "locks": [lock.name for lock in model.twist_locks],
        "parameter_sets": [parameters.name for parameters in model.parameter_sets],
    }
