"""Properties of every base calculator, for random robots with 1 to 20 wheels."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from tests.conformance.wheels import wheel
from thorvaldc.runtime.base_interface import JointStates, NotFiniteError
from thorvaldc.runtime.calculators import (
    PLUGINS,
    BaseCalculator,
    BaseGeometry,
    WheelGeometry,
    calculator_class,
)
from thorvaldc.runtime.calculators.steering_branch import LIMIT_TOLERANCE, RESUME_ABOVE
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist

SETTINGS = settings(
    max_examples=25,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.filter_too_much],
)

LIMITS: list[tuple[float | None, float | None]] = [
    (None, None),
    (-3.078027759, 3.078027759),
    (-math.pi, math.pi),
    (-2.0, 2.0),
    (-1.0, 5.0),
    (-0.7, 0.7),
    (-10.0, 10.0),
]


def coordinate(bound: float) -> st.SearchStrategy[float]:
    return st.floats(-bound, bound).map(lambda v: round(v, 3))


@st.composite
def any_wheels(draw: st.DrawFn) -> list[WheelGeometry]:
    n = draw(st.integers(1, 20))
    kinds = draw(
        st.sampled_from(
            [
                ["steered"],
                ["steered", "swivel"],
                ["steered", "passive", "swivel"],
                ["steered", "turned", "fixed", "passive", "swivel"],
                ["fixed", "swivel"],
            ]
        )
    )
    plain = draw(st.booleans())
    drawn_wheels = [
        wheel(
            f"w{i}",
            draw(coordinate(3.0)),
            draw(coordinate(2.0)),
            draw(st.sampled_from(kinds)),
            heading=0.0 if plain else draw(st.sampled_from([0.0, math.pi, 0.3, -1.5])),
            sign=1.0 if plain else draw(st.sampled_from([1.0, -1.0])),
            trail=0.0 if plain else draw(st.sampled_from([0.0, 0.0, 0.1, -0.05])),
            lateral=0.0 if plain else draw(st.sampled_from([0.0, 0.0, 0.12, -0.08])),
            radius=draw(st.sampled_from([0.1, 0.2, 0.35])),
            limits=draw(st.sampled_from(LIMITS)),
        )
        for i in range(n)
    ]
    assume(any(w.driven for w in drawn_wheels))
    return drawn_wheels


@st.composite
def casters(draw: st.DrawFn) -> list[WheelGeometry]:
    places = draw(st.lists(st.tuples(coordinate(2.0), coordinate(2.0)), max_size=4))
    return [wheel(f"c{i}", x, y, "swivel") for i, (x, y) in enumerate(places)]


@st.composite
def axle_wheels(draw: st.DrawFn) -> list[WheelGeometry]:
    """Driven wheels on one axle at a random position and heading, with casters."""
    heading = draw(st.sampled_from([0.0, 0.4, math.pi / 2, -2.0]))
    c, s = math.cos(heading), math.sin(heading)
    along = draw(coordinate(1.0))
    places = draw(
        st.lists(coordinate(2.0), min_size=2, max_size=8, unique_by=lambda v: round(v, 1))
    )
    drawn_wheels = [
        wheel(
            f"w{i}",
            c * along - s * place,
            s * along + c * place,
            "fixed" if i < 2 or draw(st.booleans()) else "passive",
            heading=heading + draw(st.sampled_from([0.0, math.pi])),
            radius=draw(st.sampled_from([0.1, 0.2, 0.35])),
        )
        for i, place in enumerate(places)
    ]
    return drawn_wheels + draw(casters())


@st.composite
def tricycle_wheels(draw: st.DrawFn) -> list[WheelGeometry]:
    offset = draw(st.booleans())
    drawn_wheels = [
        wheel(
            "drive",
            draw(st.sampled_from([0.9, -1.2])),
            draw(coordinate(0.5)),
            "steered",
            heading=draw(st.sampled_from([0.0, math.pi, 0.5])),
            sign=draw(st.sampled_from([1.0, -1.0])),
            trail=draw(st.sampled_from([0.0, 0.1])) if offset else 0.0,
            lateral=draw(st.sampled_from([0.0, -0.15])) if offset else 0.0,
            limits=draw(st.sampled_from(LIMITS)),
        )
    ]
    axle = draw(coordinate(0.4))
    places = draw(st.lists(coordinate(1.0), min_size=1, max_size=6))
    drawn_wheels += [wheel(f"p{i}", axle, place, "passive") for i, place in enumerate(places)]
    return drawn_wheels + draw(casters())


SUITED: dict[str, Callable[[], st.SearchStrategy[list[WheelGeometry]]]] = {
    "general": lambda: st.one_of(any_wheels(), axle_wheels(), tricycle_wheels()),
    "differential": axle_wheels,
    "one_wheel": tricycle_wheels,
}


def suited_wheels(name: str) -> st.SearchStrategy[list[WheelGeometry]]:
    """Wheels that the calculator drives; one without a row of its own is given any wheels."""
    if name in SUITED:
        return SUITED[name]()
    cls = calculator_class(name)
    return SUITED["general"]().filter(
        lambda wheels: cls.unsuited_reason(BaseGeometry.from_wheels(wheels)) is None
    )


twists = st.builds(
    Twist,
    st.floats(-1.5, 1.5).map(lambda v: round(v, 4)),
    st.floats(-1.5, 1.5).map(lambda v: round(v, 4)),
    st.floats(-1.5, 1.5).map(lambda v: round(v, 4)),
)


@pytest.fixture(params=PLUGINS.names(), scope="module")
def name(request: pytest.FixtureRequest) -> str:
    chosen_name: str = request.param
    return chosen_name


def make(name: str, wheels: list[WheelGeometry]) -> BaseCalculator:
    cls = calculator_class(name)
    geometry = BaseGeometry.from_wheels(wheels)
    assert cls.unsuited_reason(geometry) is None
    return cls(geometry)


def states_of(calculator: BaseCalculator, twist: Twist) -> tuple[JointStates, Twist, bool]:
    """Joint states that follow the command, the target twist, and whether all is reached."""
    command = calculator.command(twist)
    n = len(calculator.geometry.wheels)
    joints = command.joints
    states = JointStates(0.0, list(joints.speeds), list(joints.angles), [0.0] * n)
    return states, command.target, follows(calculator.geometry, states, command.target)


def follows(geometry: BaseGeometry, states: JointStates, twist: Twist) -> bool:
    """Checks that no wheel slips at this twist, by the velocity of each contact."""
    for i, w in enumerate(geometry.wheels):
        if w.swivel:
            continue
        direction = w.heading + w.sign * states.angles[i]
        c, s = math.cos(direction), math.sin(direction)
        px = w.x + c * w.trail - s * w.lateral
        py = w.y + s * w.trail + c * w.lateral
        ux, uy = twist.vx - twist.wz * py, twist.vy + twist.wz * px
        if abs(c * uy - s * ux) > 1e-12:
            return False
        if w.driven and abs(c * ux + s * uy - states.speeds[i] * w.radius) > 1e-12:
            return False
    return True


def close(a: Twist, b: Twist, bound: float) -> bool:
    return max(abs(p - q) for p, q in zip(a, b, strict=True)) <= bound


def draw_robot(data: st.DataObject, name: str) -> BaseCalculator:
    return make(name, data.draw(suited_wheels(name), label="wheels"))


@SETTINGS
@given(data=st.data())
def test_forward_of_inverse_is_the_twist(name: str, data: st.DataObject) -> None:
    calculator = draw_robot(data, name)
    twist = data.draw(twists)
    states, target, reached = states_of(calculator, twist)
    assume(reached)
    estimate = calculator.odometry(states)
    assume(estimate.rank == 3)
    spread = max(1.0, 1.0 / calculator.geometry.length)
    assert close(estimate.twist, target, 1e-12 * spread**2)


@SETTINGS
@given(data=st.data())
def test_every_steered_wheel_is_reached_or_says_why(name: str, data: st.DataObject) -> None:
    """A contact slips sideways only where the wheel holds or is out of reach."""
    calculator = draw_robot(data, name)
    twist = data.draw(twists)
    command = calculator.command(twist)
    target = command.target
    for i, w in enumerate(calculator.geometry.wheels):
        if not w.steered or i in command.unreachable:
            continue
        speed = math.hypot(target.vx - target.wz * w.y, target.vy + target.wz * w.x)
        if speed / command.scale < RESUME_ABOVE or abs(target.wz * w.trail) >= speed:
            continue
        rolling, side = w.rows(command.joints.angles[i])
        slip = sum(a * b for a, b in zip(side, target, strict=True))
        assert abs(slip) <= speed * LIMIT_TOLERANCE * 1.001 + 1e-12
        if w.driven:
            rolls = sum(a * b for a, b in zip(rolling, target, strict=True))
            assert abs(command.joints.speeds[i] * w.radius - rolls) <= 1e-12


@SETTINGS
@given(data=st.data())
def test_a_flip_does_not_change_the_contact_velocity(name: str, data: st.DataObject) -> None:
    """Started from either end of its range, a wheel without offsets rolls the same way."""
    wheels = data.draw(suited_wheels(name))
    twist = data.draw(twists)
    velocities: list[list[tuple[float, float]]] = []
    for start in (-2.0, 2.0):
        calculator = make(name, wheels)
        n = len(wheels)
        calculator.reset(JointStates(0.0, [0.0] * n, [start] * n, [0.0] * n))
        command = calculator.command(twist)
        joints = command.joints
        directions = [w.heading + w.sign * a for w, a in zip(wheels, joints.angles, strict=True)]
        # Wheels with offsets have other speeds on the other branch, and with them the limit.
        rolling = [v * w.radius / command.scale for v, w in zip(joints.speeds, wheels, strict=True)]
        velocities.append(
            [(v * math.cos(d), v * math.sin(d)) for v, d in zip(rolling, directions, strict=True)]
        )
    for w, velocity, flipped in zip(wheels, *velocities, strict=True):
        if not (w.trail or w.lateral):
            assert velocity == pytest.approx(flipped, abs=1.5 * LIMIT_TOLERANCE)


@SETTINGS
@given(data=st.data())
def test_limits_hold_at_every_tick(name: str, data: st.DataObject) -> None:
    calculator = draw_robot(data, name)
    wheels = calculator.geometry.wheels
    n = len(wheels)
    states = JointStates(0.0, [0.0] * n, [0.0] * n, [0.0] * n)
    calculator.reset(states)
    start = calculator.command(ZERO_TWIST)
    before = list(start.joints.angles)
    rates, speeds = [0.0] * n, [0.0] * n
    dt = 0.02
    for twist in data.draw(st.lists(twists, min_size=1, max_size=4)):
        for _ in range(8):
            command = calculator.command(twist, states, dt)
            for i, w in enumerate(wheels):
                speed, angle = command.joints.speeds[i], command.joints.angles[i]
                assert math.isfinite(speed)
                assert math.isfinite(angle)
                assert abs(speed) <= w.max_speed * (1 + 1e-12)
                if w.driven:
                    assert abs(speed - speeds[i]) <= w.max_acceleration * dt * (1 + 1e-9)
                if w.lower is not None and w.upper is not None:
                    assert w.lower <= angle <= w.upper
                if w.steered:
                    rate = (angle - before[i]) / dt
                    assert abs(rate) <= w.max_rate + 1e-9
                    if abs(angle) not in (w.lower, w.upper):
                        assert abs(rate - rates[i]) <= w.max_rate_change * dt + 1e-6
                    rates[i] = rate
            before, speeds = list(command.joints.angles), list(command.joints.speeds)
            states = JointStates(0.0, list(command.joints.speeds), before, [0.0] * n)


speeds = st.floats(-20.0, 20.0)


@SETTINGS
@given(data=st.data())
def test_a_stop_only_slows_down(name: str, data: st.DataObject) -> None:
    """Whatever is measured and however late a cycle is; a measurement may only slow it further."""
    calculator = draw_robot(data, name)
    calculator.decelerations = (1.5, 1.0)
    n, dt = len(calculator.geometry.wheels), 0.02
    states = JointStates(0.0, [0.0] * n, [0.0] * n, [0.0] * n)
    calculator.reset(states)
    for _ in range(data.draw(st.integers(5, 40))):
        command = calculator.command(data.draw(twists, label="twist"), states, dt)
        states = JointStates(0.0, command.joints.speeds, command.joints.angles, [0.0] * n)
    last, angles = list(command.joints.speeds), command.joints.angles
    stopped = False
    for cycle in range(400):
        late = data.draw(st.sampled_from((1, 1, 1, 2, 11))) if cycle < 12 else 1
        measured = None
        if cycle < 12 and data.draw(st.booleans()):
            feedback = data.draw(st.lists(speeds, min_size=n, max_size=n))
            measured = JointStates(0.0, feedback, angles, [0.0] * n)
        command = calculator.stop(late * dt, measured)
        for i, (before, speed) in enumerate(zip(last, command.joints.speeds, strict=True)):
            assert abs(speed) <= abs(before)
            assert speed * before >= 0.0
            if measured is not None and calculator.geometry.wheels[i].encoder:
                assert abs(speed) <= abs(measured.speeds[i])
        stopped = command.twist == ZERO_TWIST and not any(command.joints.speeds)
        if stopped and command.joints.angles == angles:
            break
        last, angles = list(command.joints.speeds), command.joints.angles
    assert stopped


@SETTINGS
@given(data=st.data())
def test_order_of_the_wheels_does_not_matter(name: str, data: st.DataObject) -> None:
    wheels = data.draw(suited_wheels(name))
    order = data.draw(st.permutations(range(len(wheels))))
    calculator_a, calculator_b = make(name, wheels), make(name, [wheels[i] for i in order])
    for twist in data.draw(st.lists(twists, min_size=1, max_size=3)):
        a, b = calculator_a.command(twist), calculator_b.command(twist)
        assert close(a.target, b.target, 1e-12)
        for j, i in enumerate(order):
            assert abs(a.joints.angles[i] - b.joints.angles[j]) <= 1e-9
            assert abs(a.joints.speeds[i] - b.joints.speeds[j]) <= 1e-9
        n = len(wheels)
        zeros = [0.0] * n
        ea = calculator_a.odometry(JointStates(0.0, a.joints.speeds, a.joints.angles, zeros))
        eb = calculator_b.odometry(JointStates(0.0, b.joints.speeds, b.joints.angles, zeros))
        assert ea.rank == eb.rank
        assert close(ea.twist, eb.twist, 1e-9)


@SETTINGS
@given(data=st.data())
def test_zero_twist_holds(name: str, data: st.DataObject) -> None:
    calculator = draw_robot(data, name)
    before = calculator.command(data.draw(twists))
    after = calculator.command(ZERO_TWIST)
    assert list(after.joints.angles) == list(before.joints.angles)
    assert not any(after.joints.speeds)
    assert after.target == ZERO_TWIST
    assert after.unreachable == ()


@SETTINGS
@given(data=st.data())
def test_scaling_keeps_the_angles(name: str, data: st.DataObject) -> None:
    wheels = data.draw(suited_wheels(name))
    twist, factor = data.draw(twists), data.draw(st.sampled_from([0.25, 0.5, 2.0, 1024.0]))
    calculator_a, calculator_b = make(name, wheels), make(name, wheels)
    fast, slow = sorted((twist, twist.scaled(factor)), key=lambda t: abs(t.speed) + abs(t.wz))
    target = calculator_a.feasible(fast)
    for w in wheels:
        speed = math.hypot(target.vx - target.wz * w.y, target.vy + target.wz * w.x)
        assume(not w.steered or speed == 0.0 or speed > 2 * RESUME_ABOVE)
    a, b = calculator_a.command(fast), calculator_b.command(slow)
    assert list(a.joints.angles) == pytest.approx(list(b.joints.angles), abs=1e-9)


@SETTINGS
@given(data=st.data())
def test_what_is_not_allowed_is_returned(name: str, data: st.DataObject) -> None:
    calculator = draw_robot(data, name)
    twist = data.draw(twists)
    command = calculator.command(twist)
    allowed = calculator.feasible(twist)
    assert close(calculator.feasible(allowed), allowed, 1e-12)
    total = Twist(*(a + b for a, b in zip(allowed, command.infeasible, strict=True)))
    assert close(total, twist, 1e-12)
    assert close(command.target, allowed.scaled(command.scale), 1e-12)
    assert 0.0 < command.scale <= 1.0


@SETTINGS
@given(data=st.data())
def test_bad_numbers_change_nothing(name: str, data: st.DataObject) -> None:
    wheels = data.draw(suited_wheels(name))
    bad = data.draw(st.sampled_from([math.nan, math.inf, -math.inf]))
    first, second = data.draw(twists), data.draw(twists)
    calculator_a, calculator_b = make(name, wheels), make(name, wheels)
    n = len(wheels)
    calculator_a.command(first)
    calculator_b.command(first)
    k = data.draw(st.integers(0, 2))
    values = [*second]
    values[k] = bad
    with pytest.raises(NotFiniteError):
        calculator_a.command(Twist(*values))
    fields = [[0.0] * n, [0.0] * n, [0.0] * n]
    fields[k][data.draw(st.integers(0, n - 1))] = bad
    states = JointStates(0.0, fields[0], fields[1], fields[2])
    with pytest.raises(NotFiniteError):
        calculator_a.odometry(states)
    with pytest.raises(NotFiniteError):
        calculator_a.command(second, states, 0.02)
    with pytest.raises(ValueError, match="joint states"):
        calculator_a.odometry(JointStates(0.0, [0.0] * (n + 1), [0.0] * n, [0.0] * n))
    for dt in (0.0, -0.1, math.nan):
        with pytest.raises(ValueError, match="time step"):
            calculator_a.command(second, None, dt)
    assert calculator_a.command(second) == calculator_b.command(second)


@SETTINGS
@given(data=st.data())
def test_covariance_is_one(name: str, data: st.DataObject) -> None:
    """Symmetric, positive, and larger where the wheels say less."""
    calculator = draw_robot(data, name)
    states, _, _ = states_of(calculator, data.draw(twists))
    estimate = calculator.odometry(states)
    (a, b, c), (b2, d, e), (c2, e2, f) = estimate.covariance
    assert (b, c, e) == (b2, c2, e2)
    assert min(a, d, f) > 0.0
    assert a * d - b * b > 0.0
    if estimate.rank < 3:
        # Whatever is not determined is as uncertain as the top speed.
        top = calculator.geometry.max_wheel_speed
        k = calculator.geometry.length
        assert 0.1 * top * top <= a + d + f * k * k <= 3.001 * top * top + extra(calculator)


def extra(calculator: BaseCalculator) -> float:
    """What the spread of wz adds to that of vx and vy, from the wheels' centre to base_link."""
    x, y = calculator.geometry.centre
    geometry = calculator.geometry
    return float((x * x + y * y) * (geometry.max_wheel_speed / geometry.length) ** 2)


@SETTINGS
@given(data=st.data())
def test_same_commands_give_the_same(name: str, data: st.DataObject) -> None:
    wheels = data.draw(suited_wheels(name))
    calculator_a, calculator_b = make(name, wheels), make(name, wheels)
    for twist in data.draw(st.lists(twists, min_size=1, max_size=4)):
        assert calculator_a.command(twist) == calculator_b.command(twist)
    calculator_a.reset()
    fresh = make(name, wheels)
    assert calculator_a.command(twist) == fresh.command(twist)


@SETTINGS
@given(data=st.data())
def test_a_reached_command_stays_through_rounding(name: str, data: st.DataObject) -> None:
    """Direction at exactly half a turn, with noise of a bit: no wheel changes its mind."""
    calculator = draw_robot(data, name)
    base = data.draw(
        st.sampled_from([Twist(-1.0, 0.0, 0.0), Twist(0.0, 1.0, 0.0), Twist(1.0, 0.0, 0.0)])
    )
    command = calculator.command(base)
    n = len(calculator.geometry.wheels)
    angles = list(command.joints.angles)
    for noise in (1e-17, -1e-17, 1e-9, -1e-9, 0.0, -1e-6, 1e-6):
        states = JointStates(0.0, command.joints.speeds, angles, [0.0] * n)
        twist = Twist(base.vx + noise, base.vy - noise, noise)
        command = calculator.command(twist, states, 0.02)
        assert list(command.joints.angles) == pytest.approx(angles, abs=1e-3)


@SETTINGS
@given(wheels=tricycle_wheels(), twist=twists)
def test_one_wheel_commands_as_general(wheels: list[WheelGeometry], twist: Twist) -> None:
    calculator_a, calculator_b = make("one_wheel", wheels), make("general", wheels)
    a, b = calculator_a.command(twist), calculator_b.command(twist)
    assert list(a.joints.angles) == pytest.approx(list(b.joints.angles), abs=1e-9)
    assert list(a.joints.speeds) == pytest.approx(list(b.joints.speeds), abs=1e-9)


numbers = st.one_of(
    st.floats(-2.0, 2.0),
    st.floats(),
    st.sampled_from([1e308, -1e200, 1e20, 1e9, 1e8, 1e5, 5e-324, math.pi, -math.pi]),
)


@SETTINGS
@given(data=st.data())
def test_any_numbers_give_finite_ones_or_an_error(name: str, data: st.DataObject) -> None:
    calculator = draw_robot(data, name)
    n = len(calculator.geometry.wheels)
    joint = st.lists(numbers, min_size=n, max_size=n)
    for _ in range(3):
        twist = Twist(*(data.draw(numbers) for _ in range(3)))
        states = JointStates(0.0, data.draw(joint), data.draw(joint), data.draw(joint))
        given_states = data.draw(st.sampled_from([None, states]))
        dt = data.draw(st.sampled_from([None, 0.02, 1e-9, 5e-324, 1e9]))
        try:
            command = calculator.command(twist, given_states, dt)
        except NotFiniteError:
            continue
        for value in (*command.joints.speeds, *command.joints.angles, *command.twist):
            assert math.isfinite(value)
        try:
            estimate = calculator.odometry(states)
        except NotFiniteError:
            continue
        assert math.isfinite(sum(estimate.twist) + sum(map(sum, estimate.covariance)))
