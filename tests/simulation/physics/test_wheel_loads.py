"""The wheel loads of settled robots in MuJoCo are the wheel loads of the model."""

from __future__ import annotations

import random
from pathlib import Path

import numpy as np
import pytest

from tests.examples import SAMPLED_ROBOTS
from thorvaldc.compiler.pipeline import compile_file, emit
from thorvaldc.model import Robot
from thorvaldc.simulation.physics.mujoco_scene import MujocoScene

mujoco = pytest.importorskip("mujoco")
EXAMPLES = Path(__file__).resolve().parents[3] / "examples"


def loads(robot: Robot) -> list[float]:
    """Vertical contact force (N) of each wheel after 3 s in MuJoCo."""
    scene = MujocoScene(emit(robot, ["mjcf"]))
    scene.advance(3.0)
    assert abs(scene.data.qvel).max() < 1e-3
    forces: dict[int, float] = {}
    force = np.zeros(6)
    for i, contact in enumerate(scene.data.contact):
        mujoco.mj_contactForce(scene.model, scene.data, i, force)
        for geom in contact.geom:
            forces[int(geom)] = forces.get(int(geom), 0.0) + abs(contact.frame[2] * force[0])
    treads = [scene.index("geom", f"{robot.prefix}{w.link}_tread", robot) for w in robot.wheels]
    return [forces.get(tread, 0.0) for tread in treads]


def random_robot(folder: Path, seed: int) -> Robot:
    """A rigid robot with 5 to 9 wheels that do not touch each other, and two batteries."""
    chance = random.Random(seed)
    places = [(x, y) for x in (-1.1, -0.4, 0.4, 1.1) for y in (-0.8, 0.0, 0.8)]
    corners = [(-1.1, -0.8), (-1.1, 0.8), (1.1, -0.8), (1.1, 0.8)]
    others = [place for place in places if place not in corners]
    wheels = corners + chance.sample(others, chance.randint(1, 5))
    lines = ["thorvaldc: 1", "name: rigid", "modules:"]
    lines += ["  frame: {type: frame/tube_rectangular, params: {length: 2.4 m, width: 1.8 m}}"]
    for i, (x, y) in enumerate(wheels):
        x, y = x + chance.uniform(-0.1, 0.1), y + chance.uniform(-0.1, 0.1)
        kind = chance.choice(("steered_drive", "fixed_drive"))
        mount = f"{{parent: frame, xyz: [{x:.3f}, {y:.3f}, 0]}}"
        lines.append(f"  w{i}: {{type: assembly/{kind}, mount: {mount}}}")
    for i in range(2):
        mount = f"[{chance.uniform(-0.7, 0.7):.3f}, {chance.uniform(-0.5, 0.5):.3f}, 0.07]"
        lines.append(f"  b{i}: {{type: battery/enclosure, mount: {{parent: frame, xyz: {mount}}}}}")
    path = folder / "rigid.yaml"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    compilation = compile_file(path)
    assert isinstance(compilation.model, Robot), [d.message for d in compilation.report]
    return compilation.model


@pytest.mark.parametrize("seed", range(12))
def test_rigid_robots_with_many_wheels(seed: int, tmp_path: Path) -> None:
    robot = random_robot(tmp_path, seed)
    assert 5 <= len(robot.wheels) <= 9
    expected = [wheel.load for wheel in robot.wheels]
    assert min(expected) > 0.0
    assert loads(robot) == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize("name", SAMPLED_ROBOTS)
def test_examples(name: str) -> None:
    robot = compile_file(EXAMPLES / name / "robot.yaml").model
    assert isinstance(robot, Robot)
    assert loads(robot) == pytest.approx([wheel.load for wheel in robot.wheels], rel=0.02)
