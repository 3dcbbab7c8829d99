"""The complete model: kinematics, names, motors, settings, spans."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from tests.workshop import CART, MODULES, Workshop
from thorvaldc.model import Cylinder, Robot, Wheel

SOURCE = 'source: "chosen: for a test"'


def leg(name: str, mount: str, params: str = "") -> str:
    params_text = f", params: {{{params}}}" if params else ""
    return f"{name}: {{type: t/leg, mount: {{parent: body, {mount}}}{params_text}}}"


def on_plate(*lines: str, params: str = "") -> str:
    """Returns a plate with these legs; ``params`` are those of all legs without own ones."""
    params_text = f", params: {{{params}}}}}" if params else "}"
    lines = tuple(x if "params:" in x else x.removesuffix("}") + params_text for x in lines)
    return "\n".join(["body: {type: t/plate}", *lines])


def wheel(robot: Robot, module: str) -> Wheel:
    (wheel_of_module,) = [w for w in robot.wheels if w.module == module]
    return wheel_of_module


def rotation(roll: float, pitch: float, yaw: float) -> np.ndarray[Any, Any]:
    """Returns the matrix of roll, pitch and yaw about fixed axes, multiplied out."""
    (cr, sr), (cp, sp), (cy, sy) = ((math.cos(a), math.sin(a)) for a in (roll, pitch, yaw))
    about_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    about_z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return np.asarray(about_z @ about_y @ about_x)


def frames(robot: Robot) -> dict[str, np.ndarray[Any, Any]]:
    """Returns the poses of all links in base_link as 4x4 matrices, computed from the joints."""
    frames_by_link = {"base_link": np.eye(4)}
    waiting = list(robot.joints)
    while waiting:
        joint = next(j for j in waiting if j.parent in frames_by_link)
        waiting.remove(joint)
        w, x, y, z = joint.pose.quat
        step = np.eye(4)
        step[:3, :3] = [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
        step[:3, 3] = joint.pose.xyz
        frames_by_link[joint.child] = frames_by_link[joint.parent] @ step
    return frames_by_link


THREE = (
    leg("a", "xyz: [0.5, 0.4, 0]"),
    leg("b", "xyz: [0.5, -0.4, 0]"),
    leg("c", "xyz: [-0.5, 0, 0]"),
)


# -- wheel geometry --------------------------------------------------------------------


def test_a_wheel_stands_below_its_mount_and_the_frame_at_its_height(workshop: Workshop) -> None:
    robot = workshop.robot(on_plate(*THREE))
    assert [(w.x, w.y, w.heading, w.contact_height) for w in robot.wheels] == [
        (0.5, 0.4, 0.0, 0.0),
        (0.5, -0.4, 0.0, 0.0),
        (-0.5, 0.0, 0.0, 0.0),
    ]
    assert robot.joint("body_mount").pose.xyz == (0.0, 0.0, 0.6)
    assert robot.links[0].name == "base_link"
    assert robot.joint("body_mount").parent == "base_link"


@pytest.mark.parametrize("degrees", [0, 30, 90, 135, 180, -90, -179])
def test_rotated_mount_rotates_the_heading(workshop: Workshop, degrees: int) -> None:
    turned = leg("a", f"xyz: [0.5, 0.4, 0], rpy: [0, 0, {degrees} deg]")
    robot = workshop.robot(on_plate(turned, *THREE[1:], params="turns: steers"))
    left_wheel = wheel(robot, "a")
    assert (left_wheel.x, left_wheel.y) == (0.5, 0.4)
    difference = math.remainder(left_wheel.heading - math.radians(degrees), 2 * math.pi)
    assert difference == pytest.approx(0.0, abs=1e-9)
    assert left_wheel.steering_sign == 1.0


@pytest.mark.parametrize("yaw", [0, 40, 180, 270])
def test_trail_and_lateral_offset_of_an_offset_axle(workshop: Workshop, yaw: int) -> None:
    mount = f"xyz: [0.5, 0.4, 0], rpy: [0, 0, {yaw} deg]"
    caster = leg("a", mount, "turns: swivels, trail: 0.07, aside: 0.03")
    robot = workshop.robot(on_plate(caster, *THREE[1:]))
    left_wheel = wheel(robot, "a")
    assert (left_wheel.x, left_wheel.y) == (0.5, 0.4)
    assert (left_wheel.trail, left_wheel.lateral_offset) == pytest.approx((-0.07, 0.03))
    assert left_wheel.swivel_joint == "a_swivel"
    assert left_wheel.steering_joint is None


def test_position_of_a_fixed_wheel_is_its_contact_point(workshop: Workshop) -> None:
    robot = workshop.robot(on_plate(leg("a", "xyz: [0.5, 0.4, 0]", "trail: 0.07"), *THREE[1:]))
    left_wheel = wheel(robot, "a")
    assert (left_wheel.x, left_wheel.y, left_wheel.trail) == (0.43, 0.4, 0.0)


def test_reversed_axle_reverses_the_heading(workshop: Workshop) -> None:
    workshop.module(
        "t/back",
        f"""
        mount: {{kinds: [clamp], link: post}}
        links:
          post: {{}}
          tyre: {{parts: [{{shape: {{sphere: {{radius: 0.2}}}}, mass: 5 kg, {SOURCE}}}]}}
        joints:
          axle: {{type: continuous, parent: post, child: tyre, xyz: [0, 0, -0.4], axis: [0, -2, 0]}}
        wheel: {{link: tyre, radius: 0.2, width: 0.1, {SOURCE}}}
        """,
    )
    robot = workshop.robot(on_plate(*THREE).replace("a: {type: t/leg", "a: {type: t/back"))
    assert abs(wheel(robot, "a").heading) == pytest.approx(math.pi)
    assert robot.joint("a_axle").axis == (0.0, -1.0, 0.0)


def test_inverted_steering_axis_has_negative_sign(workshop: Workshop) -> None:
    workshop.module(
        "t/below",
        f"""
        mount: {{kinds: [clamp], link: post}}
        links:
          post: {{parts: [{{shape: {{sphere: {{radius: 0.02}}}}, mass: 2 kg, {SOURCE}}}]}}
          fork: {{parts: [{{shape: {{sphere: {{radius: 0.02}}}}, mass: 1 kg, {SOURCE}}}]}}
          tyre: {{parts: [{{shape: {{sphere: {{radius: 0.2}}}}, mass: 5 kg, {SOURCE}}}]}}
        joints:
          turn: {{type: continuous, role: steering, parent: post, child: fork, axis: [0, 0, -1]}}
          axle: {{type: continuous, parent: fork, child: tyre, xyz: [0, 0, -0.4], axis: [0, 1, 0]}}
        wheel: {{link: tyre, radius: 0.2, width: 0.1, {SOURCE}}}
        """,
    )
    robot = workshop.robot(on_plate(*THREE).replace("a: {type: t/leg", "a: {type: t/below"))
    assert wheel(robot, "a").steering_sign == -1.0
    assert wheel(robot, "a").heading == 0.0


@pytest.mark.parametrize("degrees", [5, 20, -20])
def test_a_wheel_with_camber_stands_on_its_lowest_point(workshop: Workshop, degrees: int) -> None:
    roll = math.radians(degrees)
    down = 0.6 * (1 - math.cos(roll))
    mount = f"xyz: [0.5, 0.4, {-down:.12f}], rpy: [{degrees} deg, 0, 0]"
    robot = workshop.robot(on_plate(leg("a", mount), *THREE[1:]), warned=("tip-over",))
    rim = np.array([0.5, 0.4, 0.6 - down]) + rotation(roll, 0, 0) @ np.array([0, 0, -0.6])
    left_wheel = wheel(robot, "a")
    assert (left_wheel.x, left_wheel.y) == pytest.approx((rim[0], rim[1]))
    assert left_wheel.heading == pytest.approx(0.0)
    assert left_wheel.contact_height == pytest.approx(rim[2], abs=1e-9)


def test_frame_height_follows_from_the_lowest_wheel(workshop: Workshop) -> None:
    def robot(drop: float) -> Robot:
        return workshop.robot(
            on_plate(
                leg("a", "xyz: [0.5, 0.4, 0]", "radius: 0.15, drop: 0.45"),
                leg("b", "xyz: [0.5, -0.4, 0]", "radius: 0.15, drop: 0.45"),
                leg("c", "xyz: [-0.5, 0, 0]", f"radius: 0.3, drop: {drop}"),
            )
        )

    level = robot(0.3)
    assert [w.radius for w in level.wheels] == [0.15, 0.15, 0.3]
    assert [w.contact_height for w in level.wheels] == [0.0, 0.0, 0.0]
    assert level.joint("body_mount").pose.xyz[2] == 0.6
    raised = robot(0.299)
    assert wheel(raised, "c").contact_height == pytest.approx(0.001)
    assert raised.joint("body_mount").pose.xyz[2] == 0.6
    lowered = robot(0.301)
    assert wheel(lowered, "c").contact_height == 0.0
    assert wheel(lowered, "a").contact_height == pytest.approx(0.001)
    assert lowered.joint("body_mount").pose.xyz[2] == pytest.approx(0.601)


@pytest.mark.parametrize(
    "mount",
    [
        "xyz: [0.5, 0.4, 0]",
        "xyz: [0.5, 0.4, 0.1], rpy: [0.1, -0.2, 0.7]",
        "xyz: [0.2, -0.4, -0.1], rpy: [0.3, 0.1, 2.5]",
    ],
)
def test_link_poses_agree_with_matrices(workshop: Workshop, mount: str) -> None:
    numbers = [float(n) for n in mount.translate(str.maketrans("xyzrp:[],", " " * 9)).split()]
    xyz, rpy = numbers[:3], numbers[3:] or [0.0, 0.0, 0.0]
    robot = workshop.robot(CART + f"    part: {{type: t/block, mount: {{parent: body, {mount}}}}}")
    expected = np.eye(4)
    expected[:3, :3] = rotation(rpy[0], rpy[1], rpy[2])
    expected[:3, 3] = [xyz[0], xyz[1], xyz[2] + 0.6]
    np.testing.assert_allclose(frames(robot)["part_box"], expected, atol=1e-11)


def test_rotated_port_rotates_the_mounted_module(workshop: Workshop) -> None:
    robot = workshop.robot(
        CART + "    part: {type: t/block, mount: {port: body.rear, xyz: [0.2, 0.1, 0]}}"
    )
    np.testing.assert_allclose(frames(robot)["part_box"][:3, 3], [-0.7, -0.1, 0.6], atol=1e-12)


def test_wheel_link_has_a_collision_cylinder(workshop: Workshop) -> None:
    robot = workshop.robot(on_plate(*THREE))
    (collision,) = robot.link("a_tyre").collisions
    assert collision.shape == Cylinder(0.2, 0.1)
    along = collision.pose.rotate((0.0, 0.0, 1.0))
    assert (abs(along[1]), along[0], along[2]) == pytest.approx((1.0, 0.0, 0.0), abs=1e-9)


def test_a_tyre_that_a_module_repeats_collides_once(workshop: Workshop) -> None:
    """Shapes of another place, size or kind stay: guards and hubs of the wheel."""
    part = 'shape: {cylinder: {radius: "${radius}", length: 0.1}}'
    lines = [
        f"shape: {{cylinder: {{radius: {radius}, length: 0.1}}}}, rpy: [90 deg, 0, 0]"
        for radius in (0.203, 0.1)
    ]
    extra = "".join(f"{{{line}, collide: true}}\n{' ' * 14}- " for line in lines)
    text = MODULES["t/leg"]
    assert part in text
    workshop.module("t/leg", text.replace(part, extra + part))
    robot = workshop.robot(on_plate(*THREE))
    shapes = [collision.shape for collision in robot.link("a_tyre").collisions]
    assert shapes == [Cylinder(0.2, 0.1), Cylinder(0.1, 0.1)]


# -- masses --------------------------------------------------------------------------------


def test_robot_inertia_agrees_with_parallel_axis_theorem_in_numpy(workshop: Workshop) -> None:
    robot = workshop.robot(
        CART
        + """
    p:
      type: t/block
      mount: {parent: body, xyz: [0.1, 0.2, 0.3], rpy: [0.3, 0.2, 0.1]}
      params: {mass: 17, size: [0.3, 0.2, 0.1]}
    q:
      type: t/block
      mount: {parent: p, xyz: [0, -0.4, 0.1], rpy: [0, 1, 0]}
      params: {mass: 4, size: [0.1, 0.5, 0.2]}
    """
    )
    placed = frames(robot)
    mass, first, about_origin = 0.0, np.zeros(3), np.zeros((3, 3))
    for link in robot.links:
        if link.inertial is None:
            continue
        inertial, turn = link.inertial, placed[link.name][:3, :3]
        r = (placed[link.name] @ np.array([*inertial.com, 1.0]))[:3]
        xx, yy, zz, xy, xz, yz = inertial.inertia
        tensor = turn @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ turn.T
        mass += inertial.mass
        first += inertial.mass * r
        about_origin += tensor + inertial.mass * (r @ r * np.eye(3) - np.outer(r, r))
    com = first / mass
    about_com = about_origin - mass * (com @ com * np.eye(3) - np.outer(com, com))
    assert robot.inertial.mass == pytest.approx(mass, rel=1e-11)
    np.testing.assert_allclose(robot.inertial.com, com, atol=1e-11)
    xx, yy, zz, xy, xz, yz = robot.inertial.inertia
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    np.testing.assert_allclose(inertia, about_com, rtol=1e-9, atol=1e-10)


def test_wheel_loads_add_up_to_the_weight(workshop: Workshop) -> None:
    robot = workshop.robot(
        CART + "    p: {type: t/block, mount: {parent: body, xyz: [0.2, 0.1, 0]}}"
    )
    weight = robot.inertial.mass * 9.81
    assert sum(w.load for w in robot.wheels) == pytest.approx(weight)
    for axis, place in ((0, "x"), (1, "y")):
        moment = sum(w.load * getattr(w, place) for w in robot.wheels)
        assert moment == pytest.approx(weight * robot.inertial.com[axis])


# -- springs --------------------------------------------------------------------------------

SPRUNG = f"""
params:
  stiffness: {{quantity: stiffness, default: 10 kN/m, description: Of it., {SOURCE}}}
  up: {{type: integer, default: 1, description: Of the axis., {SOURCE}}}
mount: {{kinds: [clamp], link: guide}}
links:
  guide: {{parts: [{{shape: {{sphere: {{radius: 0.02}}}}, mass: 1 kg, {SOURCE}}}]}}
  carriage: {{parts: [{{shape: {{sphere: {{radius: 0.02}}}}, mass: 1 kg, {SOURCE}}}]}}
joints:
  travel:
    type: prismatic
    role: suspension
    parent: guide
    child: carriage
    axis: [0, 0, "${{up}}"]
    lower: -50 mm
    upper: 50 mm
    spring: {{stiffness: "${{stiffness}}", damping: 300 N s/m}}
ports:
  carriage: {{kind: carriage, link: carriage}}
"""


@pytest.mark.parametrize("up", [1, -1])
def test_spring_joint_is_at_zero_under_static_load(workshop: Workshop, up: int) -> None:
    workshop.module("t/sprung", SPRUNG)
    text = ["body: {type: t/plate}"]
    for name, x, y in (("fl", 0.5, 0.4), ("fr", 0.5, -0.4), ("rl", -0.5, 0.4), ("rr", -0.5, -0.4)):
        text.append(
            f"s{name}: {{type: t/sprung, mount: {{parent: body, xyz: [{x}, {y}, 0]}}, "
            f"params: {{up: {up}}}}}"
        )
        text.append(f"{name}: {{type: t/leg, mount: s{name}.carriage}}")
    robot = workshop.robot("\n".join(text))
    # 100 kg + 4 (1 + 1 + 8) kg; each spring carries a quarter of the body and its own guide.
    force = (100 / 4 + 1) * 9.81
    for name in ("fl", "fr", "rl", "rr"):
        joint = robot.joint(f"s{name}_travel")
        assert joint.stiffness == 10000.0
        assert joint.damping == 300.0
        assert joint.spring_reference == pytest.approx(-up * force / 10000.0)
        assert wheel(robot, name).suspension_joint == f"s{name}_travel"


# -- motors, limits, settings -----------------------------------------------------------------


def test_limits_at_the_joint_follow_from_motor_and_gear(workshop: Workshop) -> None:
    robot = workshop.robot(on_plate(*THREE, params="turns: steers, torque: 40, limit: 100 deg"))
    drive = next(a for a in robot.actuators if a.name == "a_propulsion")
    assert drive.max_velocity == 10.0  # 100 rad/s through 10:1
    assert drive.armature == pytest.approx(1e-4 * 100)
    assert (drive.gear_ratio, drive.encoder_ppr, drive.max_torque) == (10.0, 1000, 40.0)
    axle = robot.joint("a_axle")
    assert (axle.effort, axle.velocity, axle.armature) == (40.0, 10.0, drive.armature)
    steering = robot.joint("a_steering")
    assert (steering.lower, steering.upper) == pytest.approx(
        (-math.radians(100), math.radians(100))
    )
    assert wheel(robot, "a").driven
    assert wheel(robot, "a").steered


def test_slowest_module_limits_the_driver(workshop: Workshop) -> None:
    text = on_plate(leg("a", "xyz: [0.5, 0.4, 0]", "radius: 0.1, drop: 0.5"), *THREE[1:])
    settings = workshop.robot(text).driver
    assert (settings.rate, settings.command_timeout) == (50.0, 0.5)
    assert settings.max_linear_velocity == pytest.approx(10.0 * 0.1)
    assert settings.max_linear_acceleration == pytest.approx(5.0 * 0.1)
    assert settings.max_angular_velocity == pytest.approx(1.0 / math.hypot(0.5, 0.4))
    head = "driver: {rate: 20, command_timeout: 300 ms, max_linear_velocity: 0.7 m/s}\n"
    stated = workshop.robot(text, head).driver
    assert (stated.rate, stated.command_timeout, stated.max_linear_velocity) == (20.0, 0.3, 0.7)
    assert stated.max_angular_velocity == settings.max_angular_velocity


def test_a_calculator_with_options(workshop: Workshop) -> None:
    head = "base_calculator: {name: general, options: {hysteresis: 0.2}}\n"
    assert workshop.robot(CART, head).calculator.options == (("hysteresis", 0.2),)
    assert workshop.robot(CART).calculator.name == "general"


def test_properties_of_sensors_and_batteries_are_in_si(workshop: Workshop) -> None:
    body = f"""
    mount: {{kinds: [clamp], link: box}}
    links:
      box: {{parts: [{{shape: {{box: [0.1, 0.1, 0.1]}}, mass: 1 kg, {SOURCE}}}]}}
      eye: {{}}
    joints:
      look: {{type: fixed, parent: box, child: eye, xyz: [0.1, 0, 0]}}
    sensor: {{type: lidar_2d, link: eye, properties: {{range: 25 m, rate: 40 Hz, name: "3 m"}}}}
    battery: {{present: false, link: box, properties: {{capacity: 10 Ah, cells: 14}}}}
    """
    robot = workshop.part(body)
    (sensor,) = robot.sensors
    assert (sensor.name, sensor.type, sensor.link) == ("part", "lidar_2d", "part_eye")
    assert sensor.properties == (("range", 25.0), ("rate", 40.0), ("name", "3 m"))
    (battery,) = robot.batteries
    assert (battery.node, battery.properties) == (None, (("capacity", 36000.0), ("cells", 14)))


# -- names and spans ----------------------------------------------------------------------------


def test_names_are_stable_when_modules_are_added_or_moved(workshop: Workshop) -> None:
    first_robot = workshop.robot(on_plate(*THREE))
    after = workshop.robot(on_plate(leg("d", "xyz: [-0.5, 0.45, 0]"), *reversed(THREE)))
    assert {x.name for x in first_robot.links} < {x.name for x in after.links}
    assert {x.name for x in first_robot.joints} < {x.name for x in after.joints}
    assert {x.name for x in first_robot.actuators} < {x.name for x in after.actuators}


def test_model_order_is_file_order_depth_first(workshop: Workshop) -> None:
    robot = workshop.robot(
        """
    frame: {type: frame/tube_rectangular}
    rr: {type: assembly/steered_drive, mount: frame.rear_right}
    fl: {type: assembly/steered_drive, mount: frame.front_left}
    fr: {type: assembly/steered_drive, mount: frame.front_right}
    """,
        warned=("tip-over", "unstable"),
    )
    modules = [x.module.split(".")[0] for x in robot.links]
    assert [m for m, n in pairwise([*modules, ""]) if m != n] == ["", "frame", "rr", "fl", "fr"]
    assert [w.module for w in robot.wheels] == ["rr.wheel", "fl.wheel", "fr.wheel"]


def test_every_element_has_the_span_of_its_robot_file_entry(workshop: Workshop) -> None:
    robot = workshop.robot(on_plate(*THREE))
    lines = {"body": 5, "a": 6, "b": 7, "c": 8}
    elements = [*robot.links[1:], *robot.joints, *robot.wheels, *robot.actuators]
    assert {(e.span.file, e.span.line) for e in elements if e.module == "b"} == {("robot.yaml", 7)}
    assert all(e.span.line == lines[e.module] for e in elements)
    assert robot.links[0].span.line == 2


def test_modules_of_one_type_have_their_own_parameters(workshop: Workshop) -> None:
    text = on_plate(leg("a", "xyz: [0.5, 0.4, 0]", "radius: 0.1, drop: 0.5"), *THREE[1:])
    robot = workshop.robot(text)
    tyres = {x.name: x.collisions[0].shape for x in robot.links if x.name.endswith("tyre")}
    assert tyres == {
        "a_tyre": Cylinder(0.1, 0.1),
        "b_tyre": Cylinder(0.2, 0.1),
        "c_tyre": Cylinder(0.2, 0.1),
    }


@pytest.mark.parametrize("count", [5, 7, 12])
def test_robots_with_various_numbers_of_wheels(workshop: Workshop, count: int) -> None:
    placed = []
    for i in range(count):
        angle = 2 * math.pi * i / count
        x, y = 1.5 * math.cos(angle), 1.5 * math.sin(angle)
        placed.append(leg(f"w{i}", f"xyz: [{x:.6f}, {y:.6f}, 0], rpy: [0, 0, {angle:.6f}]"))
    robot = workshop.robot(on_plate(*placed, params="turns: steers"))
    assert len(robot.wheels) == count
    assert robot.inertial.mass == pytest.approx(100 + 8 * count)
    for i, wheel_of_robot in enumerate(robot.wheels):
        angle = 2 * math.pi * i / count
        assert (wheel_of_robot.x, wheel_of_robot.y) == pytest.approx(
            (1.5 * math.cos(angle), 1.5 * math.sin(angle)), abs=1e-6
        )
        assert math.remainder(wheel_of_robot.heading - angle, 2 * math.pi) == pytest.approx(
            0, abs=1e-6
        )
        assert wheel_of_robot.load == pytest.approx(robot.inertial.mass * 9.81 / count, rel=1e-4)


def test_stated_frame_height_is_compared_with_the_wheels(workshop: Workshop) -> None:
    plate = f"""
    params:
      height: {{quantity: length, default: none, description: Of it., {SOURCE}}}
    links:
      body: {{parts: [{{shape: {{box: [1, 0.8, 0.1]}}, mass: 100 kg, {SOURCE}}}]}}
    free_mount: {{kind: clamp, link: body}}
    height_above_ground: ${{height}}
    """
    workshop.module("t/plate", plate)
    assert workshop.robot(on_plate(*THREE)).joint("body_mount").pose.xyz[2] == 0.6
    stated = on_plate(*THREE).replace("t/plate}", "t/plate, params: {height: %s}}")
    assert workshop.robot(stated % "0.6").joint("body_mount").pose.xyz[2] == 0.6
    codes = [d.code.name for d in workshop.diagnostics(stated % "0.602")]
    assert "frame-height" in codes
