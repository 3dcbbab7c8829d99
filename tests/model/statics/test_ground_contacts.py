"""Parts of extras that stand on the ground carry a part of the weight, as in MuJoCo."""

from __future__ import annotations

import math
from collections.abc import Sequence
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


def mujoco_model(robot: Robot, folder: Path) -> mujoco.MjModel:
    for path, content in emit(robot, ["mjcf"]).items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_bytes(content)
    return mujoco.MjModel.from_xml_path(str(folder / "mjcf/scene.xml"))


def loads_in_mujoco(robot: Robot, folder: Path) -> dict[str, float]:
    """Returns the vertical force (N) on each link that touches the ground after 3 s."""
    model = mujoco_model(robot, folder)
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


HINGES = {"yaw": "0 0 1", "pitch": "0 1 0", "roll": "1 0 0"}
ONE = [0.0]
"""Places (m, along y) of the wheels of a trailer."""
TWO = [0.3, -0.3]


def trailer_on(names: Sequence[str], wheels: Sequence[float], mass: float, com: float) -> str:
    """Returns a trailer behind these hinges, with the axle 1 m behind and 0.1 m below them."""
    links = ["hitch", *(f"behind_{name}" for name in names[:-1]), "bed"]
    text = '<robot name="tail"><link name="hitch"/>'
    for name, parent, child in zip(names, links, links[1:], strict=False):
        body = inertial(com, 0.1, mass, 5) if child == "bed" else inertial(0, 0, 0.5, 0.01)
        height = 0.3 if parent == "hitch" else 0.0
        text += f'''<link name="{child}">{body}</link>
  <joint name="{name}" type="revolute">
    <parent link="{parent}"/><child link="{child}"/><origin xyz="0 0 {height}"/>
    <axis xyz="{HINGES[name]}"/><limit lower="-1" upper="1" effort="0" velocity="9"/>
  </joint>'''
    tyre = solid('cylinder radius="0.2" length="0.1"', 'rpy="1.5708 0 0"')
    for k, y in enumerate(wheels):
        text += f"""<link name="wheel_{k}">{inertial(0, 0, 3, 0.05)}{tyre}</link>
  <joint name="axle_{k}" type="continuous">
    <parent link="bed"/><child link="wheel_{k}"/><origin xyz="-1 {y} -0.1"/><axis xyz="0 1 0"/>
  </joint>"""
    return text + "</robot>"


BALL = trailer_on(["yaw", "pitch", "roll"], TWO, 30.0, -0.7)


@pytest.mark.parametrize(
    "tail",
    [
        trailer_on(["pitch"], ONE, 30.0, -0.7),
        trailer_on(["yaw", "pitch"], ONE, 30.0, -0.7),
        BALL,
        trailer_on(["yaw", "pitch", "roll"], TWO, 100.0, -0.9),
    ],
    ids=["pitch", "yaw and pitch", "ball", "heavy, ball"],
)
def test_a_trailer_behind_a_hinge_carries_itself(tail: str, tmp_path: Path) -> None:
    """Its load on the hinge is a part of those of the base; the heaviest is no part of the base,
    whose own centre of mass lies between its wheels."""
    robot = robot_with(tmp_path, tail, four=True)
    measured = loads_in_mujoco(robot, tmp_path)
    computed = {w.link: w.load for w in with_ground_contacts(robot).wheels}
    assert computed.keys() == measured.keys()
    for name, load in computed.items():
        assert load == pytest.approx(measured[name], rel=0.02), (name, measured)
    assert stability_of(robot).stands


@pytest.mark.slow
@pytest.mark.parametrize("direction", ["left", "front", "rear"])
def test_the_base_of_a_trailer_tips_over_where_it_does_in_mujoco(
    direction: str, tmp_path: Path
) -> None:
    """The wheels are locked; the ground falls by a degree more each third of a second."""
    robot = robot_with(tmp_path, BALL, four=True)
    computed = math.degrees(dict(stability_of(robot).angles)[direction])
    model = mujoco_model(robot, tmp_path)
    model.geom_friction[:, 0] = 3.0
    for joint in map(model.joint, range(model.njnt)):
        if joint.name.endswith(("axle", "swivel")):
            model.dof_damping[joint.dofadr] = 1e4
    state = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, state, 0)
    mujoco.mj_forward(model, state)
    x, y = {"left": (0.0, 1.0), "front": (1.0, 0.0), "rear": (-1.0, 0.0)}[direction]
    angle = 0.0
    while state.body("base_link").xmat[8] > math.cos(math.radians(6.0)) and angle < 70.0:
        angle += 3.0 * model.opt.timestep
        pull = GRAVITY * math.sin(math.radians(angle))
        model.opt.gravity[:] = x * pull, y * pull, -GRAVITY * math.cos(math.radians(angle))
        mujoco.mj_step(model, state)
    assert computed < angle < computed + 5.0


def test_a_pendulum_axle_holds_the_base(tmp_path: Path) -> None:
    """Its wheels share their load, and hold the base below the axis, and not beside it."""
    robot = robot_with(tmp_path, trailer_on(["roll"], TWO, 3.0, -1.0))
    left, right = (w.load for w in with_ground_contacts(robot).wheels[2:])
    assert left == pytest.approx(right, rel=0.01)
    stiff = robot_with(tmp_path, trailer_on(["yaw"], TWO, 3.0, -1.0))
    pendulum, rigid = (dict(stability_of(r).angles) for r in (robot, stiff))
    assert 0.3 < pendulum["left"] < rigid["left"] - 0.1
    assert pendulum["front"] == pytest.approx(rigid["front"], rel=0.01)


def test_a_trailer_that_its_hinges_let_fall_is_left_out(tmp_path: Path) -> None:
    """Two hinges in a row before one wheel: nothing holds the link between them."""
    tail = trailer_on(["pitch"], ONE, 30.0, -0.7)
    second = """<link name="drawbar"/><joint name="second" type="revolute">
    <parent link="drawbar"/><child link="hitch"/><origin xyz="-0.5 0 0.1"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="1" effort="0" velocity="9"/></joint><link name="hitch">"""
    tail = tail.replace('<link name="hitch"/>', f"{second}{inertial(0, 0, 1, 0.01)}</link>")
    robot = robot_with(tmp_path, tail.replace("0 0 0.3", "0 0 0.2"), four=True)
    assert len(with_ground_contacts(robot).wheels) == 4


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
