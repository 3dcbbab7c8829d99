"""Parameter changes between ticks: complete or not at all; the pose stays."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from tests.robots import FOUR_STEERED, SPAN, make_robot
from thorvaldc.diagnostics import DiagnosticError
from thorvaldc.model import ParameterSet, Robot
from thorvaldc.runtime.base_interface import JointStates, ParameterError
from thorvaldc.runtime.calculators import PLUGINS, BaseGeometry, Noise, calculator_class
from thorvaldc.runtime.calculators.general import General
from thorvaldc.runtime.driver import BaseDriver
from thorvaldc.runtime.run_time_parameters import Parameters
from thorvaldc.runtime.se2 import Twist
from thorvaldc.simulation.physics.sim_base import SimBase

PLAIN = make_robot(FOUR_STEERED)
DT = 1.0 / PLAIN.driver.rate


def with_sets() -> Robot:
    slow = replace(PLAIN.driver, max_linear_velocity=0.3, noise=(("speed_ratio", 0.05),))
    return replace(
        PLAIN,
        wheels=tuple(replace(w, radii=(("floor", 0.2), ("rail", 0.1))) for w in PLAIN.wheels),
        parameter_sets=(
            ParameterSet("floor", "floor", PLAIN.driver, SPAN),
            ParameterSet("rail", "rail", slow, SPAN),
        ),
    )


def run(driver: BaseDriver, twist: Twist, start: float, end: float) -> None:
    for k in range(round(start / DT), round(end / DT)):
        driver.command(twist, k * DT)
        driver.tick(k * DT)


def test_each_interval_uses_its_radius_and_the_pose_stays() -> None:
    """At 5 rad/s the robot drives 1 m/s with a radius of 0.2 m, and 0.5 m/s with 0.1 m."""
    robot = with_sets()
    driver = BaseDriver(robot, SimBase(robot))
    run(driver, Twist(1.0, 0.0, 0.0), 0.0, 3.0)
    before = driver.state
    driver.use("rail")
    assert driver.state is before
    assert driver.calculator.geometry.wheels[0].radius == 0.2
    driver.tick(3.0)
    after = driver.state
    # The robot drove the interval that ends now with the old radius.
    assert after.pose.x - before.pose.x == pytest.approx(1.0 * DT)
    assert driver.calculator.geometry.wheels[0].radius == 0.1
    driver.tick(3.0 + DT)
    positions = (after.joints, driver.state.joints)
    assert positions[0] is not None
    assert positions[1] is not None
    turned = positions[1].positions[0] - positions[0].positions[0]  # type: ignore[index]
    assert driver.state.pose.x - after.pose.x == pytest.approx(0.1 * turned)
    assert turned > 0.09
    run(driver, Twist(1.0, 0.0, 0.0), 3.06, 6.0)
    assert driver.state.ramped.vx == pytest.approx(0.3)
    assert driver.state.joints is not None
    assert driver.state.joints.speeds == pytest.approx([3.0] * 4)
    assert driver.state.odometry.twist.vx == pytest.approx(0.3)


def test_driver_starts_with_a_set_and_returns_to_the_ordinary_values() -> None:
    robot = with_sets()
    driver = BaseDriver(robot, SimBase(robot), parameters="rail")
    assert driver.parameters == Parameters.from_robot(robot, "rail")
    assert driver.calculator.noise == Noise(speed_ratio=0.05)
    driver.use(None)
    driver.tick(0.0)
    assert driver.parameters == Parameters.from_robot(robot)
    assert driver.calculator.noise == Noise()


def test_updates_accumulate_until_the_tick() -> None:
    driver = BaseDriver(PLAIN, SimBase(PLAIN))
    driver.update(radii={"w1": 0.19})
    driver.update(radii={"w2": 0.21}, noise={"angle": 0.02}, max_linear_velocity=0.5)
    driver.tick(0.0)
    assert driver.parameters.radii == (0.2, 0.19, 0.21, 0.2)
    assert [w.radius for w in driver.calculator.geometry.wheels] == [0.2, 0.19, 0.21, 0.2]
    assert driver.settings == replace(
        PLAIN.driver, max_linear_velocity=0.5, noise=(("angle", 0.02),)
    )
    assert driver.calculator.noise == Noise(angle=0.02)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"radii": {"w0": 0.19, "w1": -0.2}}, "the radius of w1 is -0.2 m; it must be positive"),
        ({"radii": {"w1": 0.0}}, "must be positive"),
        ({"radii": {"w1": math.nan}}, "the radius of w1 is nan m; it must be positive"),
        ({"radii": {"w1": math.inf}}, "must be positive"),
        ({"radii": {"w1": 200}}, "the radius of w1 is 200 m; it must be at most 0.3 m"),
        ({"radii": {"w9": 0.2}}, "there is no wheel `w9`; known: w0"),
        ({"radii": {"w1": "0.2"}}, "it must be a number"),
        ({"radii": {"w1": True}}, "it must be a number"),
        ({"max_linear_velocity": -1.0}, "max_linear_velocity is -1 m/s; it must be positive"),
        ({"max_linear_velocity": math.nan}, "must be positive"),
        ({"max_lateral_velocity": 1.0}, "there is no limit `max_lateral_velocity`; did you mean"),
        ({"rate": 10.0}, "there is no limit `rate`"),
        (
            {"max_linear_velocity": 1e300},
            "max_linear_velocity is 1e+300 m/s; it must be at most 1.5 m/s",
        ),
        ({"noise": {"angle": 1e300}}, "the noise angle is 1e+300; it must be at most 1e+12"),
        ({"noise": {"angle": 0.0}}, "the noise angle is 0; it must be positive"),
        ({"noise": {"angel": 0.1}}, "there is no noise `angel`; did you mean `angle`?"),
    ],
)
def test_invalid_change_is_rejected_and_changes_nothing(
    change: dict[str, object], message: str
) -> None:
    driver, unchanged = BaseDriver(PLAIN, SimBase(PLAIN)), BaseDriver(PLAIN, SimBase(PLAIN))
    run(driver, Twist(0.5, 0.1, 0.2), 0.0, 1.0)
    run(unchanged, Twist(0.5, 0.1, 0.2), 0.0, 1.0)
    with pytest.raises(ParameterError) as caught:
        driver.update(**change)  # type: ignore[arg-type]
    assert message in str(caught.value)
    run(driver, Twist(0.5, 0.1, 0.2), 1.0, 2.0)
    run(unchanged, Twist(0.5, 0.1, 0.2), 1.0, 2.0)
    assert driver.state == unchanged.state
    assert driver.parameters == Parameters.from_robot(PLAIN)


def test_unknown_set_is_rejected() -> None:
    robot = with_sets()
    driver = BaseDriver(robot, SimBase(robot))
    with pytest.raises(DiagnosticError) as caught:
        driver.use("rial")
    diagnostic = caught.value.diagnostic
    assert diagnostic.code.name == "parameter-set-unknown"
    assert diagnostic.hint == "did you mean `rail`?"
    driver.tick(0.0)
    assert driver.parameters == Parameters.from_robot(robot)


def test_change_while_driving_keeps_steering_and_motor_limits() -> None:
    driver = BaseDriver(with_sets(), SimBase(PLAIN))
    run(driver, Twist(0.8, 0.2, 0.3), 0.0, 2.0)
    first = driver.state.command
    assert first is not None
    before = first.joints
    driver.use("rail")
    for k in range(100, 200):
        driver.command(Twist(0.8, 0.2, 0.3), k * DT)
        command = driver.tick(k * DT).command
        assert command is not None
        # The motion is slower, and the wheels keep their directions.
        assert list(command.joints.angles) == pytest.approx(list(first.joints.angles), abs=1e-3)
        for now, then in zip(command.joints.speeds, before.speeds, strict=True):
            assert abs(now - then) <= 7.5 * DT + 1e-9
        before = command.joints


@pytest.mark.parametrize("name", sorted(PLUGINS.builtin))
def test_every_calculator_resumes(name: str) -> None:
    """Replacing a calculator by an equal one in every tick does not change its commands."""
    kinds = {
        "differential": [(0.0, 0.4, "fixed"), (0.0, -0.4, "fixed"), (0.8, 0.0, "swivel")],
        "one_wheel": [(0.8, 0.0, "steered"), (0.0, 0.4, "passive"), (0.0, -0.4, "passive")],
    }
    geometry = BaseGeometry.from_robot(make_robot(kinds.get(name, FOUR_STEERED)))
    kept = calculator_class(name)(geometry)
    replaced = calculator_class(name)(geometry)
    n = len(geometry.wheels)
    radii = [w.radius for w in geometry.wheels]
    for k in range(60):
        twist = Twist(0.5 * math.cos(k / 9), 0.2 if k > 20 else 0.0, 0.3 * math.sin(k / 5))
        a, b = kept.command(twist, None, 0.02), replaced.command(twist, None, 0.02)
        assert a == b
        states = JointStates(0.0, a.joints.speeds, a.joints.angles, [0.0] * n)
        assert kept.odometry(states) == replaced.odometry(states)
        successor = replaced.with_parameters(radii, Noise())
        successor.resume(replaced)
        replaced = successor


def test_class_of_a_given_calculator_is_kept() -> None:
    class Half(General):
        pass

    calculator = Half(BaseGeometry.from_robot(PLAIN))
    driver = BaseDriver(PLAIN, SimBase(PLAIN), calculator)
    assert driver.calculator is calculator
    driver.update(radii={"w0": 0.25})
    driver.tick(0.0)
    assert type(driver.calculator) is Half
    assert driver.calculator.geometry.wheels[0].radius == 0.25
