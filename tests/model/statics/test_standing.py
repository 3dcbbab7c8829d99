"""Robots with passive joints: who stands, and on which loads; closed forms and MuJoCo."""

from __future__ import annotations

import math
from pathlib import Path

import mujoco
import numpy as np
import pytest

from tests.backend_files import files_of
from tests.backends.conftest import write
from tests.robots import make_robot
from tests.workshop import CART, Workshop
from thorvaldc.backends.mjcf import Mjcf
from thorvaldc.backends.sdf import Sdf
from thorvaldc.backends.urdf import Urdf
from thorvaldc.model import Robot
from thorvaldc.model.facts.fact_tables import fact_tables
from thorvaldc.model.facts.robot_facts import robot_facts
from thorvaldc.model.facts.stability import load_ranges
from thorvaldc.model.statics.standing import standing_of
from thorvaldc.model.statics.standing_pose import solve_statics

G = 9.81
ROCKER = """
    params:
      stiffness: {quantity: rotational_stiffness, default: 0, description: K., source: "chosen: r"}
      limit: {quantity: angle, default: 60 deg, description: Limit., source: "chosen: round"}
      stop: {quantity: angle, default: 60 deg, description: Limit., source: "chosen: round"}
      rolls: {type: boolean, default: false, description: About x., source: "chosen: round"}
    links:
      pin: {parts: [{shape: {sphere: {radius: 0.02}}, mass: 1 kg, source: "chosen: round"}]}
      arm: {parts: [{shape: {sphere: {radius: 0.02}}, mass: 4 kg, source: "chosen: round"}]}
    joints:
      pivot:
        {type: revolute, parent: pin, child: arm, axis: "${[1, 0, 0] if rolls else [0, 1, 0]}",
         lower: "${-limit}", upper: "${stop}", damping: 5 N m s/rad,
         spring: {stiffness: "${stiffness}"}}
    mount: {kinds: [clamp], link: pin}
    ports:
      fore: {kind: clamp, link: arm, xyz: [0.4, 0, 0]}
      aft: {kind: clamp, link: arm, xyz: [-0.4, 0, 0]}
    free_mount: {kind: clamp, link: arm}
"""
DIFFERENTIAL = "couplings: {d: {joint: right.pivot, follows: left.pivot, ratio: -1}}\n"


def rover(params: str = "", ahead: float = 0.2, height: float = 0.3) -> str:
    """Returns a plate on two rockers, with 30 kg ahead of their axle and above it."""
    params = f", params: {{{params}}}" if params else ""
    return f"""
        body: {{type: t/plate}}
        load: {{type: t/block, params: {{mass: 30 kg}},
               mount: {{parent: body, xyz: [{ahead}, 0, {height}]}}}}
        left: {{type: t/rocker, mount: {{parent: body, xyz: [0, 0.5, 0]}}{params}}}
        right: {{type: t/rocker, mount: {{parent: body, xyz: [0, -0.5, 0]}}{params}}}
        lf: {{type: t/leg, mount: left.fore}}
        la: {{type: t/leg, mount: left.aft}}
        rf: {{type: t/leg, mount: right.fore}}
        ra: {{type: t/leg, mount: right.aft}}
    """


def axles(*, front: bool, rear: bool) -> str:
    """Returns a plate on two axles, of which some turn about a pin along x."""
    text = "body: {type: t/plate}\n"
    for name, x, turns in (("front", 0.5, front), ("rear", -0.5, rear)):
        if turns:
            text += f"{name}: {{type: t/rocker, params: {{rolls: true}}, "
            text += f"mount: {{parent: body, xyz: [{x}, 0, 0]}}}}\n"
        parent, at = (name, 0.0) if turns else ("body", x)
        for side in (0.4, -0.4):
            text += f"{name}_{'left' if side > 0 else 'right'}: {{type: t/leg, "
            text += f"mount: {{parent: {parent}, xyz: [{at}, {side}, 0]}}}}\n"
    return text


@pytest.fixture
def shop(workshop: Workshop) -> Workshop:
    workshop.module("t/rocker", ROCKER)
    return workshop


def codes(shop: Workshop, modules: str, head: str = "") -> list[str]:
    return [d.code.name for d in shop.diagnostics(modules, head)]


STANDING = {
    "a differential": (rover(), DIFFERENTIAL),
    "gears of another ratio": (rover(), DIFFERENTIAL.replace("-1", "-0.7")),
    "springs": (rover("stiffness: 2 kN m/rad"), ""),
    "a body that hangs below its axle": (rover("", 0.0, -0.3), ""),
    "one centre pivot": (axles(front=True, rear=False), ""),
    "a stop at 0": (rover("limit: 0 deg"), ""),
}
FALLING = {
    "two rockers": (rover(), ""),
    "a body in balance above its axle": (rover("", 0.0), ""),
    "rockers with a gear that turns them alike": (rover(), DIFFERENTIAL.replace("-1", "1")),
    "soft springs": (rover("stiffness: 30 N m/rad"), ""),
    "two centre pivots": (axles(front=True, rear=True), ""),
    "a stop on the wrong side": (rover("stop: 0 deg"), ""),
}


@pytest.mark.parametrize("name", STANDING)
def test_what_holds_a_robot(shop: Workshop, tmp_path: Path, name: str) -> None:
    """It passes, and stands in MuJoCo for 10 s on the loads of the model."""
    robot = shop.robot(*STANDING[name])
    moved, carried = simulate(robot, tmp_path)
    assert moved < math.radians(0.5)
    ranges = load_ranges(robot)
    assert ranges is not None
    for wheel, (low, high) in zip(robot.wheels, ranges, strict=True):
        assert low * 0.99 < carried[wheel.link] < high * 1.01
        assert low <= wheel.load <= high
        assert solve_statics(robot).wheels[wheel.name].force == pytest.approx(
            carried[wheel.link], rel=0.01
        )


@pytest.mark.parametrize("name", FALLING)
def test_what_does_not_hold_a_robot(shop: Workshop, name: str) -> None:
    modules, head = FALLING[name]
    diagnostics = shop.diagnostics(modules, head)
    (found,) = [d for d in diagnostics if d.code.name == "body-not-held"]
    joints = ("front.pivot", "rear.pivot") if "centre" in name else ("left.pivot", "right.pivot")
    assert all(f"`{joint}`" in found.message for joint in joints)
    assert found.span is not None
    assert found.span.line == next(
        i
        for i, line in enumerate(shop.robot_file(modules, head).read_text().splitlines(), 1)
        if line.strip().startswith(f"{joints[0].split('.')[0]}:")
    )
    assert found.labels
    assert "wheel-unloaded" not in [d.code.name for d in diagnostics]


def test_the_loads_of_a_differential_follow_from_the_levers(shop: Workshop) -> None:
    """The differential makes the moments of both rockers equal."""
    robot = shop.robot(rover(), DIFFERENTIAL)
    loads = [wheel.load for wheel in robot.wheels]
    half = robot.inertial.mass * G / 2
    difference = 30.0 * G * 0.2 / 0.4 / 2  # of fore and aft wheel on each side
    assert loads == pytest.approx([(half + difference) / 2, (half - difference) / 2] * 2)
    assert load_ranges(robot) == tuple((load, load) for load in loads)


def test_springs_must_carry_the_height_of_the_mass(shop: Workshop) -> None:
    """The curvature of the energy is 2 k - m g h; the plate lies at the height of the axle."""
    critical = 30.0 * G * 0.3 / 2
    assert "body-not-held" in codes(shop, rover(f"stiffness: {critical - 1}", 0.0))
    assert "body-not-held" not in codes(shop, rover(f"stiffness: {critical + 1}", 0.0))


def test_a_near_limit_holds_a_robot_that_leans(shop: Workshop, tmp_path: Path) -> None:
    robot = shop.robot(rover("limit: 6 deg"), warned=("leans-on-limits",))
    standing = standing_of(robot)
    assert standing is not None
    assert standing.tilt == pytest.approx(math.radians(6.0))
    assert solve_statics(robot).settled
    moved, carried = simulate(robot, tmp_path)
    assert moved < math.radians(0.5)
    for wheel in robot.wheels:
        assert carried[wheel.link] == pytest.approx(wheel.load, rel=0.02)
    assert "body-not-held" in codes(shop, rover("limit: 11 deg"))
    assert "leans-on-limits" not in codes(shop, rover("limit: 0.9 deg"))


def test_an_offset_tilts_the_body_by_half_of_it(shop: Workshop, tmp_path: Path) -> None:
    head = DIFFERENTIAL.replace("ratio: -1", "ratio: -1, offset: 8 deg")
    robot = shop.robot(rover(), head, warned=("leans-on-limits",))
    standing = standing_of(robot)
    assert standing is not None
    assert standing.tilt == pytest.approx(math.radians(4.0))
    moved, carried = simulate(robot, tmp_path)
    assert moved < math.radians(0.5)
    for wheel in robot.wheels:
        assert carried[wheel.link] == pytest.approx(wheel.load, rel=0.01)


def test_the_offset_of_a_coupling_that_tilts_nothing_is_named(shop: Workshop) -> None:
    arm = "arm: {type: t/rocker, mount: {parent: body, xyz: [0, 0, 0.1]}}\n"
    coupling = "e: {joint: arm.pivot, follows: left.pivot, offset: 10 deg}}"
    head = DIFFERENTIAL.replace("}}", "}, " + coupling)
    every = shop.diagnostics(f"{rover()}\n        {arm}", head)
    (diagnostic,) = (d for d in every if d.code.name == "leans-on-limits")
    assert diagnostic.message.startswith("at rest, the robot has `arm.pivot` at 10.0 deg;")
    assert diagnostic.hint is not None
    assert diagnostic.hint.startswith("leave out the `offset` of its coupling")


def test_uneven_ground_moves_the_loads_of_springs() -> None:
    """Four equal springs k: heights +h, -h, -h, +h twist them, and each load changes by k h."""
    robot = make_robot([(x, y, "fixed") for x in (0.5, -0.5) for y in (0.4, -0.4)], suspended=True)
    ranges = load_ranges(robot)
    assert ranges is not None
    for wheel, (low, high) in zip(robot.wheels, ranges, strict=True):
        assert (low, high) == pytest.approx((wheel.load - 160.0, wheel.load + 160.0))
    three = make_robot(
        [(0.5, 0, "fixed"), (-0.5, 0.4, "fixed"), (-0.5, -0.4, "fixed")], suspended=True
    )
    assert load_ranges(three) == tuple((wheel.load, wheel.load) for wheel in three.wheels)
    table = next(table for table in fact_tables(robot_facts(robot)) if table.key == "wheels")
    assert "range [N]" in table.columns
    assert any("on springs is that of ground uneven by 8 mm" in note for note in table.notes)


def test_a_rigid_frame_on_four_wheels_has_a_range_of_loads(shop: Workshop) -> None:
    robot = shop.robot(CART)
    half = robot.inertial.mass * G / 2
    ranges = load_ranges(robot)
    assert ranges is not None
    assert np.array(ranges) == pytest.approx(np.array([(0.0, half)] * 4), abs=1e-6)


def test_three_wheels_have_one_load(shop: Workshop) -> None:
    robot = shop.robot(
        """
        body: {type: t/plate}
        fl: {type: t/leg, mount: {parent: body, xyz: [0.5, 0.4, 0]}}
        fr: {type: t/leg, mount: {parent: body, xyz: [0.5, -0.4, 0]}}
        rear: {type: t/leg, mount: body.rear, params: {turns: swivels, driven: false}}
        """
    )
    assert load_ranges(robot) == tuple((wheel.load, wheel.load) for wheel in robot.wheels)


def test_the_formats_contain_the_coupling(shop: Workshop) -> None:
    """URDF as a mimic joint, MJCF as an equality; SDF 1.9 cannot say it and warns, if the robot
    does not stand without it."""
    robot = shop.robot(rover(), DIFFERENTIAL.replace("-1", "-0.5, offset: 1 deg"))
    urdf = files_of(Urdf, robot)["urdf/robot.urdf"].decode()
    assert '<mimic joint="left_pivot" multiplier="-0.5" offset="0.01745329' in urdf
    mjcf = files_of(Mjcf, robot)["mjcf/robot.xml"].decode()
    assert 'joint1="right_pivot" joint2="left_pivot" polycoef="0.01745329' in mjcf
    (diagnostic,) = Sdf().unsupported(robot)
    assert diagnostic.code.name == "coupling-left-out"
    assert "nothing couples `right_pivot` in Gazebo" in diagnostic.message


def test_a_module_couples_its_own_joints(shop: Workshop) -> None:
    shop.module(
        "t/part",
        """
        links:
          palm: {parts: [{shape: {sphere: {radius: 0.02}}, mass: 1 kg, source: "chosen: round"}]}
          one: {parts: [{shape: {sphere: {radius: 0.02}}, mass: 1 kg, source: "chosen: round"}]}
          two: {parts: [{shape: {sphere: {radius: 0.02}}, mass: 1 kg, source: "chosen: round"}]}
        joints:
          left: {type: revolute, parent: palm, child: one, lower: -1, upper: 1}
          right: {type: revolute, parent: palm, child: two, lower: -1, upper: 1}
        couplings:
          gear: {joint: right, follows: left, ratio: "${-1 / 2}"}
        mount: {kinds: [clamp], link: palm}
        """,
    )
    robot = shop.robot(f"{CART}    part: {{type: t/part, mount: body.front}}")
    mimic = robot.joint("part_right").mimic
    assert mimic is not None
    assert (mimic.joint, mimic.multiplier, mimic.offset) == ("part_left", -0.5, 0.0)
    (diagnostic,) = Sdf().unsupported(robot)
    assert diagnostic.code.name == "urdf-only-element"
    assert "1 x <mimic>" in diagnostic.message


def simulate(robot: Robot, folder: Path) -> tuple[float, dict[str, float]]:
    """Returns the largest motion in 10 s after a push (rad), and the load (N) of each wheel."""
    scene = write(files_of(Mjcf, robot), folder) / "mjcf" / "scene.xml"
    m = mujoco.MjModel.from_xml_path(str(scene))
    d = mujoco.MjData(m)
    mujoco.mj_resetDataKeyframe(m, d, 0)
    names = [j.name for j in robot.joints if j.name.endswith("pivot")]
    passive = [int(m.joint(name).qposadr[0]) for name in names]
    start = d.qpos[[*passive, 4, 5]].copy()
    d.qvel[3:5] += (0.02, 0.02)
    while d.time < 10.0:
        mujoco.mj_step(m, d)
    force, carried = np.zeros(6), dict.fromkeys((w.link for w in robot.wheels), 0.0)
    for i in range(d.ncon):
        mujoco.mj_contactForce(m, d, i, force)
        carried[m.body(m.geom_bodyid[max(d.contact[i].geom)]).name] += force[0]
    end = d.qpos[[*passive, 4, 5]] * ([1.0] * len(passive) + [2.0, 2.0])
    start = start * ([1.0] * len(passive) + [2.0, 2.0])
    return float(np.abs(end - start).max()), carried
