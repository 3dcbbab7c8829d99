"""What can be said against a robot that is well-formed: each check reads the model."""

from __future__ import annotations

import math
from collections.abc import Sequence

from thorvaldc.compiler.geometry.wheel_geometry import contact_point
from thorvaldc.compiler.modules.design_requirements import DesignRequirements
from thorvaldc.diagnostics import Label, Report
from thorvaldc.model.robot import Robot, Wheel
from thorvaldc.model.statics.gravity import GRAVITY
from thorvaldc.model.statics.joint_tree import JointTree

WHEEL_OFF_GROUND = 2e-3  # m; a suspension or a tyre takes up less than this


def check_robot(robot: Robot, design: DesignRequirements, report: Report) -> None:
    """Run every check; all their findings go to the report."""
    check_masses(robot, report)
    check_inertias(robot, report)
    check_wheels_present(robot, report)
    if robot.wheels:
        check_wheels_on_ground(robot, report)
        check_parts_above_ground(robot, report)
        check_wheels_overlap(robot, report)
        check_stability(robot, design, report)
        check_wheel_loads(robot, report)
        check_steering_range(robot, report)
        check_controllable(robot, report)
        check_slope(robot, design, report)


def check_masses(robot: Robot, report: Report) -> None:
    """A link that a joint moves, with nothing on it that has a mass, cannot be simulated."""
    masses = {link.name: link.inertial.mass if link.inertial else 0.0 for link in robot.links}
    fixed_children: dict[str, list[str]] = {}
    for joint in robot.joints:
        if joint.type == "fixed":
            fixed_children.setdefault(joint.parent, []).append(joint.child)
    origins = {link.name: link for link in robot.links}
    for joint in robot.joints:
        if joint.type == "fixed":
            continue
        total, stack = 0.0, [joint.child]
        while stack:
            name = stack.pop()
            total += masses[name]
            stack.extend(fixed_children.get(name, ()))
        if total <= 0.0:
            report.add(
                "link-massless",
                f"link `{joint.child}` moves on joint `{joint.name}` and has no mass",
                origins[joint.child].span,
                hint="give one of its parts a `mass`",
            )
    if sum(masses.values()) <= 0.0:
        report.add("link-massless", "the robot has no mass at all", robot.span)


def check_inertias(robot: Robot, report: Report) -> None:
    """Principal moments are positive and none exceeds the sum of the other two."""
    for link in robot.links:
        if link.inertial is None or link.inertial.mass <= 0.0:
            continue
        low, middle, high = link.inertial.principal_moments()
        if low <= 0.0 or high > (low + middle) * (1 + 1e-6):
            report.add(
                "inertia-impossible",
                f"the inertia of link `{link.name}` is that of no body: principal moments "
                f"{low:.4g}, {middle:.4g} and {high:.4g} kg m^2",
                link.span,
                hint="each must be positive and at most the sum of the other two",
            )


def check_wheels_present(robot: Robot, report: Report) -> None:
    if not robot.wheels:
        report.add("no-wheels", "the robot has no wheels", robot.span)
    elif not any(w.driven for w in robot.wheels):
        report.add("no-drive", "no wheel of the robot is driven", robot.span)


def check_wheels_on_ground(robot: Robot, report: Report) -> None:
    lowest = min(robot.wheels, key=lambda wheel: wheel.contact_height)
    for wheel in robot.wheels:
        if wheel.contact_height > WHEEL_OFF_GROUND:
            report.add(
                "wheel-off-ground",
                f"the wheel of `{wheel.module}` ends {wheel.contact_height * 1000:.3g} mm "
                "above the ground",
                wheel.span,
                labels=[Label(lowest.span, "the lowest wheel")],
                hint=f"lower its mount by {wheel.contact_height * 1000:.3g} mm "
                "(`mount: {port: .., xyz: [0, 0, ..]}`) or use legs of another length",
            )


def check_parts_above_ground(robot: Robot, report: Report) -> None:
    """A link whose mass is below the ground has been mounted upside down or too low.

    Its centre of mass is what is asked about: a tool may well reach into the soil.
    """
    pose = JointTree(robot.links, robot.joints).pose
    for link in robot.links:
        if link.inertial is None or link.inertial.mass <= 0.0 or link.name not in pose:
            continue
        height = pose[link.name].apply(link.inertial.com)[2]
        if height < 0.0:
            report.add(
                "part-below-ground",
                f"the middle of link `{link.name}` is {-height * 1000:.3g} mm below the ground",
                link.span,
                hint="raise its mount, or turn it over",
            )


def check_wheels_overlap(robot: Robot, report: Report) -> None:
    """Two wheels in one place; seen from above, each a rectangle at steering angle 0.

    Two wheels on one axle (a double wheel) may touch side by side.
    """
    cells: dict[tuple[int, int], list[Wheel]] = {}
    size = 2 * max(max(w.radius, w.width) for w in robot.wheels) + 1e-6
    for wheel in robot.wheels:
        x, y = contact_point(wheel)
        i, j = math.floor(x / size), math.floor(y / size)
        near = [
            other
            for di in (-1, 0, 1)
            for dj in (-1, 0, 1)
            for other in cells.get((i + di, j + dj), ())
        ]
        other = next((other for other in near if _rectangles_overlap(wheel, other)), None)
        if other is not None:
            # The first is enough to find the mistake; wheels that overlap do not count again,
            # so that a thousand in one place are not half a million faults.
            report.add(
                "wheels-overlap",
                f"the wheels of `{other.module}` and `{wheel.module}` are in one place",
                wheel.span,
                labels=[Label(other.span, "the other wheel")],
                hint="move one of the mounts",
            )
            continue
        cells.setdefault((i, j), []).append(wheel)


def _rectangles_overlap(a: Wheel, b: Wheel) -> bool:
    """Separating axes of two oriented rectangles of 2 r by w."""
    (ax, ay), (bx, by) = contact_point(a), contact_point(b)
    gap = 1e-6
    for heading in (a.heading, b.heading):
        for axis in (heading, heading + math.pi / 2):
            c, s = math.cos(axis), math.sin(axis)
            distance = abs((bx - ax) * c + (by - ay) * s)
            reach = 0.0
            for wheel in (a, b):
                along = abs(math.cos(wheel.heading - axis))
                across = abs(math.sin(wheel.heading - axis))
                reach += wheel.radius * along + wheel.width / 2 * across
            if distance >= reach - gap:
                return False
    return True


def check_stability(robot: Robot, design: DesignRequirements, report: Report) -> None:
    """The angle at which the robot tips over the nearest edge between its wheels."""
    hull = _convex_hull([contact_point(w) for w in robot.wheels])
    x, y, z = robot.inertial.com
    margins = []
    for (ax, ay), (bx, by) in zip(hull, [*hull[1:], *hull[:1]], strict=True):
        length = math.hypot(bx - ax, by - ay)
        if length > 1e-9:
            margins.append(((bx - ax) * (y - ay) - (by - ay) * (x - ax)) / length)
    if len(hull) < 3 or not margins:
        report.add(
            "unstable",
            "the robot stands on a line: its wheels do not span an area",
            robot.span,
            hint="add a caster or a wheel off that line",
        )
        return
    margin = min(margins)
    if margin <= 0.0:
        report.add(
            "unstable",
            f"the centre of mass (x {x:.3f} m, y {y:.3f} m) is {-margin * 1000:.3g} mm outside "
            "of the area between the wheels: the robot falls over",
            robot.span,
            hint="move a battery or a wheel",
        )
        return
    angle = math.atan2(margin, max(z, 1e-9))
    if angle < design.tip_over_angle:
        report.add(
            "tip-over",
            f"the robot tips over at {math.degrees(angle):.1f} deg "
            f"(centre of mass {z:.3f} m high, {margin:.3f} m from the nearest edge); "
            f"at least {math.degrees(design.tip_over_angle):.1f} deg is asked for",
            design.tip_over_span or robot.span,
            hint="widen the base, lower the masses, "
            "or state another `design: {minimum_tip_over_angle: ..}`",
        )


def _convex_hull(points: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """Counter-clockwise hull without collinear points (Andrew's monotone chain)."""
    ordered = sorted(set(points))
    if len(ordered) < 3:
        return ordered

    def half(source: list[tuple[float, float]]) -> list[tuple[float, float]]:
        chain: list[tuple[float, float]] = []
        for p in source:
            while len(chain) >= 2:
                (ax, ay), (bx, by) = chain[-2], chain[-1]
                if (bx - ax) * (p[1] - ay) - (by - ay) * (p[0] - ax) > 1e-12:
                    break
                chain.pop()
            chain.append(p)
        return chain[:-1]

    return half(ordered) + half(ordered[::-1])


def check_wheel_loads(robot: Robot, report: Report) -> None:
    """A wheel that carries nothing neither drives nor supports."""
    weight = robot.inertial.mass * GRAVITY
    for wheel in robot.wheels:
        if wheel.contact_height <= WHEEL_OFF_GROUND and wheel.load < 1e-3 * weight:
            report.add(
                "wheel-unloaded",
                f"the wheel of `{wheel.module}` carries {wheel.load:.3g} N of {weight:.4g} N",
                wheel.span,
                hint="move masses towards it, or leave it out",
            )


def check_steering_range(robot: Robot, report: Report) -> None:
    """With reversing, half a turn of steering reaches every direction; less does not."""
    joints = {joint.name: joint for joint in robot.joints}
    for wheel in robot.wheels:
        joint = joints.get(wheel.steering_joint or "")
        if joint is None or joint.lower is None or joint.upper is None:
            continue
        needed = _needed_range(robot, wheel)
        if needed is None:
            continue
        if joint.upper - joint.lower < needed - 1e-6:
            report.add(
                "steering-range",
                f"`{wheel.module}` steers over {math.degrees(joint.upper - joint.lower):.1f} deg; "
                f"{math.degrees(needed):.0f} deg are needed to reach every direction",
                wheel.span,
                hint="give the steering a wider range, or accept that some twists are refused",
            )


def _needed_range(robot: Robot, wheel: Wheel) -> float | None:
    """Half a turn where any direction may be asked for; nothing where fixed wheels decide."""
    return math.pi if feasible_twists(robot) == 3 else None


def feasible_twists(robot: Robot) -> int:
    """Degrees of freedom that wheels which do not turn leave: 3 minus the rank of their rows."""
    rows = [
        _lateral_row(w, w.heading)
        for w in robot.wheels
        if w.steering_joint is None and w.swivel_joint is None
    ]
    return 3 - _rank(rows)


def check_controllable(robot: Robot, report: Report) -> None:
    """Whether wheels determine the whole twist (vx, vy, wz) of the robot.

    Each wheel that is not a caster forbids sliding sideways, each driven one
    sets a speed along; together they must have rank 3 for some steering angles.
    """
    if not any(w.driven for w in robot.wheels):
        return
    free = feasible_twists(robot)
    if free == 0:
        report.add(
            "no-free-motion",
            "the wheels that cannot turn block one another: no motion is free of skidding",
            robot.span,
            hint="steer some of them, or let them swivel",
        )
        return
    best = 0
    for turn in (0.3, 1.1, 2.0):  # any angles but special ones show the generic rank
        rows = []
        for k, w in enumerate(robot.wheels):
            if w.swivel_joint is not None:
                continue
            angle = w.heading + (turn * (k + 1) if w.steering_joint is not None else 0.0)
            rows.append(_lateral_row(w, angle))
            if w.driven:
                rows.append(_rolling_row(w, angle))
        best = max(best, _rank(rows))
    if best < 3:
        casters = [w for w in robot.wheels if w.swivel_joint is not None]
        labels = [Label(w.span, "swivels freely") for w in casters[:2]]
        report.add(
            "twist-uncontrolled",
            f"the wheels control only {best} of the 3 components of the robot's motion "
            "(forward, sideways, turning)",
            robot.span,
            labels=labels,
            hint="replace a swivelling caster by a wheel with a fixed direction (`caster/fixed`), "
            "or drive another wheel",
        )
    elif free == 1 and _skids(robot):
        report.add(
            "skid-steering",
            "the robot can turn only by skidding: its fixed wheels are not on one axle",
            robot.span,
            hint="odometry will be poor; steer some wheels or let them swivel",
        )


def _skids(robot: Robot) -> bool:
    rows = [
        _lateral_row(w, w.heading)
        for w in robot.wheels
        if w.steering_joint is None and w.swivel_joint is None
    ]
    return _rank([*rows, (0.0, 0.0, 1.0)]) == _rank(rows)


def _lateral_row(wheel: Wheel, angle: float) -> tuple[float, float, float]:
    x, y = contact_point(wheel)
    c, s = math.cos(angle), math.sin(angle)
    return (-s, c, c * x + s * y)


def _rolling_row(wheel: Wheel, angle: float) -> tuple[float, float, float]:
    x, y = contact_point(wheel)
    c, s = math.cos(angle), math.sin(angle)
    return (c, s, s * x - c * y)


def _rank(rows: Sequence[tuple[float, float, float]], tolerance: float = 1e-4) -> int:
    """Rank of a matrix of three columns by Gram-Schmidt; tolerance in m at unit rows."""
    basis: list[tuple[float, float, float]] = []
    for row in sorted(rows, key=lambda r: -sum(v * v for v in r)):
        rest = list(row)
        for b in basis:
            along = sum(r * v for r, v in zip(rest, b, strict=True))
            rest = [r - along * v for r, v in zip(rest, b, strict=True)]
        size = math.sqrt(sum(r * r for r in rest))
        if size > tolerance:
            basis.append((rest[0] / size, rest[1] / size, rest[2] / size))
    return len(basis)


def check_slope(robot: Robot, design: DesignRequirements, report: Report) -> None:
    """Whether the motors, and the grip of the driven wheels, hold the stated slope."""
    if design.slope is None:
        return
    actuators = {a.joint: a for a in robot.actuators}
    weight = robot.inertial.mass * GRAVITY
    s, c = math.sin(design.slope), math.cos(design.slope)
    rolling = sum(w.rolling_resistance * w.load for w in robot.wheels) * c
    needed = weight * s + rolling
    driven = [w for w in robot.wheels if w.driven]
    torque = sum(actuators[w.spin_joint].max_torque / w.radius for w in driven)
    grip = sum(w.friction * w.load for w in driven) * c
    degrees = math.degrees(design.slope)
    for force, word, hint in (
        (torque, "the motors push", "stronger motors, more driven wheels or a lighter robot"),
        (grip, "the driven wheels grip", "drive more wheels or move weight onto the driven ones"),
    ):
        if force < needed:
            report.add(
                "slope-too-steep",
                f"{word} with {force:.0f} N; a slope of {degrees:.1f} deg needs {needed:.0f} N",
                design.slope_span or robot.span,
                hint=hint,
            )
