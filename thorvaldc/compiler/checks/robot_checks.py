"""Checks the masses, wheels, stability and wheel loads of a complete robot model."""

from __future__ import annotations

import math

from thorvaldc.compiler.checks import mobility_checks
from thorvaldc.compiler.robot_settings.robot_sections import DesignRequirements
from thorvaldc.diagnostics import Label, Report, millimetres, plain
from thorvaldc.model import Robot, Wheel
from thorvaldc.model.spatial import GRAVITY, float_sum
from thorvaldc.model.statics.joint_tree import tree_of
from thorvaldc.model.statics.slope import SlopeStatics, holds_without_torque, standing_slopes
from thorvaldc.model.statics.tip_over import Point, overlap, support_of

# Largest gap (m) between a wheel and the ground that suspensions and tyres compensate.
WHEEL_OFF_GROUND = 2e-3

TOUCHING = 1e-6  # Overlap (m) of two wheels that touch each other.

SMALLEST_SIZE, LARGEST_SIZE = 0.1, 20.0
"""Extents (m) of the smallest and the largest robot that is not reported."""


def check_robot(robot: Robot, design: DesignRequirements, report: Report) -> None:
    """Runs all geometry checks of a robot model and adds the diagnostics to the report."""
    check_size(robot, report)
    check_masses(robot, report)
    check_inertias(robot, report)
    check_wheels_present(robot, report)
    if robot.wheels:
        check_wheels_on_ground(robot, report)
        check_parts_above_ground(robot, report)
        check_wheels_overlap(robot, report)
        check_stability(robot, design, report)
        if mobility_checks.check_bodies_held(robot, report):
            check_wheel_loads(robot, report)
        mobility_checks.check_steering_range(robot, report)
        mobility_checks.check_controllable(robot, report)
        check_slope(robot, design, report)
        if not report.has_errors:  # wrong masses, wheels or a wrong slope cause false warnings
            check_standing(robot, design, report)


def check_size(robot: Robot, report: Report) -> None:
    """Warns if the whole robot is unusually large or small.

    The size is the largest extent of the centres of mass and the wheels along an axis of
    ``base_link``.  Most often one length lacks its unit.
    """
    pose = tree_of(robot).pose
    points = [
        pose[link.name].apply(link.inertial.com)
        for link in robot.links
        if link.inertial is not None and link.name in pose
    ]
    points += [(w.x + side * w.radius, w.y, w.radius) for w in robot.wheels for side in (-1, 1)]
    sizes = [max(values) - min(values) for values in zip(*points, strict=True)]
    size = max(sizes, default=0.0)
    if any(d.code.name == "number-without-unit" for d in report):
        return  # the cause has been reported
    if size > LARGEST_SIZE or 0.0 < size < SMALLEST_SIZE:
        report.add(
            "robot-size",
            f"the robot is {plain(size, 4)} m long, wide or high",
            robot.span,
            hint="look at the lengths in the file; a number without a unit is in m",
        )


def check_masses(robot: Robot, report: Report) -> None:
    """Checks that each moving link has a mass, which the physics simulation needs.

    The mass of a moving link includes the links that are fixed to the moving link.
    """
    masses = {link.name: link.inertial.mass if link.inertial else 0.0 for link in robot.links}
    fixed_children: dict[str, list[str]] = {}
    for joint in robot.joints:
        if joint.type == "fixed":
            fixed_children.setdefault(joint.parent, []).append(joint.child)
    links = {link.name: link for link in robot.links}
    for joint in robot.joints:
        if joint.type == "fixed":
            continue
        moved_mass, stack = 0.0, [joint.child]
        while stack:
            name = stack.pop()
            moved_mass += masses[name]
            stack.extend(fixed_children.get(name, ()))
        if moved_mass <= 0.0:
            report.add(
                "link-massless",
                f"link `{joint.child}` moves on joint `{joint.name}` and has no mass",
                links[joint.child].span,
                hint="give one of its parts a `mass`",
            )
    if float_sum(masses.values()) <= 0.0:
        report.add("link-massless", "the robot has no mass", robot.span)


def check_inertias(robot: Robot, report: Report) -> None:
    """Checks that a real body can have the inertia of each link.

    The principal moments of inertia of a real body are positive and satisfy the triangle
    inequality.
    """
    for link in robot.links:
        if link.inertial is None or link.inertial.mass <= 0.0:
            continue
        low, middle, high = link.inertial.principal_moments()
        if low <= 0.0 or high > (low + middle) * (1 + 1e-6):
            report.add(
                "inertia-impossible",
                f"no body has the inertia of link `{link.name}`: principal moments "
                f"{low:.4g}, {middle:.4g} and {high:.4g} kg m^2",
                link.span,
                hint="each must be positive and at most the sum of the other two",
            )


def check_wheels_present(robot: Robot, report: Report) -> None:
    """Checks that the robot has wheels and that at least one wheel is driven."""
    if not robot.wheels:
        report.add("no-wheels", "the robot has no wheels", robot.span)
    elif not any(wheel.driven for wheel in robot.wheels):
        report.add("no-drive", "no wheel of the robot is driven", robot.span)


def check_wheels_on_ground(robot: Robot, report: Report) -> None:
    """Checks that every wheel touches the ground.

    The ground is at the height of the contact point of the lowest wheel.
    """
    lowest = min(robot.wheels, key=lambda wheel: wheel.contact_height)
    for wheel in robot.wheels:
        if wheel.contact_height > WHEEL_OFF_GROUND:
            report.add(
                "wheel-off-ground",
                f"the wheel of `{wheel.module}` ends {millimetres(wheel.contact_height)} "
                "above the ground",
                wheel.span,
                labels=[Label(lowest.span, "the lowest wheel")],
                hint="turn its mount over (`rpy`): the module is upside down"
                if _is_upside_down(wheel, robot)
                else f"lower its mount by {millimetres(wheel.contact_height)} "
                "(`mount: {port: .., xyz: [0, 0, ..]}`) or use legs of another length",
            )


def _is_upside_down(wheel: Wheel, robot: Robot) -> bool:
    """Returns whether the module that the robot file mounts for a wheel points downwards.

    The first link of a module carries its other links; its z axis points upwards on its mount.
    """
    name, pose = wheel.module.partition(".")[0], tree_of(robot).pose
    root = next(link.name for link in robot.links if link.module.partition(".")[0] == name)
    return root in pose and pose[root].rotate((0.0, 0.0, 1.0))[2] < -0.5


def check_parts_above_ground(robot: Robot, report: Report) -> None:
    """Checks that no link has a centre of mass below the ground.

    A link with a centre of mass below the ground is mounted upside down or too low.  Other points
    of a link may be below the ground, for example the tip of a tool in the soil.
    """
    pose = tree_of(robot).pose
    for link in robot.links:
        if link.inertial is None or link.inertial.mass <= 0.0 or link.name not in pose:
            continue
        height = pose[link.name].apply(link.inertial.com)[2]
        if height < 0.0:
            report.add(
                "part-below-ground",
                f"the centre of mass of link `{link.name}` is {millimetres(-height)} "
                "below the ground",
                link.span,
                hint="raise its mount, or turn it over",
            )


def check_wheels_overlap(robot: Robot, report: Report) -> None:
    """Checks that no two wheels overlap.

    For the overlap check, each wheel is a rectangle in the ground plane, at the steering angle 0.
    The two wheels of a double wheel may touch each other.  The wheels are sorted into grid cells
    that are larger than any wheel.  Each wheel is then compared only with the wheels in the same
    and the neighbouring grid cells.
    """
    cells: dict[tuple[int, int], list[tuple[Wheel, list[Point]]]] = {}
    size = 2 * max(max(w.radius, w.width) for w in robot.wheels) + 1e-6
    for wheel in robot.wheels:
        x, y = wheel.contact_point
        i, j = math.floor(x / size), math.floor(y / size)
        neighbours = [
            neighbour
            for di in (-1, 0, 1)
            for dj in (-1, 0, 1)
            for neighbour in cells.get((i + di, j + dj), ())
        ]
        outline = _outline(wheel)
        overlaps = ((other, overlap(outline, corners)) for other, corners in neighbours)
        overlapping = next((w for w, move in overlaps if move and move[0] > TOUCHING), None)
        if overlapping is not None:
            # Each wheel causes at most one diagnostic about overlapping wheels.  Without the
            # restriction, a thousand wheels in one position would cause half a million diagnostics.
            report.add(
                "wheels-overlap",
                f"the wheels of `{overlapping.module}` and `{wheel.module}` overlap",
                wheel.span,
                labels=[Label(overlapping.span, "the other wheel")],
                hint="move one of the mounts",
            )
            continue
        cells.setdefault((i, j), []).append((wheel, outline))


def _outline(wheel: Wheel) -> list[Point]:
    """Returns the corners (m) of the rectangle of a wheel on the ground, counter-clockwise.

    The rectangle has the length 2 * radius along the heading, and the width of the wheel.
    """
    x, y = wheel.contact_point
    c, s, a, b = math.cos(wheel.heading), math.sin(wheel.heading), wheel.radius, wheel.width / 2
    corners = ((a, b), (-a, b), (-a, -b), (a, -b))
    return [(x + c * along - s * left, y + s * along + c * left) for along, left in corners]


def check_stability(robot: Robot, design: DesignRequirements, report: Report) -> None:
    """Checks the smallest tip-over angle of the robot, see ``model.statics.tip_over``."""
    support = support_of(robot)
    x, y, z = robot.inertial.com
    if not support.edges:
        report.add(
            "unstable",
            "the robot stands on a line: its wheels do not span an area",
            robot.span,
            hint="add a caster or a wheel off that line",
        )
        return
    margin = support.margin
    if not support.stands:
        report.add(
            "unstable",
            f"the centre of mass (x {x:.3f} m, y {y:.3f} m) is {millimetres(-margin)} outside "
            "the area between the wheels: the robot falls over",
            robot.span,
            hint="move a battery or a wheel",
        )
        return
    _, angle = support.least_tip_over()
    if angle < design.tip_over_angle:
        report.add(
            "tip-over",
            f"the robot tips over at {math.degrees(angle):.1f} deg "
            f"(centre of mass {z:.3f} m high, {margin:.3f} m from the nearest edge); "
            f"the required angle is at least {math.degrees(design.tip_over_angle):.1f} deg",
            design.tip_over_span or robot.span,
            hint="widen the base, lower the masses, "
            "or state another `design: {minimum_tip_over_angle: ..}`",
        )


def check_wheel_loads(robot: Robot, report: Report) -> None:
    """Checks that each wheel on the ground carries a part of the robot's weight."""
    weight = robot.inertial.mass * GRAVITY
    for wheel in robot.wheels:
        if wheel.contact_height <= WHEEL_OFF_GROUND and wheel.load < 1e-3 * weight:
            report.add(
                "wheel-unloaded",
                f"the wheel of `{wheel.module}` carries {wheel.load:.3g} N of {weight:.4g} N",
                wheel.span,
                hint="move masses towards the wheel, or leave it out",
            )


def check_slope(robot: Robot, design: DesignRequirements, report: Report) -> None:
    """Checks that the robot can climb the required slope forwards, see ``model.statics.slope``."""
    if design.slope is None:
        return
    needed, motor_force, grip = SlopeStatics(robot).forces(design.slope)
    degrees = math.degrees(design.slope)
    for force, cause, hint in (
        (motor_force, "the motors push", "stronger motors, more driven wheels or a lighter robot"),
        (grip, "the driven wheels grip", "drive more wheels or move weight onto the driven ones"),
    ):
        if force < needed:
            report.add(
                "slope-too-steep",
                f"{cause} with {force:.0f} N; a slope of {degrees:.1f} deg needs {needed:.0f} N",
                design.slope_span or robot.span,
                hint=hint,
            )


def check_standing(robot: Robot, design: DesignRequirements, report: Report) -> None:
    """Checks that the robot stands on the required slope without power, see
    ``model.statics.slope``.

    While the drives have power, they hold the robot.  Somebody must know what holds it then.
    """
    slopes = standing_slopes(robot)
    if design.slope is None or slopes is None or holds_without_torque(robot):
        return
    limits = f"stands with its motors off up to {math.degrees(slopes.motors_off):.1f} deg"
    if slopes.braked is not None:
        limits += f", with its brakes closed up to {math.degrees(slopes.braked):.1f} deg"
    report.add(
        "slope-not-held",
        f"the robot {limits}; it is designed for {math.degrees(design.slope):.1f} deg",
        design.slope_span or robot.span,
        hint="choose drives with brakes (`brake`), or put chocks under the wheels before the "
        "power is cut on a slope",
    )
