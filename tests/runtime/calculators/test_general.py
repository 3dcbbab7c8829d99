"""The general calculator with special arrangements of wheels."""

from __future__ import annotations

import math
import random
from dataclasses import replace

import pytest

from tests.conformance.wheels import wheel
from thorvaldc.runtime.base_interface import JointStates
from thorvaldc.runtime.calculators import BaseCommand, BaseGeometry, WheelGeometry
from thorvaldc.runtime.calculators.general import General, GeneralOptions
from thorvaldc.runtime.se2 import ZERO_TWIST, Twist

SQUARE = [(0.55, 0.45), (0.55, -0.45), (-0.55, 0.45), (-0.55, -0.45)]


def general(*wheels: WheelGeometry, options: GeneralOptions | None = None) -> General:
    return General(BaseGeometry.from_wheels(wheels), options)


def four(*kinds: str) -> list[WheelGeometry]:
    return [
        wheel(f"w{i}", x, y, kind)
        for i, ((x, y), kind) in enumerate(zip(SQUARE, kinds, strict=True))
    ]


def followed(command: BaseCommand) -> JointStates:
    n = len(command.joints.speeds)
    return JointStates(0.0, command.joints.speeds, command.joints.angles, [0.0] * n)


def test_turn_on_the_spot_points_wheels_across_their_arms() -> None:
    calculator = general(*four(*["steered"] * 4))
    command = calculator.command(Twist(0.0, 0.0, 1.0))
    arm = math.hypot(0.55, 0.45)
    for (x, y), angle, speed in zip(
        SQUARE, command.joints.angles, command.joints.speeds, strict=True
    ):
        assert abs(speed * 0.2) == pytest.approx(arm)
        velocity = (speed * 0.2 * math.cos(angle), speed * 0.2 * math.sin(angle))
        assert velocity == pytest.approx((-y, x), abs=1e-12)


def test_every_steered_wheel_gets_the_velocity_of_its_position() -> None:
    rng = random.Random(4)
    for count in (2, 4, 9, 20):
        wheels = [
            replace(
                wheel(
                    f"w{i}",
                    rng.uniform(-2.0, 2.0),
                    rng.uniform(-2.0, 2.0),
                    "swivel" if i and rng.random() < 0.3 else "steered",
                    heading=rng.choice([0.0, 0.3, math.pi]),
                    sign=rng.choice([1.0, -1.0]),
                    radius=rng.choice([0.1, 0.2]),
                    limits=(None, None),
                ),
                max_speed=1e3,
            )
            for i in range(count)
        ]
        calculator = general(*wheels)
        for _ in range(10):
            twist = Twist(*(rng.uniform(-1.0, 1.0) for _ in range(3)))
            joints = calculator.command(twist).joints
            for w, speed, angle in zip(wheels, joints.speeds, joints.angles, strict=True):
                direction, v = w.heading + w.sign * angle, w.radius * speed
                velocity = (v * math.cos(direction), v * math.sin(direction))
                position_velocity = (twist.vx - twist.wz * w.y, twist.vy + twist.wz * w.x)
                expected = position_velocity if w.steered else (0.0, 0.0)
                assert velocity == pytest.approx(expected, abs=1e-12)


def test_fixed_wheels_roll_along_and_a_turned_one_rolls_backwards() -> None:
    calculator = general(
        wheel("l", 0.2, 0.4, "fixed"),
        wheel("r", 0.2, -0.4, "fixed", heading=math.pi),
        wheel("f", 1.0, 0.0, "steered"),
    )
    twist = Twist(0.6, -0.2 * 0.3, 0.3)
    command = calculator.command(twist)
    assert command.joints.speeds[:2] == pytest.approx(((0.6 - 0.12) / 0.2, -(0.6 + 0.12) / 0.2))
    assert calculator.estimator.least_squares(followed(command)) == pytest.approx(twist)


def test_one_fixed_axle_keeps_the_rotation_and_determines_the_lateral_speed() -> None:
    calculator = general(*four("steered", "steered", "fixed", "fixed"))
    command = calculator.command(Twist(0.5, 0.0, 0.3))
    assert command.target == pytest.approx((0.5, 0.3 * 0.55, 0.3))
    assert command.infeasible == pytest.approx((0.0, -0.3 * 0.55, 0.0))
    sideways = calculator.command(Twist(0.0, 0.5, 0.0))
    assert sideways.target == ZERO_TWIST
    assert sideways.infeasible == pytest.approx((0.0, 0.5, 0.0))


def test_two_axles_only_allow_rotation_about_one_point() -> None:
    across = wheel("a", 1.0, 0.0, "fixed", heading=math.pi / 2)
    along = wheel("b", 0.0, 1.0, "fixed")
    calculator = general(across, along)
    allowed = calculator.feasible(Twist(1.0, 1.0, 0.5))
    # Their axle lines are y = 0 and x = 0.
    assert allowed == pytest.approx((0.0, 0.0, 0.5))
    third = wheel("c", 1.0, 1.0, "passive", heading=0.9)
    assert general(across, along, third).feasible(Twist(1.0, 1.0, 0.5)) == ZERO_TWIST


def test_nearly_parallel_wheels_are_one_axle() -> None:
    """Five degrees of toe do not stop the robot."""
    toe = math.radians(5)
    calculator = general(
        wheel("l", 0.0, 0.4, "fixed", heading=toe), wheel("r", 0.0, -0.4, "fixed", heading=-toe)
    )
    command = calculator.command(Twist(0.5, 0.0, 0.2))
    # The mean axle line passes slightly in front of base_link.
    assert command.target == pytest.approx((0.5, -0.2 * 0.4 * math.tan(toe), 0.2), abs=1e-12)


def test_skid_steering_commands_more_and_measures_the_true_rotation() -> None:
    """Wheels at (+-a, +-b) turn the robot by b^2 / (a^2 + b^2) of pure rolling."""
    calculator = general(*four(*["fixed"] * 4))
    twist = Twist(0.0, 0.0, 0.5)
    command = calculator.command(twist)
    gain = (0.55**2 + 0.45**2) / 0.45**2
    assert command.joints.speeds[1] * 0.2 == pytest.approx(gain * 0.45 * 0.5)
    assert command.joints.speeds[0] == pytest.approx(-command.joints.speeds[1])
    estimate = calculator.odometry(followed(command))
    assert estimate.twist == pytest.approx(twist, abs=1e-9)
    arc = Twist(0.6, 0.0, 0.3)
    assert calculator.odometry(followed(calculator.command(arc))).twist == pytest.approx(
        arc, abs=1e-9
    )


def test_two_parallel_fixed_axles_act_as_one_in_the_middle() -> None:
    calculator = general(
        wheel("f", 1.5, 0.0, "steered"),
        wheel("a", -0.4, 0.0, "fixed"),
        wheel("b", -0.8, 0.0, "fixed"),
    )
    assert calculator.command(Twist(0.5, 0.0, 0.2)).target == pytest.approx((0.5, 0.12, 0.2))


def test_saturation_keeps_the_centre_of_rotation() -> None:
    calculator = general(*four(*["steered"] * 4))
    command = calculator.command(Twist(1.4, 0.0, 1.0))
    assert command.scale < 1.0
    assert command.target == pytest.approx(Twist(1.4, 0.0, 1.0).scaled(command.scale))
    assert max(abs(v) for v in command.joints.speeds) == pytest.approx(7.5)
    assert calculator.odometry(followed(command)).twist == pytest.approx(command.target, abs=1e-12)


def test_wheel_at_the_centre_of_rotation_holds() -> None:
    calculator = general(*four(*["steered"] * 4))
    calculator.command(Twist(0.5, 0.1, 0.0))
    before = calculator.command(Twist(0.5, 0.1, 0.0)).joints.angles[0]
    # About the first wheel: v = -w x r.
    command = calculator.command(Twist(0.45 * 0.5, -0.55 * 0.5, 0.5))
    assert command.joints.angles[0] == before
    assert command.joints.speeds[0] == 0.0
    assert command.unreachable == ()
    assert calculator.odometry(followed(command)).twist == pytest.approx(command.target, abs=1e-12)


def test_unreachable_wheel_holds_and_is_listed() -> None:
    wheels = four(*["steered"] * 4)
    wheels[2] = replace(wheels[2], lower=-0.5, upper=0.5)
    calculator = general(*wheels)
    command = calculator.command(Twist(0.0, 0.5, 0.0))
    assert command.unreachable == (2,)
    assert command.joints.speeds[2] == 0.0
    assert command.joints.angles[2] == 0.0
    # With the real angles of the wheels, the others do not drag it along.
    calculator.reset(followed(calculator.command(ZERO_TWIST)))
    command = calculator.command(Twist(0.0, 0.5, 0.0), None, 0.02)
    for _ in range(100):
        command = calculator.command(Twist(0.0, 0.5, 0.0), followed(command), 0.02)
    assert math.hypot(*command.twist[:2]) < 0.05


def test_two_wheels_on_one_steering_joint_turn_together() -> None:
    geometry = BaseGeometry.from_wheels(
        [
            wheel("twin_l", 0.5, 0.0, "steered", lateral=0.1),
            wheel("twin_r", 0.5, 0.0, "steered", lateral=-0.1),
            wheel("p", -0.5, 0.0, "passive"),
        ],
        steering=["s", "s", None],
    )
    calculator = General(geometry)
    twist = Twist(0.5, 0.25, 0.5)
    command = calculator.command(twist)
    left, right, _ = command.joints.angles
    assert left == right
    assert calculator.odometry(followed(command)).twist == pytest.approx(command.target, abs=1e-12)


def test_two_wheels_on_one_axle_get_one_speed() -> None:
    geometry = BaseGeometry.from_wheels(
        [
            wheel("a", 0.0, 0.55, "fixed"),
            wheel("b", 0.0, 0.45, "fixed"),
            wheel("c", 0.0, -0.5, "fixed"),
        ],
        spin=["one", "one", "other"],
    )
    speeds = General(geometry).command(Twist(0.5, 0.0, 0.4)).joints.speeds
    assert speeds[0] == speeds[1] == pytest.approx((0.5 - 0.4 * 0.5) / 0.2)


def scrub(twist: Twist, coordinated: bool) -> float:
    """Mean distance (m) that four contacts slip while their wheels turn from forward to a twist.

    The robot moves as the unweighted least-squares fit of its wheel velocities.
    """
    wheels = [replace(w, max_rate=2.0, max_speed=100.0) for w in four(*["steered"] * 4)]
    calculator, dt, slipped = general(*wheels), 0.01, 0.0
    goals = general(*wheels).command(twist).joints
    angles, speeds = [0.0] * 4, [0.0] * 4
    for _ in range(150):
        command = calculator.command(twist, JointStates(0.0, speeds, angles, [0.0] * 4), dt)
        speeds = list(command.joints.speeds)
        if not coordinated:
            away = [a - goal for a, goal in zip(angles, goals.angles, strict=True)]
            speeds = [v * math.cos(a) for v, a in zip(goals.speeds, away, strict=True)]
        ux = [0.2 * v * math.cos(a) for v, a in zip(speeds, angles, strict=True)]
        uy = [0.2 * v * math.sin(a) for v, a in zip(speeds, angles, strict=True)]
        pairs = list(zip(SQUARE, ux, uy, strict=True))
        wz = sum(x * b - y * a for (x, y), a, b in pairs) / sum(x * x + y * y for x, y in SQUARE)
        vx, vy = sum(ux) / 4, sum(uy) / 4
        slip = sum(math.hypot(vx - wz * y - a, vy + wz * x - b) for (x, y), a, b in pairs)
        slipped += slip / 4 * dt
        angles = list(command.joints.angles)
    return slipped


def test_coordinated_speeds_scrub_far_less_than_the_cosine_rule() -> None:
    random.seed(0)
    twists = [Twist(*(random.uniform(-1.0, 1.0) for _ in range(3))) for _ in range(10)]
    ours = sum(scrub(twist, coordinated=True) for twist in twists)
    cosine = sum(scrub(twist, coordinated=False) for twist in twists)
    assert ours < cosine / 10.0


def test_offset_contacts_do_not_push_the_robot_while_they_turn() -> None:
    """Wheels with contacts beside and behind the steering axis turn to a new motion.

    During the motion, the odometry of the joints agrees with the twist of the command.
    """
    wheels = [
        wheel("a", 0.5, 0.4, "steered", lateral=0.1, trail=-0.08),
        wheel("b", 0.5, -0.4, "steered", lateral=-0.1, sign=-1.0, trail=-0.08),
        wheel("c", -0.5, 0.0, "steered", lateral=0.1, heading=0.5),
    ]
    calculator, dt = general(*(replace(w, max_acceleration=1e3) for w in wheels)), 0.01
    angles = [0.0] * 3
    states = JointStates(0.0, [0.0] * 3, angles, [0.0] * 3)
    calculator.reset(states)
    worst = 0.0
    for k in range(250):
        twist = Twist(0.3, 0.0, 0.0) if k < 60 else Twist(0.0, 0.3, 0.2)
        command = calculator.command(twist, states, dt)
        rates = [(b - a) / dt for a, b in zip(angles, command.joints.angles, strict=True)]
        estimate = calculator.odometry(JointStates(0.0, command.joints.speeds, angles, rates)).twist
        apart = [abs(a - b) for a, b in zip(estimate, command.twist, strict=True)]
        worst = max(worst, *apart)
        angles = list(command.joints.angles)
        states = JointStates(0.0, command.joints.speeds, angles, rates)
    assert worst < 0.12
    assert command.twist == pytest.approx((0.0, 0.3, 0.2), abs=1e-9)


def test_option_arrive_together() -> None:
    def arrivals(together: bool) -> set[int]:
        calculator = general(
            *four(*["steered"] * 4), options=GeneralOptions(arrive_together=together)
        )
        twist = Twist(0.3, 0.1, 0.5)
        goal = general(*four(*["steered"] * 4)).command(twist).joints.angles
        arrival_ticks: dict[int, int] = {}
        for tick in range(100):
            angles = calculator.command(twist, None, 0.02).joints.angles
            for i in range(4):
                if i not in arrival_ticks and abs(angles[i] - goal[i]) < 0.02:
                    arrival_ticks[i] = tick
        return set(arrival_ticks.values())

    assert max(arrivals(True)) - min(arrivals(True)) <= 4
    assert max(arrivals(False)) - min(arrivals(False)) > 4


def test_servo_errors_cost_no_speed() -> None:
    """With half a degree of error at every wheel, the robot keeps its commanded speed."""
    calculator = general(*four(*["steered"] * 4))
    states = followed(calculator.command(Twist(0.8, 0.0, 0.2)))
    states.angles = [a + math.radians(0.5) * (-1) ** i for i, a in enumerate(states.angles)]
    command = calculator.command(Twist(0.8, 0.0, 0.2), states, 0.02)
    assert command.twist == command.target == Twist(0.8, 0.0, 0.2)
    # Thirty degrees cost speed: wheels that point apart roll slowly.
    states.angles = [a + math.radians(30.0) * (-1) ** i for i, a in enumerate(states.angles)]
    for _ in range(100):
        command = calculator.command(Twist(0.8, 0.0, 0.2), states, 0.02)
    assert command.twist.speed < 0.1


def test_motors_keep_their_accelerations_together() -> None:
    wheels = four(*["steered"] * 4)
    wheels[1] = replace(wheels[1], max_acceleration=1.0)
    calculator = general(*wheels)
    dt, before = 0.02, [0.0] * 4
    for tick in range(200):
        command = calculator.command(Twist(0.5, 0.0, 0.0), None, dt)
        speeds = list(command.joints.speeds)
        assert abs(speeds[1] - before[1]) <= 1.0 * dt + 1e-12
        assert speeds == pytest.approx([speeds[0]] * 4)
        assert command.twist.vx == pytest.approx(0.2 * speeds[0])
        if tick < 100:
            assert speeds[0] == pytest.approx((tick + 1) * dt)
        before = speeds
    assert speeds[0] == pytest.approx(2.5)


def test_required_rates_show_late_wheels() -> None:
    calculator = general(*four(*["steered"] * 4))
    calculator.command(Twist(0.5, 0.0, 0.0))
    command = calculator.command(Twist(0.5, 0.0, 0.0), None, 0.02)
    assert list(command.required_rates) == [0.0] * 4
    command = calculator.command(Twist(0.0, 0.5, 0.0), None, 0.02)
    assert list(map(abs, command.required_rates)) == pytest.approx([math.pi / 2 / 0.02] * 4)
    assert max(map(abs, command.required_rates)) > 4.0
    assert not any(calculator.command(Twist(0.5, 0.1, 0.0)).required_rates)


def test_robots_without_a_drive_are_rejected() -> None:
    assert General.unsuited_reason(BaseGeometry.from_wheels([])) == "it has no wheels"
    geometry = BaseGeometry.from_wheels([wheel("c", 0.0, 0.0, "swivel")])
    assert "motor" in str(General.unsuited_reason(geometry))


def test_commanded_twist_fits_the_wheel_speeds_while_wheels_turn_and_accelerate() -> None:
    """No twist has rolling speeds that are much nearer to the commanded ones."""
    rng = random.Random(8)
    for _ in range(10):
        wheels = [
            wheel(
                f"w{i}",
                *SQUARE[i],
                "steered" if i < 3 else "fixed",
                lateral=rng.uniform(-0.1, 0.1) if i < 3 else 0.0,
                trail=rng.uniform(-0.1, 0.1) if i < 3 else 0.0,
                radius=rng.choice([0.1, 0.2]),
            )
            for i in range(4)
        ]
        calculator, dt = general(*wheels), 0.02
        states = JointStates(0.0, [0.0] * 4, [0.0] * 4, [0.0] * 4)
        calculator.reset(states)
        for k in range(150):
            if k % 50 == 0:
                twist = Twist(*(rng.uniform(-1.0, 1.0) for _ in range(3)))
            command = calculator.command(twist, states, dt)
            angles = command.joints.angles
            rates = [(b - a) / dt for a, b in zip(states.angles, angles, strict=True)]
            vx, vy, wz = command.target
            holding = any(math.hypot(vx - wz * w.y, vy + wz * w.x) < 2e-3 for w in wheels)
            slope = [0.0, 0.0, 0.0]
            for w, angle, rate, speed in zip(
                wheels, states.angles, rates, command.joints.speeds, strict=True
            ):
                rolling, _ = w.rows(angle)
                turning = sum(a * b for a, b in zip(rolling, command.twist, strict=True))
                gap = speed * w.radius + w.lateral * w.sign * rate - turning
                slope = [s + gap * row for s, row in zip(slope, rolling, strict=True)]
            # While it stops, the pushes of joints that no longer turn fade with all speeds.
            assert holding or command.must_stop or max(map(abs, slope)) < 0.02
            assert max(map(abs, command.twist)) < 3.0
            states = JointStates(0.0, command.joints.speeds, angles, rates)


def test_wheels_without_acceleration_limits_have_the_speeds_of_the_commanded_twist() -> None:
    wheels = [
        wheel("a", 0.5, 0.4, "steered", lateral=0.1, trail=-0.08),
        wheel("b", 0.5, -0.4, "steered", lateral=-0.1, sign=-1.0, trail=-0.08),
        wheel("c", -0.5, 0.0, "steered", lateral=0.1, heading=0.5),
    ]
    calculator, dt = general(*(replace(w, max_acceleration=1e6) for w in wheels)), 0.01
    states = JointStates(0.0, [0.0] * 3, [0.0] * 3, [0.0] * 3)
    calculator.reset(states)
    for k in range(200):
        twist = Twist(0.3, 0.0, 0.0) if k < 60 else Twist(0.0, 0.3, 0.2)
        command = calculator.command(twist, states, dt)
        angles, speeds = command.joints.angles, command.joints.speeds
        rates = [(b - a) / dt for a, b in zip(states.angles, angles, strict=True)]
        turning = max(map(abs, rates)) > 1e-3
        for w, angle, rate, speed in zip(wheels, states.angles, rates, speeds, strict=True):
            rolling, _ = w.rows(angle)
            rolls = speed * w.radius + w.lateral * w.sign * rate
            if turning and abs(rate) * dt > 0.0175:
                made = sum(a * b for a, b in zip(rolling, command.twist, strict=True))
                assert rolls == pytest.approx(made, abs=1e-9)
        states = JointStates(0.0, speeds, angles, rates)


def test_turning_contact_points_do_not_make_the_robot_faster_than_its_target() -> None:
    """Wheels with trail turn from one side to the other while the robot is to move slowly."""
    wheels = [
        wheel(f"w{i}", x, y, "steered", trail=0.1, limits=(None, None))
        for i, (x, y) in enumerate(SQUARE[:3])
    ]
    calculator, dt = general(*wheels), 0.02
    states = JointStates(0.0, [0.0] * 3, [0.0] * 3, [0.0] * 3)
    calculator.reset(states)
    turned = 0.0
    for _ in range(50):
        command = calculator.command(Twist(0.0, 0.05, 0.0), states, dt)
        turned = max(turned, *map(abs, command.joints.angles))
        assert max(abs(v) * 0.2 for v in command.joints.speeds) < 0.06
        states = JointStates(0.0, command.joints.speeds, command.joints.angles, [0.0] * 3)
    assert turned > 1.5


def test_drive_follows_its_turning_joint_before_the_robot_accelerates() -> None:
    """A contact point beside the steering axis rolls exactly as far as its joint turns."""
    wheels = [
        wheel(f"w{i}", x, y, "steered", lateral=0.1, limits=(None, None), radius=0.1)
        for i, (x, y) in enumerate(SQUARE[:3])
    ]
    calculator, dt = general(*wheels), 0.02
    states = JointStates(0.0, [0.0] * 3, [0.0] * 3, [0.0] * 3)
    calculator.reset(states)
    fastest, last = 0.0, [0.0] * 3
    for _ in range(60):
        command = calculator.command(Twist(0.0, 0.02, 0.0), states, dt)
        angles, speeds = command.joints.angles, command.joints.speeds
        rates = [(b - a) / dt for a, b in zip(states.angles, angles, strict=True)]
        fastest = max(fastest, *map(abs, rates))
        for w, rate, speed, before in zip(wheels, rates, speeds, last, strict=True):
            assert abs(speed * w.radius + w.lateral * rate) < 0.03
            assert abs(speed - before) <= w.max_acceleration * dt * (1.0 + 1e-9)
        states, last = JointStates(0.0, speeds, angles, rates), list(speeds)
    assert fastest > 1.0
