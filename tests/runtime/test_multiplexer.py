"""The multiplexer: priorities, time-outs and locks."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace

import pytest

from tests.robots import FOUR_STEERED, make_robot
from thorvaldc.model import TwistInput
from thorvaldc.runtime.base_interface import ParameterError
from thorvaldc.runtime.driver import BaseDriver, DriveMode
from thorvaldc.runtime.multiplexer import Multiplexer
from thorvaldc.runtime.permission import MotionPermission, Rules
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist
from thorvaldc.simulation.physics.sim_base import SimBase

SLOW, FAST = Twist(0.2, 0.0, 0.0), Twist(0.8, 0.0, 0.1)
ROBOT = make_robot(FOUR_STEERED)


RESUMING = [replace(source, first_command="any") for source in ROBOT.twist_sources]


def multiplexer(
    sources: Iterable[TwistInput], locks: Iterable[TwistInput] = ROBOT.twist_locks
) -> Multiplexer:
    return Multiplexer(MotionPermission(Rules(sources, locks)))


@pytest.fixture
def mux() -> Multiplexer:
    """``teleop_joy`` 100, ``auto_nav`` 10; ``safety_stop`` 255, ``auto_nav_pause`` 50.

    Both sources resume.
    """
    return multiplexer(RESUMING)


def test_no_source_is_selected_before_the_first_publication(mux: Multiplexer) -> None:
    selection = Multiplexer.from_robot(ROBOT).select(0.0)
    assert (selection.source, selection.twist, selection.locks) == ("", ZERO_TWIST, ())


def test_active_source_of_the_highest_priority_drives(mux: Multiplexer) -> None:
    mux.publish("auto_nav", SLOW, 0.0)
    assert mux.select(0.1).source == "auto_nav"
    mux.publish("teleop_joy", FAST, 0.1)
    mux.publish("auto_nav", SLOW, 0.2)
    selection = mux.select(0.2)
    assert (selection.source, selection.twist, selection.time) == ("teleop_joy", FAST, 0.1)
    # A source that publishes a zero twist is active, too.
    mux.publish("teleop_joy", ZERO_TWIST, 0.3)
    assert mux.select(0.4).twist == ZERO_TWIST


def test_source_that_times_out_is_replaced(mux: Multiplexer) -> None:
    mux.publish("teleop_joy", FAST, 0.0)
    for tick in range(1, 6):
        mux.publish("auto_nav", SLOW, tick * 0.2)
    assert mux.select(0.5).source == "teleop_joy"  # exactly at its time-out
    assert mux.select(0.51).source == "auto_nav"
    assert mux.select(2.0).source == ""


def test_active_lock_blocks_lower_priorities(mux: Multiplexer) -> None:
    mux.lock("auto_nav_pause", True, 0.0)
    mux.publish("auto_nav", SLOW, 0.0)
    assert mux.select(0.1).source == ""
    assert mux.select(0.1).locks == ("auto_nav_pause",)
    mux.publish("teleop_joy", FAST, 0.1)
    assert mux.select(0.1).source == "teleop_joy"
    mux.lock("safety_stop", True, 0.2)
    assert mux.select(0.2).source == ""
    mux.lock("safety_stop", False, 0.3)
    assert mux.select(0.3).source == "teleop_joy"


def test_active_lock_blocks_its_own_priority() -> None:
    mux = multiplexer(
        [
            TwistInput("a", "a/cmd_vel", 51, 1.0, "any"),
            TwistInput("b", "b/cmd_vel", 50, 1.0, "any"),
        ],
        [TwistInput("l", "l/lock", 50, 0.0)],
    )
    mux.lock("l", True, 0.0)
    mux.publish("b", SLOW, 0.0)
    assert mux.select(0.0).source == ""
    mux.publish("a", SLOW, 0.0)
    assert mux.select(0.0).source == "a"


@pytest.mark.parametrize("stop_priority", [255, 100])
def test_no_priority_drives_through_a_stop_lock(stop_priority: int) -> None:
    """The compiler refuses such sources; a model from elsewhere must be stopped too."""
    for name, priority in (("safety_stop", stop_priority), ("fence", 255)):
        mux = multiplexer(
            [TwistInput("override", "override/cmd_vel", 255, 1.0, "any")],
            [TwistInput(name, f"{name}/lock", priority, 0.0)],
        )
        mux.publish("override", SLOW, 0.0)
        assert mux.select(0.0).source == "override"
        mux.lock(name, True, 0.0)
        assert mux.select(0.0).source == ""


def test_lock_with_a_time_out_is_active_when_it_times_out() -> None:
    mux = multiplexer(
        [TwistInput("a", "a/cmd_vel", 10, 9.0, "any")], [TwistInput("gate", "gate/lock", 20, 1.0)]
    )
    mux.publish("a", SLOW, 0.0)
    assert mux.select(0.0).locks == ("gate",)  # never published
    mux.lock("gate", False, 0.0)
    assert mux.select(1.0).source == "a"
    assert mux.select(1.1).source == ""
    mux.lock("gate", False, 2.0)
    assert mux.select(2.0).source == "a"


def test_order_of_the_sources_does_not_matter() -> None:
    inputs = [
        TwistInput(name, f"{name}/cmd_vel", n, 1.0, "any") for n, name in enumerate("abcd", 1)
    ]
    for listed in (inputs, inputs[::-1]):
        mux = multiplexer(listed, ())
        for name in "abcd":
            mux.publish(name, SLOW, 0.0)
        assert mux.select(0.5).source == "d"


@pytest.mark.parametrize(
    ("twist", "now"),
    [
        (Twist(math.nan, 0.0, 0.0), 0.1),
        (Twist(0.0, math.inf, 0.0), 0.1),
        (Twist(1e12, 0.0, 0.0), 0.1),
        (FAST, math.nan),
    ],
)
def test_values_that_are_not_finite_are_rejected(
    mux: Multiplexer, twist: Twist, now: float
) -> None:
    assert mux.publish("auto_nav", SLOW, 0.0) == ""
    assert mux.publish("auto_nav", twist, now) == "the twist is too large"
    selection = mux.select(0.1)
    assert (selection.twist, selection.time) == (SLOW, 0.0)


def test_unknown_names(mux: Multiplexer) -> None:
    with pytest.raises(ParameterError, match="did you mean `teleop_joy`"):
        mux.publish("teleop-joy", SLOW, 0.0)
    with pytest.raises(ParameterError, match="known: safety_stop, auto_nav_pause"):
        mux.lock("x", True, 0.0)


# -- in front of a driver -------------------------------------------------------------------------


def front(sources: Iterable[TwistInput]) -> tuple[Multiplexer, BaseDriver]:
    """Returns a multiplexer in front of a driver that is armed."""
    robot = replace(ROBOT, twist_sources=tuple(sources))
    driver = BaseDriver(robot, SimBase(robot))
    return Multiplexer(driver.permission), driver


def drive(
    sources: Iterable[TwistInput], until: float, start: int = 0
) -> list[tuple[float, DriveMode, Twist]]:
    """``auto_nav`` publishes SLOW from 0 to 2 s; returns time, mode and ramped twist per tick."""
    mux, driver = front(sources)
    samples = []
    for tick in range(start, round(until * 50)):
        now = tick * 0.02
        if now <= 2.0:
            mux.publish("auto_nav", SLOW, now)
        if abs(now - 1.0) < 1e-9:
            mux.lock("auto_nav_pause", True, now)
        if abs(now - 1.7) < 1e-9:
            mux.lock("auto_nav_pause", False, now)
        mux.feed(driver, now)
        state = driver.tick(now)
        samples.append((now, state.mode, state.ramped))
    return samples


def test_lock_stops_the_robot_immediately_and_silence_after_the_time_out() -> None:
    seen = drive(RESUMING, 4.0)
    speed = {round(now, 2): twist.vx for now, _, twist in seen}
    mode = {round(now, 2): mode for now, mode, _ in seen}
    assert speed[0.98] == pytest.approx(0.2)
    assert 0.0 < speed[1.0] < 0.2  # on the ramp
    assert speed[1.3] == 0.0
    assert mode[1.68] is DriveMode.IDLE
    assert speed[2.1] == pytest.approx(0.2)
    assert speed[2.48] == pytest.approx(0.2)
    assert mode[2.48] is DriveMode.DRIVING
    assert mode[2.52] is DriveMode.TIMED_OUT
    assert speed[3.0] == 0.0


def test_runs_are_repeatable() -> None:
    assert drive(RESUMING, 3.0) == drive(RESUMING, 3.0)


# -- zero first (ADR 22) ---------------------------------------------------------------------------


def test_the_first_twist_of_a_source_must_be_zero() -> None:
    mux = Multiplexer.from_robot(ROBOT)
    assert (
        mux.publish("auto_nav", SLOW, 0.0) == "`auto_nav` was not heard before; command zero first"
    )
    assert mux.publish("auto_nav", SLOW, 0.1).endswith("command zero first")
    assert mux.select(0.1).twist == ZERO_TWIST
    assert mux.awaited_zeros(0.1) == {"auto_nav": "`auto_nav` was not heard before"}
    assert mux.publish("auto_nav", ZERO_TWIST, 0.2) == ""
    assert mux.publish("auto_nav", SLOW, 0.2) == ""
    assert mux.select(0.2).twist == SLOW


def test_a_silent_source_awaits_zero_because_of_its_silence() -> None:
    """A gap in time, or a clock that did not run, of before its silence is not the reason."""
    nav = TwistInput("nav", "nav", 10, 0.5, "ramp")
    mux, driver = front([nav, TwistInput("joy", "joy", 100, 0.5)])
    driver.permission.step(Rules.void, "a gap in time", 0.0)
    step = "its first step exceeds 0.075 m/s or 0.075 rad/s; command zero first"
    assert mux.publish("nav", FAST, 1.0) == f"`nav` was not heard before, and {step}"
    assert mux.publish("nav", ZERO_TWIST, 1.1) == ""
    silence = "was silent for more than 0.5 s"
    assert mux.publish("nav", FAST, 2.0) == f"`nav` {silence}, and {step}"
    mux.publish("joy", ZERO_TWIST, 2.0)
    assert mux.publish("joy", FAST, 3.0) == f"`joy` {silence}; command zero first"
    driver.permission.step(Rules.void, "a gap in time", 3.1)
    assert mux.publish("joy", FAST, 3.2) == "a gap in time; command zero first"


@pytest.mark.parametrize("leaves", ["time-out", "another program", "end"])
def test_a_source_that_comes_back_must_command_zero(leaves: str) -> None:
    mux = Multiplexer.from_robot(ROBOT)
    mux.publish("auto_nav", ZERO_TWIST, 0.0, "a")
    assert mux.publish("auto_nav", SLOW, 0.1, "a") == ""
    now, owner = 0.2, "a"
    if leaves == "time-out":
        now = 0.7
    elif leaves == "another program":
        now, owner = 0.7, "b"
    else:
        mux.release("a")
    assert mux.publish("auto_nav", SLOW, now, owner).endswith("command zero first")
    assert mux.select(now).twist == ZERO_TWIST


def test_a_source_that_must_command_zero_keeps_its_rank() -> None:
    """A person who deflects the stick stops the navigation, also before the stick was centred."""
    mux = Multiplexer.from_robot(ROBOT)
    mux.publish("auto_nav", ZERO_TWIST, 0.0)
    for tick in range(4):
        mux.publish("auto_nav", SLOW, 0.2 * tick)
    assert mux.publish("teleop_joy", FAST, 0.6) != ""
    selection = mux.select(0.6)
    assert (selection.source, selection.twist) == ("teleop_joy", ZERO_TWIST)


@pytest.mark.parametrize("first_command", ["zero", "any"])
def test_a_source_below_one_that_falls_silent(first_command: str) -> None:
    mux, driver = front(
        [TwistInput("joy", "joy", 100, 0.5), TwistInput("nav", "nav", 10, 0.5, first_command)]
    )
    speeds = []
    for tick in range(100):
        now = tick * 0.02
        if now < 0.5:
            mux.publish("joy", ZERO_TWIST, now)  # a person supervises with the stick at zero
        mux.publish("nav", ZERO_TWIST if tick == 0 else SLOW, now)
        mux.feed(driver, now)
        speeds.append(driver.tick(now).ramped.vx)
    assert max(speeds) == pytest.approx(0.2 if first_command == "any" else 0.0)


def test_a_gap_requires_zero_of_every_source() -> None:
    permission = MotionPermission(Rules([TwistInput("nav", "nav", 10, 0.5, "any")]))
    mux = Multiplexer(permission)
    assert mux.publish("nav", SLOW, 0.0) == ""
    permission.step(Rules.void, "no control cycle for 120 ms", 0.1)
    assert mux.publish("nav", SLOW, 0.1) == "no control cycle for 120 ms; command zero first"


def test_a_zero_before_a_gap_does_not_count() -> None:
    permission = MotionPermission(Rules([TwistInput("joy", "joy", 10, 0.5, "zero")]))
    mux = Multiplexer(permission)
    assert mux.publish("joy", ZERO_TWIST, 0.0) == ""
    permission.step(Rules.void, "no control cycle for 100 ms", 0.1)
    permission.step(Rules.begin_cycle, 0.1)
    assert mux.publish("joy", SLOW, 0.12) == "no control cycle for 100 ms; command zero first"
    assert mux.publish("joy", ZERO_TWIST, 0.14) == ""
    assert mux.publish("joy", SLOW, 0.16) == ""
