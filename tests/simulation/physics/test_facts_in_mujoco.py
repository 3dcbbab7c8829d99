"""The facts of robots, compared with their motion in MuJoCo."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.examples import SAMPLED_ROBOTS, example_robot
from thorvaldc.compiler.pipeline import emit
from thorvaldc.model import Robot
from thorvaldc.model.facts.robot_facts import robot_facts
from thorvaldc.model.facts.stability import DIRECTIONS
from thorvaldc.model.spatial import GRAVITY
from thorvaldc.model.statics.slope import SlopeStatics
from thorvaldc.simulation.physics.mujoco_scene import MujocoScene

mujoco = pytest.importorskip("mujoco")
G = GRAVITY


@pytest.mark.parametrize("name", SAMPLED_ROBOTS)
def test_mass_and_center_of_mass(name: str) -> None:
    facts = robot_facts(example_robot(name))
    scene = MujocoScene(emit(example_robot(name), ["mjcf"]))
    scene.data.qpos[:] = scene.model.qpos0
    mujoco.mj_forward(scene.model, scene.data)
    base = mujoco.mj_name2id(scene.model, mujoco.mjtObj.mjOBJ_BODY, "base_link")
    assert scene.model.body_subtreemass[base] == pytest.approx(facts.mass)
    center = scene.data.subtree_com[base] - scene.data.xpos[base]
    assert center == pytest.approx(np.array(facts.center_of_mass), abs=1e-6)


def tilted(name: str, angle: float, direction: float, friction: float = 5.0) -> MujocoScene:
    """Returns a robot on ground that falls in a direction: the gravity turns, the ground does not.

    The grip is so large that the robot tips over before it slides.
    """
    scene = MujocoScene(emit(example_robot(name), ["mjcf"]))
    scene.model.geom_friction[:, 0] = friction
    if scene.model.npair:
        scene.model.pair_friction[:, :2] = friction
    down = G * math.sin(angle)
    scene.model.opt.gravity[:] = (
        down * math.cos(direction),
        down * math.sin(direction),
        -G * math.cos(angle),
    )
    return scene


def upright(scene: MujocoScene) -> float:
    """Cosine of the tilt of the robot."""
    base = mujoco.mj_name2id(scene.model, mujoco.mjtObj.mjOBJ_BODY, "base_link")
    return float(scene.data.xmat[base][8])


@pytest.mark.parametrize("name", ["car", "1wd1ws_front"])
@pytest.mark.parametrize("direction", ["left", "right", "least"])
def test_a_robot_tips_over_at_its_angle(name: str, direction: str) -> None:
    stability = robot_facts(example_robot(name)).stability
    assert stability.least is not None
    where = stability.least.direction if direction == "least" else DIRECTIONS[direction]
    limit = dict(stability.angles).get(direction, stability.least.angle)
    stands = tilted(name, limit - math.radians(2.0), where)
    stands.advance(2.0)
    assert upright(stands) > math.cos(math.radians(10.0))
    falls = tilted(name, limit + math.radians(2.0), where)
    falls.advance(2.0)
    assert upright(falls) < math.cos(math.radians(20.0))


def without_rolling_resistance(name: str) -> Robot:
    robot = example_robot(name)
    wheels = tuple(replace(wheel, rolling_resistance=0.0) for wheel in robot.wheels)
    return replace(robot, wheels=wheels)


@pytest.mark.parametrize("name", ["car", "1wd1ws_front", "9wd9ws"])
@pytest.mark.parametrize("backwards", [False, True])
def test_wheel_loads_on_a_slope(name: str, backwards: bool) -> None:
    robot, angle = example_robot(name), math.radians(10.0)
    scene = tilted(name, angle, 0.0 if backwards else math.pi, friction=2.0)
    scene.advance(2.0)
    forces: dict[int, float] = {}
    force = np.zeros(6)
    for i, contact in enumerate(scene.data.contact):
        mujoco.mj_contactForce(scene.model, scene.data, i, force)
        for geom in contact.geom:
            forces[int(geom)] = forces.get(int(geom), 0.0) + abs(contact.frame[2] * force[0])
    treads = [scene.index("geom", f"{robot.prefix}{w.link}_tread", robot) for w in robot.wheels]
    loads = SlopeStatics(robot).loads(angle, (-1.0 if backwards else 1.0, 0.0))
    assert [forces.get(tread, 0.0) for tread in treads] == pytest.approx(
        loads, abs=0.01 * robot.inertial.mass * G
    )


@pytest.mark.parametrize("backwards", [False, True])
def test_a_robot_with_one_driven_wheel_slides_at_the_limit_of_its_grip(backwards: bool) -> None:
    """Its wheel is held by the motor; the other wheels roll freely."""
    name = "1wd1ws_front"
    slopes = robot_facts(without_rolling_resistance(name)).slopes
    assert slopes is not None
    limits = slopes.backwards if backwards else slopes.forwards
    assert limits.grip is not None
    downhill = 0.0 if backwards else math.pi
    distances = []
    for angle in (limits.grip - math.radians(1.5), limits.grip + math.radians(1.5)):
        wheel = next(wheel for wheel in example_robot(name).wheels if wheel.driven)
        scene = tilted(name, angle, downhill, friction=wheel.friction)
        scene.advance(1.0)
        distances.append(abs(float(scene.data.qpos[0])))
    assert distances[0] < 0.05
    assert distances[1] > 3.0 * distances[0]
    assert distances[1] > 0.05
