"""What odometry keeps for every robot of 1 to 20 wheels, whatever its joints say."""

from __future__ import annotations

import math

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from tests.conformance.test_calculators import (
    SETTINGS,
    any_wheels,
    axle_wheels,
    close,
    make,
    states_of,
    tricycle_wheels,
    twists,
)
from tests.conformance.wheels import wheel
from thorvaldc.runtime.base_interface import JointStates, NotFiniteError
from thorvaldc.runtime.calculators import BaseGeometry, WheelGeometry
from thorvaldc.runtime.calculators.twist_estimator import (
    EstimatorOptions,
    TwistEstimate,
    TwistEstimator,
)
from thorvaldc.runtime.se2 import Cov3

robots = st.one_of(any_wheels(), axle_wheels(), tricycle_wheels())
options = st.builds(EstimatorOptions, faulty=st.integers(0, 2), polish=st.integers(0, 2))


@st.composite
def joints(draw: st.DrawFn, n: int, bound: float = 8.0) -> JointStates:
    """Anything, far from any motion as a rule."""
    speeds, angles, rates = (
        draw(st.lists(st.floats(-b, b).map(lambda v: round(v, 3)), min_size=n, max_size=n))
        for b in (bound, 3.2, 4.0)
    )
    yaw_rate = draw(st.one_of(st.none(), st.floats(-2.0, 2.0).map(lambda v: round(v, 3))))
    return JointStates(0.0, speeds, angles, rates, None, yaw_rate)


@st.composite
def steered_wheels(draw: st.DrawFn) -> list[WheelGeometry]:
    """Four to nine steered wheels that stand apart, so that any can be estimate from the others."""
    places = draw(
        st.lists(
            st.tuples(st.integers(-3, 3), st.integers(-3, 3)),
            min_size=4,
            max_size=9,
            unique=True,
        )
    )
    return [wheel(f"w{i}", 0.5 * x, 0.5 * y, "steered") for i, (x, y) in enumerate(places)]


def sound(estimate: TwistEstimate) -> None:
    """Finite, and a covariance that is one."""
    assert all(math.isfinite(v) for v in estimate.twist)
    (a, b, c), (b2, d, e), (c2, e2, f) = estimate.covariance
    assert (b, c, e) == (b2, c2, e2)
    assert min(a, d, f) > 0.0
    rounding = 1e-9
    assert a * d - b * b >= -rounding * a * d
    assert determinant(estimate.covariance) >= -rounding * a * d * f
    assert all(v >= 0.0 and math.isfinite(v) for v in estimate.chi_squares)


def determinant(p: Cov3) -> float:
    (a, b, c), (_, d, e), (_, _, f) = p
    return a * (d * f - e * e) - b * (b * f - c * e) + c * (b * e - c * d)


@SETTINGS
@given(wheels=robots, chosen=options, data=st.data())
def test_whatever_the_joints_say_the_estimate_is_sound(
    wheels: list[WheelGeometry], chosen: EstimatorOptions, data: st.DataObject
) -> None:
    estimator = TwistEstimator(BaseGeometry.from_wheels(wheels), None, chosen)
    estimate = estimator.estimate(data.draw(joints(len(wheels))))
    sound(estimate)
    assert len(estimate.chi_squares) == len(wheels)
    assert len(estimate.dropped) <= chosen.faulty
    for i in estimate.dropped:
        assert not wheels[i].swivel


@SETTINGS
@given(wheels=robots, chosen=options, data=st.data())
def test_whatever_joints_and_commands_say_the_estimate_is_sound(
    wheels: list[WheelGeometry], chosen: EstimatorOptions, data: st.DataObject
) -> None:
    """Also the errors that last for the drive are finite, with any number of wheels left out."""
    estimator = TwistEstimator(BaseGeometry.from_wheels(wheels), None, chosen)
    n = len(wheels)
    states = data.draw(joints(n))
    commanded = data.draw(st.lists(st.sampled_from([-5.0, 0.0, 0.3, 5.0]), min_size=n, max_size=n))
    estimate = estimator.estimate(states, commanded)
    sound(estimate)
    assert not set(estimate.dropped) & {*estimate.suspects, *estimate.sliding}
    for errors in estimator.lasting_errors(states, estimate, estimate.twist):
        assert all(math.isfinite(v) for v in errors)


@SETTINGS
@given(wheels=robots, chosen=options, data=st.data())
def test_no_size_of_a_joint_state_makes_a_nan(
    wheels: list[WheelGeometry], chosen: EstimatorOptions, data: st.DataObject
) -> None:
    estimator = TwistEstimator(BaseGeometry.from_wheels(wheels), None, chosen)
    size = data.draw(st.sampled_from([1e-300, 1e-160, 1e-8, 1e8, 1e80, 1e160, 1e300]))
    try:
        estimate = estimator.estimate(data.draw(joints(len(wheels), size)))
    except NotFiniteError:
        assert size >= 1e8
        return
    assert all(math.isfinite(v) for v in estimate.twist)
    assert all(math.isfinite(v) for row in estimate.covariance for v in row)


@SETTINGS
@given(wheels=robots, chosen=options, twist=twists)
def test_joints_of_a_motion_tell_it_and_no_wheel_is_wrong(
    wheels: list[WheelGeometry], chosen: EstimatorOptions, twist: object
) -> None:
    calculator = make("general", wheels)
    states, target, reached = states_of(calculator, twist)  # type: ignore[arg-type]
    assume(reached)
    estimate = TwistEstimator(calculator.geometry, None, chosen).estimate(states)
    sound(estimate)
    assert estimate.dropped == ()
    if estimate.rank == 3:
        spread = max(1.0, 1.0 / calculator.geometry.length)
        assert close(estimate.twist, target, 1e-11 * spread**2)
        assert max(estimate.chi_squares) < 1e-9


@SETTINGS
@given(wheels=robots, data=st.data())
def test_order_of_the_wheels_does_not_matter(
    wheels: list[WheelGeometry], data: st.DataObject
) -> None:
    states = data.draw(joints(len(wheels)))
    order = data.draw(st.permutations(range(len(wheels))))
    reordered_states = JointStates(
        0.0,
        [states.speeds[i] for i in order],
        [states.angles[i] for i in order],
        [states.angle_rates[i] for i in order],
        None,
        states.yaw_rate,
    )
    # Two hypotheses of equal cost may come in any order, so do not reject wheels.
    no_rejection = EstimatorOptions(faulty=0)
    estimate = TwistEstimator(BaseGeometry.from_wheels(wheels), None, no_rejection).estimate(states)
    turned = [wheels[i] for i in order]
    reordered = TwistEstimator(BaseGeometry.from_wheels(turned), None, no_rejection).estimate(
        reordered_states
    )
    assert estimate.rank == reordered.rank
    sigma = math.sqrt(max(estimate.covariance[j][j] for j in range(3)))
    assert close(
        estimate.twist,
        reordered.twist,
        1e-6 * max(1.0, *(abs(v) for v in estimate.twist)) + 0.01 * sigma,
    )


@SETTINGS
@given(
    wheels=steered_wheels(),
    twist=twists,
    wrong=st.sampled_from(["x3", "reversed", "+40 deg"]),
    data=st.data(),
)
def test_one_wheel_that_is_plainly_wrong_is_named_and_does_no_harm(
    wheels: list[WheelGeometry], twist: object, wrong: str, data: st.DataObject
) -> None:
    calculator = make("general", wheels)
    states, target, reached = states_of(calculator, twist)  # type: ignore[arg-type]
    assume(reached)
    for w in wheels:
        assume(math.hypot(target.vx - target.wz * w.y, target.vy + target.wz * w.x) > 0.2)
    healthy = calculator.odometry(states)
    i = data.draw(st.integers(0, len(wheels) - 1))
    speeds, angles = [*states.speeds], [*states.angles]
    if wrong == "+40 deg":
        angles[i] += math.radians(40.0)
    else:
        speeds[i] *= 3.0 if wrong == "x3" else -1.0
    estimate = calculator.odometry(JointStates(0.0, speeds, angles, states.angle_rates))
    sound(estimate)
    assert estimate.dropped == (i,)
    for j in range(3):
        sigma = math.sqrt(estimate.covariance[j][j])
        assert abs(estimate.twist[j] - target[j]) <= 0.5 * sigma + 1e-9
        assert sigma >= 0.99 * math.sqrt(healthy.covariance[j][j])


@SETTINGS
@given(wheels=robots, twist=twists)
def test_a_gyro_never_makes_it_worse(wheels: list[WheelGeometry], twist: object) -> None:
    calculator = make("general", wheels)
    states, target, reached = states_of(calculator, twist)  # type: ignore[arg-type]
    assume(reached)
    blind = calculator.odometry(states)
    states.yaw_rate = target.wz
    estimate = calculator.odometry(states)
    assert estimate.rank >= blind.rank
    if blind.rank == 3:
        assert estimate.covariance[2][2] <= blind.covariance[2][2] * 1.001
    assert math.sqrt(estimate.covariance[2][2]) <= calculator.noise.gyro * 1.001


@pytest.mark.parametrize("what", ["speed", "steering angle", "steering rate", "position", "yaw"])
@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_what_is_not_finite_is_named(what: str, bad: float) -> None:
    wheels = [wheel(f"w{i}", x, 0.0, "steered") for i, x in enumerate((-0.5, 0.5))]
    estimator = TwistEstimator(BaseGeometry.from_wheels(wheels))

    def values(name: str) -> list[float]:
        return [0.0, bad if name == what else 0.0]

    states = JointStates(
        0.0,
        values("speed"),
        values("steering angle"),
        values("steering rate"),
        values("position"),
        values("yaw")[1],
    )
    name = f"the {what} of wheel w1" if what != "yaw" else "the yaw rate"
    with pytest.raises(NotFiniteError, match=name):
        estimator.estimate(states)
