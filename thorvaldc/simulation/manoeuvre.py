"""What a robot is asked to do over time, and a default that suits its kinematics."""

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
    """From ``start`` (s) on, ``twist``, until the next segment."""

    start: float
    twist: Twist


Manoeuvre = Sequence[Segment]
"""In the order of their starts."""
_LAST = (math.inf, math.inf, math.inf)


def twist_at(manoeuvre: Manoeuvre, time: float) -> Twist:
    """The twist asked for at ``time``; zero before the first segment."""
    after = bisect.bisect_right(manoeuvre, (time + 1e-9, _LAST))
    return manoeuvre[after - 1].twist if after else ZERO_TWIST


PARTS = (
    (4.0, "forward"),
    (4.0, "arc"),
    (3.0, "sideways"),
    (3.0, "turn"),
)
"""The default manoeuvre: durations (s) and names of its parts."""
STOP = 2.0
"""Time (s) that it ends with, standing."""


def default_manoeuvre(robot: Robot) -> tuple[list[Segment], float]:
    """Forward, an arc, sideways and a turn on the spot, as far as the robot can; its duration.

    A part is left out where the wheels' arrangement or a steering limit does
    not allow it.  Ends with a stop of ``STOP`` s.
    """
    segments: list[Segment] = []
    time = 0.0
    for duration, name in PARTS:
        twist = _part(name, robot.driver)
        if _possible(robot, twist):
            segments.append(Segment(time, twist))
            time += duration
    segments.append(Segment(time, ZERO_TWIST))
    return segments, time + STOP


def fleet_manoeuvres(
    robots: Sequence[tuple[str, Robot, Pose2]],
) -> tuple[dict[str, list[Segment]], float]:
    """A manoeuvre for each robot of a scene that keeps them apart; their duration.

    Each is given by name, robot and its pose in the world.  Of the default
    manoeuvre in one time for all (who cannot do a part stands), then of it
    without the parts sideways and arc, then at shorter ways, takes the first in
    which no two come nearer than they can reach, or than they stood.
    """
    if not robots:
        return {}, STOP
    settings = min((robot.driver for _, robot, _ in robots), key=lambda s: s.max_linear_velocity)
    plans: dict[str, list[Segment]] = {}
    duration = STOP
    for names, factor in (
        (("forward", "arc", "sideways", "turn"), 1.0),
        (("forward", "arc", "turn"), 1.0),
        (("forward", "turn"), 1.0),
        (("forward", "turn"), 0.4),
        (("turn",), 1.0),
    ):
        plans = {name: [] for name, _, _ in robots}
        time = 0.0
        for length, part in PARTS:
            if part not in names:
                continue
            twist = _part(part, settings)
            if part != "turn":
                twist = twist.scaled(factor)
            for name, robot, _ in robots:
                plans[name].append(Segment(time, twist if _possible(robot, twist) else ZERO_TWIST))
            time += length
        for plan in plans.values():
            plan.append(Segment(time, ZERO_TWIST))
        duration = time + STOP
        if _apart(robots, plans, duration):
            break
    return plans, duration


def _part(name: str, settings: DriverSettings) -> Twist:
    v = min(1.0, 0.8 * settings.max_linear_velocity)
    w = min(0.5, 0.8 * settings.max_angular_velocity)
    return {
        "forward": Twist(v, 0.0, 0.0),
        "arc": Twist(v, 0.0, w),
        "sideways": Twist(0.0, 0.7 * v, 0.0),
        "turn": Twist(0.0, 0.0, -w),
    }[name]


def _possible(robot: Robot, twist: Twist) -> bool:
    calculator = for_robot(robot)
    allowed = calculator.feasible(twist)
    if abs(allowed.wz - twist.wz) > 1e-6:
        return False
    # What the wheels add across (an axle behind base_link swings it) is no hindrance.
    if twist.vx and abs(allowed.vx - twist.vx) > 1e-6:
        return False
    if twist.vy and abs(allowed.vy - twist.vy) > 1e-6:
        return False
    return not calculator.command(twist).unreachable


def _apart(
    robots: Sequence[tuple[str, Robot, Pose2]],
    plans: Mapping[str, Manoeuvre],
    duration: float,
) -> bool:
    """Whether the robots, as discs about their wheels, keep apart on these ways."""
    step = 0.1
    ways: list[list[Pose2]] = []
    reach: list[float] = []
    for name, robot, start in robots:
        pose, way = start, [start]
        for k in range(round(duration / step)):
            allowed = twist_at(plans[name], k * step)
            pose = pose.moved(se2.exp(allowed, step))
            way.append(pose)
        ways.append(way)
        reach.append(max((math.hypot(w.x, w.y) + w.width for w in robot.wheels), default=0.5))
    for i in range(len(robots)):
        for j in range(i):
            gaps = [math.dist(a[:2], b[:2]) for a, b in zip(ways[i], ways[j], strict=True)]
            if min(gaps) < min(reach[i] + reach[j], gaps[0] - 0.05):
                return False
    return True
