"""Drives the generated MJCF of a robot with joint commands from its wheel geometry.

There is no calculator and no driver: the tests measure only the model in MuJoCo.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from thorvaldc.model import Robot, Wheel

SPEED = 0.7  # m/s
RAMP = 1.0  # s
SETTLING = 6.0  # s, until casters point in their direction of motion
MEASURED = 3.0  # s


@dataclass(frozen=True)
class Run:
    """Path of ``base_link`` (m) and its turn (rad), and both computed from the driven wheels."""

    distance: float
    wheel_distance: float
    turn: float
    wheel_turn: float
    highest_jump: float


def rolling(wheel: Wheel, centre: tuple[float, float] | None, along: float) -> tuple[float, float]:
    """Returns the steering angle and the ground speed of a wheel for a motion of the robot.

    ``centre`` is the point c about which the robot turns at 1 rad/s, or ``None`` for a straight
    run at 1 m/s in the direction ``along``.  The contact of the wheel lies ``trail`` ahead and
    ``lateral_offset`` to the left of its steering axis a, seen in the rolling direction d.
    The wheel does not slip sideways if d . (c - a) = trail.  Then it rolls at the speed
    n . (c - a) - lateral_offset, with n to the left of d.
    """
    if centre is None:
        candidates = [along, along + math.pi]
    else:
        ux, uy = centre[0] - wheel.x, centre[1] - wheel.y
        distance = math.hypot(ux, uy)
        if distance < 1e-6:  # the robot turns about this wheel, which only scrubs
            return 0.0, 0.0
        spread = math.acos(max(-1.0, min(1.0, wheel.trail / distance)))
        candidates = [math.atan2(uy, ux) + spread, math.atan2(uy, ux) - spread]
    best: tuple[float, float] | None = None
    for direction in candidates:
        angle = wheel.steering_sign * (direction - wheel.heading)
        angle = math.remainder(angle, 2 * math.pi)
        if best is None or abs(angle) < abs(best[0]) - 1e-9:
            if centre is None:
                speed = math.cos(direction - along)
            else:
                nx, ny = -math.sin(direction), math.cos(direction)
                speed = nx * ux + ny * uy - wheel.lateral_offset
            best = (angle, speed)
    assert best is not None
    return best


def fixed_line(robot: Robot) -> tuple[float, float, float] | None:
    """Returns a point on the axle line of the fixed wheels, and their heading."""
    fixed = [w for w in robot.wheels if w.steering_joint is None and w.swivel_joint is None]
    if not fixed:
        return None
    x = sum(w.x for w in fixed) / len(fixed)
    y = sum(w.y for w in fixed) / len(fixed)
    return x, y, fixed[0].heading


def can_turn(robot: Robot) -> bool:
    """Reports if all fixed wheels have one axle line, so that the robot turns without skidding."""
    line = fixed_line(robot)
    if line is None:
        return True
    x, y, heading = line
    c, s = math.cos(heading), math.sin(heading)
    return all(
        abs(c * (w.x - x) + s * (w.y - y)) < 1e-6 and abs(math.sin(w.heading - heading)) < 1e-6
        for w in robot.wheels
        if w.steering_joint is None and w.swivel_joint is None
    )


def can_steer(robot: Robot, radius: float) -> bool:
    """Reports if the steering limits allow a circle of this radius (m) to the left."""
    x, y, along = fixed_line(robot) or (0.0, 0.0, 0.0)
    centre = (x - radius * math.sin(along), y + radius * math.cos(along))
    for wheel in robot.wheels:
        joint = robot.joint(wheel.steering_joint) if wheel.steering_joint is not None else None
        if joint is not None and joint.lower is not None and joint.upper is not None:
            angle, _ = rolling(wheel, centre, along)
            if not joint.lower <= angle <= joint.upper:
                return False
    return True


def drive(scene: Path, robot: Robot, *, radius: float | None) -> Run:
    """Drives straight (``radius`` is ``None``) or on a circle of this radius (m), to the left.

    The measurement begins after the ramp, when the casters have settled.
    """
    prefix = robot.prefix
    m = mujoco.MjModel.from_xml_path(str(scene))
    d = mujoco.MjData(m)
    mujoco.mj_resetDataKeyframe(m, d, 0)
    x, y, along = fixed_line(robot) or (0.0, 0.0, 0.0)
    centre = None
    rate = SPEED
    if radius is not None:
        centre = (x - radius * math.sin(along), y + radius * math.cos(along))
        rate = SPEED / max(radius, 1.0)
    speeds: list[tuple[int, int, float, float]] = []
    for wheel in robot.wheels:
        angle, speed = rolling(wheel, centre, along)
        if wheel.steering_joint is None and wheel.swivel_joint is None and abs(angle) > 1.6:
            angle, speed = angle - math.copysign(math.pi, angle), -speed
        if wheel.steering_joint is not None:
            joint = d.joint(prefix + wheel.steering_joint)
            joint.qpos[0] = angle
            actuator = robot.actuator_of(wheel.steering_joint)
            assert actuator is not None
            d.ctrl[m.actuator(prefix + actuator.name).id] = angle
        actuator = robot.actuator_of(wheel.spin_joint)
        if wheel.driven and actuator is not None:
            spin = m.joint(prefix + wheel.spin_joint).qposadr[0]
            speeds.append((m.actuator(prefix + actuator.name).id, int(spin), speed, wheel.radius))
    base = m.joint(f"{prefix}floating_base").qposadr[0]
    step = m.opt.timestep
    start: tuple[Any, float, list[float]] | None = None
    path, turned, highest = 0.0, 0.0, 0.0
    last, heading = d.qpos[base : base + 2].copy(), _yaw(d.qpos[base + 3 : base + 7])
    height = float(d.qpos[base + 2])
    for i in range(round((SETTLING + MEASURED) / step)):
        factor = rate * min(1.0, i * step / RAMP)
        for actuator_id, _, speed, r in speeds:
            d.ctrl[actuator_id] = factor * speed / r
        mujoco.mj_step(m, d)
        now, yaw = d.qpos[base : base + 2].copy(), _yaw(d.qpos[base + 3 : base + 7])
        if start is not None:
            path += float(np.linalg.norm(now - last))
            turned += math.remainder(yaw - heading, 2 * math.pi)
            highest = max(highest, abs(float(d.qpos[base + 2]) - height))
        elif (i + 1) * step >= SETTLING:
            start = (now, yaw, [float(d.qpos[q]) for _, q, _, _ in speeds])
        last, heading = now, yaw
    assert start is not None
    # The motion of the robot, computed from each driven wheel.
    estimates = [
        (float(d.qpos[q]) - begin) * r / speed
        for (_, q, speed, r), begin in zip(speeds, start[2], strict=True)
        if abs(speed) > 0.05
    ]
    mean = sum(estimates) / len(estimates)
    arm = math.hypot(*centre) if centre is not None else 0.0
    return Run(
        path,
        mean if centre is None else mean * arm,
        turned,
        0.0 if centre is None else mean,
        highest,
    )


def _yaw(quat: Any) -> float:
    w, x, y, z = (float(v) for v in quat)
    return math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
