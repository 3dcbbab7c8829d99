from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from tests.backend_files import files_of
from tests.backends.plans import ROBOTS, grafted, mesh, stl
from tests.examples import FOLDER, example_robot
from thorvaldc.backends.mjcf import Mjcf, simulation_files
from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.model import (
    Block,
    Box,
    Collision,
    Fleet,
    Ground,
    Inertial,
    Mesh,
    MeshShape,
    Placement,
    Pose,
    Robot,
    Visual,
    World,
)
from thorvaldc.model.statics.standing_pose import solve_statics
from thorvaldc.simulation.physics.mujoco_scene import MujocoScene

Written = Callable[[Robot], Path]
WrittenFleet = Callable[[Fleet], Path]


def fleet(*names: str) -> Fleet:
    """Robots side by side, 3 m apart, with different headings."""
    placements = [
        Placement(
            f"r{i}",
            Pose.from_xyz_rpy((0.0, 3.0 * i, 0.0), (0.0, 0.0, 0.7 * i)),
            replace(ROBOTS[name], namespace=f"r{i}"),
        )
        for i, name in enumerate(names)
    ]
    return Fleet("several", "", tuple(placements))


def test_robot_file_can_be_attached(written: Written) -> None:
    folder = written(grafted(1))
    parent = mujoco.MjSpec()
    child = mujoco.MjSpec.from_file(str(folder / "mjcf" / "robot.xml"))
    # The options of the parent apply; MuJoCo warns if they differ.
    for option in ("timestep", "impratio", "integrator", "cone", "jacobian"):
        setattr(parent.option, option, getattr(child.option, option))
    for prefix in ("a/", "b/"):
        frame = parent.worldbody.add_frame(pos=[0, 5 if prefix == "b/" else 0, 0])
        parent.attach(child.copy(), prefix=prefix, frame=frame)
    model = parent.compile()
    assert model.body("a/base_link").id != model.body("b/base_link").id


def test_fleet_stands_still_together(written_fleet: WrittenFleet) -> None:
    scene = fleet("square", "suspended", "casters", "square")
    folder = written_fleet(scene)
    m = mujoco.MjModel.from_xml_path(str(folder / "mjcf" / "scene.xml"))
    d = mujoco.MjData(m)
    mujoco.mj_resetDataKeyframe(m, d, 0)
    start = d.qpos.copy()
    for placement in scene.placements:
        base = d.joint(f"{placement.name}/floating_base").qpos
        assert base[:2] == pytest.approx(placement.pose.xyz[:2])
        assert abs(np.dot(base[3:], placement.pose.quat)) == pytest.approx(1.0, abs=1e-6)
    for _ in range(200):
        mujoco.mj_step(m, d)
    assert np.abs(d.qpos - start).max() < 1e-5
    for placement in scene.placements:
        scene = folder / placement.name / "mjcf" / "scene.xml"
        alone = mujoco.MjModel.from_xml_path(str(scene))
        assert alone.nu == len(placement.robot.actuators)


def test_robots_of_a_fleet_collide(written_fleet: WrittenFleet) -> None:
    folder = written_fleet(fleet("square", "square", "square"))
    m = mujoco.MjModel.from_xml_path(str(folder / "mjcf" / "scene.xml"))
    d = mujoco.MjData(m)
    mujoco.mj_resetDataKeyframe(m, d, 0)
    for one, two in ((0, 1), (0, 2), (1, 2)):
        mujoco.mj_resetDataKeyframe(m, d, 0)
        at = d.joint(f"r{one}/floating_base").qpos
        d.joint(f"r{two}/floating_base").qpos[:2] = at[:2] + np.array([0.3, 0.1])
        mujoco.mj_forward(m, d)
        pairs = {frozenset(m.geom(g).name.split("/")[0] for g in c.geom) for c in d.contact}
        assert frozenset((f"r{one}", f"r{two}")) in pairs
        assert not any(len(pair) == 1 for pair in pairs)


def test_equal_meshes_of_a_fleet_are_one_asset(written_fleet: WrittenFleet) -> None:
    robots = [replace(grafted(s), namespace=f"r{i}") for i, s in enumerate((1, 1, 2))]
    placements = [
        Placement(f"r{i}", Pose((0.0, 4.0 * i, 0.0)), robot) for i, robot in enumerate(robots)
    ]
    folder = written_fleet(Fleet("several", "", tuple(placements)))
    m = mujoco.MjModel.from_xml_path(str(folder / "mjcf" / "scene.xml"))
    scales = {
        (shape.mesh, shape.scale)
        for robot in robots
        for link in robot.links
        for part in (*link.visuals, *link.collisions)
        if isinstance(shape := part.shape, MeshShape)
    }
    assert m.nmesh == len(scales)


def test_a_flat_mesh_can_be_shown(written: Written) -> None:
    data = stl(
        ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
        ((1.0, 0.0, 0.0), (1.0, 1.0, 0.0), (0.0, 1.0, 0.0)),
    )
    mesh = Mesh("sheet.stl", hashlib.sha256(data).hexdigest(), data)
    robot = ROBOTS["square"]
    body = robot.link("frame_body")
    seen = replace(body, visuals=(Visual(MeshShape("sheet.stl"), Pose(), (1.0, 0.0, 0.0, 1.0)),))
    links = [seen if link is body else link for link in robot.links]
    folder = written(replace(robot, links=tuple(links), meshes=(mesh,)))
    assert mujoco.MjModel.from_xml_path(str(folder / "mjcf" / "scene.xml")).nmesh == 1


def test_reserved_names_of_mujoco_are_avoided(written: Written) -> None:
    robot = ROBOTS["square"]
    links = [replace(link, name="world") if link.name == "w3_leg" else link for link in robot.links]
    joints = []
    for joint in robot.joints:
        child = "world" if joint.child == "w3_leg" else joint.child
        parent = "world" if joint.parent == "w3_leg" else joint.parent
        name = "floating_base" if joint.name == "w2_axle" else joint.name
        joints.append(replace(joint, name=name, parent=parent, child=child))
    wheels = [replace(w, spin_joint="floating_base") if w.name == "w2" else w for w in robot.wheels]
    actuators = [
        replace(a, joint="floating_base") if a.joint == "w2_axle" else a for a in robot.actuators
    ]
    changed = replace(
        robot,
        links=tuple(links),
        joints=tuple(joints),
        wheels=tuple(wheels),
        actuators=tuple(actuators),
    )
    m = mujoco.MjModel.from_xml_path(str(written(changed) / "mjcf" / "scene.xml"))
    assert m.body("world_link").parentid[0] == m.body("frame_body").id
    assert m.joint("floating_base_").type[0] == mujoco.mjtJoint.mjJNT_FREE


def test_wheels_hold_on_a_slope(written: Written) -> None:
    # 10 degrees along x, servos at zero speed: only the softness of the contact lets the robot
    # creep.
    m = mujoco.MjModel.from_xml_path(str(written(ROBOTS["square"]) / "mjcf" / "scene.xml"))
    d = mujoco.MjData(m)
    mujoco.mj_resetDataKeyframe(m, d, 0)
    angle = np.radians(10)
    m.opt.gravity[:] = (-9.81 * np.sin(angle), 0, -9.81 * np.cos(angle))
    for _ in range(400):
        mujoco.mj_step(m, d)
    after = d.qpos[0]
    for _ in range(1000):
        mujoco.mj_step(m, d)
    assert abs(d.qpos[0] - after) / 5.0 < 1e-4  # m/s
    assert abs(after) < 0.02


def test_long_drives_do_not_saturate(written: Written) -> None:
    m = mujoco.MjModel.from_xml_path(str(written(ROBOTS["square"]) / "mjcf" / "scene.xml"))
    d = mujoco.MjData(m)
    mujoco.mj_resetDataKeyframe(m, d, 0)
    for name in ("w0", "w1", "w2", "w3"):
        axle = d.joint(f"{name}_axle")
        axle.qpos[0] = 1e5  # about 20 km of driving
        d.act[m.actuator(f"{name}_propulsion").actadr[0]] = 1e5
        d.ctrl[m.actuator(f"{name}_propulsion").id] = 5.0
    for _ in range(400):
        mujoco.mj_step(m, d)
    assert d.joint("w0_axle").qvel[0] == pytest.approx(5.0, rel=1e-3)


def test_repeated_emission_of_random_trees() -> None:
    assert files_of(Mjcf, grafted(3)) == files_of(Mjcf, grafted(3))


@pytest.mark.parametrize("seed", range(20))
def test_inertias_of_flat_plates_are_accepted(seed: int, written: Written) -> None:
    # The largest moment of a plate is the sum of the others; MuJoCo rejects anything above.
    rng = np.random.default_rng(seed)
    a, b = (float(v) for v in rng.uniform(0.01, 1.0, 2))
    turn = Pose.from_xyz_rpy(rpy=tuple(float(v) for v in rng.uniform(-3, 3, 3)))  # type: ignore[arg-type]
    plate = Inertial(5.0, (0.0, 0.0, 0.0), (a, b, a + b, 0.0, 0.0, 0.0)).transformed(turn).clean()
    robot = ROBOTS["square"]
    links = [replace(x, inertial=plate) if x.name == "w0_leg" else x for x in robot.links]
    folder = written(replace(robot, links=tuple(links)))
    m = mujoco.MjModel.from_xml_path(str(folder / "mjcf" / "scene.xml"))
    assert sum(m.body("w0_leg").inertia) == pytest.approx(2 * (a + b), rel=1e-8)


@pytest.mark.parametrize("names", [("4wd4ws_wide",), ("6wd6ws", "2wd0ws_greenhouse")])
def test_a_scene_without_visual_shapes_has_the_same_physics(names: tuple[str, ...]) -> None:
    placements = [
        Placement(name, Pose((0.0, 3.0 * i, 0.0)), replace(example_robot(name), namespace=name))
        for i, name in enumerate(names)
    ]
    world = World(Ground(angle=0.1), (Block("obstacle", "box", Box((0.4, 0.4, 0.4)), Pose()),))
    placements[0] = replace(placements[0], robot=_with_hull(placements[0].robot))
    whole = Fleet("whole", "", tuple(placements), world)
    scenes = [MujocoScene(files_of(Mjcf, whole)), MujocoScene(simulation_files(whole))]
    files = simulation_files(whole)
    assert len(files) == 2, "the scene and the mesh of the hull"
    assert len(files["mjcf/scene.xml"]) < 0.8 * len(files_of(Mjcf, whole)["mjcf/scene.xml"])
    for scene in scenes:
        scene.data.ctrl[:2] = 3.0
        scene.advance(1.0)
    with_visuals, without = (scene.data.qpos.copy() for scene in scenes)
    assert scenes[0].data.ncon > 0
    assert np.array_equal(with_visuals, without)


def _with_hull(robot: Robot) -> Robot:
    """A robot whose base has a collision shape from a mesh."""
    hull = mesh("hull.stl", 0.1)
    collision = Collision(MeshShape(hull.name), Pose((0.0, 0.0, 1.0)))
    base = replace(robot.links[0], collisions=(collision,))
    return replace(robot, links=(base, *robot.links[1:]), meshes=(*robot.meshes, hull))


def test_a_joint_far_from_the_others_keeps_its_inertia(tmp_path: Path) -> None:
    """At 26,000 km, moments about a common origin have no correct digit."""
    text = (FOLDER / "1wd1ws_rear/robot.yaml").read_text(encoding="utf-8")
    inertias = []
    for inset in ("110 mm", "25953705 m"):
        file = tmp_path / "robot.yaml"
        file.write_text(text.replace("tube_inset_x: 110 mm", f"tube_inset_x: {inset}"), "utf-8")
        robot = compile_file(file).model
        assert isinstance(robot, Robot)
        assert files_of(Mjcf, robot)
        inertias.append(solve_statics(robot).inertias["rear_steering_joint"])
    assert inertias[1] == pytest.approx(inertias[0], rel=1e-6)
