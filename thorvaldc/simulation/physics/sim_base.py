"""Simulated bases without MuJoCo: ideal joints, and wheels that roll without slip."""

from __future__ import annotations

import abc
import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

from thorvaldc.diagnostics import DiagnosticError, did_you_mean
from thorvaldc.model import Actuator, Robot
from thorvaldc.model.statics.slope import coasting_deceleration
from thorvaldc.runtime import se2
from thorvaldc.runtime.base_interface import BaseHandle, JointCommands, JointStates
from thorvaldc.runtime.calculators.base_geometry import BaseGeometry, FixedWheels
from thorvaldc.runtime.calculators.twist_fit import solve3
from thorvaldc.runtime.mypyc_marks import mypyc_attr, trait
from thorvaldc.runtime.se2 import ORIGIN, ZERO_TWIST, Pose2, Twist

# -- interfaces of simulated bases -----------------------------------------------------------------


@mypyc_attr(allow_interpreted_subclasses=True)
class SimulatedJoints(BaseHandle):
    """The joints of a simulated base.

    All motors have power at first.  A joint whose motor has no power does not follow its commands.
    It turns freely, against the back-driving torque of the motor and a closed brake.
    """

    @abc.abstractmethod
    def switch_motor(self, wheel: int, steering: bool, on: bool, now: float) -> None:
        """Switches the power of a motor on or off at the time ``now`` (s).

        ``wheel`` is the index in ``Robot.wheels``.  ``steering``: the motor of the steering joint;
        otherwise that of the spin joint.  Nothing changes for a motor that is on or off already.
        """


# -- joints without power --------------------------------------------------------------------------

# An ideal joint has no mass and no ground, so its deceleration is computed from the model: a driven
# wheel rolls with its share of the robot's mass against the friction of its motor, gear and tyre
# (``model.statics.slope``).  A steering joint turns the tyre on the spot; its friction is as
# strong as the motor that is made to overcome it, so the joint comes to rest with the largest
# acceleration of the motor.  Time from the loss of power, with the closing time t_c of the brake:
#
#     speed  \__                    slope: deceleration
#               \__ t_c
#                  \                slope: braked (the same without a brake)
#             ______\____


class Coasting(NamedTuple):
    """The decelerations of a joint without power in rad/s^2.

    - ``deceleration``: before the brake has closed.
    - ``braked``: with a closed brake; the same value for a motor without a brake.
    - ``closing_time``: time in s from the loss of power until the brake is closed.
    """

    deceleration: float
    braked: float
    closing_time: float = 0.0

    def roll(self, speed: float, off_for: float, dt: float) -> tuple[float, float]:
        """Returns the speed (rad/s) after ``dt`` s, and the angle (rad) of the motion until then.

        At the begin of ``dt``, the motor has been without power for ``off_for`` s.
        """
        free = min(max(self.closing_time - off_for, 0.0), dt)
        speed, angle = _roll(speed, self.deceleration, free)
        speed, more = _roll(speed, self.braked, dt - free)
        return speed, angle + more


def _roll(speed: float, deceleration: float, dt: float) -> tuple[float, float]:
    if abs(speed) <= deceleration * dt:
        return 0.0, 0.5 * speed * abs(speed) / deceleration if speed else 0.0
    end = speed - math.copysign(deceleration * dt, speed)
    return end, 0.5 * (speed + end) * dt


def coasting_of(robot: Robot, motor: Actuator) -> Coasting:
    """Returns how the joint of a motor rolls out without power."""
    wheel = next((w for w in robot.wheels if w.spin_joint == motor.joint), None)
    if wheel is None:
        return Coasting(motor.max_acceleration, motor.max_acceleration)
    axle = robot.joint(motor.joint)
    free, braked = (
        coasting_deceleration(wheel, axle, motor, braked=closed) / wheel.radius
        for closed in (False, True)
    )
    return Coasting(free, braked, motor.brake.closing_time if motor.brake is not None else 0.0)


MAX_STEP: Final = 0.5
"""Longest time (s) between two reads in which the base moves.

After a longer time, the base assumes that the driver was suspended."""


@mypyc_attr(allow_interpreted_subclasses=True)
class SimBase(SimulatedJoints):
    """A simulated base whose joints follow the commands within the limits of the joints.

    The maximum acceleration limits the change of the wheel speeds.  The maximum steering rate
    limits the change of the steering angles.  A call ``read(now)`` moves the joints from the time
    of the last call to the time ``now``.  A wheel without a motor does not turn.  A joint whose
    motor has no power rolls out (``coasting``).  The ground couples the wheels: a wheel without
    power rolls no faster than the fastest wheel with power.

    >>> import thorvaldc
    >>> robot = thorvaldc.load("examples/4wd4ws_wide/robot.yaml")
    >>> driver = thorvaldc.BaseDriver(robot, thorvaldc.SimBase(robot))
    >>> for tick in range(100):
    ...     accepted = driver.command(thorvaldc.Twist(0.5, 0.0, 0.0), now=tick * 0.02)
    ...     state = driver.tick(tick * 0.02)
    >>> round(state.ramped.vx, 3)  # m/s
    0.5
    """

    def __init__(self, robot: Robot, start: float = 0.0) -> None:
        """Creates a base at rest at the time ``start`` (s)."""
        self._wheels = BaseGeometry.from_robot(robot).wheels
        n = len(self._wheels)
        self._time = start
        self._commands = JointCommands([0.0] * n, [0.0] * n)
        self._speeds = [0.0] * n
        self._positions = [0.0] * n
        self._angles = [0.0] * n
        self._rates = [0.0] * n
        self._coasting: dict[tuple[int, bool], Coasting] = {}
        for i, wheel in enumerate(robot.wheels):
            for joint in (wheel.spin_joint, wheel.steering_joint):
                motor = robot.actuator_of(joint) if joint is not None else None
                if motor is not None:
                    self._coasting[i, joint == wheel.steering_joint] = coasting_of(robot, motor)
        self._off_since: dict[tuple[int, bool], float] = {}
        """Time (s) at which each motor without power has lost it, by (wheel, steering)."""

    def __repr__(self) -> str:
        return f"<SimBase: {len(self._wheels)} wheels, {self._time:g} s>"

    def read(self, now: float) -> JointStates:
        """Returns the joint states at the time ``now`` (s): rad, rad/s, one value per wheel."""
        dt = now - self._time
        if 0.0 < dt <= MAX_STEP:
            self._advance(dt)
        self._time = max(now, self._time)
        return JointStates(
            self._time,
            tuple(self._speeds),
            tuple(self._angles),
            tuple(self._rates),
            tuple(self._positions),
        )

    def write(self, commands: JointCommands, now: float) -> None:
        """Commands wheel speeds (rad/s) and steering angles (rad) from the time ``now`` (s) on."""
        self._commands = commands

    def switch_motor(self, wheel: int, steering: bool, on: bool, now: float) -> None:
        self.read(now)
        if on:
            self._off_since.pop((wheel, steering), None)
        else:
            self._off_since.setdefault((wheel, steering), now)

    def _advance(self, dt: float) -> None:
        if self._off_since:
            self._roll_out(dt)
        for i, wheel in enumerate(self._wheels):
            if wheel.driven and (i, False) not in self._off_since:
                goal = min(max(self._commands.speeds[i], -wheel.max_speed), wheel.max_speed)
                start = self._speeds[i]
                step = wheel.max_acceleration * dt
                end = min(max(goal, start - step), start + step)
                # The joint speed changes linearly for `ramp` s and is then constant.  The joint
                # position is the integral of the joint speed.
                ramp = min(abs(end - start) / wheel.max_acceleration, dt)
                self._positions[i] += (start + end) / 2.0 * ramp + end * (dt - ramp)
                self._speeds[i] = end
            if wheel.steered and (i, True) not in self._off_since:
                goal = self._commands.angles[i]
                if wheel.lower is not None:
                    goal = max(goal, wheel.lower)
                if wheel.upper is not None:
                    goal = min(goal, wheel.upper)
                start = self._angles[i]
                step = wheel.max_rate * dt
                self._angles[i] = min(max(goal, start - step), start + step)
                self._rates[i] = (self._angles[i] - start) / dt

    def _roll_out(self, dt: float) -> None:
        """Moves the joints whose motors have no power."""
        fastest = self._fastest_with_power()
        for (i, steering), since in self._off_since.items():
            coasting = self._coasting[i, steering]
            speeds, positions = (
                (self._rates, self._angles) if steering else (self._speeds, self._positions)
            )
            speed = speeds[i]
            if not steering:
                limit = fastest / self._wheels[i].radius
                speed = min(max(speed, -limit), limit)
            speeds[i], angle = coasting.roll(speed, self._time - since, dt)
            positions[i] += angle

    def _fastest_with_power(self) -> float:
        """Returns the speed (m/s) of the fastest wheel with power, infinite without one."""
        return max(
            (
                abs(self._speeds[i]) * wheel.radius
                for i, wheel in enumerate(self._wheels)
                if wheel.driven and (i, False) not in self._off_since
            ),
            default=math.inf,
        )


@trait
class GroundTruth(abc.ABC):
    """The true motion of a simulated robot, for measurements; the base driver does not use it."""

    @abc.abstractmethod
    def true_pose(self) -> Pose2:
        """Returns the planar pose of ``base_link`` in the world frame."""

    @abc.abstractmethod
    def true_twist(self) -> Twist:
        """Returns the planar velocity of ``base_link``, expressed in ``base_link``."""

    @abc.abstractmethod
    def place(self, pose: Pose2) -> None:
        """Moves the robot to a planar pose in the world frame, at the start of a run."""

    def posture(self) -> tuple[float, float, float]:
        """Returns the height (m), roll (rad) and pitch (rad) of ``base_link``.

        The height of ``base_link`` is measured from the ground plane.
        """
        return 0.0, 0.0, 0.0

    def uprightness(self) -> float:
        """Returns the cosine of the tilt angle of the robot.

        The cosine of the tilt angle is 1 for an upright robot and 0 for a robot that lies on its
        side.
        """
        return 1.0

    def leaning(self) -> str:
        """Returns the direction in which the robot leans, such as `to its left`.

        Returns an empty text if the direction in which the robot leans is unknown.
        """
        return ""


# -- wheel errors ----------------------------------------------------------------------------------

# The model of the robot does not contain the wheel errors, and the driver does not correct the
# wheel errors.


@dataclass(frozen=True, slots=True)
class WheelErrors:
    """Errors of the wheels of a simulated robot, in the order of ``Robot.wheels``.

    * ``radius_ratios``: true wheel radius divided by the wheel radius in the model.
    * ``steering_offsets``: true angle of the steering joint minus the angle that the base reports
      (rad).  The simulated base reports the encoder reading plus the encoder offset in the robot
      model.
    """

    radius_ratios: tuple[float, ...]
    steering_offsets: tuple[float, ...]

    @staticmethod
    def none(robot: Robot) -> WheelErrors:
        """Returns radius ratios of 1 and steering offsets of 0 for all wheels."""
        n = len(robot.wheels)
        return WheelErrors((1.0,) * n, (0.0,) * n)

    @staticmethod
    def by_name(
        robot: Robot,
        radius_ratios: Mapping[str, float] | None = None,
        steering_offsets: Mapping[str, float] | None = None,
    ) -> WheelErrors:
        """Returns the wheel errors for radius ratios and steering offsets by wheel name.

        A wheel without a given radius ratio or steering offset has no wheel error.  Raises
        ``DiagnosticError`` (``hidden-error``) if the robot does not have a named wheel, if a wheel
        with a steering offset is not steered, or if a value is out of range.
        """
        ratios, offsets = radius_ratios or {}, steering_offsets or {}
        names = [wheel.name for wheel in robot.wheels]
        for name in (*ratios, *offsets):
            if name not in names:
                hint = did_you_mean(name, names, f"its wheels: {', '.join(names)}")
                raise _error(robot, f"{robot.name} has no wheel `{name}`", hint)
        for name, ratio in ratios.items():
            if not 0.5 <= ratio <= 2.0:
                raise _error(
                    robot,
                    f"the radius ratio of `{name}` is {ratio:g}; it must be 0.5 to 2",
                )
        for wheel in robot.wheels:
            offset = offsets.get(wheel.name)
            if offset is not None and wheel.steering_joint is None:
                raise _error(robot, f"the wheel `{wheel.name}` is not steered; it has no offset")
            if offset is not None and not -1.0 <= offset <= 1.0:
                raise _error(
                    robot,
                    f"the steering offset of `{wheel.name}` is {offset:g} rad; it must be -1 to 1",
                )
        return WheelErrors(
            tuple(ratios.get(name, 1.0) for name in names),
            tuple(offsets.get(name, 0.0) for name in names),
        )


def _error(robot: Robot, message: str, hint: str | None = None) -> DiagnosticError:
    return DiagnosticError("hidden-error", message, robot.span, hint=hint)


# -- wheels that roll without slip -----------------------------------------------------------------

# The commanded joint motions of several wheels rarely fit to one motion of the robot, for example
# if the wheel radii in the model are wrong.  In each step, the true twist (vx, vy, wz) of the robot
# is the least-squares solution of the rolling and no-slip conditions of all wheels.  The base then
# sets each joint to the motion that the true twist requires.  The encoder readings thus agree with
# the true motion and with the true wheels, as a calibration assumes.  The agreement is exact while
# the wheels roll.  A steered wheel gives way only while it rolls (``RELAXATION_LENGTH``), so that
# wheels that turn on the spot scrub as on a real floor.

RELAXATION_LENGTH: Final = 0.15
"""Distance (m) on which a rolling wheel gives way by 1 rad.

A wheel that turns on the spot keeps the commanded angle, although the robot moves a little.
"""
_WITHOUT_POWER: Final = 1e-2
"""Weight of a wheel without power in the fit of the twist; that of the other wheels is 1."""
_LEAST_SPEED: Final = 1e-3
"""Ground speed (m/s) of a wheel below which the direction of motion of the wheel is undefined."""


class RollingBase(SimBase, GroundTruth):
    """A simulated base whose wheels roll without slip.

    The twist of the robot is the best fit to the commanded joints, and all joints follow the twist.
    Real drive motors without speed control follow the motion of the robot in the same way.  Real
    steering motors hold the steering angle instead.
    """

    def __init__(
        self,
        robot: Robot,
        wheel_errors: WheelErrors | None = None,
        radii: Sequence[float] | None = None,
        start: float = 0.0,
    ) -> None:
        """Creates the base at rest, at the time ``start`` (s).

        ``radii`` are the wheel radii (m) without wheel errors.  By default, ``radii`` has the wheel
        radii of the model.
        """
        super().__init__(robot, start)
        wheel_errors = wheel_errors or WheelErrors.none(robot)
        self._ratios, self._offsets = wheel_errors.radius_ratios, wheel_errors.steering_offsets
        model = BaseGeometry.from_robot(robot)
        radii = radii or [wheel.radius for wheel in model.wheels]
        self._true = tuple(
            dataclasses.replace(wheel, radius=radius * ratio)
            for wheel, radius, ratio in zip(model.wheels, radii, self._ratios, strict=True)
        )
        self._fixed = FixedWheels(model.wheels)
        self._length2 = model.length**2
        n = len(self._true)
        self._pose = ORIGIN
        self._twist = ZERO_TWIST
        # The encoder readings are the positions (rad) and speeds (rad/s) of the drives, and the
        # angles (rad) and rates (rad/s) of the steering joints.
        self._encoder_positions = [0.0] * n
        self._encoder_speeds = [0.0] * n
        self._encoder_angles = [0.0] * n
        self._encoder_rates = [0.0] * n
        # Angle (rad) by which each wheel gives way: true angle minus commanded true angle.
        self._corrections = [0.0] * n

    def read(self, now: float) -> JointStates:
        ideal = super().read(now)
        return JointStates(
            ideal.time,
            tuple(self._encoder_speeds),
            tuple(self._encoder_angles),
            tuple(self._encoder_rates),
            tuple(self._encoder_positions),
        )

    def true_pose(self) -> Pose2:
        return self._pose

    def true_twist(self) -> Twist:
        return self._twist

    def place(self, pose: Pose2) -> None:
        self._pose = pose

    def _advance(self, dt: float) -> None:
        super()._advance(dt)
        last_twist, self._twist = self._twist, self._fitted_twist()
        mean = Twist(*((a + b) / 2.0 for a, b in zip(last_twist, self._twist, strict=True)))
        self._pose = self._pose.moved(se2.exp(mean, dt))
        vx, vy, wz = self._twist
        for i, wheel in enumerate(self._true):
            angle = self._encoder_angles[i]
            if wheel.steered:
                correction = self._angle_without_slip(i) - self._angles[i] - self._offsets[i]
                # A wheel gives way while it rolls, at most as fast as its steering motor turns.
                ground_speed = math.hypot(vx - wz * wheel.y, vy + wz * wheel.x)
                step = min(wheel.max_rate, ground_speed / RELAXATION_LENGTH) * dt
                change = min(max(correction - self._corrections[i], -step), step)
                self._corrections[i] += change
                angle = self._angles[i] + self._corrections[i]
            self._encoder_rates[i] = (angle - self._encoder_angles[i]) / dt
            self._encoder_angles[i] = angle
            if wheel.encoder:
                (l1, l2, l3), _ = wheel.rows(angle + self._offsets[i])
                rolled = l1 * vx + l2 * vy + l3 * wz
                rolled -= wheel.lateral * wheel.sign * self._encoder_rates[i]
                speed = rolled / wheel.radius
                self._encoder_positions[i] += (self._encoder_speeds[i] + speed) / 2.0 * dt
                self._encoder_speeds[i] = speed
                if (i, False) in self._off_since:
                    self._speeds[i] = speed

    def _angle_without_slip(self, i: int) -> float:
        """Returns the true steering angle (rad) at which a wheel rolls without side slip.

        With the velocity u of the steering axis, its direction a, the trail c and the direction p
        of the wheel, the contact point has no velocity across the wheel if

            |u| sin(a - p) + c (wz + p') = 0

        The rate p' is the commanded steering rate.  Of the two solutions, one per sense of rolling,
        the nearer one counts.  A wheel without a solution, such as a wheel that turns on the spot,
        keeps its angle relative to the command.
        """
        wheel, (vx, vy, wz) = self._true[i], self._twist
        commanded = self._angles[i] + self._offsets[i]
        ux, uy = vx - wz * wheel.y, vy + wz * wheel.x
        speed = math.hypot(ux, uy)
        across = wheel.trail * (wz + wheel.sign * self._rates[i])
        if speed <= _LEAST_SPEED or abs(across) >= speed:
            return commanded + self._corrections[i]
        direction = wheel.heading + wheel.sign * commanded
        motion, side = math.atan2(uy, ux), math.asin(across / speed)
        forwards = math.remainder(motion + side - direction, math.tau)
        backwards = math.remainder(motion + math.pi - side - direction, math.tau)
        return commanded + wheel.sign * min(forwards, backwards, key=abs)

    def _fitted_twist(self) -> Twist:
        """Returns the least-squares fit of the twist to the commanded joints.

        Each wheel that is not a caster gives one or two linear equations for the twist of the
        robot.  The speed of the wheel contact point across the wheel is zero.  For a driven wheel,
        the ground speed along the wheel (m/s) is the wheel speed (rad/s) times the true wheel
        radius (m).  The equations contain a correction for a wheel contact point that is not on the
        steering axis.  A robot may have fewer equations than unknowns, so that a small multiple of
        the identity matrix is added to the normal equations of the least-squares fit.
        """
        a11 = a12 = a13 = a22 = a23 = a33 = b1 = b2 = b3 = 0.0
        for i, wheel in enumerate(self._true):
            if wheel.swivel:
                continue
            rolling, across = wheel.rows(self._angles[i] + self._offsets[i])
            rate = wheel.sign * self._rates[i] if wheel.steered else 0.0
            rows = [(across, -wheel.trail * rate)]
            if wheel.driven:
                speed = self._speeds[i] * wheel.radius + wheel.lateral * rate
                # A wheel without power follows the others; alone, it rolls on with the robot.
                scale = _WITHOUT_POWER if (i, False) in self._off_since else 1.0
                rows.append(
                    ((scale * rolling[0], scale * rolling[1], scale * rolling[2]), scale * speed)
                )
            for (r1, r2, r3), z in rows:
                a11 += r1 * r1
                a12 += r1 * r2
                a13 += r1 * r3
                a22 += r2 * r2
                a23 += r2 * r3
                a33 += r3 * r3
                b1 += r1 * z
                b2 += r2 * z
                b3 += r3 * z
        weight = 1e-9
        a11, a22, a33 = a11 + weight, a22 + weight, a33 + weight * self._length2
        return self._fixed.feasible(Twist(*solve3(a11, a12, a13, a22, a23, a33, b1, b2, b3)))
