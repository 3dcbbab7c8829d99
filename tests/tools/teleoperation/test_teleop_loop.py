"""The loop: keys move the robot through the multiplexer, and the end is always a stop."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator

import pytest

from tests.examples import example_robot
from tests.robots import FOUR_STEERED, make_robot
from tests.runtime.can_base.simulated_rig import Rig
from thorvaldc.model.settings import AUTOMATIC
from thorvaldc.runtime.driven_robot import DrivenRobot
from thorvaldc.runtime.service_table import ServiceError
from thorvaldc.runtime.teleop_loop import Limits, operate
from thorvaldc.simulation.physics.sim_base import SimBase
from thorvaldc.tools.teleoperation.keyboard import Keyboard

ROBOT = make_robot(FOUR_STEERED)


class Clock:
    def __init__(self) -> None:
        self.now = 1000.0

    def __call__(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds


class Drive:
    """Types ``script`` (s from the start: keys) at a robot on ideal joints; notes what happens."""

    def __init__(self, script: dict[float, str]) -> None:
        self.clock = Clock()
        self.script = dict(script)
        self.vehicle = DrivenRobot(
            ROBOT, SimBase(ROBOT), arming=AUTOMATIC, real_time=self.clock, sleep=self.clock.sleep
        )
        self.shown: list[list[str]] = []
        self.hook: Callable[[float], None] = lambda now: None

    def read(self) -> list[str]:
        now = self.clock() - 1000.0
        self.hook(now)
        due = [at for at in self.script if at <= now]
        return [key for at in due for key in self.script.pop(at)]

    def run(self) -> None:
        keyboard = Keyboard(Limits.of(self.vehicle.call("description")), self.read, 1.0)
        operate(self.vehicle, keyboard, "teleop_joy", self.shown.append, clock=self.clock)


def held_state(key: str, start: float, end: float) -> dict[float, str]:
    presses = [start] + [start + 0.25 + i * 0.04 for i in range(int((end - start - 0.25) / 0.04))]
    return dict.fromkeys(presses, key)


def test_a_held_key_moves_the_robot_and_its_end_stops_it() -> None:
    drive = Drive({**held_state("i", 0.1, 2.0), 4.0: "q"})
    drive.run()
    state = drive.vehicle.call("state")
    assert state["pose"]["x"] == pytest.approx(1.5 * 2.0, abs=0.8)
    assert state["in_force"] == {"vx": 0.0, "vy": 0.0, "wz": 0.0}
    assert state["source"] == ""  # the keyboard commands nothing any more
    first, second = drive.shown[10][0], " ".join(drive.shown[10][1:])
    assert "100 %  commanded +1.50 +0.00 m/s +0.00 rad/s" in first
    assert "driving  drives: teleop_joy" in second


def test_quitting_at_full_speed_stops_first() -> None:
    drive = Drive({**held_state("i", 0.1, 2.0), 1.9: "q"})
    drive.run()
    assert abs(drive.vehicle.call("state")["in_force"]["vx"]) < 1e-3


def test_an_interrupt_stops_first_too() -> None:
    def interrupt(now: float) -> None:
        if now > 1.5:
            drive.hook = lambda now: None
            raise KeyboardInterrupt

    drive = Drive(held_state("i", 0.1, 2.0))
    drive.hook = interrupt
    with pytest.raises(KeyboardInterrupt):
        drive.run()
    assert abs(drive.vehicle.call("state")["in_force"]["vx"]) < 1e-3
    assert drive.vehicle.call("state")["pose"]["x"] > 0.5


def test_navigation_drives_when_the_operator_does_not() -> None:
    def navigate(now: float) -> None:
        moves = 0.1 < now < 3.0 or now > 3.1
        with contextlib.suppress(ServiceError):
            drive.vehicle.call("twist", source="auto_nav", vx=0.2 if moves else 0.0)
        state = drive.vehicle.call("state")
        driven[round(now, 2)] = state["source"], state["in_force"]["vx"] > 0.1

    driven: dict[float, tuple[str, bool]] = {}
    drive = Drive({1.0: "l", 4.0: "q"})
    drive.hook = navigate
    drive.run()
    assert driven[0.5] == ("auto_nav", True)
    assert driven[1.5][0] == "teleop_joy"
    # The navigation takes over when the keys are silent, and must command zero first.
    assert driven[2.9] == ("auto_nav", False)
    assert driven[3.5] == ("auto_nav", True)


def test_a_refused_request_is_shown() -> None:
    drive = Drive({0.1: "h", 1.0: "q"})
    drive.run()
    text = " " * 7 + "this base has no joints to home"
    assert any(lines[-1] == text for lines in drive.shown)


def test_the_safety_stop_holds_the_robot() -> None:
    drive = Drive({**held_state("i", 0.1, 4.0), 1.01: "x", 3.9: "q"})
    drive.run()
    assert drive.vehicle.call("state")["locks"] == ["safety_stop"]
    assert any("locked: safety_stop" in " ".join(lines) for lines in drive.shown)
    assert drive.vehicle.call("state")["pose"]["x"] < 1.6


def test_a_machine_that_is_too_slow_falls_behind_the_clock() -> None:
    drive = Drive({})
    drive.vehicle.step()
    before = drive.vehicle.now
    drive.clock.now += 5.0
    drive.vehicle.step()
    assert drive.vehicle.now - before == pytest.approx(0.02)
    drive.vehicle.step()
    assert drive.vehicle.now - before == pytest.approx(0.04)


def test_a_stopped_process_voids_the_key_that_was_held() -> None:
    """The process was stopped for 3 s with a pressed key, for example by a debugger."""
    speeds: dict[float, float] = {}

    def stop_process(now: float) -> None:
        speeds[round(now, 2)] = drive.vehicle.driver.state.ramped.vx
        if 1.0 <= now < 1.02:
            drive.clock.now += 3.0

    drive = Drive({**held_state("i", 0.1, 1.0), **held_state("i", 4.0, 8.0), 9.0: "q"})
    drive.hook = stop_process
    drive.run()
    assert max(speed for now, speed in speeds.items() if now < 1.0) > 0.5
    assert max(speed for now, speed in speeds.items() if now > 5.5) == 0.0
    assert any("command zero first" in " ".join(lines) for lines in drive.shown)


def test_an_operator_drives_the_robot_on_its_bus() -> None:
    """The keys follow the virtual time of the bus."""
    rig = Rig(example_robot("4wd4ws_wide"))
    rig.driven.feed = None
    vehicle = rig.driven
    shown: list[list[str]] = []

    def typed() -> Iterator[list[str]]:
        while not rig.driven.ready:
            yield ["i"]  # pressed too early: the robot does not start by itself
        early = rig.now + 0.5
        while rig.now < early:
            yield ["i"]
        assert rig.speed() == 0.0
        resting = rig.now + 1.5
        while rig.now < resting:
            yield []
        yield ["g"]
        ends = rig.now + 3.0
        while rig.now < ends:
            yield ["i"]
        yield ["q"]

    keys = typed()
    keyboard = Keyboard(Limits.of(vehicle.call("description")), lambda: next(keys), 0.5)
    operate(vehicle, keyboard, "teleop_joy", shown.append, clock=lambda: rig.now)
    assert rig.driven.driver.state.pose.x > 1.0
    assert rig.speed() < 0.1
    assert any("homing  drives: teleop_joy" in " ".join(lines) for lines in shown)
    hold_line = "ready  drives: teleop_joy  disarmed: press g"
    assert any(hold_line in " ".join(lines) for lines in shown)
    assert any("active  drives: teleop_joy" in " ".join(lines) for lines in shown)
    vehicle.shutdown()
    assert rig.speed() == 0.0
