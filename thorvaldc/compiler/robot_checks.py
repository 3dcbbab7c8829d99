"""Checks the model of a complete robot: masses, wheels, stability, slopes, motions, purpose.

``model.statics.mobility`` explains the rows of twists, ``model.statics.standing`` how gravity and
ground hold the bodies of a robot.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace

from thorvaldc.compiler.descriptions.description import Description
from thorvaldc.compiler.descriptions.description_rules import check_description
from thorvaldc.compiler.robot_settings.robot_sections import DesignRequirements
from thorvaldc.compiler.room_checks import check_room
from thorvaldc.compiler.source.node import Node
from thorvaldc.diagnostics import Label, Report, millimetres, plain
from thorvaldc.model import Joint, Pose, Robot, Vec3, Wheel
from thorvaldc.model.spatial import GRAVITY
from thorvaldc.model.statics import mobility
from thorvaldc.model.statics.joint_tree import OF_EXTRA, tree_of
from thorvaldc.model.statics.slope import SlopeStatics, holds_without_torque, standing_slopes
from thorvaldc.model.statics.standing import Standing, standing_of
from thorvaldc.model.statics.tip_over import outer_points, pulls_out, support_of
from thorvaldc.model.stopping import driven_wheels
from thorvaldc.model.sums import float_sum

# Largest gap (m) between a wheel and the ground that suspensions and tyres compensate.
WHEEL_OFF_GROUND = 2e-3

UPRIGHT = ("lidar_2d", "lidar_3d", "gnss")
"""Types of sensors whose z axis points upwards; that of a camera is the direction of its view."""
SMALLEST_SIZE, LARGEST_SIZE = 0.1, 20.0
"""Extents (m) of the smallest and the largest robot that is not reported."""


def check_robot(robot: Robot, design: DesignRequirements, report: Report) -> None:
    """Runs all geometry checks of a robot model and adds the diagnostics to the report."""
    check_size(robot, report)
    check_bodies(robot, report)
    check_wheels_present(robot, report)
    if robot.wheels:
        check_wheels_on_ground(robot, report)
        check_stability(robot, design, report)
        if check_bodies_held(robot, report):
            check_wheel_loads(robot, report)
        check_steering_range(robot, report)
        check_controllable(robot, report)
        check_slope(robot, design, report)
        if not report.has_errors:  # wrong masses, wheels or a wrong slope cause false warnings
            check_standing(robot, design, report)
    check_room(robot, report)
    check_sensors(robot, report)


def check_sensors(robot: Robot, report: Report) -> None:
    """Reports each lidar or antenna whose z axis points downwards in the drawn pose.

    A lidar that hangs measures angles in the other direction, an antenna for GNSS receives nothing.
    """
    pose = tree_of(robot).pose
    for sensor in robot.sensors:
        if sensor.type in UPRIGHT and sensor.link in pose and _points_down(pose[sensor.link]):
            report.add(
                "sensor-upside-down",
                f"the sensor `{sensor.name}` is upside down: the z axis of `{sensor.link}` points "
                "downwards",
                sensor.span,
                hint="turn its mount over (`rpy`), or accept the warning for a sensor that hangs",
            )


def check_size(robot: Robot, report: Report) -> None:
    """Warns if the whole robot is unusually large or small.

    The size is the largest extent of masses and wheels along an axis of ``base_link``.
    """
    points = outer_points(robot)
    size = _extent(point for point, *_ in points)
    is_known = any(d.code.name == "number-without-unit" for d in report)
    if not is_known and (size > LARGEST_SIZE or 0.0 < size < SMALLEST_SIZE):
        span, hint = robot.span, "look at the lengths in the file; a number without a unit is in m"
        for part, place in {module.split(".")[0]: place for _, place, module in points}.items():
            others = (point for point, _, module in points if module.split(".")[0] != part)
            if size > LARGEST_SIZE >= _extent(others):
                span, hint = place, f"`{part}` is far away from the others; {hint}"
        text = f"the robot is {plain(size, 4)} m long, wide or high"
        report.add("robot-size", text, span, hint=hint)


def _extent(points: Iterable[Vec3]) -> float:
    """Returns the largest extent of points along an axis."""
    return max((max(v) - min(v) for v in zip(*points, strict=True)), default=0.0)


def check_bodies(robot: Robot, report: Report) -> None:
    """Judges the links and joints of the modules; those of extras are judged as they are read."""
    description = Description.of(robot.links, robot.joints, "robot", {})
    modules = [link.name for link in robot.links if not link.module.startswith(OF_EXTRA)]
    check_description(description, report, modules)
    if float_sum(link.inertial.mass for link in robot.links if link.inertial) <= 0.0:
        report.add("link-massless", "the robot has no mass", robot.span)


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
    return root in pose and _points_down(pose[root])


def _points_down(pose: Pose) -> bool:
    return pose.rotate((0.0, 0.0, 1.0))[2] < -0.5


def check_stability(robot: Robot, design: DesignRequirements, report: Report) -> None:
    """Checks the smallest tip-over angle of the robot, see ``model.statics.tip_over``."""
    support = support_of(robot)
    x, y, z = support.com
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
        out = pulls_out(robot)
        report.add(
            "unstable",
            f"the centre of mass (x {x:.3f} m, y {y:.3f} m) is {millimetres(-margin)} outside "
            "the area between the wheels: the robot falls over",
            out.span,
            hint=f"`{out.module}` pulls it out most: move it, or a wheel",
        )
        return
    if any(d.code.name == "robot-size" for d in report):
        return  # the height is wrong
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
    for force, cause, hint in (
        (motor_force, "the motors push", "stronger motors, more driven wheels or a lighter robot"),
        (grip, "the driven wheels grip", "drive more wheels or move weight onto the driven ones"),
    ):
        if force < needed:
            report.add(
                "slope-too-steep",
                f"{cause} with {force:.0f} N; "
                f"a slope of {math.degrees(design.slope):.1f} deg needs {needed:.0f} N",
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


# -- motions of the robot ----------------------------------------------------------------


def check_steering_range(robot: Robot, report: Report) -> None:
    """Checks that each steered wheel can point in every direction.

    A steering range of half a turn is enough, because a wheel can also roll backwards.  The
    steering range of a robot with fixed wheels is not checked, because the fixed wheels limit the
    directions of motion.
    """
    if mobility.feasible_twists(robot) < 3:
        return
    joints = {joint.name: joint for joint in robot.joints}
    for wheel in robot.wheels:
        joint = joints.get(wheel.steering_joint or "")
        if joint is None or joint.lower is None or joint.upper is None:
            continue
        if joint.upper - joint.lower < math.pi - 1e-6:
            report.add(
                "steering-range",
                f"`{wheel.module}` steers over {math.degrees(joint.upper - joint.lower):.1f} deg; "
                "180 deg are needed to reach every direction",
                wheel.span,
                hint="give the steering a wider range; without it, the robot makes the nearest "
                "reachable motion, or stands",
            )


def check_controllable(robot: Robot, report: Report) -> None:
    """Checks that the wheels fully determine the motion of the robot, with suitable steering
    angles.

    Each wheel that is not a caster adds a lateral row to a matrix.  Each driven wheel also adds a
    rolling row to the matrix.  The matrix of all lateral and rolling rows must have the rank 3.
    """
    if not any(wheel.driven for wheel in robot.wheels):
        return
    free = mobility.feasible_twists(robot)
    if free == 0:
        report.add(
            "no-free-motion",
            "the wheels that cannot turn block each other: every motion skids",
            robot.span,
            hint="steer some of them, or let them swivel",
        )
        return
    controlled = 0
    # The steering angles (rad) are arbitrary values.  Special steering angles, such as 0, can
    # reduce the rank of the matrix.
    for turn in (0.3, 1.1, 2.0):
        rows = []
        for k, wheel in enumerate(robot.wheels):
            if wheel.swivel_joint is not None:
                continue
            angle = wheel.heading + (turn * (k + 1) if wheel.steered else 0.0)
            rows.append(mobility.lateral_row(wheel, angle))
            if wheel.driven:
                rows.append(mobility.rolling_row(wheel, angle))
        controlled = max(controlled, mobility.rank(rows))
    if controlled < 3:
        casters = [wheel for wheel in robot.wheels if wheel.swivel_joint is not None]
        report.add(
            "twist-uncontrolled",
            f"the wheels control only {controlled} of the 3 components of the robot's motion "
            "(forward, sideways, turning)",
            robot.span,
            labels=[Label(wheel.span, "swivels freely") for wheel in casters[:2]],
            hint="replace a swivelling caster by a wheel with a fixed direction (`caster/fixed`), "
            "or drive another wheel",
        )
    elif free == 1 and mobility.cannot_turn(robot):
        report.add(
            "skid-steering",
            "the robot can turn only by skidding: its fixed wheels are not on one axle",
            robot.span,
            hint="odometry will be poor; steer some wheels or let them swivel",
        )


# -- what gravity and ground hold --------------------------------------------------------

_LEAN = math.radians(1.0)
_LARGEST_LEAN = math.radians(10.1)
"""A robot that leans further before limits stop it cannot be said to stand."""
_SHIFT = 0.01  # m
_MAX_LABELS = 4


def check_bodies_held(robot: Robot, report: Report) -> bool:
    """Reports joints that form a mechanism, and a robot that leans at rest.

    Returns whether the robot stands, so that its wheel loads exist.
    """
    if not support_of(robot).stands:
        return True  # `unstable` has been reported
    standing = standing_of(robot)
    if standing is None:
        return True
    falls = not standing.stands or standing.tilt > _LARGEST_LEAN
    if falls:
        _report_mechanism(robot, standing, report)
    else:
        _check_lean(robot, standing, report)
    return not falls


def _report_mechanism(robot: Robot, standing: Standing, report: Report) -> None:
    names = standing.mechanism or tuple(
        name
        for name, position in standing.positions.items()
        if abs(position) > 0.1 * max(map(abs, standing.positions.values()))
    )
    joints = [robot.joint(name) for name in names]
    listed = _listed([_reference(joint) for joint in joints])
    if standing.stands:
        degrees = math.degrees(standing.tilt)
        message = f"the robot leans by {degrees:.1f} deg before limits stop it: nothing else holds"
        message += f" {listed}"
    elif len(joints) > 1:
        message = f"nothing holds the robot upright: {listed} can move together, and gravity moves"
        message += " them"
    else:
        message = f"nothing holds {listed}: gravity moves it"
    are_sprung = any(joint.stiffness > 0.0 for joint in joints)
    report.add(
        "body-not-held",
        message,
        joints[0].span if joints else robot.span,
        labels=[Label(joint.span, "moves too") for joint in joints[1:_MAX_LABELS]],
        hint="use stiffer springs, or lower the masses"
        if are_sprung
        else "couple the joints (`couplings`, such as a differential between two rockers), give "
        "one a `spring`, stop it by near limits (`lower`, `upper`), or make it `fixed`",
    )


def _check_lean(robot: Robot, standing: Standing, report: Report) -> None:
    moved, positions, hint = [], [], "couple the joints, give them springs, or move the masses"
    for name, position in standing.positions.items():
        joint = robot.joint(name)
        is_shifted = joint.type == "prismatic"
        if abs(position) > (_SHIFT if is_shifted else _LEAN):
            moved.append((joint, position))
            size = millimetres(position) if is_shifted else f"{math.degrees(position):.1f} deg"
            positions.append(f"{_reference(joint)} at {size}")
            if joint.mimic is not None and joint.mimic.offset:
                hint = "leave out the `offset` of its coupling"
    if not moved and standing.tilt <= _LEAN:
        return
    lean = f"leans by {math.degrees(standing.tilt):.1f} deg, with"
    report.add(
        "leans-on-limits",
        f"at rest, the robot {lean if standing.tilt > _LEAN else 'has'} "
        f"{_listed(positions[:_MAX_LABELS])}; its other numbers hold with all joints at 0",
        moved[0][0].span if moved else robot.span,
        labels=[Label(joint.span, "moves too") for joint, _ in moved[1:_MAX_LABELS]],
        hint=f"{hint}, so that the robot rests with its joints at 0",
    )


def _reference(joint: Joint) -> str:
    """Returns the name of a joint as robot documents refer to it, such as `left.pivot`."""
    prefix = joint.module.replace(".", "_") + "_"
    return f"`{joint.module}.{joint.name.removeprefix(prefix)}`"


def _listed(texts: list[str]) -> str:
    return " and ".join(filter(None, (", ".join(texts[:-1]), *texts[-1:])))


# -- what a robot is for: to drive straight, with its own motors and battery -------------

FORWARDS = (1.0, 0.0, 0.0)


def check_purpose(robot: Robot, document: Node, report: Report) -> None:
    """Checks that a robot can do what it is for, and adds the diagnostics to the report."""
    check_straight_line(robot, report)
    check_motors_turn_wheels(robot, report)
    check_battery(robot, document, report)


def check_straight_line(robot: Robot, report: Report) -> None:
    """Checks that the wheels of a driven robot roll straight ahead.

    A robot whose wheels block each other is left out; it is an error already.
    """
    driven = any(wheel.driven for wheel in robot.wheels)
    if (
        not driven
        or mobility.feasible_twists(robot) == 0
        or mobility.roll_speeds(robot, FORWARDS) is not None
    ):
        return
    turned = [
        w
        for w in robot.wheels
        if mobility.roll_speeds(replace(robot, wheels=(w,)), FORWARDS) is None
    ]
    wheel = turned[0]
    # A wheel also rolls backwards, so its axis is at most 90 deg off.
    angle = math.remainder(wheel.heading, math.pi)
    direction = f"at {math.degrees(angle):.1f} deg to straight ahead"
    other = _straight_line(robot)
    report.add(
        "no-straight-line",
        f"`{wheel.module}` rolls {direction}: "
        + (
            "the robot cannot drive along any straight line"
            if other is None
            else f"the robot drives straight only at {math.degrees(other):.1f} deg to it"
        ),
        wheel.span,
        labels=[
            Label(w.span, "also turned" if w in turned else "rolls straight ahead")
            for w in robot.wheels
            if w is not wheel and w.swivel_joint is None and w.steering_joint is None
        ][:2],
        hint="turn its mount so that it rolls along x, or steer it over a wider range",
    )


def _straight_line(robot: Robot) -> float | None:
    """Returns the direction (rad) of a straight line that all wheels allow, or ``None``.

    A fixed wheel allows one direction, and a steered one an interval of directions.  If the
    intersection of these sets is not empty, it contains the direction of a fixed wheel or the end
    of an interval.
    """
    joints = {joint.name: joint for joint in robot.joints}
    for wheel in robot.wheels:
        joint = joints.get(wheel.steering_joint or "")
        turns = (joint.lower or 0.0, joint.upper or 0.0) if joint is not None else (0.0,)
        for turn in turns:
            angle = math.remainder(wheel.heading + wheel.steering_sign * turn, math.pi)
            if mobility.roll_speeds(robot, (math.cos(angle), math.sin(angle), 0.0)) is not None:
                return angle
    return None


def check_motors_turn_wheels(robot: Robot, report: Report) -> None:
    """Checks that motors on joints for driving and steering wheels drive and steer a wheel.

    Motors on other joints, such as those of a tool, need no wheel.
    """
    of_wheels = {name for w in robot.wheels for name in (w.spin_joint, w.steering_joint)}
    verbs = {"propulsion": "drives", "steering": "steers"}
    for motor in robot.actuators:
        verb = verbs.get(robot.joint(motor.joint).role)
        if verb is not None and motor.joint not in of_wheels:
            report.add(
                "motor-without-wheel",
                f"the motor `{motor.name}` {verb} no wheel",
                motor.span,
                hint="mount a wheel on its module, or leave the module out",
            )


def check_battery(robot: Robot, document: Node, report: Report) -> None:
    """Checks that a robot whose drive motors have controllers has a battery.

    A robot without controllers has no electronics at all, which `robot-without-controller` reports.
    """
    driven = any(m.node is not None for _, m in driven_wheels(robot.wheels, robot.actuators))
    if not driven or any(battery.node is not None for battery in robot.batteries):
        return
    modules = document.get("modules")
    empty = robot.batteries[0].span if robot.batteries else None
    report.add(
        "battery-missing",
        "the robot has drive motors and no battery: its weight, wheel loads and energy leave it out"
        if empty is None
        else "the robot has drive motors, and no battery is in its enclosure",
        empty or (modules.where if modules is not None else robot.span),
        hint="mount a `battery/enclosure`, or a module of your own with a section `battery`; "
        "accept the warning for a robot on a cable",
    )
