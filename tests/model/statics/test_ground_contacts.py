"""Parts of extras that stand on the ground carry a part of the weight, as in MuJoCo."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from thorvaldc import compile as compile_robot
from thorvaldc import emit
from thorvaldc.model import Robot
from thorvaldc.model.facts.stability import stability_of, wheel_loads_of
from thorvaldc.model.spatial import GRAVITY
from thorvaldc.model.statics.ground_contacts import with_ground_contacts
from thorvaldc.runtime.se2 import Twist
from thorvaldc.simulation.simulation_run import Simulation

CART = """thorvaldc: 1
name: cart
modules:
  frame: {type: frame/tube_rectangular, params: {length: 1.1 m, width: 0.9 m}}
  left: {type: assembly/fixed_drive, mount: frame.front_left}
  right: {type: assembly/fixed_drive, mount: frame.front_right}
  motors:
    type: controller/propulsion_propulsion
    channels: {left: left.propulsion, right: right.propulsion}
  battery: {type: battery/enclosure, mount: {parent: frame, xyz: [0, 0.397, 70 mm]}}
extras:
  - {xacro: tail.urdf, parent: frame, xyz: [-0.426, 0, -0.65]}
"""


def inertial(x: float, z: float, mass: float, moment: float) -> str:
    moments = " ".join(f'i{axis}{axis}="{moment}"' for axis in "xyz")
    return (
        f'<inertial><origin xyz="{x} 0 {z}"/><mass value="{mass}"/>'
        f'<inertia {moments} ixy="0" ixz="0" iyz="0"/></inertial>'
    )


def solid(shape: str, origin: str) -> str:
    content = f"<origin {origin}/><geometry><{shape}/></geometry>"
    return f"<visual>{content}</visual><collision>{content}</collision>"


SKID = f"""<robot name="tail">
  <link name="skid">
    {inertial(0, 0.1, 2, 0.02)}{solid('sphere radius="0.1"', 'xyz="0 0 0.1"')}
  </link>
</robot>"""
TRAILER = f"""<robot name="tail">
  <link name="bed">{inertial(-0.7, 0.4, 30, 5)}</link>
  <link name="roll">
    {inertial(0, 0, 6, 0.1)}{solid('cylinder radius="0.2" length="0.6"', 'rpy="1.5708 0 0"')}
  </link>
  <joint name="axle" type="continuous">
    <parent link="bed"/><child link="roll"/><origin xyz="-1 0 0.2"/><axis xyz="0 1 0"/>
  </joint>
</robot>"""


def robot_with(folder: Path, tail: str, *, four: bool = False) -> Robot:
    cart = CART
    if four:
        rear = "  rl: {type: caster/swivel, mount: frame.rear_left}\n"
        rear += rear.replace("rl:", "rr:").replace("left", "right")
        cart = cart.replace("extras:", f"{rear}extras:")
        tail = tail.replace('mass value="30"', 'mass value="3"')
    (folder / "tail.urdf").write_text(tail)
    (folder / "robot.yaml").write_text(cart)
    model = compile_robot(folder / "robot.yaml").model
    assert isinstance(model, Robot)
    return model


def loads_in_mujoco(robot: Robot, folder: Path) -> dict[str, float]:
    """Returns the vertical force (N) on each link that touches the ground after 3 s."""
    for path, content in emit(robot, ["mjcf"]).items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_bytes(content)
    model = mujoco.MjModel.from_xml_path(str(folder / "mjcf/scene.xml"))
    state = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, state, 0)
    for _ in range(round(3.0 / model.opt.timestep)):
        mujoco.mj_step(model, state)
    loads: dict[str, float] = {}
    for k in range(state.ncon):
        force = np.zeros(6)
        mujoco.mj_contactForce(model, state, k, force)
        contact = state.contact[k]
        body = model.body(model.geom_bodyid[max(contact.geom1, contact.geom2)]).name
        loads[body] = loads.get(body, 0.0) + abs((contact.frame.reshape(3, 3).T @ force[:3])[2])
    return loads


@pytest.mark.parametrize(
    ("tail", "link"), [(SKID, "skid"), (TRAILER, "roll")], ids=["skid", "trailer"]
)
def test_three_supports_carry_what_they_carry_in_mujoco(
    tail: str, link: str, tmp_path: Path
) -> None:
    robot = robot_with(tmp_path, tail)
    assert [wheel.name for wheel in robot.wheels] == ["left_wheel", "right_wheel"]
    measured = loads_in_mujoco(robot, tmp_path)
    computed = {w.link: w.load for w in with_ground_contacts(robot).wheels}
    assert computed.keys() == measured.keys() == {"left_wheel_tyre", "right_wheel_tyre", link}
    for name, load in computed.items():
        assert load == pytest.approx(measured[name], rel=0.02), (name, measured)
    assert sum(computed.values()) == pytest.approx(robot.inertial.mass * GRAVITY, rel=1e-6)


def test_a_trailer_on_a_ball_hitch_does_not_hold_the_base(tmp_path: Path) -> None:
    """With a joint that gives way, its wheels hold the trailer alone; a turning one carries."""
    hitch = """<link name="hitch"/>
  <joint name="turn" type="{kind}">
    <parent link="hitch"/><child link="bed"/><axis xyz="{axis}"/>
    <limit lower="-1" upper="1" effort="0" velocity="9"/>
  </joint>"""
    for axis, expected in (("0 0 1", ["roll"]), ("0 1 0", []), ("1 0 0", [])):
        joint = hitch.format(kind="revolute", axis=axis)
        robot = robot_with(tmp_path, TRAILER.replace('"tail">', f'"tail">{joint}', 1), four=True)
        assert [w.name for w in with_ground_contacts(robot).wheels][4:] == expected


@pytest.mark.parametrize("tail", [SKID, TRAILER], ids=["skid", "trailer"])
def test_what_stands_on_the_ground_does_not_collide_with_it(tail: str, tmp_path: Path) -> None:
    (run,) = Simulation(robot_with(tmp_path, tail)).run(2.0, Twist(0.3, 0.0, 0.0)).robots
    assert run.path_true > 0.3
    assert run.collisions == 0


def test_the_facts_count_them(tmp_path: Path) -> None:
    robot = robot_with(tmp_path, TRAILER)
    assert [load.name for load in wheel_loads_of(robot)] == ["left_wheel", "right_wheel", "roll"]
    assert sum(load.share for load in wheel_loads_of(robot)) == pytest.approx(1.0, abs=1e-6)
    assert stability_of(robot).stands
    (tmp_path / "tail.urdf").write_text(TRAILER.replace("-1 0 0.2", "-1 0 0.21"))
    report = compile_robot(tmp_path / "robot.yaml").report  # 10 mm above the ground
    assert "unstable" in {d.code.name for d in report}
