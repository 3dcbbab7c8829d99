"""A driver commands finite numbers and recovers, for any joint states and any commands."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.robots import FOUR_STEERED, make_robot
from thorvaldc.model import Robot
from thorvaldc.runtime.base_interface import BaseHandle, JointCommands, JointStates, ParameterError
from thorvaldc.runtime.driver import BaseDriver, DriveMode
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist
from thorvaldc.simulation.physics.sim_base import SimBase

HALF_STEERED = [(x, y, kind if x > 0.0 else "fixed") for x, y, kind in FOUR_STEERED]
ROBOTS = {"4WD4WS": make_robot(FOUR_STEERED), "4WD2WS": make_robot(HALF_STEERED)}
DT = 1.0 / ROBOTS["4WD4WS"].driver.rate
BAD = [math.nan, math.inf, -math.inf, 1e308, -1e200]


class CorruptedBase(BaseHandle):
    """A simulated base whose joint states can be corrupted."""

    def __init__(self, robot: Robot) -> None:
        self.inner = SimBase(robot)
        self.corruption: dict[str, Any] = {}
        self.written: list[JointCommands] = []

    def read(self, now: float) -> JointStates:
        states = self.inner.read(now)
        for field, (index, value) in self.corruption.items():
            if field == "time":
                states = replace(states, time=states.time + value)
            else:
                values = [*getattr(states, field)]
                if index is None:
                    values.pop()
                else:
                    values[index] = value
                states = replace(states, **{field: values})
        return states

    def write(self, commands: JointCommands, now: float) -> None:
        self.written.append(commands)
        self.inner.write(commands, now)


joints = st.sampled_from(["speeds", "angles", "angle_rates", "positions"])
corruptions = st.one_of(
    st.just({}),
    st.dictionaries(
        joints, st.tuples(st.sampled_from([None, 0, 1, 2, 3]), st.sampled_from(BAD)), max_size=2
    ),
    st.fixed_dictionaries({"time": st.tuples(st.just(0), st.sampled_from([-9.0, 0.0, 9.0]))}),
)
steps = st.sampled_from([DT, DT, DT, DT, 0.0, -1.0, 3.0, 1e-9, math.nan])
value = st.one_of(st.floats(-1.0, 1.0), st.sampled_from(BAD))
changes = st.sampled_from(
    [
        {"radii": {"w0": -0.2}},
        {"radii": {"w0": math.nan}},
        {"max_linear_velocity": -1.0},
        {"noise": {"angle": math.inf}},
    ]
)


@pytest.mark.parametrize("robot", ROBOTS.values(), ids=ROBOTS)
@settings(max_examples=25, deadline=None, derandomize=True)
@given(
    ticks=st.lists(
        st.tuples(corruptions, steps, st.tuples(value, value, value), st.none() | changes),
        min_size=5,
        max_size=40,
    )
)
def test_no_joint_state_and_no_command_makes_a_nan(
    robot: Robot,
    ticks: list[tuple[dict[str, Any], float, tuple[float, float, float], dict[str, Any] | None]],
) -> None:
    base = CorruptedBase(robot)
    driver = BaseDriver(robot, base)
    now = 0.0
    for corruption, step, twist, change in ticks:
        base.corruption = corruption
        driver.command(Twist(*twist), now)
        if change is not None:
            parameters = driver.parameters
            with pytest.raises(ParameterError):
                driver.update(**change)
            assert driver.parameters is parameters
        state = driver.tick(now + step)
        if step > 0.0:
            now += step
        for number in (*state.pose, *state.odometry.twist, *map(sum, state.pose_covariance)):
            assert math.isfinite(number)
    base.corruption = {}
    # A long gap in time is a fault, which a person resets.  The driver then waits for a zero twist.
    for tick in range(100):
        now += DT
        if tick == 50:
            driver.reset()
        driver.command(ZERO_TWIST, now)
        driver.tick(now)
    # 5 s: if wheels must turn around, the robot stops first, which takes more than 3 s in all.
    for _ in range(250):
        now += DT
        driver.command(Twist(0.4, 0.1, 0.2), now)
        state = driver.tick(now)
    assert state.mode is DriveMode.DRIVING
    feasible = driver.calculator.feasible(Twist(0.4, 0.1, 0.2))
    assert state.odometry.twist == pytest.approx(feasible, abs=1e-6)
    for commands in base.written:
        assert all(map(math.isfinite, (*commands.speeds, *commands.angles)))
