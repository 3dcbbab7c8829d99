"""A stop is a stop: commanded wheel speeds only fall, whatever is measured, however late it is.

The wheels are those of a simulated robot, and are read as they are, not as they are reported.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from dataclasses import replace
from itertools import combinations, pairwise

import pytest

from tests.model.stops import stop_bound
from tests.robots import make_robot
from thorvaldc.model import Robot
from thorvaldc.model.stopping import STOP_LOCK
from thorvaldc.runtime.base_interface import BaseHandle, JointCommands, JointStates
from thorvaldc.runtime.driver import BaseDriver
from thorvaldc.runtime.permission import Rules
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist
from thorvaldc.simulation.physics.sim_base import SimBase

SQUARE = [(x, y) for x in (0.5, -0.5) for y in (0.4, -0.4)]
ROBOTS = {
    "general": make_robot([(x, y, "steered") for x, y in SQUARE]),
    "skid": make_robot([(x, y, "fixed") for x, y in SQUARE]),
    "differential": make_robot(
        [(0.0, 0.4, "fixed"), (0.0, -0.4, "fixed"), (0.6, 0.0, "swivel")],
        calculator="differential",
    ),
    "one_wheel": make_robot(
        [(0.6, 0.0, "steered"), (-0.5, 0.45, "passive"), (-0.5, -0.45, "passive")],
        calculator="one_wheel",
    ),
}
DT = 0.02
FAST = Twist(1.0, 0.0, 0.3)
WATCHDOG = 0.1
"""Time (s) without commands after which the drives of ``Plant`` brake by themselves."""
Lie = Callable[[JointStates], JointStates]


class Plant(BaseHandle):
    """Wheels that can report what is not true, and whose drives can brake by themselves.

    - ``lie``: what the base reports for the true joint states;
    - ``watches``: the drives brake hard after ``WATCHDOG``;
    - ``ages``: the reports of the drives are too old in the first cycle after a gap;
    - ``held``: the base does not follow commands.
    """

    def __init__(self, robot: Robot) -> None:
        self.inner = SimBase(robot)
        self.radius = robot.wheels[0].radius
        self.lie: Lie = lambda states: states
        self.watches = False
        self.ages = False
        self.held = ""
        self.speeds: list[list[float]] = []
        """Commanded wheel speeds (rad/s) of each cycle."""
        self.angles: list[list[float]] = []
        self._written = 0.0

    @property
    def hold_reason(self) -> str:
        return self.held

    def read(self, now: float) -> JointStates:
        if self.watches and now - self._written > WATCHDOG:
            self.inner.read(self._written + WATCHDOG)
            self.inner._speeds = [0.4 * speed for speed in self.inner._speeds]
        states = self.inner.read(now)
        if self.ages and now - self._written > 2.5 * DT + 1e-9:
            return replace(states, speeds=[math.nan] * len(states.speeds))
        return self.lie(states)

    def write(self, commands: JointCommands, now: float) -> None:
        self.speeds.append(list(commands.speeds))
        self.angles.append(list(commands.angles))
        self._written = now
        if not self.held:
            self.inner.write(commands, now)

    def turned(self, now: float) -> float:
        """Mean path (m) of the wheels that are commanded to turn."""
        positions = self.inner.read(now).positions
        assert positions is not None
        driven = [i for i, v in enumerate(self.speeds[-1]) if self.inner._wheels[i].driven]
        return sum(abs(positions[i]) for i in driven) * self.radius / len(driven)

    @property
    def fastest(self) -> float:
        return max(map(abs, self.inner._speeds)) * self.radius


class Drive:
    """A robot that drives for 2 s, and then stops."""

    def __init__(self, robot: Robot) -> None:
        self.base = Plant(robot)
        self.driver = BaseDriver(robot, self.base)
        self.cycle = 0
        self.now = 0.0
        for _ in range(100):
            self.step(FAST)

    def step(self, twist: Twist | None = None, late: float = 0.0) -> None:
        """Runs the next control cycle, ``late`` s later than it is due."""
        self.now += DT + late
        if twist is not None:
            self.driver.command(twist, self.now)
        self.driver.tick(self.now)

    def stop(self, how: str, late: Callable[[int], float] = lambda cycle: 0.0) -> tuple[float, ...]:
        """Stops; returns the time (s) and the path (m) until no wheel turns."""
        begin, path = self.now, self.base.turned(self.now)
        first = len(self.base.speeds) - 1
        twist: Twist | None = FAST
        if how == "disarmed":
            self.driver.permission.step(Rules.disarm)
        elif how == "zero":
            twist = ZERO_TWIST
        elif how == "held":
            self.base.held = "homing"
        elif how == "unknown":
            self.base.lie = lambda states: replace(states, speeds=[math.nan, *states.speeds[1:]])
        elif how == "silent":
            twist = None
            for _ in range(26):  # the command times out
                self.step()
            first = len(self.base.speeds) - 2
        for cycle in range(150):
            self.step(twist, late(cycle))
            if self.base.fastest == 0.0 and not any(self.base.speeds[-1]):
                break
        self.only_falls(first)
        return self.now - begin, self.base.turned(self.now) - path

    def only_falls(self, first: int) -> None:
        for last, speeds in pairwise(self.base.speeds[first:]):
            for before, speed in zip(last, speeds, strict=True):
                assert abs(speed) <= abs(before)
                assert speed * before >= 0.0


def frozen(share: float, drive: Drive) -> Lie:
    states = drive.base.inner.read(drive.now)
    speeds = [share * v for v in states.speeds]
    return lambda now: replace(states, time=now.time, speeds=speeds)


LIES: dict[str, Callable[[Drive], Lie]] = {
    "true": lambda drive: lambda states: states,
    "frozen": lambda drive: frozen(1.0, drive),
    "frozen high": lambda drive: frozen(1.5, drive),
    "frozen low": lambda drive: frozen(0.3, drive),
    "backwards": lambda drive: frozen(-1.0, drive),
}


@pytest.mark.parametrize("lie", LIES)
@pytest.mark.parametrize("name", ROBOTS)
def test_no_measurement_raises_or_sustains_a_command(name: str, lie: str) -> None:
    """Frozen joint states once let the robot drive on for ever, one step below the frozen speed."""
    robot = ROBOTS[name]
    bound = stop_bound(robot, STOP_LOCK)
    for how in ("disarmed", "zero", "silent", "unknown"):
        for gap in (0.0, 0.2):
            drive = Drive(robot)
            drive.base.watches = gap > 0.0
            drive.base.lie = LIES[lie](drive)
            waits = robot.driver.command_timeout + DT if how == "silent" else 0.0
            time, path = drive.stop(how, lambda cycle, gap=gap: gap if cycle == 3 else 0.0)
            assert time <= bound.time + waits + gap, (how, gap)
            assert path <= bound.distance + FAST.vx * (waits + gap), (how, gap)


def test_a_base_that_holds_its_joints_goes_on_from_rest() -> None:
    """No command was followed meanwhile, so that none of them is where the joints are."""
    drive = Drive(ROBOTS["general"])
    drive.base.held = "homing"
    drive.base.inner.write(JointCommands([0.0] * 4, [0.3] * 4), drive.now)
    for _ in range(50):
        drive.step(FAST)
    drive.base.held = ""
    drive.driver.permission.step(Rules.disarm)
    drive.step(FAST)
    assert not any(drive.base.speeds[-1])
    assert drive.base.angles[-1] == pytest.approx([0.3] * 4)


def test_wheels_that_braked_by_themselves_do_not_accelerate() -> None:
    drive = Drive(ROBOTS["general"])
    drive.base.watches = True
    drive.driver.permission.step(Rules.disarm)
    drive.step(late=0.2)
    slow = drive.base.fastest
    assert max(map(abs, drive.base.speeds[-1])) * drive.base.radius <= slow + 1e-9
    for _ in range(60):
        drive.step()
        assert drive.base.fastest <= slow + 1e-9
        slow = drive.base.fastest
    assert slow == 0.0


@pytest.mark.parametrize(
    ("length", "grid"),
    [
        (0.22, 4),
        pytest.param(0.22, 1, marks=pytest.mark.slow),
        pytest.param(0.06, 1, marks=pytest.mark.slow),
    ],
)
def test_a_stop_keeps_its_bound_with_two_gaps_anywhere_in_it(length: float, grid: int) -> None:
    """Two objects once remembered where the stop was; a second gap let them disagree."""
    robot = ROBOTS["differential"]
    bound = stop_bound(robot, STOP_LOCK)
    cycles = math.ceil(bound.time / DT)
    driving = Drive(robot)
    driving.base.ages = True
    shared = {id(part): part for part in (robot, driving.driver.calculator.geometry)}
    for gaps in combinations(range(0, cycles, grid), 2):
        drive = copy.deepcopy(driving, {**shared})
        time, path = drive.stop("disarmed", lambda cycle, gaps=gaps: length * (cycle in gaps))
        assert time <= bound.time + 2.0 * length, gaps
        assert path <= bound.distance + 2.0 * length * FAST.vx, gaps


@pytest.mark.parametrize("name", ROBOTS)
def test_a_stop_keeps_its_bound_with_late_cycles_only(name: str) -> None:
    """Each cycle is 2.5 periods after the last one, which is no gap."""
    robot = ROBOTS[name]
    bound = stop_bound(robot, STOP_LOCK)
    for how in ("disarmed", "zero"):
        time, path = Drive(robot).stop(how, lambda cycle: 1.5 * DT)
        assert time <= bound.time + 2.5 * DT
        assert path <= bound.distance + 2.5 * DT * FAST.vx
