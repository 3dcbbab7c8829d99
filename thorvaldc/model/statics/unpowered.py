"""How a robot stands and rolls while its motors have no power.

A motor without power applies no torque. What is left of its drive is the back-driving torque B (the
friction of motor and gear, see ``Actuator``) and the holding torque H of a closed brake. With the
Coulomb friction C of the axle, the radius r, the load N, the coefficient c of rolling resistance
and the coefficient mu of friction, a wheel resists the motion of the robot with the force

    F = min(c N + (B + C + H) / r, mu N).

The wheels hold a robot of the weight W on a slope of the angle a if the sum of F is at least
W sin(a). The wheel loads depend on the slope (``slope``). The robot faces straight uphill or
downhill with all steering angles at 0, and its steering joints and casters do not turn. The time in
which a brake closes is not part of the statics: the robot rolls g sin(a) t^2 / 2 at most in it.

A robot on level ground rolls out with the deceleration sum(F) / m. A single wheel that carries its
share N / g of the mass rolls out with F g / N. The inertia of motors and wheels, which lengthens
the way by some percent, is left out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from thorvaldc.model import quantities as si
from thorvaldc.model.float_sum import float_sum
from thorvaldc.model.once_per_model import once_per_model
from thorvaldc.model.robot import Actuator, Joint, Robot, Wheel
from thorvaldc.model.statics.gravity import GRAVITY
from thorvaldc.model.statics.slope import SlopeStatics, steepest_angle
from thorvaldc.model.statics.tip_over import support_of
from thorvaldc.model.stopping import Ramp, driven_wheels


@dataclass(frozen=True, slots=True)
class StandingSlopes:
    """The steepest slopes in rad on which a robot stands without power, facing up or down.

    - ``motors_off``: with every brake held open, by the friction of motors, gears and tyres alone.
    - ``braked``: with the brakes closed, or ``None`` for a robot without brakes on its drives.
    """

    motors_off: si.Radians
    braked: si.Radians | None

    @property
    def without_power(self) -> float:
        """Steepest slope in rad on which the robot stands if its power is cut."""
        return self.motors_off if self.braked is None else self.braked


@once_per_model
def standing_slopes(robot: Robot) -> StandingSlopes | None:
    """Return the steepest slopes on which a robot stands without power.

    Returns ``None`` for a robot that does not stand on level ground.
    """
    if not support_of(robot).stands:
        return None
    drives = _drives(robot)
    has_brake = any(motor is not None and motor.brake is not None for _, _, motor in drives)
    return StandingSlopes(
        _steepest(robot, drives, braked=False),
        _steepest(robot, drives, braked=True) if has_brake else None,
    )


@once_per_model
def holds_without_torque(robot: Robot) -> bool:
    """Return whether a standing robot stays at rest on its design slope if all motors lose torque.

    Brakes are closed then. Returns ``False`` for a robot whose file states no design slope: nothing
    is known of the ground on which it stands.
    """
    slopes = standing_slopes(robot)
    if slopes is None or robot.design_slope is None:
        return False
    return robot.design_slope <= slopes.without_power


def coasting_deceleration(
    wheel: Wheel, axle: Joint, motor: Actuator, *, braked: bool = False
) -> float:
    """Return the deceleration in m/s^2 of a wheel that rolls with its share of the mass.

    ``axle`` and ``motor`` turn the wheel. ``braked``: the brake of the motor is closed.
    """
    if wheel.load <= 0.0:
        return wheel.friction * GRAVITY
    return _resistance(wheel, axle, motor, wheel.load, braked) * GRAVITY / wheel.load


def roll_out(robot: Robot) -> Ramp:
    """Return the way on which all wheels roll out on level ground after all drives lost power.

    The wheel with the lowest deceleration counts, from the top speed of the motors. The time and
    the distance are infinite for a wheel without friction.
    """
    stops = [Ramp(0.0, 0.0, 0.0)]
    for wheel, motor in driven_wheels(robot.wheels, robot.actuators):
        axle, brake = robot.joint(wheel.spin_joint), motor.brake
        closing = 0.0 if brake is None else brake.closing_time
        deceleration = coasting_deceleration(wheel, axle, motor, braked=True)
        speed = motor.max_velocity * wheel.radius
        seconds = speed / deceleration if deceleration > 0.0 else math.inf
        stops.append(Ramp(speed, closing + seconds, speed * closing + 0.5 * speed * seconds))
    return max(stops, key=lambda stop: stop.distance)


_Drive = tuple[Wheel, Joint, Actuator | None]


def _drives(robot: Robot) -> list[_Drive]:
    joints = {joint.name: joint for joint in robot.joints}
    motors = {actuator.joint: actuator for actuator in robot.actuators}
    return [(w, joints[w.spin_joint], motors.get(w.spin_joint)) for w in robot.wheels]


def _resistance(
    wheel: Wheel, axle: Joint, motor: Actuator | None, load: float, braked: bool
) -> float:
    """Return the largest force in N with which a wheel without power resists motion."""
    torque = axle.friction
    if motor is not None:
        torque += motor.back_driving_torque
        if braked and motor.brake is not None:
            torque += motor.brake.torque
    force = wheel.rolling_resistance * load + torque / wheel.radius
    return min(force, wheel.friction * load)


def _steepest(robot: Robot, drives: list[_Drive], *, braked: bool) -> float:
    statics = SlopeStatics(robot)
    weight = robot.inertial.mass * GRAVITY

    def limit(backwards: bool) -> float:
        def excess(angle: float) -> float:
            loads = statics.loads(angle, backwards=backwards)
            resistance = float_sum(
                _resistance(*drive, max(load, 0.0), braked)
                for drive, load in zip(drives, loads, strict=True)
            )
            return resistance - weight * math.sin(angle)

        tips = support_of(robot).tip_over_angle(0.0 if backwards else math.pi)
        rolls = steepest_angle(excess)
        return tips if rolls is None else min(rolls, tips)

    return min(limit(False), limit(True))
