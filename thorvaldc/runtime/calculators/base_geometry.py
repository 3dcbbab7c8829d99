"""What a base calculator needs to know of a robot: plain numbers, computed once."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from thorvaldc.model import Robot, Wheel
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist

# Fixed wheels whose headings differ by less share an axle, with some scrub;
# beyond it their axle lines meet in a point about which alone the robot turns.
_SAME_HEADING = math.radians(10.0)
_SAME_LINE = 1e-3
"""Distance (m) between axle lines that counts as none."""


@dataclass(frozen=True, slots=True)
class WheelGeometry:
    """A wheel as numbers, in ``base_link``; see ``thorvaldc.model.Wheel`` for the meanings.

    ``steered`` means turned by a motor; ``swivel`` free to turn, which says
    nothing about the robot's motion.  ``encoder`` says that its speed is
    measured.  Limits: ``max_speed`` (rad/s) and ``max_acceleration`` (rad/s^2)
    of the spin, ``lower``/``upper`` (rad, ``None``: none), ``max_rate`` (rad/s)
    and ``max_rate_change`` (rad/s^2) of the steering.
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
        return not (self.steered or self.swivel)

    def rows(self, angle: float) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
        """Rolling row L and side-slip row T at a steering angle (0 for a fixed wheel).

        L xi is the speed at which the contact point moves along the rolling
        direction, T xi to its left, for the twist xi = (vx, vy, wz).
        """
        direction = self.heading + self.sign * angle
        c, s = math.cos(direction), math.sin(direction)
        return (
            (c, s, s * self.x - c * self.y - self.lateral),
            (-s, c, c * self.x + s * self.y + self.trail),
        )


@dataclass(frozen=True, slots=True)
class BaseGeometry:
    """A robot's wheels, and the groups of them that must agree.

    ``steering_groups`` lists, per steering joint, the wheels on it; most have
    one.  ``spin_groups`` lists the wheels of spin joints that carry several.
    ``length`` (m) is the root mean square distance of the wheels that hold
    the ground from ``centre``: the lever between linear and angular motion.
    """

    wheels: tuple[WheelGeometry, ...]
    steering_groups: tuple[tuple[int, ...], ...]
    spin_groups: tuple[tuple[int, ...], ...]
    centre: tuple[float, float]
    length: float

    @staticmethod
    def from_robot(robot: Robot) -> BaseGeometry:
        """Geometry of a robot with the ordinary radii of its wheels."""
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
        """Geometry of these wheels; ``steering`` and ``spin`` name their joints."""
        steering = steering or [w.name for w in wheels]
        spin = spin or [w.name for w in wheels]
        steering_groups: dict[str | None, list[int]] = {}
        spin_groups: dict[str, list[int]] = {}
        for i, wheel in enumerate(wheels):
            if wheel.steered:
                steering_groups.setdefault(steering[i], []).append(i)
            if wheel.driven:
                spin_groups.setdefault(spin[i], []).append(i)
        holding = [w for w in wheels if not w.swivel]
        n = max(len(holding), 1)
        xm, ym = sum(w.x for w in holding) / n, sum(w.y for w in holding) / n
        square = sum((w.x - xm) ** 2 + (w.y - ym) ** 2 for w in holding) / n
        length = math.sqrt(square)
        if length < 0.05:  # a single wheel has no lever of its own
            length = max((math.hypot(w.x, w.y) for w in wheels), default=0.0) or 0.5
        return BaseGeometry(
            tuple(wheels),
            tuple(tuple(group) for group in steering_groups.values()),
            tuple(tuple(group) for group in spin_groups.values() if len(group) > 1),
            (xm, ym),
            length,
        )

    def with_radii(self, radii: Sequence[float]) -> BaseGeometry:
        """The same wheels on these radii (m), one for each."""
        wheels = zip(self.wheels, radii, strict=True)
        return replace(self, wheels=tuple(replace(w, radius=r) for w, r in wheels))

    @property
    def driven(self) -> tuple[WheelGeometry, ...]:
        return tuple(w for w in self.wheels if w.driven)

    @property
    def fastest(self) -> float:
        """Speed (m/s) of the fastest driven wheel at its limit; 1.5 where there is none."""
        speeds = [w.max_speed * w.radius for w in self.wheels if w.driven]
        return max((v for v in speeds if math.isfinite(v)), default=1.5)

    @property
    def steering_time(self) -> float:
        """Time (s) in which every steering joint reaches its rate; 0 where nothing steers."""
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
        # A steering joint that no motor turns is free to turn.
        swivel=wheel.swivel_joint is not None or (limits is not None and steering is None),
        encoder=spin is not None,
        max_speed=spin.max_velocity if spin else math.inf,
        max_acceleration=spin.max_acceleration if spin else math.inf,
        lower=limits.lower if limits else None,
        upper=limits.upper if limits else None,
        max_rate=steering.max_velocity if steering else math.inf,
        max_rate_change=steering.max_acceleration if steering else math.inf,
    )


class FixedWheels:
    """What wheels that do not turn allow of a twist.

    Wheels of like heading act as one axle through their mean contact; where
    they are not in line they scrub in turns (``skids``).  One axle keeps wz
    and the velocity along the wheels, and decides the velocity across; two
    axles leave turning about where their lines meet; more, as a rule, nothing.
    """

    def __init__(self, wheels: Sequence[WheelGeometry]) -> None:
        axles: list[list[tuple[int, tuple[float, float, float]]]] = []
        for i, wheel in enumerate(wheels):
            if not wheel.fixed:
                continue
            _, row = wheel.rows(0.0)
            for axle in axles:
                _, first = axle[0]
                across = first[0] * row[0] + first[1] * row[1]
                if abs(across) >= math.cos(_SAME_HEADING):
                    if across < 0.0:  # mounted the other way round
                        row = (-row[0], -row[1], -row[2])
                    axle.append((i, row))
                    break
            else:
                axles.append([(i, row)])
        self.rows: list[tuple[float, float, float]] = []
        skids: list[int] = []
        for axle in axles:
            n = len(axle)
            tx, ty, tw = (sum(row[k] for _, row in axle) / n for k in range(3))
            size = math.hypot(tx, ty)
            mean = (tx / size, ty / size, tw / size)
            self.rows.append(mean)
            # One that is out of line makes the whole axle scrub.
            if any(
                math.hypot(row[0] - mean[0], row[1] - mean[1]) > 1e-6
                or abs(row[2] - mean[2]) > _SAME_LINE
                for _, row in axle
            ):
                skids += [i for i, _ in axle]
        self.skids: tuple[int, ...] = tuple(skids)
        self._pole: tuple[float, float] | None = None
        self._turns = True
        if len(self.rows) >= 2:
            (a0, a1, a2), (b0, b1, b2) = self.rows[0], self.rows[1]
            det = a0 * b1 - a1 * b0
            # Velocity of the origin per rad/s: n_a . v = -a2, n_b . v = -b2.
            self._pole = ((-a2 * b1 + a1 * b2) / det, (-a0 * b2 + a2 * b0) / det)
            px, py = self._pole
            self._turns = all(abs(r[0] * px + r[1] * py + r[2]) <= _SAME_LINE for r in self.rows)

    @property
    def free(self) -> bool:
        """Whether there are no such wheels."""
        return not self.rows

    def feasible(self, twist: Twist) -> Twist:
        """The nearest twist that these wheels allow; linear in ``twist``."""
        if not self.rows:
            return twist
        if self._pole is not None:
            if not self._turns:
                return ZERO_TWIST
            px, py = self._pole
            return Twist(px * twist.wz, py * twist.wz, twist.wz)
        nx, ny, d = self.rows[0]
        across = nx * twist.vx + ny * twist.vy + d * twist.wz
        return Twist(twist.vx - nx * across, twist.vy - ny * across, twist.wz)
