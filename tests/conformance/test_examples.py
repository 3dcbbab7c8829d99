"""The examples compile without diagnostics, and their parts fit together."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from tests.examples import FLEETS, FOLDER, ROBOTS, SAMPLED_ROBOTS, example_robot, sampled
from thorvaldc.backends import DEFAULT_TARGETS
from thorvaldc.compiler.pipeline import compile_file, emit
from thorvaldc.model import Robot

PAPER = {
    "4wd4ws_wide": (4, 4),
    "4wd2ws_tall": (4, 2),
    "6wd6ws": (6, 6),
    "1wd1ws_rear": (1, 1),
    "2wd0ws_greenhouse": (2, 0),
    "4wd4ws_slim": (4, 4),
    "1wd1ws_front": (1, 1),
    "9wd9ws": (9, 9),
    "6wd6ws_asymmetric": (6, 6),
}
ROOT = Path(__file__).resolve().parents[2]
VISUAL = 2  # the group of visual geoms


@pytest.mark.parametrize("name", [*ROBOTS, *FLEETS])
def test_builds_without_diagnostics(name: str) -> None:
    file = next(
        FOLDER / name / f for f in ("robot.yaml", "fleet.yaml") if (FOLDER / name / f).is_file()
    )
    compilation = compile_file(file)
    assert compilation.model is not None
    emit(compilation.model, DEFAULT_TARGETS, compilation.report)
    assert not list(compilation.report), [d.message for d in compilation.report]


@pytest.mark.parametrize("name", [*ROBOTS, *FLEETS])
def test_has_a_picture_and_a_readme(name: str) -> None:
    folder = FOLDER / name
    picture = (folder / "picture.png").read_bytes()
    assert picture.startswith(b"\x89PNG")
    assert struct.unpack(">II", picture[16:24]) == (1000, 700)
    assert len(picture) < 250_000
    text = (folder / "README.md").read_text()
    assert "picture.png" in text
    assert "thorvaldc build" in text


def test_all_robots_of_the_paper_are_examples() -> None:
    assert set(PAPER) <= set(ROBOTS)
    for name, (driven, steered) in PAPER.items():
        wheels = example_robot(name).wheels
        assert (sum(w.driven for w in wheels), sum(w.steered for w in wheels)) == (driven, steered)


@pytest.mark.parametrize("name", SAMPLED_ROBOTS)
def test_every_wheel_is_on_the_ground_and_carries_load(name: str) -> None:
    robot = example_robot(name)
    assert all(abs(w.contact_height) < 1e-9 for w in robot.wheels)
    assert min(w.load for w in robot.wheels) > 50.0
    assert sum(w.load for w in robot.wheels) == pytest.approx(robot.inertial.mass * 9.81, rel=1e-3)


class Scene:
    """A robot's MJCF in its home pose, with distances between visual geoms (convex hulls)."""

    def __init__(self, robot: Robot, folder: Path) -> None:
        for path, data in emit(robot, ["mjcf"]).items():
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            (folder / path).write_bytes(data)
        self.model = mujoco.MjModel.from_xml_path(str(folder / "mjcf" / "scene.xml"))
        self.data = mujoco.MjData(self.model)
        mujoco.mj_resetDataKeyframe(self.model, self.data, 0)
        mujoco.mj_kinematics(self.model, self.data)
        self.home = self.data.qpos.copy()
        self.visuals = [g for g in range(self.model.ngeom) if self.model.geom_group[g] == VISUAL]

    def near(self, geom: int, others: Any, distance: float) -> list[int]:
        """Returns the geoms of ``others`` within ``distance`` (m) of ``geom``."""
        m, d = self.model, self.data
        others = np.asarray(others)
        apart = np.linalg.norm(d.geom_xpos[others] - d.geom_xpos[geom], axis=1)
        close = others[apart < m.geom_rbound[others] + m.geom_rbound[geom] + distance]
        return [
            int(o)
            for o in close
            if mujoco.mj_geomDistance(m, d, geom, int(o), 0.05, None) < distance
        ]

    def body(self, geom: int) -> int:
        return int(self.model.geom_bodyid[geom])

    def name(self, geom: int) -> str:
        return str(self.model.body(self.body(geom)).name)

    def is_below(self, geom: int, body: int) -> bool:
        """Reports if the geom belongs to the body or to one of its descendants."""
        ancestor = self.body(geom)
        while ancestor and ancestor != body:
            ancestor = int(self.model.body_parentid[ancestor])
        return ancestor == body


@pytest.mark.parametrize("name", SAMPLED_ROBOTS)
def test_nothing_floats(name: str, tmp_path: Path) -> None:
    assert floating(example_robot(name), tmp_path) == []


PRESETS = sorted(p.stem for p in (ROOT / "templates/robot").iterdir())


@pytest.mark.parametrize("preset", sampled(PRESETS, PRESETS[:2]))
def test_nothing_floats_in_robots_of_the_command_new(preset: str, tmp_path: Path) -> None:
    text = (ROOT / f"templates/robot/{preset}.yaml").read_text().replace("@NAME@", "mine")
    assert floating(compiled(text, tmp_path), tmp_path) == []


def test_nothing_floats_in_the_robot_of_the_first_look(tmp_path: Path) -> None:
    page = (ROOT / "docs/first-look.md").read_text()
    text = page.split("```yaml\n", 1)[1].split("```", 1)[0]
    assert floating(compiled(text, tmp_path), tmp_path) == []


def compiled(text: str, folder: Path) -> Robot:
    (folder / "robot.yaml").write_text(text)
    compilation = compile_file(folder / "robot.yaml")
    assert isinstance(compilation.model, Robot)
    assert not list(compilation.report)
    return compilation.model


def floating(robot: Robot, folder: Path) -> list[str]:
    """Returns the bodies with visual geoms that are not connected to the rest by contacts."""
    scene = Scene(robot, folder)
    reached, waiting = {scene.visuals[0]}, [scene.visuals[0]]
    while waiting:
        for geom in scene.near(waiting.pop(), scene.visuals, 0.002):
            if geom not in reached:
                reached.add(geom)
                waiting.append(geom)
    return sorted({scene.name(g) for g in scene.visuals if g not in reached})


@pytest.mark.parametrize("name", SAMPLED_ROBOTS)
def test_legs_turn_freely(name: str, tmp_path: Path) -> None:
    """Over the whole steering range no part of the leg touches the rest of the robot."""
    scene = Scene(example_robot(name), tmp_path)
    m = scene.model
    for wheel in example_robot(name).wheels:
        turning = wheel.steering_joint or wheel.swivel_joint
        if turning is None:
            continue
        joint = m.joint(turning)
        body = int(joint.bodyid[0])
        moving = [g for g in scene.visuals if scene.is_below(g, body)]
        holder = int(m.body_parentid[body])
        fixed = [
            g for g in scene.visuals if not scene.is_below(g, body) and scene.body(g) != holder
        ]
        limits = joint.range if joint.limited[0] else (-np.pi, np.pi)
        for angle in np.linspace(*limits, 25):
            scene.data.qpos[:] = scene.home
            scene.data.qpos[joint.qposadr[0]] = angle
            mujoco.mj_kinematics(m, scene.data)
            contacts = [
                (scene.name(g), scene.name(o)) for g in moving for o in scene.near(g, fixed, -1e-3)
            ]
            assert contacts == [], f"at {np.degrees(angle):.0f} deg"


@pytest.mark.parametrize("name", SAMPLED_ROBOTS)
def test_tyres_touch_nothing(name: str, tmp_path: Path) -> None:
    """A tyre touches neither its leg or fork nor another part of the robot."""
    scene = Scene(example_robot(name), tmp_path)
    m, d = scene.model, scene.data
    for wheel in example_robot(name).wheels:
        body = m.body(wheel.link).id
        tyre = [g for g in scene.visuals if scene.body(g) == body and "tyre" in _mesh(m, g)]
        assert tyre
        carriers = {body, int(m.body_parentid[body])} if wheel.driven else {body}
        # The convex hull of a tyre has no hole, so geoms on the axle do not count.
        axle, across = d.xpos[body], d.xmat[body].reshape(3, 3)[:, 1]
        others = [
            g
            for g in scene.visuals
            if scene.body(g) not in carriers
            and np.linalg.norm(np.cross(d.geom_xpos[g] - axle, across)) > 1e-3
        ]
        contacts = {scene.name(o) for g in tyre for o in scene.near(g, others, -1e-3)}
        assert contacts == set()


def _mesh(model: mujoco.MjModel, geom: int) -> str:
    mesh = int(model.geom_dataid[geom])
    return str(model.mesh(mesh).name) if mesh >= 0 else ""
