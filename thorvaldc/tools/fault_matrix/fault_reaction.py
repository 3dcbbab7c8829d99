"""Measures the reaction of a robot to one fault in one phase."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import asdict, dataclass
from typing import Any

from thorvaldc.model import Robot
from thorvaldc.model.sums import float_sum
from thorvaldc.runtime.can_base.base_state_machine import BaseState
from thorvaldc.runtime.pace import NORMAL_PERIODS
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist
from thorvaldc.tools.fault_matrix import fault_cases
from thorvaldc.tools.fault_matrix.fault_cases import Evidence, FaultCase
from thorvaldc.tools.fault_matrix.rehearsal import FRESH, Rehearsal, RehearsalError, Weave

AT_REST = 0.01
"""Speed (m/s) of a wheel at the ground below which it stands."""
UNASKED = 0.05
"""Increase (m/s) of the fastest wheel speed above which the robot has moved unasked."""
AFTERWARDS = 0.3
"""Time (s) of observation after the robot has reacted and stands, to see whether it moves again."""
STEADY = 1.0
"""Time (s) of a curve after the robot has changed its yaw rate."""
LONGEST_START = 40.0
"""Longest time (s) of observation in the phase start-up, with a homing that fails."""
_ORDER = ("fault", "estop", "disarmed", "stops", "slower", "warns")
"""Reactions from the strongest to the weakest."""
NOT_SIMULATED = "not simulated"
STOPS = ("fault", "estop", "disarmed", "stops")


@dataclass(frozen=True)
class Reaction:
    """The measured reaction to a fault.

    - ``reaction``: ``fault`` or ``estop`` (state of the base), ``disarmed``, ``stops``, ``slower``,
      ``warns``, ``continues``, ``not simulated`` if the simulated device cannot have the fault, or
      ``ready`` at the end of a start-up.
    - ``after``: time (s) from the fault to the reaction, or ``None``.
    - ``reason``: message of the base driver.
    - ``rest_time``: time (s) from the fault until all wheels stand, or ``None`` without a stop.
    - ``rest_distance``: path (m) of the robot from the fault until all wheels stand, as the mean of
      the paths of the driven wheels at the ground.
    - ``speed_error``: largest difference (m/s) of the true and the commanded speed of a wheel.
    - ``speed``: speed (m/s) of the fastest wheel at the time of the fault.
    - ``unasked``: largest increase (m/s) of the fastest wheel speed without a fresh command of an
      armed robot.
    """

    reaction: str
    after: float | None
    reason: str
    rest_time: float | None
    rest_distance: float | None
    speed: float
    unasked: float
    speed_error: float = 0.0

    @property
    def moved_unasked(self) -> bool:
        return self.unasked > UNASKED

    def as_json(self) -> dict[str, Any]:
        return {**asdict(self), "moved_unasked": self.moved_unasked}


def top_twist(robot: Robot, parameters: str | None = None) -> Twist:
    """Returns the twist of the phase driving: the top speed in a curve of a radius of 1 m."""
    settings = robot.driver
    for parameter_set in robot.parameter_sets:
        if parameter_set.name == parameters:
            settings = parameter_set.driver
    speed = settings.max_linear_velocity
    return Twist(speed, 0.0, min(speed / 1.0, settings.max_angular_velocity))


def advance(rehearsal: Rehearsal, phase: str, twist: Twist) -> None:
    """Brings a rehearsal from the phase before into ``phase``.

    The phase before ``idle`` is a robot without power.  Raises ``RehearsalError`` if the robot does
    not become ready or does not drive.
    """
    if phase == fault_cases.IDLE:
        rehearsal.power_on()
        rehearsal.become_ready()
        rehearsal.connect()
        rehearsal.arm()
    elif phase == fault_cases.DRIVING:
        # The drive ends where the curve changes its side, so that the steering joints turn.
        settings = rehearsal.driven.driver.settings
        seconds = 2.0 * twist.wz / settings.max_angular_acceleration + STEADY
        curves = math.ceil(twist.vx / settings.max_linear_acceleration / seconds) + 1
        rehearsal.weave = Weave(twist, rehearsal.now, seconds)
        rehearsal.run(curves * seconds)
        if rehearsal.state is not BaseState.ACTIVE:
            raise RehearsalError(
                f"the robot does not drive: {rehearsal.state.value} {rehearsal.reason}".rstrip()
            )
    elif phase == fault_cases.STOPPING:
        rehearsal.weave = None
        rehearsal.connect(ZERO_TWIST)
        rehearsal.run(0.1)


def react(rehearsal: Rehearsal, case: FaultCase, phase: str, evidence: Evidence) -> Reaction:
    """Injects the fault of a case into a rehearsal that is in the phase, and observes it.

    In the phase ``start-up`` the rehearsal has no power yet, and the client commands the top speed
    from the first cycle on, as a joystick does that is deflected.
    """
    if phase == fault_cases.START:
        rehearsal.connect(top_twist(rehearsal.robot))
        rehearsal.power_on()
        rehearsal.run(case.starts_at)
    observed = LONGEST_START if phase == fault_cases.START else case.observed
    # A robot at rest gets frames of the moving robot, and the reverse.
    at_rest = phase not in (fault_cases.START, fault_cases.DRIVING)
    rehearsal.other_frames = evidence.moving if at_rest else evidence.at_rest
    observation = _Observation(rehearsal, phase, observed)
    rehearsal.observe = observation.observe
    try:
        case.inject(rehearsal)
    except ValueError:  # the simulated device of another package cannot have the fault
        return Reaction(NOT_SIMULATED, None, "", None, None, observation.speed, 0.0)
    observation.observe()
    braking = 2.0 * observation.speed / rehearsal.driven.driver.settings.max_linear_deceleration
    until = observation.start + observed + braking
    rehearsal.run(until - rehearsal.now, observation.is_over)
    return observation.reaction()


class _Observation:
    """Observes the wheels and the state of the base driver from the fault on."""

    def __init__(self, rehearsal: Rehearsal, phase: str, observed: float) -> None:
        """``observed``: time (s) of the observation of a robot that does not react."""
        self.rehearsal = rehearsal
        self.phase = phase
        self.observed = observed
        self.start = rehearsal.now
        self.times: dict[str, float] = {}
        """Time (s) from the fault to each reaction; a reaction that ended is removed."""
        self.reason = ""
        self._last = rehearsal.wheel_states()
        self.speed = max((speed for _, speed in self._last), default=0.0)
        self._lowest = self.speed
        self._highest = self._commanded_speed()
        self._paths = [0.0] * len(self._last)
        self._rest: tuple[float, float] | None = None
        self._speed_error = 0.0
        self._unasked = 0.0
        self._authority = True
        self._disarmed_at = math.inf
        self._was_armed = rehearsal.driven.armed
        seconds = 1.0 if rehearsal.weave is None else rehearsal.weave.seconds
        self._ramped: deque[float] = deque(maxlen=round(seconds / rehearsal.base.period))
        self._asked_speed = rehearsal.driven.driver.state.ramped.speed
        self._warnings = set(rehearsal.base.warnings(rehearsal.now))
        self._ready_at: float | None = None
        rehearsal.forget()

    # -- in each cycle -----------------------------------------------------------------------

    def observe(self) -> None:
        states = self.rehearsal.wheel_states()
        self._measure_rest(states)
        for (_, speed), commanded in zip(states, self.rehearsal.commanded_speeds(), strict=True):
            self._speed_error = max(self._speed_error, abs(speed - commanded))
        self._measure_unasked_motion([speed for _, speed in states])
        if not self.rehearsal.driver_killed:
            self._note_reactions()

    def _measure_rest(self, states: list[tuple[float, float]]) -> None:
        for i, ((path, _), (last, _)) in enumerate(zip(states, self._last, strict=True)):
            self._paths[i] += abs(path - last)
        self._last = states
        if max((speed for _, speed in states), default=0.0) > AT_REST:
            self._rest = None
        elif self._rest is None:
            mean = float_sum(self._paths) / max(len(self._paths), 1)
            self._rest = self.rehearsal.now - self.start, mean

    def _measure_unasked_motion(self, speeds: list[float]) -> None:
        """Compares the wheel speeds with the speeds that a person has commanded.

        A person commands while a living client commands a motion, the robot is armed, and the base
        driver runs without a gap.  Without a command the fastest wheel may not become faster; other
        wheels may, because the curve changes while the robot brakes.  With a command no wheel may
        be faster than the fastest commanded wheel.
        """
        rehearsal, fastest = self.rehearsal, max(speeds, default=0.0)
        if not rehearsal.driven.armed:
            self._disarmed_at = min(self._disarmed_at, rehearsal.now)
        if (
            not rehearsal.asked
            or rehearsal.now > self._disarmed_at + FRESH * rehearsal.base.period + 1e-6
            or rehearsal.driver_killed
            or rehearsal.longest_gap > NORMAL_PERIODS * rehearsal.base.period + 1e-6
        ):
            self._authority = False
        if self._authority:
            self._highest = max(self._highest, self._commanded_speed())
            self._lowest = fastest
            excess = fastest - self._highest
        else:
            self._lowest = min(self._lowest, fastest)
            excess = fastest - self._lowest
        self._unasked = max(self._unasked, excess)

    def _commanded_speed(self) -> float:
        """Speed (m/s) of the fastest commanded wheel at the ground."""
        return max(self.rehearsal.commanded_speeds(), default=0.0)

    def _note_reactions(self) -> None:
        rehearsal = self.rehearsal
        state, driver = rehearsal.state, rehearsal.driven.driver.state
        present = {
            "fault": state is BaseState.FAULT,
            "estop": state is BaseState.ESTOP,
            "disarmed": self._was_armed and not rehearsal.driven.armed,
        }
        if self.phase == fault_cases.DRIVING:
            present["stops"] = driver.commanded_twist == ZERO_TWIST
            self._ramped.append(driver.ramped.speed)
            fastest = max(self._ramped) if len(self._ramped) == self._ramped.maxlen else math.inf
            present["slower"] = fastest < 0.9 * self._asked_speed
        present["warns"] = bool(set(rehearsal.base.warnings(rehearsal.now)) - self._warnings)
        for name, holds in present.items():
            if holds:
                self.times.setdefault(name, rehearsal.now - self.start)
            else:
                self.times.pop(name, None)
        self.reason = rehearsal.reason or driver.hold_reason or self.reason
        if rehearsal.driven.ready and self._ready_at is None:
            self._ready_at = rehearsal.now - self.start

    # -- the result --------------------------------------------------------------------------

    def is_over(self) -> bool:
        """Returns whether nothing more is expected."""
        now = self.rehearsal.now - self.start
        times = [self.times[name] for name in STOPS if name in self.times]
        if self.phase == fault_cases.START and self._ready_at is not None:
            times.append(self._ready_at)
        if not times and now >= self.observed:
            return self._rest is not None or self._authority
        if self._rest is None or not times:
            return False
        return now > max(self._rest[0], min(times)) + AFTERWARDS

    def reaction(self) -> Reaction:
        name = next((name for name in _ORDER if name in self.times), "continues")
        if self.phase == fault_cases.START and name not in STOPS:
            name = "ready" if self._ready_at is not None else "waits"
        after = self._ready_at if name == "ready" else self.times.get(name)
        stops = name in STOPS or self.phase in fault_cases.MOVING_PHASES
        rest_time, distance = self._rest if self._rest and stops else (None, None)
        return Reaction(
            name,
            after,
            self.reason if name in STOPS else "",
            rest_time,
            distance,
            self.speed,
            self._unasked,
            self._speed_error,
        )
