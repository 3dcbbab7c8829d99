"""Computes the geometry of the wheels in the frame ``base_link``, with every joint at zero.

A wheel is modelled as a circle in the middle plane of the wheel.  The contact point is the lowest
point of the circle, also for a wheel with camber.  A wheel can turn about a vertical axis, which is
a steering axis or a swivel axis.  ``Wheel.x`` and ``Wheel.y`` are the coordinates of the turning
point, where the steering or swivel axis meets the horizontal plane through the contact point.
``Wheel.trail`` is the distance from the turning point to the contact point along the heading.
``Wheel.lateral_offset`` is the distance from the turning point to the contact point to the left of
the heading.  Side view of a caster that rolls to the right::

                  | swivel axis
            _     |
          ( + )---+
        ----c-----o----->  heading      o = (x, y), c = contact point, trail = -|oc|
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

from thorvaldc.diagnostics import Report, millimetres
from thorvaldc.model import Actuator, Collision, Cylinder, Joint, Link, Pose, Robot, Vec3, Wheel
from thorvaldc.model.number_origins import least
from thorvaldc.model.spatial import add, clean, cross, dot, norm, scale
from thorvaldc.model.statics.joint_tree import JointTree, tree_of
from thorvaldc.model.sums import float_sum

UP: Vec3 = (0.0, 0.0, 1.0)
# Sine of 10 deg, the least angle between the spin axis of a wheel and the vertical.
_MIN_FORWARD = 0.17
_MIN_UPRIGHT = 0.5  # Cosine of 60 deg, the largest tilt of a steering axis.
_UPRIGHT = math.cos(math.radians(0.1))
_STEPS = [k / 3 for k in range(-3, 4)]
"""Steering angles as shares of a quarter turn."""
_LIKELY = 2.0
"""Errors below this multiple of the standard deviation are usual."""

_SAME_PLACE = 1e-3  # m, and share of the unit vector of an axis
_SAME_SIZE = 0.05  # share of the radius and width of a tyre


class _WheelJoints(NamedTuple):
    """The movable joints between a wheel and the base of the robot.

    ``axis`` is the spin axis of the wheel, as a unit vector in ``base_link``.
    """

    spin: Joint
    steering: Joint | None
    swivel: Joint | None
    suspension: Joint | None
    axis: Vec3


class _TurningPoint(NamedTuple):
    """Turning point of a wheel, and the position of the contact point relative to the turning
    point.

    Attributes
    ----------
    x, y : point where the steering axis meets the horizontal plane through the contact point (m).
    trail : distance from the turning point to the contact point along the heading (m).
    lateral_offset : distance from the turning point to the contact point, to the left of the
        heading (m).
    sign : 1 if the steering axis points up, -1 if the steering axis points down.
    """

    x: float
    y: float
    trail: float
    lateral_offset: float
    sign: float


def lowest_point(center: Vec3, axis: Vec3, radius: float) -> Vec3:
    """Returns the contact point of a wheel, which is the lowest point of the wheel's circle.

    ``axis`` is the spin axis of the wheel, as a unit vector.  The direction from the centre to the
    lowest point is the projection of the downward vector onto the plane of the wheel, normalized:
    ``-(UP - axis_z axis) / sqrt(1 - axis_z^2)``.
    """
    horizontal = math.sqrt(max(1.0 - axis[2] * axis[2], 1e-12))
    down: Vec3 = (axis[0] * axis[2], axis[1] * axis[2], axis[2] * axis[2] - 1.0)
    return add(center, scale(radius / horizontal, down))


def spin_joint(tree: JointTree, link: str) -> Joint | None:
    """Returns the nearest movable joint between a wheel's link and the root of the robot."""
    return next((joint for joint in tree.joints_above(link) if joint.type != "fixed"), None)


def ground_height(tree: JointTree, wheels: Sequence[Wheel], report: Report) -> float:
    """Returns the height (m) by which the robot must be raised to stand on the ground.

    The contact point of the lowest wheel of the raised robot is at z = 0.
    """
    heights = []
    for wheel in wheels:
        joints = _wheel_joints(tree, wheel, report)
        if joints is not None:
            point = lowest_point(tree.pose[wheel.link].xyz, joints.axis, wheel.radius)
            heights.append(point[2])
    return -least(*heights) if heights else 0.0


def raise_axles(
    joints: Sequence[Joint],
    tree: JointTree,
    nominal_wheels: Sequence[Wheel],
    measured_wheels: Sequence[Wheel],
) -> tuple[Joint, ...]:
    """Returns the joints, with each axle raised by measured minus nominal radius.

    All wheels of the model then touch the ground.  The frame of a real robot bends by a few
    millimetres until all wheels touch the ground.  A rigid robot model with different wheel radii
    would stand on three wheels.
    """
    raised = {joint.name: joint for joint in joints}
    for nominal, measured in zip(nominal_wheels, measured_wheels, strict=True):
        growth = measured.radius - nominal.radius
        spin = spin_joint(tree, nominal.link)
        if growth == 0.0 or spin is None:
            continue
        axis = tree.pose[spin.child].rotate(spin.axis)
        # The height of the axle of a wheel with camber is radius * cos(camber angle).
        rise = growth * math.sqrt(max(1.0 - axis[2] * axis[2], 0.0))
        shift = tree.pose[spin.parent].inverse().rotate((0.0, 0.0, rise))
        joint = raised[spin.name]
        pose = replace(joint.pose, xyz=add(joint.pose.xyz, shift)).clean()
        raised[spin.name] = replace(joint, pose=pose)
    return tuple(raised.values())


def make_wheels(
    tree: JointTree,
    placed: Sequence[Wheel],
    actuators: Mapping[str, Actuator],
    report: Report,
) -> list[Wheel]:
    """Returns the wheels with their joints and their places in the robot.

    The static loads of the returned wheels are 0 and are computed later.

    ``actuators``: actuators of the robot, by the name of the joint.
    """
    wheels: list[Wheel] = []
    for wheel in placed:
        joints = _wheel_joints(tree, wheel, report)
        if joints is None:
            continue
        forward = cross(joints.axis, UP)
        if norm(forward) < _MIN_FORWARD:
            report.add(
                "wheel-lies-flat",
                f"the wheel of `{wheel.module}` spins about a vertical axis",
                wheel.span,
                hint="turn its mount",
            )
            continue
        heading = math.atan2(forward[1], forward[0])
        contact = lowest_point(tree.pose[wheel.link].xyz, joints.axis, wheel.radius)
        turning = _turning_point(tree, wheel, joints, contact, heading, report)
        if turning is None:
            continue
        wheels.append(
            replace(
                wheel,
                spin_joint=joints.spin.name,
                steering_joint=joints.steering.name if joints.steering else None,
                swivel_joint=joints.swivel.name if joints.swivel else None,
                suspension_joint=joints.suspension.name if joints.suspension else None,
                driven=joints.spin.name in actuators,
                x=clean(turning.x),
                y=clean(turning.y),
                heading=clean(heading),
                steering_sign=turning.sign,
                trail=clean(round(turning.trail, 10)),
                lateral_offset=clean(round(turning.lateral_offset, 10)),
                contact_height=clean(round(contact[2], 9)),
            )
        )
    return wheels


def _wheel_joints(tree: JointTree, wheel: Wheel, report: Report) -> _WheelJoints | None:
    """Returns the spin, steering, swivel and suspension joints of a wheel.

    Returns ``None`` and reports an error if no rotating joint carries the wheel.
    """
    movable = [joint for joint in tree.joints_above(wheel.link) if joint.type != "fixed"]
    if not movable or movable[0].type not in ("continuous", "revolute"):
        report.add(
            "wheel-does-not-spin",
            f"the wheel of `{wheel.module}` hangs on no joint that turns it",
            wheel.span,
            hint="mount it on a drive or a caster",
        )
        return None
    spin = movable[0]
    axis = tree.pose[spin.child].rotate(spin.axis)
    steering = swivel = suspension = None
    for joint in movable[1:]:
        if joint.role == "steering" and steering is None and swivel is None:
            steering = joint
        elif joint.role == "swivel" and swivel is None and steering is None:
            swivel = joint
        elif joint.role == "suspension" and suspension is None:
            suspension = joint
    return _WheelJoints(spin, steering, swivel, suspension, axis)


def _turning_point(
    tree: JointTree,
    wheel: Wheel,
    joints: _WheelJoints,
    contact: Vec3,
    heading: float,
    report: Report,
) -> _TurningPoint | None:
    """Returns the turning point of a wheel.

    A wheel without a steering or swivel joint has the turning point at the contact point.  Returns
    ``None`` and reports an error if the steering or swivel axis of the wheel is tilted too much.
    """
    turning_joint = joints.steering or joints.swivel
    if turning_joint is None:
        return _TurningPoint(contact[0], contact[1], 0.0, 0.0, 1.0)
    pose = tree.pose[turning_joint.child]
    direction = pose.rotate(turning_joint.axis)
    if abs(direction[2]) < _MIN_UPRIGHT:
        tilt = math.degrees(math.acos(min(1.0, abs(direction[2]))))
        report.add(
            "steering-axis-tilted",
            f"the steering axis of `{wheel.module}` is {tilt:.0f} deg off the vertical",
            wheel.span,
            hint="the base calculators need a nearly vertical axis",
        )
        return None
    sign = 1.0 if direction[2] > 0 else -1.0
    t = (contact[2] - pose.xyz[2]) / direction[2]
    x, y = pose.xyz[0] + t * direction[0], pose.xyz[1] + t * direction[1]
    c, s = math.cos(heading), math.sin(heading)
    trail = c * (contact[0] - x) + s * (contact[1] - y)
    lateral_offset = -s * (contact[0] - x) + c * (contact[1] - y)
    return _TurningPoint(x, y, trail, lateral_offset, sign)


def with_wheel_collisions(
    links: Sequence[Link], wheels: Sequence[Wheel], tree: JointTree
) -> tuple[Link, ...]:
    """Returns the links, with a collision cylinder for each wheel.

    The axis of the collision cylinder is the spin axis of the wheel.  A cylinder of the module that
    is the tyre once more is left out.
    """
    changed = {link.name: link for link in links}
    for wheel in wheels:
        spin = spin_joint(tree, wheel.link)
        if spin is None:
            continue
        wheel_from_base = tree.pose[wheel.link].inverse()
        axis = wheel_from_base.rotate(tree.pose[spin.child].rotate(spin.axis))
        pose = Pose(quat=_rotation_from_z_to(axis)).clean()
        cylinder = Collision(Cylinder(wheel.radius, wheel.width), pose)
        link = changed[wheel.link]
        others = tuple(c for c in link.collisions if not _is_same_tyre(c, cylinder))
        changed[wheel.link] = replace(link, collisions=(cylinder, *others))
    return tuple(changed.values())


def _is_same_tyre(collision: Collision, tyre: Collision) -> bool:
    """Returns whether a collision shape is a cylinder in the place of the tyre and of its size.

    The radius of the tyre can be calibrated: it differs from that of the shape by some per cent.
    """
    shape, cylinder = collision.shape, tyre.shape
    if not isinstance(shape, Cylinder) or not isinstance(cylinder, Cylinder):
        return False
    along = dot(collision.pose.rotate(UP), tyre.pose.rotate(UP))
    return (
        norm(collision.pose.xyz) < _SAME_PLACE
        and abs(along) > 1.0 - _SAME_PLACE
        and abs(shape.radius - cylinder.radius) < _SAME_SIZE * cylinder.radius
        and shape.length < (1.0 + _SAME_SIZE) * cylinder.length
    )


def _rotation_from_z_to(axis: Vec3) -> tuple[float, float, float, float]:
    """Returns the quaternion (w, x, y, z) of the shortest rotation from the z axis to a unit
    vector.

    The shortest rotation from the z axis to the direction -z is not unique.  For the direction -z,
    the function returns half a turn about the x axis.
    """
    if axis[2] < -1 + 1e-12:
        return (0.0, 1.0, 0.0, 0.0)
    v = cross(UP, axis)
    w = 1.0 + axis[2]
    n = math.sqrt(w * w + norm(v) ** 2)
    x, y, z = scale(1.0 / n, v)
    return (w / n, x, y, z)


def check_steering_axes(robot: Robot, report: Report) -> None:
    """Warns if a steering axis leans so far that the odometry is worse than its covariance states.

    The base calculators turn the direction and the contact point of a wheel about a vertical axis.
    About an axis that leans, the direction differs by an angle, and the contact point by a distance
    d along it, which a yaw rate turns into side slip.  At the distance L from the other wheels, it
    is as if the direction differed by d / L more.
    """
    tree = tree_of(robot)
    points = [wheel.contact_point for wheel in robot.wheels]
    middle = [float_sum(values) / len(points) for values in zip(*points, strict=True)]
    for wheel in robot.wheels:
        joint = tree.joints.get(wheel.steering_joint or "")
        upright = 1.0 if joint is None else abs(tree.pose[joint.child].rotate(joint.axis)[2])
        if joint is None or upright > _UPRIGHT:
            continue
        from thorvaldc.runtime.calculators.twist_fit import Noise  # for few robots

        lever = max(math.dist(middle, (wheel.x, wheel.y)), wheel.radius)
        error, away, angle = max(_error_of(wheel, joint, tree, lever, k) for k in _STEPS)
        if error > _LIKELY * Noise(**dict(robot.driver.noise)).direction:
            report.add(
                "steering-axis-leans",
                f"the steering axis of `{wheel.module}` leans by"
                f" {math.degrees(math.acos(upright)):.1f} deg: steered by {math.degrees(angle):.0f}"
                f" deg, its wheel stands {millimetres(away)} off where odometry expects it, an"
                f" error of {math.degrees(error):.1f} deg that its covariance does not include",
                wheel.span,
                hint="correct the `rpy` of its mount, or state the error:"
                f" `driver: {{noise: {{angle: {math.degrees(error):.1f} deg}}}}`",
            )


def _error_of(
    wheel: Wheel, steering: Joint, tree: JointTree, lever: float, share: float
) -> tuple[float, float, float]:
    """Returns the error of the direction (rad), that of the place (m), and the steering angle."""
    lower, upper = (math.inf if q is None else abs(q) for q in (steering.lower, steering.upper))
    angle = share * min(math.pi / 2.0, upper if share > 0.0 else lower)
    turned, spin = tree.at({steering.name: angle}), tree.joints[wheel.spin_joint]
    axle = turned.pose[spin.child].rotate(spin.axis)
    heading = wheel.heading + wheel.steering_sign * angle
    x, y = replace(wheel, heading=heading).contact_point
    contact = lowest_point(turned.pose[wheel.link].xyz, axle, wheel.radius)
    away = abs((contact[0] - x) * math.cos(heading) + (contact[1] - y) * math.sin(heading))
    turn = abs(math.remainder(math.atan2(-axle[0], axle[1]) - heading, math.tau))
    return turn + away / lever, away, angle
