"""What a robot is asked to do over time, and a default that suits its kinematics."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from thorvaldc.model import Robot
from thorvaldc.runtime.calculators import for_robot
from thorvaldc.runtime.faults import RuntimeFault
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist


class Segment(NamedTuple):
    """From ``start`` (s) on, ``twist``, until the next segment."""

    start: float
    twist: Twist


Manoeuvre = Sequence[Segment]


def twist_at(manoeuvre: Manoeuvre, time: float) -> Twist:
    """The twist asked for at ``time``; zero before the first segment."""
    found = ZERO_TWIST
    for start, twist in manoeuvre:
        if start > time + 1e-9:
            break
        found = twist
    return found


def parse_twist(text: str) -> Twist:
    """``vx,vy,wz`` in m/s, m/s and rad/s.  Raises ``RuntimeFault`` (``twist-invalid``)."""
    parts = text.split(",")
    try:
        numbers = [float(part) for part in parts]
    except ValueError:
        numbers = []
    if len(numbers) == 3 and Twist(*numbers).finite:
        return Twist(*numbers)
    raise RuntimeFault(
        "twist-invalid",
        f"{text!r} is not a twist of three finite numbers",
        hint="give forward m/s, leftward m/s and turning rad/s, such as 1,0,0.3",
    )


def default_manoeuvre(robot: Robot) -> tuple[list[Segment], float]:
    """Forward, an arc, sideways and a turn on the spot, as far as the robot can; its duration.

    A part is left out where the wheels' arrangement or a steering limit does
    not allow it.  Ends with a stop of 2 s.
    """
    settings = robot.driver
    v = min(1.0, 0.8 * settings.max_linear_velocity)
    w = min(0.5, 0.8 * settings.max_angular_velocity)
    wanted = (
        (4.0, Twist(v, 0.0, 0.0)),
        (4.0, Twist(v, 0.0, w)),
        (3.0, Twist(0.0, 0.7 * v, 0.0)),
        (3.0, Twist(0.0, 0.0, -w)),
    )
    segments: list[Segment] = []
    time = 0.0
    for duration, twist in wanted:
        calculator = for_robot(robot)
        allowed = calculator.allowed(twist)
        # What the wheels add across (an axle behind base_link swings it) is no hindrance.
        kept = abs(allowed.wz - twist.wz) < 1e-6 and (
            abs(allowed.vx - twist.vx) < 1e-6 or twist.vx == 0.0
        )
        if twist.vy:
            kept = kept and abs(allowed.vy - twist.vy) < 1e-6
        if not kept or calculator.command(twist).unreachable:
            continue
        segments.append(Segment(time, twist))
        time += duration
    segments.append(Segment(time, ZERO_TWIST))
    return segments, time + 2.0
