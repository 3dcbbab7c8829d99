"""Robots with arms of others float: no reader fixes them to the ground."""

from __future__ import annotations

import json
import re
import subprocess
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import pytest

from tests.compiler.extras.arms import ARM, ROBOT, arm_robot
from tests.outside_tools import path_of, path_of_drake_python
from thorvaldc import compile
from thorvaldc.compiler.pipeline import emit
from thorvaldc.model import Robot

# The structures of published descriptions: UR, Kinova and Franka begin with `world` and a link
# with content; UR's base_link is empty; Robotiq mounts a gripper alone on `world`.
EMPTY_BASE = ARM.replace(
    '<xacro:body name="base_link" mass="4" length="0.15"/>',
    '<link name="${p}base_link"/><xacro:body name="base_inertia" mass="4" length="0.15"/>'
    '<joint name="${p}inertia_joint" type="fixed">'
    '<parent link="${p}base_link"/><child link="${p}base_inertia"/></joint>',
)
BODY, _, CONTROL = ARM.partition('<link name="world"/>')
GRIPPER = (
    BODY
    + '<link name="world"/><joint name="${p}base_joint" type="fixed"><origin xyz="0 0 0.1"/>'
    + '<parent link="world"/><child link="${p}hand"/></joint>'
    + "\n".join(re.findall(r'<xacro:body name="(?:hand|left_finger|right_finger)".*', CONTROL))
    + re.sub(
        '<xacro:driven name="(shoulder|elbow|wrist)".*',
        "",
        CONTROL[CONTROL.index('<xacro:hinge name="knuckle"') :],
    )
)
WITHOUT_WORLD = ARM.replace('<link name="world"/>', "").replace(
    '<joint name="${p}base_joint" type="fixed">\n  <parent link="world"/>\n'
    '  <child link="${p}base_link"/>\n</joint>',
    "",
)
READ_BY_DRAKE = """
import json, sys
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
plant = MultibodyPlant(0.0)
Parser(plant).AddModels(sys.argv[1])
plant.Finalize()
names = lambda bodies: [plant.get_body(i).name() for i in bodies]
print(json.dumps({
    "floating": names(plant.GetFloatingBaseBodies()),
    "fixed": [body.name() for body in plant.GetBodiesWeldedTo(plant.world_body())],
    "mass": plant.CalcTotalMass(plant.CreateDefaultContext()),
}))
"""
DESCRIPTIONS = {
    "arm": ARM,
    "empty_base_link": EMPTY_BASE,
    "gripper": GRIPPER,
    "without_world": WITHOUT_WORLD,
}


@pytest.fixture(params=DESCRIPTIONS, scope="module")
def build(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Robot, Path]:
    """A robot with the description, and the folder of its files."""
    folder = tmp_path_factory.mktemp("arm")
    compilation = compile(arm_robot(folder, arm=DESCRIPTIONS[request.param]))
    assert not compilation.report.errors, [d.message for d in compilation.report.errors]
    robot = compilation.model
    for name, data in emit(robot, ["urdf", "mjcf"]).items():
        path = folder / "build" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
    return robot, folder / "build"


def test_no_link_of_the_model_is_the_ground(build: tuple[Robot, Path]) -> None:
    robot, _ = build
    names = [link.name for link in robot.links]
    assert "world" not in names
    assert names.count("base_link") == 1
    assert names[0] == "base_link"
    assert "arm_hand" in names


@pytest.mark.parametrize("file", ["urdf/robot.urdf", "mjcf/scene.xml"])
def test_every_body_belongs_to_the_robot_in_mujoco(build: tuple[Robot, Path], file: str) -> None:
    robot, folder = build
    model = mujoco.MjModel.from_xml_path(str(folder / file))
    base = model.body("base_link").id
    assert {int(root) for root in model.body_rootid[1:]} == {base}
    assert model.body_subtreemass[base] == pytest.approx(robot.inertial.mass)
    if file.startswith("mjcf"):
        assert model.jnt_type[model.body_jntadr[base]] == mujoco.mjtJoint.mjJNT_FREE


@pytest.mark.slow
def test_sdformat_has_no_joint_to_the_world(build: tuple[Robot, Path]) -> None:
    path = build[1] / "urdf" / "robot.urdf"
    command = [path_of("ign"), "sdf", "-p", str(path)]
    process = subprocess.run(command, capture_output=True, text=True)
    model = ElementTree.fromstring(process.stdout).find("model")
    assert model is not None, process.stderr
    assert "base_link" in [link.get("name") for link in model.findall("link")]
    parents = [joint.findtext("parent") for joint in model.findall("joint")]
    assert parents
    assert "world" not in parents
    assert (model.findtext("static") or "false") in ("false", "0")
    command = [path_of("ign"), "sdf", "-k", str(path)]
    process = subprocess.run(command, capture_output=True, text=True)
    assert process.stdout.splitlines()[-1] == "Valid.", process.stdout


@pytest.mark.slow
def test_only_the_base_floats_in_drake(build: tuple[Robot, Path]) -> None:
    robot, folder = build
    command = [path_of_drake_python(), "-c", READ_BY_DRAKE, str(folder / "urdf/robot.urdf")]
    process = subprocess.run(command, capture_output=True, text=True)
    assert process.returncode == 0, process.stderr
    plant = json.loads(process.stdout)
    assert plant["floating"] == ["base_link"]
    assert plant["fixed"] == ["world"]
    assert plant["mass"] == pytest.approx(robot.inertial.mass)


def test_the_robot_falls_with_its_arm(build: tuple[Robot, Path]) -> None:
    """Lifted by 1 m, the whole robot falls: nothing holds it."""
    model = mujoco.MjModel.from_xml_path(str(build[1] / "mjcf/scene.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    data.qpos[2] += 1.0
    height = float(data.qpos[2])
    while data.time < 0.3:
        mujoco.mj_step(model, data)
    assert height - data.qpos[2] == pytest.approx(9.81 * 0.3**2 / 2, rel=0.05)


def test_an_extra_that_would_be_the_ground_is_refused(tmp_path: Path) -> None:
    filled = '<link name="world"><visual><geometry><box size="1 1 1"/></geometry></visual></link>'
    arm = ARM.replace('<link name="world"/>', filled)
    report = compile(arm_robot(tmp_path, arm=arm, robot=ROBOT)).report
    assert [d.code.name for d in report.errors] == ["extra-world"]
