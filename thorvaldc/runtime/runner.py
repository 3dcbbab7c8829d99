"""The control loop of a robot on its buses, and the services of a running robot.

The control loop starts its cycles at absolute deadlines, one per period T, so that timing errors do
not accumulate.  If a control cycle takes longer than the period T, the loop skips the missed
deadlines and continues at the next deadline:

    deadlines   |--------|--------|--------|--------|
    work        [##]     [################]         [##]
                           overrun: 1      skipped: 1
"""

from __future__ import annotations

import math
import queue
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field
from typing import Any, NamedTuple, TypeVar

from thorvaldc.can.canopen import NmtCommand
from thorvaldc.can.frame import CanFrame
from thorvaldc.can.interface import CanInterface
from thorvaldc.diagnostics.error import DiagnosticError
from thorvaldc.model.robot import AUTOMATIC, Robot
from thorvaldc.runtime.can_base.base_state import BaseState
from thorvaldc.runtime.can_base.battery_and_io_drivers import BatteryState, IoBoardDriver
from thorvaldc.runtime.can_base.battery_supervision import BatteryLevel, BatterySupervision
from thorvaldc.runtime.can_base.bus_connection import BusConnection
from thorvaldc.runtime.can_base.can_base import CanBase
from thorvaldc.runtime.can_base.foreign_frame_relay import RelayedFrame
from thorvaldc.runtime.can_base.motor_controller import MotorController
from thorvaldc.runtime.driver import BaseDriver, DriveMode, DriverState
from thorvaldc.runtime.errors import ParameterError
from thorvaldc.runtime.owned_stop import THIS_PROGRAM, OwnedStop
from thorvaldc.runtime.pre_arm_checks import PRE_ARM_CHECKS, PreArmCheck
from thorvaldc.runtime.se2 import ORIGIN, ZERO_TWIST
from thorvaldc.runtime.time_gap import Gap, gap_text

Feed = Callable[[BaseDriver, float], object]
"""Function that is called at the start of each control cycle with the driver and the time (s).

The function may command a twist, as ``Multiplexer.feed`` does.
"""
Watch = Callable[["BaseRunner", DriverState], None]
"""Function that is called after each control cycle with the runner and the driver's state."""
T = TypeVar("T")


class RequestRefused(ValueError):
    """A service of the robot refused a request and changed nothing.

    The message of the exception contains the reason for the refusal.
    """


class StateChange(NamedTuple):
    """A change of the state of the base.

    - ``time``: time of the change, s.
    - ``state``: new state of the base.
    - ``reason``: reason for the state FAULT or ESTOP.
    """

    time: float
    state: BaseState
    reason: str


class RunEvent(NamedTuple):
    """An event of a run at the time ``time`` (s), such as ``armed``."""

    time: float
    text: str


@dataclass(slots=True)
class Timing:
    """Statistics of the timing of the control loop.

    - ``cycles``: number of control cycles.
    - ``overruns``: number of control cycles that ended after the next deadline.
    - ``skipped``: number of deadlines that the loop skipped because of overruns.
    - ``latest``: longest delay (s) between a deadline and the start of its cycle.
    - ``longest``: longest duration (s) of a cycle.
    - ``gaps``: number of gaps in time between two cycles, see ``time_gap``.
    """

    cycles: int = 0
    overruns: int = 0
    skipped: int = 0
    latest: float = 0.0
    longest: float = 0.0
    gaps: int = 0
    latest_gap: tuple[float, float] | None = None
    """End (s) and duration (s) of the latest gap."""
    starts: list[float] = field(default_factory=list)
    """Start times (s) of the cycles.  Recorded only with ``keep_starts``."""


class BaseRunner:
    """A running robot with its base on the buses, its driver and its services.

    All work of the runner happens in the thread that calls ``cycle`` or ``run``.  Other threads use
    ``submit`` to call a service.  A service raises ``RequestRefused`` if it cannot be executed.

    - ``base``: base of the robot on its CAN buses.
    - ``driver``: base driver that computes the joint commands.
    - ``clock``: CAN interface of the first bus, which measures the time.  The time of a simulated
      bus is virtual.
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
        """Creates the base driver of the robot.

        ``parameters`` is the name of the initial parameter set.  If ``parameters`` is ``None``, the
        driver uses the ordinary values of the robot file.  Raises ``DiagnosticError`` if the
        parameter set is unknown or the calculator cannot drive the robot.
        """
        self.robot = robot
        self.base = base
        self.clock = clock
        self.driver = BaseDriver(robot, base, parameters=parameters)
        self.period = base.period
        self.timing = Timing()
        self.changes: list[StateChange] = []
        self.feed: Feed | None = None
        self.pace: Callable[[float], None] | None = None
        """Function that is called before each control cycle with the time (s) of the cycle.

        The function can sleep to slow down virtual time.
        """
        self._requests: queue.SimpleQueue[tuple[Future[Any], Callable[[], Any]]] = (
            queue.SimpleQueue()
        )
        self.battery_supervision = BatterySupervision(
            robot.driver.battery,
            [battery for connection in base.connections for battery in connection.batteries],
        )
        self._keep_starts = keep_starts
        self._deadline: float | None = None
        self._was_ready = False
        self._stop = OwnedStop()
        self._arms_automatically = self.driver.settings.arming == AUTOMATIC
        self.events: list[RunEvent] = []
        self.pre_arm_checks: list[PreArmCheck] = list(PRE_ARM_CHECKS)
        base.state_machine.changed = self._note_change

    # -- the loop ----------------------------------------------------------------------------------

    @property
    def state(self) -> BaseState:
        return self.base.state_machine.state

    @property
    def ready(self) -> bool:
        """``True`` if the robot is ready to drive."""
        return self.state.drives and not self.base.state_machine.ending

    def cycle(self, now: float) -> DriverState:
        """Runs one control cycle at the time ``now`` (s) and returns the state of the driver.

        A control cycle executes the requested services, selects the commanded twist, reads the
        joints, sends the joint commands, and updates the state of the base.

        A gap in time since the last control cycle voids all commands.  A long gap is a fault if the
        motors may have torque.
        """
        if self.driver.gap_at(now) is not Gap.NONE:
            self._note_gap(now)
        self._run_requests()
        if self.feed is not None:
            self.feed(self.driver, now)
        batteries = self.battery_supervision
        stops = batteries.update(now) is BatteryLevel.STOP
        self.driver.speed_share = batteries.speed_share
        if stops and self.base.armed and not self._arms_automatically:
            self.base.disarm(f"disarmed: {batteries.reason}")
            self.note(f"disarmed: {batteries.reason}")
        if self._arms_automatically and self.ready and not self.base.armed:
            # A joystick that is deflected during the start-up cannot move the robot.
            self._arm_at_zero(now)
        state = self.driver.tick(now)
        stale = state.mode is not DriveMode.DRIVING
        self.base.state_machine.note_motion(now, not self.base.standing, stale)
        if self.ready and not self._was_ready:
            # During homing, the odometry has measured motions of the steering joints although the
            # robot did not move.
            self._was_ready = True
            self.driver.reset_pose()
        return state

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
            deadline = self._deadline = self.deadline
            self.clock.sleep_until(deadline)
            if self.pace is not None:
                self.pace(deadline)
            if self.clock.now >= until - 1e-9:
                break
            self.run_due_cycle(watch)

    @property
    def deadline(self) -> float:
        """Time (s) at which the next control cycle is due."""
        return self._deadline if self._deadline is not None else self.clock.now

    def run_due_cycle(self, watch: Watch | None = None) -> None:
        """Runs the control cycle that is due, and updates the timing statistics.

        The caller has waited until ``deadline``.  A program that has other work between two cycles
        calls ``run_due_cycle`` in place of ``run``.
        """
        clock, timing, period, deadline = self.clock, self.timing, self.period, self.deadline
        now = clock.now
        timing.cycles += 1
        timing.latest = max(timing.latest, now - deadline)
        if self._keep_starts:
            timing.starts.append(now)
        state = self.cycle(now)
        if watch is not None:
            watch(self, state)
        end = clock.now
        timing.longest = max(timing.longest, end - now)
        deadline += period
        if end > deadline:
            skipped = math.ceil((end - deadline) / period)
            timing.overruns += 1
            timing.skipped += skipped
            deadline += skipped * period
        self._deadline = deadline

    def shutdown(self) -> None:
        """Stops the robot, switches the motors off, and closes the CAN interfaces.

        The runner commands a quick stop, then switches the motor torque off, then sends the NMT
        command that puts all nodes into the state pre-operational.  The method returns when the
        robot stands still, at the latest after the time ``Times.stop``.
        """
        state_machine = self.base.state_machine
        state_machine.end()
        self.feed = None
        try:
            limit = self.clock.now + state_machine.times.stop
            self._deadline = None
            # At least two cycles run: the first cycle sends the stop commands, and the second cycle
            # reads the answers of the motor controllers.
            earliest = self.clock.now + 2.5 * self.period
            self.run(limit, stop=lambda: state_machine.ended and self.clock.now > earliest)
            if state_machine.may_send:
                for connection in self.base.connections:
                    connection.outbox.clear()
                    connection.queue_nmt(NmtCommand.ENTER_PRE_OPERATIONAL)
                    while connection.outbox:
                        connection.send(connection.outbox.popleft(), self.period)
                self.clock.sleep(self.period)
        finally:
            self.base.close()

    def _note_gap(self, now: float) -> None:
        elapsed = now - self.driver.state.time
        self.timing.gaps += 1
        self.timing.latest_gap = (now, elapsed)
        state_machine = self.base.state_machine
        powered = self.state.drives or self.state is BaseState.HOMING
        is_long = self.driver.gap_at(now) is Gap.LONG
        if is_long and powered and not state_machine.ending:
            state_machine.fail(gap_text(elapsed))

    def _arm_at_zero(self, now: float) -> None:
        if self.driver.commanded_twist(now) == ZERO_TWIST:
            self.base.arm()
        else:
            self.base.disarm("a motion was commanded before the base was ready")

    def note(self, text: str) -> None:
        """Records an event for the summary of the run, such as ``armed``."""
        self.events.append(RunEvent(self.clock.now, text))

    def _note_change(self, now: float, state: BaseState, reason: str) -> None:
        self.changes.append(StateChange(now, state, reason))

    # -- services ----------------------------------------------------------------------------------

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

    def safety_stop(
        self, engaged: bool = True, *, owner: str = THIS_PROGRAM, force: bool = False
    ) -> None:
        """Stops all motors of the base and switches the motors off.

        With ``engaged=False``, releases the safety stop of the program ``owner``, or with ``force``
        of all programs.  Raises ``RequestRefused`` if another program has engaged it.

        After the release, the services ``reset`` and ``arm`` must be called before the robot can
        drive again.  A stop in software is not a safety function.
        """
        stop = self._stop
        others = [name for name in stop.owners if name != owner]
        refusal = ""
        if engaged:
            stop.engage(owner)
        else:
            refusal = stop.release(owner, force)
            if force and others:
                self.note(f"{owner} released by force the safety stop of {' and '.join(others)}")
        self.base.state_machine.safety_stop(stop.engaged)
        _raise_if(refusal)

    @property
    def stop_owners(self) -> tuple[str, ...]:
        """Names of the programs that have engaged the safety stop."""
        return self._stop.owners

    def note_end(self, owner: str) -> None:
        """Notes that a program has ended; its safety stop stays engaged."""
        self._stop.note_end(owner)

    def reset(self, *, commanded: bool = False) -> None:
        """Resets the base from the state FAULT or ESTOP.  After the reset, the base is disarmed.

        ``commanded``: ``True`` if a motion is commanded that the driver has not taken over.  Raises
        ``RequestRefused`` unless the safety stop is released and no motion is commanded.
        """
        now = self.clock.now
        commanded = commanded or self.driver.commanded_twist(now) != ZERO_TWIST
        _raise_if(self.base.state_machine.reset(now, commanded))
        self.driver.reset()

    def arm(self) -> None:
        """Accepts motion of the robot, if all pre-arm checks pass.

        The base is disarmed before it is ready, after each fault, stop and homing, and after
        ``disarm``.  Raises ``RequestRefused`` with the reasons of all checks that do not pass.
        """
        if self.base.armed:
            return
        now = self.clock.now
        reasons = [reason for check in self.pre_arm_checks for reason in check(self, now)]
        # Two checks can have the same reason, such as a motion that is commanded by a source.
        _raise_if("; ".join(dict.fromkeys(reasons)))
        self.base.arm()
        self.driver.accept_motion()
        self.note("armed")
        self._arms_automatically = self.driver.settings.arming == AUTOMATIC

    def disarm(self) -> None:
        """Accepts no motion until ``arm`` is called.  A moving robot ramps to rest."""
        if self.base.armed:
            self.note("disarmed")
        self.base.disarm()
        self._arms_automatically = False

    def home_steering(self) -> None:
        """Starts the homing of all steering joints again.

        The steering joints turn during homing.
        """
        _raise_if(self.base.state_machine.home(self.clock.now))

    def set_home_count_current_position_zero(self, node: str = "") -> None:
        """Sets the present steering angles of one or all motor controllers as the zero position.

        ``node`` is the name of a motor controller in the robot file.  An empty name selects all
        motor controllers.  The motor controllers store the new zero position and use the new zero
        position from the next homing on.  Raises ``RequestRefused`` if the robot moves, if a
        selected motor controller is not homed, or if none of the selected motor controllers uses a
        home switch.
        """
        self._require_standing()
        frames = 0
        for connection, controller in self._controllers(node):
            if not controller.homed:
                raise RequestRefused(f"{controller.node.name} is not homed")
            frame = controller.set_zero_frame()
            if frame is not None:
                connection.outbox.append(frame)
                frames += 1
        if not frames:
            raise RequestRefused("none of these controllers counts from a home switch")

    def reset_odometry(self) -> None:
        """Sets the pose of the odometry to the origin."""
        self.driver.reset_pose(ORIGIN)

    def set_drive_parameters(
        self,
        parameters: str | None = None,
        *,
        radii: Mapping[str, float] | None = None,
        limits: Mapping[str, float] | None = None,
    ) -> None:
        """Switches to a parameter set of the robot file, or changes single parameters.

        - ``parameters``: name of a parameter set.  The name ``None`` selects the ordinary
          parameters of the robot file.
        - ``radii``: wheel radii (m) by wheel name.
        - ``limits``: limits in SI units by name.

        All parameter changes take effect together, between two control cycles.  Raises
        ``RequestRefused`` if the name or the value of a parameter is invalid.  If the request is
        refused, no parameter is changed.
        """
        try:
            if radii or limits:
                self.driver.update(radii=radii, noise=None, **(limits or {}))
            else:
                self.driver.use(parameters)
        except (ParameterError, DiagnosticError) as error:
            raise RequestRefused(str(error)) from None

    def setup_motor_controller(self, node: str, setting: str, value: float) -> None:
        """Changes a setting of a motor controller.

        - ``node``: name of the motor controller.  An empty name selects all motor controllers.
        - ``setting``: name of a value that the settings frame of the motor controller can change.
        - ``value``: new value in the unit of the motor controller.

        Raises ``RequestRefused`` if the robot moves, or if the name or the value of the setting is
        invalid.
        """
        self._require_standing()
        for connection, controller in self._controllers(node):
            try:
                connection.queue_setting(controller, setting, value)
            except ValueError as error:
                known = ", ".join(controller.setting_names())
                reason = f"{error}; there are {known}" if known else str(error)
                raise RequestRefused(reason) from None

    def mute_devices(self, muted: bool = True) -> None:
        """Stops relaying CAN frames to foreign devices.  ``muted=False`` resumes relaying."""
        for connection in self.base.connections:
            connection.relay.mute(muted)

    def set_output(self, board: str, output: str, on: bool) -> None:
        """Switches an output of an IO board on or off.

        Raises ``RequestRefused`` if the robot has no such IO board or output.
        """
        for connection in self.base.connections:
            for io_board in connection.boards:
                if io_board.node.name == board:
                    try:
                        connection.outbox.append(io_board.switch(output, on))
                    except KeyError:
                        known = ", ".join(io_board.outputs)
                        reason = f"{board} has no output `{output}`; it has {known}"
                        raise RequestRefused(reason) from None
                    return
        boards = ", ".join(b.node.name for b in self.boards)
        known = f"; there are {boards}" if boards else ""
        raise RequestRefused(f"there is no IO board `{board}`{known}")

    def send_to_device(self, cob_id: int, data: bytes, bus: str = "") -> None:
        """Relays a CAN frame to a foreign device.  An empty ``bus`` selects the first CAN bus.

        Raises ``RequestRefused`` if the bus is unknown or the relay drops the CAN frame, for
        example because the robot file does not allow its CAN id.
        """
        connection = self._connection(bus)
        reason = connection.relay.offer(CanFrame(cob_id, data), self.clock.now)
        _raise_if(f"{cob_id:#05x}: {reason}" if reason else "")

    def from_devices(self, bus: str = "") -> list[RelayedFrame]:
        """Returns the CAN frames that foreign devices have sent since the last call."""
        return self._connection(bus).relay.received()

    # -- state -----------------------------------------------------------------------------------

    @property
    def boards(self) -> list[IoBoardDriver]:
        return [board for connection in self.base.connections for board in connection.boards]

    def batteries(self) -> dict[str, BatteryState]:
        """Returns the states of the batteries by the name of the battery's node."""
        return {b.node.name: b.state for c in self.base.connections for b in c.batteries}

    def warnings(self) -> list[str]:
        """Returns warnings about the robot for the operator.

        The warnings do not stop the robot.
        """
        now = self.clock.now
        warnings = self.battery_supervision.warnings()
        for connection in self.base.connections:
            warnings += [f"{name}: no reports" for name in connection.silent_devices(now)]
            warnings += connection.suspicious_devices()
        return warnings

    def relay_drops(self) -> dict[str, int]:
        """Returns the number of CAN frames that the relay dropped, for each CAN id and reason.

        The keys of the returned dictionary are texts such as ``0x240 too often``.
        """
        return {
            f"{cob_id:#05x} {reason}": number
            for connection in self.base.connections
            for (cob_id, reason), number in sorted(connection.relay.dropped.items())
        }

    # -- inside --------------------------------------------------------------------------------

    def _controllers(self, node: str) -> Sequence[tuple[BusConnection, MotorController]]:
        """Returns the motor controllers with the name ``node``, each with its bus connection.

        An empty name selects all motor controllers.  Raises ``RequestRefused`` if no motor
        controller has this name.
        """
        every = [(c, controller) for c in self.base.connections for controller in c.controllers]
        matching = [
            (c, controller) for c, controller in every if node in ("", controller.node.name)
        ]
        if not matching:
            known = ", ".join(controller.node.name for _, controller in every)
            raise RequestRefused(f"there is no controller `{node}`; there are {known}")
        return matching

    def _connection(self, bus: str) -> BusConnection:
        for connection in self.base.connections:
            if bus in ("", connection.bus.name):
                return connection
        raise RequestRefused(f"there is no bus `{bus}`")

    def _require_standing(self) -> None:
        if self.state is BaseState.ACTIVE or not self.base.standing:
            raise RequestRefused("the robot drives; stop it first")


def _raise_if(reason: str) -> None:
    """Raises ``RequestRefused`` with the text ``reason`` if ``reason`` is not empty."""
    if reason:
        raise RequestRefused(reason)
