"""Random robots follow random twists: who stands, twitches, scrubs, or reports a wrong twist.

Each robot has ideal joints and its real base driver.  The driver gets a sequence of twists, with
reversals, pure sideways motions and turns on the spot.  At the end of each twist, the robot must
make the reachable part of the twist.  A robot whose wheels cross the centre of rotation, or turn
the long way round past a steering limit, needs up to 5.3 s.

Once the wheels are settled, the commanded twist must be what the joints make, to 1e-9.  On the way,
the wheels slip sideways, and no twist fits all wheels: ``BaseCommand.twist`` then has the rolling
speeds of the driven wheels, exactly or, at acceleration limits, as a best fit.  The study therefore
judges the twist only at the end.  On the way, the robot must not be faster than commanded.

``python -m bench.following [ROBOTS]`` drives this number of robots of each family, by default 60,
and prints a line for each family and for each twist that a robot did not follow.
"""

from __future__ import annotations

import math
import random
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from bench.figure import Figure
from bench.random_robots import FAMILIES, random_robot

GROUP = "long"

if TYPE_CHECKING:
    from thorvaldc.model import Robot
    from thorvaldc.runtime.calculators import BaseCommand, BaseGeometry
    from thorvaldc.runtime.driver import BaseDriver
    from thorvaldc.runtime.se2 import Twist

ROBOTS = 60
"""Robots of each family in the study."""
SAMPLE = 4
"""Robots of each family in the bench."""
TWISTS = 6
"""Twists of each robot."""
HOLD = 7.0
"""Time (s) for which a twist is commanded."""
EXCESS = 0.1
"""Speed (m/s) above the commanded one from which on a twist is noted.

While wheels turn and are at their acceleration limits, their speeds contradict each other a little.
"""
CALM = 1.0
"""The robot must move steadily in the last ``CALM`` s of each twist."""


@dataclass
class Conduct:
    """Counts of twists that robots did not follow, and errors of their commanded twists.

    - ``twists``: number of commanded twists.
    - ``standing``: twists with a reachable part, at the end of which the robot stands.
    - ``off``: twists whose reachable part the robot does not make at the end, including
      ``standing``.
    - ``twitching``: twists at the end of which steering joints still move.
    - ``backwards``: twists during which the robot moves against their reachable part for more than
      2 s, after the first 2 s.
    - ``limited``: twists that are not reachable as a whole.
    - ``misreported``: twists that the driver reported as not followed before the robot made them.
    - ``excess``: largest speed (m/s) on the way to a twist above the faster of this twist and the
      last one.
    - ``scrub``: largest speed (m/s) of a contact point across its wheel at the end of a twist.
    - ``wrong_twist``: largest difference (m/s, rad/s) between the commanded twist and the twist of
      the commanded joints at the end of a twist.
    - ``notes``: a line for each twist that a robot did not follow.
    """

    twists: int = 0
    standing: int = 0
    off: int = 0
    twitching: int = 0
    backwards: int = 0
    limited: int = 0
    misreported: int = 0
    excess: float = 0.0
    scrub: float = 0.0
    wrong_twist: float = 0.0
    notes: list[str] = field(default_factory=list)

    def add(self, other: Conduct) -> None:
        """Adds the counts of ``other``, and keeps the larger errors."""
        self.twists += other.twists
        self.standing += other.standing
        self.off += other.off
        self.twitching += other.twitching
        self.backwards += other.backwards
        self.limited += other.limited
        self.misreported += other.misreported
        self.excess = max(self.excess, other.excess)
        self.scrub = max(self.scrub, other.scrub)
        self.wrong_twist = max(self.wrong_twist, other.wrong_twist)
        self.notes += other.notes


def random_twists(rng: random.Random) -> list[Twist]:
    """Returns a sequence of twists with reversals, pure sideways motions and turns on the spot."""
    from thorvaldc.runtime.se2 import Twist

    sequence: list[Twist] = []
    for _ in range(TWISTS):
        kind = rng.choice(["any", "any", "arc", "arc", "sideways", "spin", "reversal"])
        v, w = rng.choice([-1, 1]) * rng.uniform(0.1, 0.9), rng.uniform(-0.8, 0.8)
        if kind == "reversal" and sequence:
            twist = sequence[-1].scaled(-1.0)
        elif kind == "sideways":
            twist = Twist(0.0, v, 0.0)
        elif kind == "spin":
            twist = Twist(0.0, 0.0, w)
        elif kind == "arc":
            twist = Twist(v, 0.0, w)
        else:
            twist = Twist(v, rng.uniform(-0.8, 0.8), w)
        sequence.append(twist)
    return sequence


def follow(robot: Robot, sequence: Sequence[Twist], label: str = "") -> Conduct:
    """Drives ``robot`` with a sequence of twists, each for ``HOLD`` s, and returns its conduct."""
    from thorvaldc.runtime.driver import BaseDriver
    from thorvaldc.simulation.physics.sim_base import SimBase

    driver = BaseDriver(robot, SimBase(robot))
    dt = 1.0 / driver.settings.rate
    driver.tick(0.0)
    total, now, last_speed = Conduct(), 0.0, 0.0
    for number, twist in enumerate(sequence):
        against, travel, fastest, speed = 0.0, 0.0, 0.0, 0.0
        report = ""
        ticks = round(HOLD / dt)
        for k in range(ticks):
            now += dt
            driver.command(twist, now)
            state = driver.tick(now)
            command, joints = state.command, state.joints
            report = report or state.not_followed
            assert command is not None
            assert joints is not None
            reachable = driver.calculator.feasible(twist)
            geometry = driver.calculator.geometry
            speed = _size(reachable, geometry)
            fastest = max(fastest, _size(command.twist, geometry))
            if k * dt > 2.0 and _product(state.odometry.twist, reachable, geometry) < -1e-3:
                against += dt
            if (ticks - k) * dt <= CALM:
                steps = zip(joints.angles, command.joints.angles, strict=True)
                travel += sum(abs(b - a) for a, b in steps)
        result = _judge(driver, twist, command, against, travel)
        result.excess = max(fastest - max(speed, last_speed), 0.0)
        if result.excess > EXCESS:
            result.notes.append(f"the robot is {result.excess:.3f} m/s too fast")
        if report and not state.not_followed:
            result.misreported = 1
            result.notes.append(f"the driver reported: {report}")
        last_speed = speed
        result.notes = [f"{label}, twist {number} {tuple(twist)}: {note}" for note in result.notes]
        total.add(result)
    return total


def _judge(
    driver: BaseDriver, twist: Twist, command: BaseCommand, against: float, travel: float
) -> Conduct:
    """Judges the motion at the end of a commanded twist.

    - ``against``: time (s) for which the robot moved against the twist.
    - ``travel``: sum (rad) of the last motions of the steering joints.
    """
    geometry = driver.calculator.geometry
    feasible = driver.calculator.feasible(twist)
    goal = _within_speeds(driver, feasible, command)
    gap = _size(_difference(command.twist, goal), geometry)
    scrub, wrong_twist = _errors(driver, command)
    result = Conduct(1, scrub=scrub, wrong_twist=wrong_twist)
    result.limited = int(_size(_difference(feasible, twist), geometry) > 1e-9)
    if _size(goal, geometry) > 0.02 and _size(command.twist, geometry) < 0.002:
        result.standing = 1
        result.notes.append("the robot stands")
    if gap > 1e-6:
        result.off = 1
        result.notes.append(f"the robot is off by {gap:.3f} m/s")
    if travel > 1e-3:
        result.twitching = 1
        result.notes.append(f"steering joints move by {travel:.3f} rad")
    if against > 2.0:
        result.backwards = 1
        result.notes.append(f"the robot moves against the command for {against:.1f} s")
    if max(scrub, wrong_twist) > 1e-9:
        result.notes.append(f"scrub {scrub:.2g} m/s, twist wrong by {wrong_twist:.2g}")
    return result


def _difference(a: Twist, b: Twist) -> Twist:
    from thorvaldc.runtime.se2 import Twist

    return Twist(a.vx - b.vx, a.vy - b.vy, a.wz - b.wz)


def _product(a: Twist, b: Twist, geometry: BaseGeometry) -> float:
    return a.vx * b.vx + a.vy * b.vy + geometry.length**2 * a.wz * b.wz


def _size(twist: Twist, geometry: BaseGeometry) -> float:
    return math.sqrt(_product(twist, twist, geometry))


def _within_speeds(driver: BaseDriver, twist: Twist, command: BaseCommand) -> Twist:
    """Returns the twist at the robot's speed limits, and at the limits of its drive motors."""
    settings, geometry = driver.settings, driver.calculator.geometry
    goal = twist.scaled(
        min(
            1.0,
            settings.max_linear_velocity / max(twist.speed, 1e-12),
            settings.max_angular_velocity / max(abs(twist.wz), 1e-12),
        )
    )
    speeds = zip(geometry.wheels, command.joints.speeds, strict=True)
    if not any(w.driven and abs(v) > w.max_speed * (1.0 - 1e-9) for w, v in speeds):
        return goal
    share = _product(goal, command.twist, geometry) / _product(goal, goal, geometry)
    return goal.scaled(min(max(share, 0.0), 1.0))


def _errors(driver: BaseDriver, command: BaseCommand) -> tuple[float, float]:
    """Returns the scrub (m/s) and the error of the commanded twist (m/s, rad/s).

    Wheels whose steering axis moves by less than 2 mm/s keep their angles, and scrub by as much.
    """
    from thorvaldc.runtime.base_interface import JointStates
    from thorvaldc.runtime.calculators.steering_branch import RESUME_ABOVE

    wheels = driver.calculator.geometry.wheels
    twist, joints = command.twist, command.joints
    scrub = 0.0
    for w, angle in zip(wheels, joints.angles, strict=True):
        if math.hypot(twist.vx - twist.wz * w.y, twist.vy + twist.wz * w.x) < RESUME_ABOVE:
            return 0.0, 0.0
        if not w.swivel:
            _, across = w.rows(angle)
            scrub = max(scrub, abs(sum(a * b for a, b in zip(across, twist, strict=True))))
    states = JointStates(0.0, joints.speeds, joints.angles, [0.0] * len(wheels))
    if driver.calculator.odometry(states).rank < 3:
        return scrub, 0.0
    estimate = driver.calculator.estimator.least_squares(states)
    return scrub, max(abs(a - b) for a, b in zip(estimate, twist, strict=True))


def case(family: str, number: int) -> tuple[Robot, list[Twist]]:
    """Returns a random robot of a family, by its number, and its sequence of twists."""
    rng = random.Random(100_000 + list(FAMILIES).index(family) * 1000 + number)
    return random_robot(FAMILIES[family], rng), random_twists(rng)


def study(robots: int, family: str) -> Conduct:
    """Returns the conduct of the first ``robots`` random robots of a family."""
    total = Conduct()
    for number in range(robots):
        robot, sequence = case(family, number)
        total.add(follow(robot, sequence, f"robot {number}"))
    return total


def figures() -> Iterator[Figure]:
    total = Conduct()
    for family in FAMILIES:
        total.add(study(SAMPLE, family))
    how = (
        f"{SAMPLE * len(FAMILIES)} random robots of {len(FAMILIES)} families, {total.twists} "
        f"twists of {HOLD:g} s, {total.limited} of them not reachable as a whole"
    )
    wrong = total.off + total.twitching + total.backwards + total.misreported
    yield Figure("twists not followed", wrong, "", 0, "lower", how)
    worst = max(total.scrub, total.wrong_twist)
    yield Figure("twist of the commanded joints", worst, "m/s", 1e-9, "lower", "largest error")


def main(robots: int) -> None:
    """Prints the conduct of all families."""
    total = Conduct()
    for family in FAMILIES:
        result = study(robots, family)
        total.add(result)
        print(row(family, result), *result.notes, sep="\n  ", flush=True)
    print(row("all", total))


def row(name: str, result: Conduct) -> str:
    """Returns a line with the counts and errors of ``result``."""
    return (
        f"{name:<30} {result.twists} twists, {result.limited} limited, {result.standing} standing, "
        f"{result.off} off, {result.twitching} twitching, {result.backwards} backwards, "
        f"{result.misreported} misreported, "
        f"{result.excess:.2g} m/s too fast, scrub {result.scrub:.2g}, twist "
        f"{result.wrong_twist:.2g}"
    )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else ROBOTS)
