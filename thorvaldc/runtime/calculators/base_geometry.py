"""Geometry of a robot's wheels as plain numbers, computed once for the base calculators."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

from thorvaldc.model import Robot, Wheel
from thorvaldc.model.sums import float_sum
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist

_SAME_HEADING: Final = math.radians(10.0)
"""Largest difference (rad) between the headings of fixed wheels that form one axle.

The wheels of an axle with slightly different headings scrub a little.  If the headings differ by
more, the axle lines intersect, and the robot can only turn about the intersection.
"""
_SAME_LINE: Final = 1e-3
"""Two parallel axle lines that are at most this distance (m) apart count as the same line."""


@dataclass(frozen=True, slots=True)
class WheelGeometry:
    """Geometry and limits of one wheel, in ``base_link``.

    ``thorvaldc.model.Wheel`` documents the position, direction, radius and offsets of the wheel.

    - ``driven``: ``True`` if a motor drives the spin joint.
    - ``steered``: ``True`` if a motor turns the steering joint.
    - ``swivel``: ``True`` if the wheel turns freely about its steering axis.  A swivelling wheel
      does not measure the robot's motion.
    - ``encoder``: ``True`` if the wheel speed is measured.
    - ``max_speed``: speed limit of the spin joint, rad/s.
    - ``max_acceleration``: acceleration limit of the spin joint, rad/s^2.
    - ``lower``, ``upper``: limits of the steering angle in rad, or ``None`` for an unlimited angle.
    - ``max_rate``: rate limit of the steering joint, rad/s.
    - ``max_rate_change``: acceleration limit of the steering joint, rad/s^2.
    """

    name: str
    x: float
    y: float
    heading: float
    sign: float
    trail: float
    lateral: float
    radius: float
    driven: bool
    steered: bool
    swivel: bool
    encoder: bool
    max_speed: float
    max_acceleration: float
    lower: float | None
    upper: float | None
    max_rate: float
    max_rate_change: float

    @property
    def fixed(self) -> bool:
        """``True`` if the wheel neither steers nor swivels."""
        return not (self.steered or self.swivel)

    def rows(self, angle: float) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
        """Returns the rolling row L and the side-slip row T of the wheel at a steering angle (rad).

        The twist is the vector xi = (vx, vy, wz).  The product L xi is the speed of the contact
        point along the rolling direction.  The product T xi is the speed of the contact point to
        the left of the rolling direction.  If the wheel has a trail or a lateral offset, a turning
        steering joint also moves the contact point.  The steering angle of a fixed wheel is 0.
        """
        direction = self.heading + self.sign * angle
        c, s = math.cos(direction), math.sin(direction)
        return (
            (c, s, s * self.x - c * self.y - self.lateral),
            (-s, c, c * self.x + s * self.y + self.trail),
        )


@dataclass(frozen=True, slots=True)
class BaseGeometry:
    """The wheels of a robot, and the groups of wheels that share a joint.

    - ``steering_groups``: for each steering joint, the indices of its wheels.  Most steering joints
      turn a single wheel.
    - ``spin_groups``: for each spin joint with several wheels, the indices of its wheels.
    - ``centre``: centroid (m) of the wheels that do not swivel.
    - ``length``: root mean square distance (m) from the centroid to the wheels that do not swivel.
      The calculators multiply the yaw rate by ``length`` to convert the yaw rate to a linear speed.
    """

    wheels: tuple[WheelGeometry, ...]
    steering_groups: tuple[tuple[int, ...], ...]
    spin_groups: tuple[tuple[int, ...], ...]
    centre: tuple[float, float]
    length: float

    @staticmethod
    def from_robot(robot: Robot) -> BaseGeometry:
        """Returns the geometry of a robot with the ordinary radii of its wheels."""
        return BaseGeometry.from_wheels(
            [_wheel_geometry(robot, wheel) for wheel in robot.wheels],
            steering=[wheel.steering_joint for wheel in robot.wheels],
            spin=[wheel.spin_joint for wheel in robot.wheels],
        )

    @staticmethod
    def from_wheels(
        wheels: Sequence[WheelGeometry],
        *,
        steering: Sequence[str | None] | None = None,
        spin: Sequence[str] | None = None,
    ) -> BaseGeometry:
        """Returns the geometry of a robot with the given wheels.

        ``steering`` and ``spin`` contain the name of each wheel's steering joint and spin joint.
        By default every wheel has its own steering joint and spin joint.
        """
        steering = steering or [w.name for w in wheels]
        spin = spin or [w.name for w in wheels]
        steering_groups: dict[str | None, list[int]] = {}
        spin_groups: dict[str, list[int]] = {}
        for i, wheel in enumerate(wheels):
            if wheel.steered:
                steering_groups.setdefault(steering[i], []).append(i)
            if wheel.driven:
                spin_groups.setdefault(spin[i], []).append(i)
        guiding = [w for w in wheels if not w.swivel]
        n = max(len(guiding), 1)
        xm, ym = float_sum(w.x for w in guiding) / n, float_sum(w.y for w in guiding) / n
        mean_square = float_sum((w.x - xm) ** 2 + (w.y - ym) ** 2 for w in guiding) / n
        length = math.sqrt(mean_square)
        if length < 0.05:  # a single wheel: use its distance from base_link
            length = max((math.hypot(w.x, w.y) for w in wheels), default=0.0) or 0.5
        return BaseGeometry(
            tuple(wheels),
            tuple(tuple(group) for group in steering_groups.values()),
            tuple(tuple(group) for group in spin_groups.values() if len(group) > 1),
            (xm, ym),
            length,
        )

    def with_radii(self, radii: Sequence[float]) -> BaseGeometry:
        """Returns a copy of the geometry with different wheel radii (m), one per wheel."""
        wheels = zip(self.wheels, radii, strict=True)
        return replace(self, wheels=tuple(replace(w, radius=r) for w, r in wheels))

    @property
    def driven(self) -> tuple[WheelGeometry, ...]:
        return tuple(w for w in self.wheels if w.driven)

    @property
    def max_wheel_speed(self) -> float:
        """Speed limit (m/s) of the fastest driven wheel.

        The result is 1.5 m/s if no driven wheel has a speed limit.
        """
        speeds = [w.max_speed * w.radius for w in self.wheels if w.driven]
        return max((v for v in speeds if math.isfinite(v)), default=1.5)

    @property
    def steering_time(self) -> float:
        """Time (s) that the slowest steering joint needs to accelerate from rest to its full rate.

        The result is 0 if no steering joint has an acceleration limit.
        """
        times = [
            w.max_rate / w.max_rate_change
            for w in self.wheels
            if w.steered and w.max_rate_change > 0.0
        ]
        return max((t for t in times if math.isfinite(t)), default=0.0)


def _wheel_geometry(robot: Robot, wheel: Wheel) -> WheelGeometry:
    spin = robot.actuator_of(wheel.spin_joint) if wheel.driven else None
    steering = robot.actuator_of(wheel.steering_joint) if wheel.steering_joint else None
    limits = robot.joint(wheel.steering_joint) if wheel.steering_joint else None
    lower, upper = (limits.lower, limits.upper) if limits else (None, None)
    if steering is not None and steering.node is not None and lower is None and upper is None:
        # A motor controller is configured for encoder angles of -pi to pi if the joint has no
        # limits.  Beyond them, the controller refuses the commands.
        upper = math.pi - abs(steering.encoder_offset or 0.0)
        lower = -upper
    return WheelGeometry(
        name=wheel.name,
        x=wheel.x,
        y=wheel.y,
        heading=wheel.heading,
        sign=wheel.steering_sign,
        trail=wheel.trail,
        lateral=wheel.lateral_offset,
        radius=wheel.radius,
        driven=spin is not None,
        steered=steering is not None,
        # A steering joint without a motor turns freely.
        swivel=wheel.swivel_joint is not None or (limits is not None and steering is None),
        encoder=spin is not None,
        max_speed=spin.max_velocity if spin else math.inf,
        max_acceleration=spin.max_acceleration if spin else math.inf,
        lower=lower,
        upper=upper,
        max_rate=steering.max_velocity if steering else math.inf,
        max_rate_change=steering.max_acceleration if steering else math.inf,
    )


class FixedWheels:
    """The constraint that fixed wheels impose on the twist.

    Fixed wheels with the same heading act as one axle.  The position of an axle is the mean contact
    point of its wheels.  The wheels of an axle must not slip sideways: (nx, ny, d) . (vx, vy, wz) =
    0, where n = (nx, ny) is the unit vector across the wheels, and d is the offset of the axle.
    Feasible twists by the number of axles:

    - no axle: every twist is feasible.
    - one axle: the yaw rate wz and the speed along the wheels are free, and determine the speed
      across the wheels.
    - two axles: the robot can only turn about the intersection of the two axle lines.
    - three or more axles whose lines do not all meet in one point: the robot cannot move.

    ``rows`` contains the coefficients (nx, ny, d) of each axle.  ``skids`` contains the indices of
    wheels that scrub whenever the robot turns.  The wheels of an axle scrub in turns if their
    contact points are not in line.
    """

    def __init__(self, wheels: Sequence[WheelGeometry]) -> None:
        axles: list[list[tuple[int, tuple[float, float, float]]]] = []
        for i, wheel in enumerate(wheels):
            if not wheel.fixed:
                continue
            _, row = wheel.rows(0.0)
            for axle in axles:
                _, first_row = axle[0]
                alignment = first_row[0] * row[0] + first_row[1] * row[1]
                if abs(alignment) >= math.cos(_SAME_HEADING):
                    if alignment < 0.0:  # the wheel is mounted the other way round
                        row = (-row[0], -row[1], -row[2])
                    axle.append((i, row))
                    break
            else:
                axles.append([(i, row)])
        self.rows: list[tuple[float, float, float]] = []
        skids: list[int] = []
        for axle in axles:
            n = len(axle)
            tx, ty, tw = (float_sum(row[k] for _, row in axle) / n for k in range(3))
            norm = math.hypot(tx, ty)
            mean = (tx / norm, ty / norm, tw / norm)
            self.rows.append(mean)
            # If the contact point of one wheel is out of line, all wheels of the axle scrub.
            if any(
                math.hypot(row[0] - mean[0], row[1] - mean[1]) > 1e-6
                or abs(row[2] - mean[2]) > _SAME_LINE
                for _, row in axle
            ):
                skids += [i for i, _ in axle]
        self.skids: tuple[int, ...] = tuple(skids)
        # Velocity (m/s) of the origin of base_link per rad/s of the only feasible rotation.
        self._pole: tuple[float, float] | None = None
        self._can_turn = True
        if len(self.rows) >= 2:
            (a0, a1, a2), (b0, b1, b2) = self.rows[0], self.rows[1]
            # The normals of two axles a and b determine the velocity v: n_a . v = -a2 and n_b . v =
            # -b2.
            det = a0 * b1 - a1 * b0
            self._pole = ((-a2 * b1 + a1 * b2) / det, (-a0 * b2 + a2 * b0) / det)
            px, py = self._pole
            self._can_turn = all(abs(r[0] * px + r[1] * py + r[2]) <= _SAME_LINE for r in self.rows)

    @property
    def unconstrained(self) -> bool:
        """``True`` if the robot has no fixed wheels."""
        return not self.rows

    def feasible(self, twist: Twist) -> Twist:
        """Returns the feasible twist with the yaw rate of ``twist``, or zero if there is none.

        The feasible twist is a linear function of ``twist``.  With one axle of the normal n and the
        offset d, it has the same yaw rate wz, the same speed along the wheels, and no side slip:
        v' = v - n (n . v + d wz).  If the axle is not under ``base_link``, |v'| may exceed |v|.
        With two axles, v' is the velocity of the turn about the intersection, at any |v|.
        """
        if not self.rows:
            return twist
        if self._pole is not None:
            if not self._can_turn:
                return ZERO_TWIST
            px, py = self._pole
            return Twist(px * twist.wz, py * twist.wz, twist.wz)
        nx, ny, d = self.rows[0]
        slip = nx * twist.vx + ny * twist.vy + d * twist.wz
        return Twist(twist.vx - nx * slip, twist.vy - ny * slip, twist.wz)
