"""Defines manoeuvres (commanded twists over time) and creates default manoeuvres for robots."""

from __future__ import annotations

import bisect
import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from thorvaldc.model import DriverSettings, Robot
from thorvaldc.runtime import se2
from thorvaldc.runtime.calculators import for_robot
from thorvaldc.runtime.se2 import ZERO_TWIST, Pose2, Twist


class Segment(NamedTuple):
    """A commanded twist that holds from the time ``start`` (s) to the next segment's start."""

    start: float
    twist: Twist


Manoeuvre = Sequence[Segment]
"""Segments in the order of their start times."""
_LARGEST = (math.inf, math.inf, math.inf)


def twist_at(manoeuvre: Manoeuvre, time: float) -> Twist:
    """Returns the commanded twist of a manoeuvre at ``time`` (s).

    The commanded twist is zero before the first segment of the manoeuvre.
    """
    following = bisect.bisect_right(manoeuvre, (time + 1e-9, _LARGEST))
    return manoeuvre[following - 1].twist if following else ZERO_TWIST


PARTS = (
    (4.0, "forward"),
    (4.0, "arc"),
    (3.0, "sideways"),
    (3.0, "turn"),
)
"""The default manoeuvre: durations (s) and names of its parts."""
STOP = 2.0
"""Duration (s) of the standstill at the end of the default manoeuvre."""
_TIME_STEP = 0.1
"""Time step (s) of the predicted paths of a fleet."""


def default_manoeuvre(robot: Robot) -> tuple[list[Segment], float]:
    """Returns the default manoeuvre of a robot and the duration of the manoeuvre (s).

    The default manoeuvre has four parts: straight ahead, an arc, sideways, and a turn on the spot.
    The arc is as tight as the steering limits allow.  A part of the default manoeuvre is omitted if
    the arrangement of the wheels or a steering limit does not allow the motion.  At the end the
    robot stands still for ``STOP`` s.
    """
    segments: list[Segment] = []
    time = 0.0
    for duration, name in PARTS:
        twist = _possible_part(robot, _part_twist(name, robot.driver))
        if twist != ZERO_TWIST:
            segments.append(Segment(time, twist))
            time += duration
    segments.append(Segment(time, ZERO_TWIST))
    return segments, time + STOP


def fleet_manoeuvres(
    robots: Sequence[tuple[str, Robot, Pose2]],
) -> tuple[dict[str, list[Segment]], float]:
    """Returns a manoeuvre for each robot of a fleet, and the duration of the manoeuvres (s).

    ``robots`` has a tuple for each robot: name, robot, and start pose in the world.  All robots
    drive the same parts of the default manoeuvre at the same times.  A robot that cannot drive a
    part of the manoeuvre stands still during the part.  The function tries the whole default
    manoeuvre first, and then simpler and shorter manoeuvres.  The function returns the first
    manoeuvres in which the robots do not collide (``_keep_apart``).
    """
    if not robots:
        return {}, STOP
    settings = min((robot.driver for _, robot, _ in robots), key=lambda s: s.max_linear_velocity)
    manoeuvres: dict[str, list[Segment]] = {}
    duration = STOP
    for parts, speed_factor in (
        (("forward", "arc", "sideways", "turn"), 1.0),
        (("forward", "arc", "turn"), 1.0),
        (("forward", "turn"), 1.0),
        (("forward", "turn"), 0.4),
        (("turn",), 1.0),
    ):
        manoeuvres = {name: [] for name, _, _ in robots}
        time = 0.0
        for part_duration, part in PARTS:
            if part not in parts:
                continue
            twist = _part_twist(part, settings)
            if part != "turn":
                twist = twist.scaled(speed_factor)
            for name, robot, _ in robots:
                manoeuvres[name].append(Segment(time, _possible_part(robot, twist)))
            time += part_duration
        for manoeuvre in manoeuvres.values():
            manoeuvre.append(Segment(time, ZERO_TWIST))
        duration = time + STOP
        if _keep_apart(robots, manoeuvres, duration):
            break
    return manoeuvres, duration


def _part_twist(name: str, settings: DriverSettings) -> Twist:
    v = min(1.0, 0.8 * settings.max_linear_velocity)
    w = min(0.5, 0.8 * settings.max_angular_velocity)
    return {
        "forward": Twist(v, 0.0, 0.0),
        "arc": Twist(v, 0.0, w),
        "sideways": Twist(0.0, 0.7 * v, 0.0),
        "turn": Twist(0.0, 0.0, -w),
    }[name]


def _possible_part(robot: Robot, twist: Twist) -> Twist:
    """Returns ``twist`` with a yaw rate that the steering limits allow, or zero.

    The result is zero if the wheels do not allow a nonzero component of the velocity, or no turn.
    The feasible twist may contain components that are zero in ``twist``.  For example, a robot
    whose axle lies behind ``base_link`` moves ``base_link`` sideways in a turn.
    """
    allowed = for_robot(robot).feasible(twist)
    if twist.vx and abs(allowed.vx - twist.vx) > 1e-6:
        return ZERO_TWIST
    if twist.vy and abs(allowed.vy - twist.vy) > 1e-6:
        return ZERO_TWIST
    if twist.wz and abs(allowed.wz) < 1e-6:
        return ZERO_TWIST
    return Twist(twist.vx, twist.vy, allowed.wz)


def _keep_apart(
    robots: Sequence[tuple[str, Robot, Pose2]],
    manoeuvres: Mapping[str, Manoeuvre],
    duration: float,
) -> bool:
    """Returns true if all robots keep a safe distance from each other on the predicted paths.

    Each robot is approximated by a disc around the wheels of the robot.  The discs of two robots
    must not touch.  If two discs touch at the start already, the distance between the two robots
    must not decrease by more than 5 cm.
    """
    paths: list[list[Pose2]] = []
    radii: list[float] = []
    for name, robot, start in robots:
        pose, path = start, [start]
        for k in range(round(duration / _TIME_STEP)):
            twist = twist_at(manoeuvres[name], k * _TIME_STEP)
            pose = pose.moved(se2.exp(twist, _TIME_STEP))
            path.append(pose)
        paths.append(path)
        radii.append(max((math.hypot(w.x, w.y) + w.width for w in robot.wheels), default=0.5))
    for i in range(len(robots)):
        for j in range(i):
            distances = [math.dist(a[:2], b[:2]) for a, b in zip(paths[i], paths[j], strict=True)]
            if min(distances) < min(radii[i] + radii[j], distances[0] - 0.05):
                return False
    return True
