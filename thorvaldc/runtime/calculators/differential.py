"""Base calculators for robots with one fixed axle: ``differential`` and ``one_wheel``."""

from __future__ import annotations

import math

from thorvaldc.runtime.base_interface import JointCommands, JointStates
from thorvaldc.runtime.calculators.base_calculator import BaseCommand, NoOptions
from thorvaldc.runtime.calculators.base_geometry import BaseGeometry, FixedWheels
from thorvaldc.runtime.calculators.calculator_options import GeneralOptions, SteeringOptions
from thorvaldc.runtime.calculators.general import General
from thorvaldc.runtime.calculators.twist_estimator import Noise
from thorvaldc.runtime.se2 import Twist


class Differential(General):
    """``general`` for robots that turn by the speeds of one axle.

    Refuses robots with steered wheels, and robots that turn by skidding.

    A robot file that names it states what the robot is, so that a later change of the wheels that
    ``general`` would accept is an error.
    """

    name = "differential"
    summary = "driven wheels on one axle, steered by the difference of their speeds"
    Options = NoOptions

    def __init__(
        self, geometry: BaseGeometry, options: object = None, noise: Noise | None = None
    ) -> None:
        super().__init__(geometry, GeneralOptions(), noise)

    @classmethod
    def unsuited_reason(cls, geometry: BaseGeometry) -> str | None:
        steered = [w.name for w in geometry.wheels if w.steered]
        if steered:
            return f"it has steered wheels ({', '.join(steered)})"
        driven = [w for w in geometry.driven if not w.swivel]
        if len(driven) < 2:
            return f"it has {len(driven)} driven wheels; two or more are needed"
        fixed = FixedWheels(geometry.wheels)
        if len(fixed.rows) > 1:
            return "its fixed wheels point in different directions"
        if fixed.skids:
            names = ", ".join(geometry.wheels[i].name for i in fixed.skids)
            return f"its fixed wheels ({names}) are not on one axle, so that it turns by skidding"
        nx, ny, _ = fixed.rows[0]
        positions = [nx * w.x + ny * w.y for w in driven]
        if max(positions) - min(positions) < 1e-3:
            return "its driven wheels are at the same position along the axle"
        return None


# -- tricycles: a driven and steered wheel, and a fixed axle of passive wheels ------------------
#
# The fixed axle has the normal n = (nx, ny) and the offset d.  The axle allows no side slip: n . v
# + d wz = 0 for the velocity v and the yaw rate wz.  The driven wheel at p = (px, py) moves with
# the velocity u = v + wz (-py, px).  Solution for the twist, with n . u = n . v + wz (ny px - nx
# py):
#
#     wz = n . u / (ny px - nx py - d),   v = u - wz (-py, px)


class OneWheel(General):
    """Calculator for tricycles, with the odometry of ``general``.

    The robot can move without scrub at any steering angle of the driven wheel.  A tricycle
    therefore does not stop while the driven wheel turns to its target angle.  While the driven
    wheel turns, its rolling speed is the component of the commanded velocity along the present
    wheel direction.
    """

    name = "one_wheel"
    summary = "one driven and steered wheel, with a fixed axle of passive wheels"
    Options = SteeringOptions

    def __init__(
        self,
        geometry: BaseGeometry,
        options: SteeringOptions | None = None,
        noise: Noise | None = None,
    ) -> None:
        options = options or SteeringOptions()
        general = GeneralOptions(options.hysteresis, options.arrive_together)
        super().__init__(geometry, general, noise)
        self._axle = self._fixed.rows[0]
        self._joint = self._steering[0]

    @classmethod
    def unsuited_reason(cls, geometry: BaseGeometry) -> str | None:
        drives = [w for w in geometry.wheels if w.driven]
        steered = [w for w in geometry.wheels if w.steered]
        if len(drives) != 1 or len(steered) != 1 or drives[0] is not steered[0]:
            return (
                f"it has {len(drives)} driven and {len(steered)} steered wheels; "
                "exactly one that is both is needed"
            )
        fixed = FixedWheels(geometry.wheels)
        if fixed.unconstrained:
            return "it has no fixed passive wheel, without which nothing holds its heading"
        if len(fixed.rows) > 1 or fixed.skids:
            return "its fixed wheels are not on one axle"
        nx, ny, d = fixed.rows[0]
        wheel = drives[0]
        reach = math.hypot(wheel.trail, wheel.lateral)
        if abs(ny * wheel.x - nx * wheel.y - d) < reach + 1e-3:
            return "its driven wheel is, or can be steered, in line with the fixed axle"
        return None

    def command(
        self, twist: Twist, states: JointStates | None = None, dt: float | None = None
    ) -> BaseCommand:
        self._check(twist, states, dt)
        steering = self._joint
        i, wheel = steering.wheels[0], steering.wheel
        feasible, unreachable = self._reachable.project(twist)
        self._reachable.keep(feasible)
        vx, vy, wz = feasible
        angle = states.angles[i] if states else steering.angle
        speed = states.speeds[i] * wheel.radius if states else 0.0
        steering.choose(vx - wz * wheel.y, vy + wz * wheel.x, wz, angle, speed)
        n = len(self.geometry.wheels)
        speeds, rates = [0.0] * n, [0.0] * n
        if dt is not None:
            rates[i] = (steering.target - steering.angle) / dt
        if dt is None or wheel.max_rate == math.inf:
            steering.jump()
        else:
            steering.advance(dt, 1.0)
        self._store_angles()
        angle = states.angles[i] if states else steering.angle
        rolling, _ = wheel.rows(angle)
        v = 0.0
        if steering.holding:
            v = -wz * wheel.lateral if not steering.unreachable else 0.0
        else:
            v = rolling[0] * vx + rolling[1] * vy + rolling[2] * wz
        # The speed limit of the wheel at its target angle determines the scale of the twist.
        rolling, _ = wheel.rows(steering.target)
        limit = wheel.max_speed * wheel.radius
        target_speed = abs(rolling[0] * vx + rolling[1] * vy + rolling[2] * wz)
        scale = limit / target_speed if target_speed > limit else 1.0
        turning = wheel.sign * steering.rate
        v = min(max(v * scale - wheel.lateral * turning, -limit), limit)
        speeds[i] = v / wheel.radius
        _, limited_speeds = self._motors.limit_accelerations(feasible, speeds, dt)
        v = limited_speeds[i] * wheel.radius
        current = self._motion(angle, v + wheel.lateral * turning, -wheel.trail * turning)
        self._motors.twist = current
        infeasible = twist.minus(feasible)
        target = feasible.scaled(scale) if scale < 1.0 else feasible
        joints = JointCommands(limited_speeds, self._angles)
        return BaseCommand(joints, target, current, infeasible, scale, unreachable, rates)

    def _motion(self, angle: float, rolls: float, slips: float) -> Twist:
        """Returns the twist for given speeds (m/s) of the driven wheel, without slip of the axle.

        - ``rolls``: rolling speed of the driven wheel.
        - ``slips``: side slip of the driven wheel, positive to the left.
        """
        wheel = self._joint.wheel
        direction = wheel.heading + wheel.sign * angle
        c, s = math.cos(direction), math.sin(direction)
        px = wheel.x + c * wheel.trail - s * wheel.lateral
        py = wheel.y + s * wheel.trail + c * wheel.lateral
        ux, uy = c * rolls - s * slips, s * rolls + c * slips
        nx, ny, d = self._axle
        wz = (nx * ux + ny * uy) / (ny * px - nx * py - d)
        return Twist(ux + wz * py, uy - wz * px, wz)
