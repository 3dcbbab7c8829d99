"""The checks of one motor after the other, as steps of a ``MotorSession``.

Each motion is started by the operator and ended by silence.  Order of the checks of a wheel::

    one turn         which wheel moved, how far; time to rest after silence
    half a second    safety stop: time to rest            } once for each
    half a second    no heartbeat and no command: time to } motor controller
                     rest by the drive's own watchdog

and of a steering joint: homing, which wheel moved, its angle at zero; a turn by ``STEERING_TRAVEL``
and the angle after it; both limits, if the direction is right.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection

from thorvaldc.commissioning.commission_report import YES
from thorvaldc.model import Actuator, Robot, stopping
from thorvaldc.model.settings import SAFETY_STOP
from thorvaldc.runtime.can_base.base_fault import Cause
from thorvaldc.runtime.can_base.base_state_machine import BaseState, Times
from thorvaldc.runtime.can_base.motor_controller import FRESH, MotorController
from thorvaldc.runtime.motion_supervision import Axis
from thorvaldc.runtime.pace import gap_text
from thorvaldc.tools.commission.assembly_findings import has_moved_as_expected
from thorvaldc.tools.commission.motion_watch import ABORTS, CYCLES, MotionWatch, Travel, test_speed
from thorvaldc.tools.commission.motor_session import (
    Interrupted,
    MotorSession,
    SingleMotorBase,
    Steps,
)
from thorvaldc.tools.commission.questions import Answer, Operator, Question, joint_text
from thorvaldc.tools.commission.results import (
    EMERGENCY_STOP,
    STANDS,
    WATCHDOG,
    MotorResult,
    Observation,
)

WHEEL_TRAVEL = math.tau
"""Travel (rad) of a wheel: one turn, which a mark on the tyre shows."""
STEERING_TRAVEL = math.radians(30.0)
"""Travel (rad) of a steering joint."""
LIMIT_MARGIN = math.radians(3.0)
"""Distance (rad) from the limits of a steering joint up to which it is turned."""
STEADY = 0.3
"""Time (s) at the test speed before a stop, and at least ``REPORT_CYCLES`` control cycles."""
REST_SHARE = 0.05
"""Share of the test speed below which a motor is at rest."""
SLOWER = 0.8
"""Share of the test speed below which a motor slows down."""
SERVO_LAG = 0.15
"""Time (s) in which the speed loop of a drive settles."""
REPORT_CYCLES = 4
"""Control cycles in which a rest is seen: share of the twist, command, reports."""
WATCHDOG_PATIENCE = 0.5
"""Time (s) after the promised one in which a drive may still act, before its torque is taken."""
WRONG_ENCODER = 4.0
"""Factor by which a wheel is faster with the wrong encoder, at most."""
REACTION = 0.6
"""Time (s) in which a motor with an unstable speed loop loses its torque."""
PRESS_TIME = 20.0
"""Longest time (s) in which the operator presses the emergency stop."""
WATCHDOG_CAUSES = (Cause.DRIVE, Cause.SILENCE, Cause.MOTION)
"""Causes of the faults that follow when the watchdogs of drives act."""
REPORTED_TOLERANCE = 0.1
"""Largest deviation of the reported travel, as a share of the commanded one."""


class MotorChecks:
    """The checks of all motors of a robot.

    - ``results``: results by the name of the motor, which ``run`` adds to;
    - ``kept``: names of motors that are not checked, because an earlier check has passed;
    - ``save``: called after each motor.
    """

    def __init__(
        self,
        session: MotorSession,
        operator: Operator,
        results: dict[str, MotorResult],
        kept: Collection[str] = (),
        save: Callable[[], object] = lambda: None,
    ) -> None:
        self.session = session
        self.robot: Robot = session.driven.robot
        self.operator = operator
        self.results = results
        self._save = save
        self.interruption = ""
        self._kept = kept
        self._stops_tested: set[str] = set()
        for axis in session.base.axes:
            if axis.actuator.name in kept and not axis.steering:
                self._stops_tested.add(self._controller(axis).node.name)

    def run(self) -> Steps[None]:
        """Checks each motor that has no result yet, wheels first.

        Ends with a reason in ``interruption`` if the base fails for another reason than the motion
        of the motor.
        """
        try:
            yield from self._run()
        except Interrupted as interruption:
            self.interruption = str(interruption)
            self.operator.alarm(self.interruption)

    def _run(self) -> Steps[None]:
        yield from self.session.wait_until_ready()
        axes = sorted(self.session.base.axes, key=lambda axis: axis.steering)
        for axis in axes:
            if axis.actuator.name in self._kept:
                continue
            result = MotorResult(Observation(axis))
            text = motion_text(self.robot, axis, self.session.base)
            if (yield from self._ask("motor", text, axis)):
                yield from self._check(axis, result)
                yield from self.session.release()
            else:
                result.skipped = True
            self.results[axis.actuator.name] = result
            self._save()

    def _check(self, axis: Axis, result: MotorResult) -> Steps[None]:
        observation = result.observation
        self.operator.note_motion(axis)
        if axis.steering:
            yield from self._home(axis, result)
            if observation.homing is not None and not observation.homing.completed:
                observation.moved = yield from self._ask_joint(axis)
                return
            yield from self._move_to(axis, 0.0)
            observation.zero = yield from self._ask_angle(axis)
        if axis.steering:
            degrees = math.degrees(STEERING_TRAVEL)
            text = f"The wheel turns by about {degrees:.0f} deg to the left."
            if not (yield from self._may_start(axis, result, "turn", text)):
                return
            room = self._upper(axis) - axis.position
            travel = min(STEERING_TRAVEL, 0.7 * room)
            observation.travel = yield from self._move(axis, travel, result, limit=room)
        else:
            observation.travel = yield from self._move(axis, WHEEL_TRAVEL, result)
        observation.moved = yield from self._ask_joint(axis)
        if not observation.travel.completed or observation.moved is None:
            return
        if observation.moved.role == "steering":
            angle = yield from self._ask_angle(axis)
            start = 0.0 if math.isnan(observation.zero) else observation.zero
            observation.seen = angle - start
        else:
            turns = yield from self._ask("turns", "How many turns did it make?", axis)
            observation.seen = float(turns) * math.tau  # type: ignore[arg-type]
        if not has_moved_as_expected(observation):
            return
        text = "The wheel turns to both limits of its steering, and back."
        if axis.steering and (yield from self._may_start(axis, result, "limits", text)):
            yield from self._turn_to_limits(axis, result)
        yield from self._check_stops(axis, result)
        yield from self._check_brake(axis, result)

    # -- questions ---------------------------------------------------------------------------------

    def _ask(self, kind: str, text: str, axis: Axis) -> Steps[Answer]:
        """Asks the operator while the control loop goes on; all motors are off meanwhile."""
        self.operator.ask(Question(kind, text, axis))
        while (answer := self.operator.answer()) is None:
            if self.session.fault:  # such as a gap in time, which moves nothing now
                yield from self.session.release()
            yield
        return answer[0]

    def _ask_joint(self, axis: Axis) -> Steps[Actuator | None]:
        yield from self.session.release()
        answer = yield from self._ask("joint", "Which wheel moved?", axis)
        return answer if isinstance(answer, Actuator) else None

    def _ask_angle(self, axis: Axis) -> Steps[float]:
        """Asks for the direction of the steered wheel, in rad."""
        self.session.driven.disarm()
        text = "Where does the wheel that was steered point?"
        answer = yield from self._ask("degrees", text, axis)
        return math.radians(float(answer))  # type: ignore[arg-type]

    # -- motions -----------------------------------------------------------------------------------

    def _home(self, axis: Axis, result: MotorResult) -> Steps[None]:
        session = self.session
        permission = session.driven.permission
        if stops := permission.rules.stops(permission.value, session.now):
            raise Interrupted(permission.rules.stop_text(stops[0]))
        self._controller(axis).discard_home(session.now)
        watch = MotionWatch(session.base, axis, math.nan)
        since = session.now
        yield from session.begin_power(axis)
        while session.base.state is not BaseState.READY and not session.fault and not watch.cause:
            watch.update(session.now)
            yield
        travel = self._travel_of(watch, math.nan)
        result.observation.homing = travel
        if travel.completed:
            limit = session.base.state_machine.times.home
            result.add("homing", session.now - since, "s", 0.0, limit)

    def _move(
        self, axis: Axis, travel: float, result: MotorResult | None = None, limit: float = math.inf
    ) -> Steps[Travel]:
        """Moves a joint by about ``travel`` (rad), ends with silence and takes its torque.

        ``limit``: travel (rad) at which a steering joint stops; if it is ``travel``, the silence
        begins there.
        """
        session, base = self.session, self.session.base
        velocity = math.copysign(test_speed(axis), travel)
        watch = yield from self._begin(axis, velocity, limit)
        bound = self._silence_bound(axis)
        # After the silence, the twist lasts for its time-out and then ramps down.
        timeout = session.driven.driver.settings.command_timeout
        ramp = (timeout + 0.5 * self._ramp() + session.driven.period) * abs(velocity)
        goal = limit if limit == abs(travel) else max(abs(travel) - ramp, 0.2 * abs(travel))
        until = session.now + 1.5 * abs(travel / velocity) + 3.0
        while abs(base.travel) < goal - 1e-9 and session.now < until and self._goes_on(watch):
            yield
        session.commands_motion = False
        silent_since = session.now
        while self._goes_on(watch) and not self._rests(axis):
            if session.now - silent_since > bound + WATCHDOG_PATIENCE:
                break
            yield
        motion = self._travel_of(watch, base.travel)
        if motion.completed and abs(travel) > 0.01 and not base.travel:
            state = session.driven.driver.state
            raise Interrupted(state.hold_reason or state.fault or "the driver commands no motion")
        if result is not None and motion.completed:
            rest = session.now - silent_since
            result.add("rest after silence", rest, "s", 0.0, bound)
            share = motion.reported / motion.commanded
            result.add(
                "reported / commanded travel",
                share,
                "",
                1.0 - REPORTED_TOLERANCE,
                1.0 + REPORTED_TOLERANCE,
            )
        yield from session.release()
        return motion

    def _begin(self, axis: Axis, velocity: float, limit: float = math.inf) -> Steps[MotionWatch]:
        """Powers a motor and begins to command its motion."""
        session = self.session
        if not axis.powered:
            yield from session.begin_power(axis)
        yield from session.wait_until_ready()
        yield from session.arm()
        session.base.begin(axis, velocity, limit)
        session.commands_motion = True
        return MotionWatch(session.base, axis, velocity)

    def _goes_on(self, watch: MotionWatch) -> bool:
        """Watches a motion for one cycle, and takes the torque if it is not the commanded one."""
        if not self.session.fault:
            watch.update(self.session.now)
        if watch.cause:
            self.session.take_torque()
        return not (watch.cause or self.session.fault)

    def _travel_of(self, watch: MotionWatch, commanded: float) -> Travel:
        """Returns the motion.  Raises ``Interrupted`` for a fault that the motor has not caused."""
        fault = self.session.fault
        if watch.cause:
            self.session.take_torque()
        elif fault and not self._has_caused(watch.axis):
            raise Interrupted(fault)
        return Travel(commanded, watch.reported, watch.cause, fault, watch.others)

    def _has_caused(self, axis: Axis) -> bool:
        fault = self.session.cause
        own = fault is not None and fault.node == self._controller(axis).node.name
        return fault is not None and (
            fault.cause is Cause.HOMING or (own and fault.cause in (Cause.DRIVE, Cause.MOTION))
        )

    @property
    def _fresh(self) -> float:
        """Age (s) of a report above which a drive is silent."""
        return max(FRESH, REPORT_CYCLES * self.session.base.period)

    def _rests(self, axis: Axis) -> bool:
        return self.session.base.speed == 0.0 and abs(axis.velocity) < _rest_speed(axis)

    def _silence_bound(self, axis: Axis) -> float:
        """Returns the longest time (s) from the last command to rest."""
        times = stopping.reaction_times(self.robot, self.session.driven.driver.settings)
        return times[stopping.COMMAND_TIMEOUT] + self._ramp() + self._delay(axis)

    def _ramp(self) -> float:
        """Returns the time (s) in which the driver ramps the twist of the session to zero."""
        settings, twist = self.session.driven.driver.settings, self.session.twist
        linear = twist.speed / settings.max_linear_deceleration
        return max(linear, abs(twist.wz) / settings.max_angular_deceleration)

    def _delay(self, axis: Axis) -> float:
        """Returns the time (s) of the motor behind its command, and until its report is read."""
        ramp = test_speed(axis) / axis.actuator.max_acceleration
        return REPORT_CYCLES * self.session.driven.period + SERVO_LAG + ramp

    def _turn_to_limits(self, axis: Axis, result: MotorResult) -> Steps[None]:
        """Turns a steering joint to both limits and back, slowly."""
        joint = self.robot.joint(axis.actuator.joint)
        if joint.lower is None or joint.upper is None:
            return
        upper, lower = joint.upper - LIMIT_MARGIN, joint.lower + LIMIT_MARGIN
        for name, goal in (("upper", upper), ("lower", lower)):
            motion = yield from self._move_to(axis, goal)
            reached = axis.position if motion.completed else math.nan
            error = math.degrees(abs(reached - goal))
            result.add(f"deviation at the {name} limit", error, "deg", 0.0, 6.0)
            if not motion.completed:
                return
        yield from self._move_to(axis, 0.0)

    def _upper(self, axis: Axis) -> float:
        upper = self.robot.joint(axis.actuator.joint).upper
        return math.pi if upper is None else upper - LIMIT_MARGIN

    def _move_to(self, axis: Axis, angle: float) -> Steps[Travel]:
        """Turns a steering joint to an angle (rad)."""
        travel = angle - axis.position
        return (yield from self._move(axis, travel, limit=abs(travel)))

    # -- stops -------------------------------------------------------------------------------------

    def _check_stops(self, axis: Axis, result: MotorResult) -> Steps[None]:
        """Stops the motor by the safety stop and by the watchdog of its drive."""
        controller = self._controller(axis)
        if controller.node.name in self._stops_tested:
            return
        is_first = not self._stops_tested
        self._stops_tested.add(controller.node.name)
        if axis.steering:
            return
        if (yield from self._may_start(axis, result, "safety stop", SAFETY_TEXT)):
            yield from self._check_stop(axis, result, "safety stop")
        if stopping.watchdog_time(controller.node) is None:
            result.not_tested.append(f"watchdog: {controller.node.name} has none")
        elif (yield from self._may_start(axis, result, "watchdog", ALONE_TEXT)):
            yield from self._check_watchdog(axis, controller, result)
        if is_first:  # one of the robot, and no matter of the motor controller
            if (yield from self._may_start(axis, result, "stop lock", LOCK_TEXT)):
                yield from self._check_stop(axis, result, "stop lock")
            yield from self._check_emergency_stop(axis, result)

    def _may_start(
        self, axis: Axis, result: MotorResult, name: str, text: str, kind: str = "start"
    ) -> Steps[bool]:
        """Asks whether a motion may begin; otherwise its check ``name`` is not tested."""
        starts = bool((yield from self._ask(kind, text, axis)))
        if not starts:
            result.not_tested.append(name)
            # Not every robot has a button for the emergency stop.
            result.skipped |= kind != "press"
        return starts

    def _run_steadily(self, axis: Axis, *, expects_fault: bool = False) -> Steps[MotionWatch]:
        """Begins a motion, and returns at the test speed, or before it if a fault is expected."""
        watch = yield from self._begin(axis, test_speed(axis))
        since = math.nan
        settings, twist = self.session.driven.driver.settings, self.session.twist
        linear = twist.speed / settings.max_linear_acceleration
        ramp = max(linear, abs(twist.wz) / settings.max_angular_acceleration)
        until = self.session.now + START_LIMIT + ramp
        steady = max(STEADY, REPORT_CYCLES * self.session.driven.period)
        while not self.session.now - since >= steady:
            if not self._goes_on(watch) or self.session.now > until:
                break
            if self.session.base.share >= 0.99 and math.isnan(since):
                since = self.session.now
            yield
        if not expects_fault:
            self._travel_of(watch, math.nan)
        return watch

    def _check_stop(self, axis: Axis, result: MotorResult, kind: str) -> Steps[None]:
        """Measures the time to rest after the safety stop, or after a stop lock."""
        session, driven = self.session, self.session.driven
        watch = yield from self._run_steadily(axis)
        if watch.cause:
            result.leave_unmeasured(kind, ABORTS[watch.cause])
            yield from session.release()
            return
        times = stopping.reaction_times(self.robot, driven.driver.settings)
        bound = times[stopping.STOP_LOCK] + self._delay(axis)
        if kind == "safety stop":
            driven.safety_stop(True)
        else:
            driven.lock(SAFETY_STOP, True)
            bound += self._ramp()
        since = session.now
        rest = yield from self._time_to_rest(axis, bound + WATCHDOG_PATIENCE)
        expected = (Cause.STOP,) if kind == "safety stop" else ()
        if disturbance := self._disturbance(axis, since, expected):
            result.leave_unmeasured(kind, disturbance)
        else:
            result.add(f"rest after the {kind}", rest, "s", 0.0, bound)
        session.commands_motion = False
        if kind == "safety stop":
            driven.safety_stop(False)
        else:
            driven.lock(SAFETY_STOP, False)
        yield from session.release()

    def _check_watchdog(
        self, axis: Axis, controller: MotorController, result: MotorResult
    ) -> Steps[None]:
        """Withholds heartbeat and commands, and measures when the drive stops by itself."""
        session, node = self.session, controller.node
        promise = stopping.watchdog_time(node) or 0.0
        watch = yield from self._run_steadily(axis)
        if watch.cause:
            result.leave_unmeasured("watchdog", ABORTS[watch.cause])
            yield from session.release()
            return
        bound = promise + self._delay(axis)
        session.base.starves_drives = True
        since, acts, disturbance = session.now, math.inf, ""
        while session.now - since < bound + WATCHDOG_PATIENCE:
            if math.isinf(acts) and not disturbance:
                # A CANopen drive whose watchdog acts sends no reports any more, but an emergency.
                slow = abs(axis.velocity) < SLOWER * test_speed(axis)
                silent = session.now - axis.time > self._fresh
                disturbance = self._disturbance(axis, since, WATCHDOG_CAUSES)
                if slow or silent or controller.watchdog_acted:
                    acts = session.now - since
            yield
        self.operator.look()
        session.base.starves_drives = False
        # A drive that restarts later, or reports another error, has not waited for its watchdog.
        disturbance = disturbance or self._disturbance(axis, since, tuple(Cause))
        yield from session.release()
        if disturbance:
            result.leave_unmeasured("watchdog", disturbance)
            return
        result.add(WATCHDOG, acts, "s", self._least_watchdog_time(controller), bound)
        stood = yield from self._ask("yes", "Did the wheel come to rest by itself?", axis)
        if not node.watchdog_coasts:
            result.add(STANDS, float(bool(stood)), YES, 1.0, 1.0)

    def _least_watchdog_time(self, controller: MotorController) -> float:
        """Returns the shortest time (s) from the begin of the silence until the watchdog can act.

        The drive has heard the latest heartbeat and the latest command before the silence.
        """
        node, period = controller.node, self.session.driven.period
        heartbeats = [f.period for f in controller.bus.frames if f.kind == "heartbeat"]
        beat = max((time for time in heartbeats if time is not None), default=0.0)
        times = [
            time - age
            for time, age in (
                (node.heartbeat_consumer_time, beat + period),
                (node.command_watchdog, 2.0 * period),
            )
            if time is not None
        ]
        return max(min(times, default=0.0), 0.0)

    def _disturbance(self, axis: Axis, since: float, causes: Collection[Cause]) -> str:
        """Returns what else may have stopped the motor since a time (s) than a fault with one of
        the causes, or an empty text."""
        session, controller = self.session, self._controller(axis)
        connection = next(c for c in session.base.connections if controller in c.controllers)
        fault, gap = session.cause, session.driven.timing.latest_gap
        if fault is not None and fault.cause not in causes:
            return fault.text
        if connection.foreign_master:
            return connection.foreign_master
        if controller.problem and not controller.watchdog_acted:
            return f"{controller.node.name}: {controller.problem}"
        if connection.watchdog.has_booted(controller, since):
            return f"{controller.node.name}: it restarted"
        return "" if gap is None or gap[0] <= since else gap_text(gap[1])

    def _check_emergency_stop(self, axis: Axis, result: MotorResult) -> Steps[None]:
        """Lets the operator press the emergency stop while the wheel turns."""
        session = self.session
        text = "The wheel turns until you press the emergency stop."
        if not (yield from self._may_start(axis, result, "emergency stop", text, "press")):
            return
        watch = yield from self._run_steadily(axis, expects_fault=True)
        since = session.now
        while self._goes_on(watch) and session.now - since < PRESS_TIME:
            yield
        fault = session.cause
        yield from self._time_to_rest(axis, REACTION)
        session.take_torque()
        self.operator.look()
        is_fresh = session.now - axis.time <= self._fresh
        controller = self._controller(axis)
        disturbance = ABORTS[watch.cause] if watch.cause else ""
        if fault is not None and fault.cause is not Cause.POWER:
            disturbance = fault.text
        elif fault is not None and fault.node != controller.node.name and not controller.power_loss:
            disturbance = f"{fault.text}; {controller.node.name} kept its power"
        text = "Did you press the emergency stop?"
        if not disturbance and not (yield from self._ask_in_fault("pressed", text, axis)):
            disturbance = "nobody has pressed it"
        if disturbance:
            result.leave_unmeasured("emergency stop", disturbance)
        else:
            stands = fault is not None and is_fresh and self._rests(axis)
            stood = yield from self._ask_in_fault("yes", "Did the wheel stand at once?", axis)
            result.add(EMERGENCY_STOP, float(stands and bool(stood)), YES, 1.0, 1.0)
        yield from self._ask_in_fault("start", "Release the emergency stop.", axis)
        yield from session.release()

    def _ask_in_fault(self, kind: str, text: str, axis: Axis) -> Steps[Answer]:
        """Asks the operator while the robot is in a fault, which is not reset meanwhile."""
        self.operator.ask(Question(kind, text, axis))
        while (answer := self.operator.answer()) is None:
            yield
        return answer[0]

    def _time_to_rest(self, axis: Axis, limit: float) -> Steps[float]:
        """Waits until a motor stands, and returns the time (s), infinite after ``limit``."""
        since = self.session.now
        while self.session.now - since < limit:
            if abs(axis.velocity) < _rest_speed(axis):
                return self.session.now - since
            yield
        return math.inf

    def _check_brake(self, axis: Axis, result: MotorResult) -> Steps[None]:
        if axis.actuator.brake is None:
            return
        yield from self.session.release()
        text = "Try to turn the wheel by hand: does its brake hold it?"
        self.session.by_hand = axis
        holds = yield from self._ask("yes", text, axis)
        self.session.by_hand = None
        result.add("brake holds", float(bool(holds)), YES, 1.0, 1.0)

    def _controller(self, axis: Axis) -> MotorController:
        controllers = self.session.base.state_machine.controllers
        return next(controller for controller in controllers if axis in controller.axes)


def _rest_speed(axis: Axis) -> float:
    return REST_SHARE * test_speed(axis)


SAFETY_TEXT, LOCK_TEXT, ALONE_TEXT = (
    f"The wheel turns for {STEADY + 1.0:.0f} s and stops {how}."
    for how in ("by the safety stop", "by a stop lock", "by itself, as if this program had ended")
)
START_LIMIT = 5.0
"""Longest time (s) until a motor has reached its test speed, after the ramp of the driver."""


# -- the stated motion -----------------------------------------------------------------------------


def largest_speed(axis: Axis, base: SingleMotorBase) -> float:
    """Returns the largest speed (rad/s) of any joint while a motor is checked, also of a wrongly
    assembled robot."""
    velocity, pulses = test_speed(axis), axis.actuator.pulses_per_joint_turn
    speeds = [axis.actuator.max_velocity] if axis.steering else []
    for motor in (other.actuator for other in base.axes):
        wrong = WRONG_ENCODER * velocity * pulses / motor.pulses_per_joint_turn
        unstable = motor.max_acceleration * (REACTION + CYCLES * base.period)
        speeds.append(min(motor.max_velocity, max(wrong, unstable)))
    return max(speeds)


def motion_text(robot: Robot, axis: Axis, base: SingleMotorBase) -> str:
    """Returns the stated motion of a motor: expected, and at most."""
    velocity, largest = test_speed(axis), largest_speed(axis, base)
    name = joint_text(robot, axis.actuator)
    if axis.steering:
        expected = (
            f"The {name} searches its home position and turns straight ahead, in at most"
            f" {Times().home:.0f} s."
        )
    else:
        duration = WHEEL_TRAVEL / velocity
        expected = f"The {name} turns forwards once, with {velocity:.1f} rad/s in {duration:.0f} s."
    return (
        f"{expected} If the robot is assembled wrongly, any wheel may turn with up to"
        f" {largest:.1f} rad/s and up to {axis.actuator.max_torque:.0f} N m."
    )
