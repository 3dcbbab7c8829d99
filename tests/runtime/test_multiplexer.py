"""Who drives: priorities, time-outs and locks, by given times alone."""

from __future__ import annotations

import math

import pytest

from tests.robots import FOUR_STEERED, make_robot
from thorvaldc.model.robot import TwistInput
from thorvaldc.runtime.driver import BaseDriver, DriveMode
from thorvaldc.runtime.errors import ParameterError
from thorvaldc.runtime.multiplexer import Multiplexer
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist
from thorvaldc.simulation.physics.sim_base import SimBase

SLOW, FAST = Twist(0.2, 0.0, 0.0), Twist(0.8, 0.0, 0.1)
ROBOT = make_robot(FOUR_STEERED)


@pytest.fixture
def mux() -> Multiplexer:
    """``teleop_joy`` 100, ``auto_nav`` 10; ``safety_stop`` 255, ``auto_nav_pause`` 50."""
    return Multiplexer.from_robot(ROBOT)


def test_nobody_drives_before_anybody_has_said_so(mux: Multiplexer) -> None:
    found = mux.select(0.0)
    assert (found.source, found.twist, found.locks) == ("", ZERO_TWIST, ())


def test_the_highest_that_is_being_published_drives(mux: Multiplexer) -> None:
    mux.publish("auto_nav", SLOW, 0.0)
    assert mux.select(0.1).source == "auto_nav"
    mux.publish("teleop_joy", FAST, 0.1)
    mux.publish("auto_nav", SLOW, 0.2)
    found = mux.select(0.2)
    assert (found.source, found.twist, found.time) == ("teleop_joy", FAST, 0.1)
    # A person who says zero drives, too.
    mux.publish("teleop_joy", ZERO_TWIST, 0.3)
    assert mux.select(0.4).twist == ZERO_TWIST


def test_a_source_that_falls_silent_gives_way(mux: Multiplexer) -> None:
    mux.publish("teleop_joy", FAST, 0.0)
    for tick in range(1, 6):
        mux.publish("auto_nav", SLOW, tick * 0.2)
    assert mux.select(0.5).source == "teleop_joy"  # on its time-out, not past it
    assert mux.select(0.51).source == "auto_nav"
    assert mux.select(2.0).source == ""


def test_a_lock_holds_back_what_is_below_it(mux: Multiplexer) -> None:
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


def test_a_lock_lets_its_own_priority_pass_as_in_ros() -> None:
    mux = Multiplexer(
        [TwistInput("a", "a/cmd_vel", 50, 1.0), TwistInput("b", "b/cmd_vel", 49, 1.0)],
        [TwistInput("l", "l/lock", 50, 0.0)],
    )
    mux.lock("l", True, 0.0)
    mux.publish("b", SLOW, 0.0)
    assert mux.select(0.0).source == ""
    mux.publish("a", SLOW, 0.0)
    assert mux.select(0.0).source == "a"


def test_a_lock_with_a_time_out_holds_when_it_is_silent() -> None:
    mux = Multiplexer(
        [TwistInput("a", "a/cmd_vel", 10, 9.0)], [TwistInput("gate", "gate/lock", 20, 1.0)]
    )
    mux.publish("a", SLOW, 0.0)
    assert mux.select(0.0).locks == ("gate",)  # it was never heard
    mux.lock("gate", False, 0.0)
    assert mux.select(1.0).source == "a"
    assert mux.select(1.1).source == ""
    mux.lock("gate", False, 2.0)
    assert mux.select(2.0).source == "a"


def test_the_order_of_the_list_does_not_count() -> None:
    inputs = [TwistInput(name, f"{name}/cmd_vel", n, 1.0) for n, name in enumerate("abcd", 1)]
    for listed in (inputs, inputs[::-1]):
        mux = Multiplexer(listed, ())
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
def test_what_is_not_finite_is_refused(mux: Multiplexer, twist: Twist, now: float) -> None:
    assert mux.publish("auto_nav", SLOW, 0.0)
    assert not mux.publish("auto_nav", twist, now)
    found = mux.select(0.1)
    assert (found.twist, found.time) == (SLOW, 0.0)


def test_names_that_there_are_not(mux: Multiplexer) -> None:
    with pytest.raises(ParameterError, match="did you mean `teleop_joy`"):
        mux.publish("teleop-joy", SLOW, 0.0)
    with pytest.raises(ParameterError, match="known: safety_stop, auto_nav_pause"):
        mux.lock("x", True, 0.0)


# -- in front of a driver -------------------------------------------------------------------------


def drive(mux: Multiplexer, until: float, start: int = 0) -> list[tuple[float, DriveMode, Twist]]:
    """``auto_nav`` says SLOW from 0 to 2 s; what the driver asks for and does."""
    driver = BaseDriver(ROBOT, SimBase(ROBOT))
    found = []
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
        found.append((now, state.mode, state.ramped))
    return found


def test_a_lock_stops_the_robot_at_once_and_silence_after_the_time_out(mux: Multiplexer) -> None:
    seen = drive(mux, 4.0)
    speed = {round(now, 2): twist.vx for now, _, twist in seen}
    mode = {round(now, 2): mode for now, mode, _ in seen}
    assert speed[0.98] == pytest.approx(0.2)
    assert 0.0 < speed[1.0] < 0.2  # by the ramp
    assert speed[1.3] == 0.0
    assert mode[1.68] is DriveMode.IDLE
    assert speed[2.1] == pytest.approx(0.2)
    assert speed[2.48] == pytest.approx(0.2)
    assert mode[2.48] is DriveMode.DRIVING
    assert mode[2.52] is DriveMode.TIMED_OUT
    assert speed[3.0] == 0.0


def test_a_run_repeats() -> None:
    assert drive(Multiplexer.from_robot(ROBOT), 3.0) == drive(Multiplexer.from_robot(ROBOT), 3.0)
