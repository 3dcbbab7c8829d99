"""MJCF and SDF files of others become robots, as URDF files do."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import trimesh

from tests.examples import example_robot
from tests.tools.importer.test_urdf_import import (
    assert_same_bodies,
    body,
    compiled,
    read_by_mujoco,
    said,
)
from thorvaldc import Simulation, Twist
from thorvaldc.cli.main import run_command
from thorvaldc.compiler.pipeline import emit
from thorvaldc.diagnostics import Report
from thorvaldc.model import MeshShape, Robot
from thorvaldc.model.stl import mesh_vertices
from thorvaldc.model.sums import float_sum
from thorvaldc.tools.importer.urdf_import import UrdfImport, import_urdf, write_files

FORMATS = Path(__file__).parent / "formats"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with the carts, and the mesh of one of them beside it."""
    shutil.copytree(FORMATS, tmp_path / "formats")
    (tmp_path / "meshes").mkdir()
    lid = trimesh.creation.box((200.0, 100.0, 30.0))
    lid.apply_translation([20.0, 10.0, 15.0])
    lid.export(tmp_path / "meshes/lid.stl")
    return tmp_path / "formats"


def imported(file: Path) -> tuple[UrdfImport, Robot, tuple[Any, Any]]:
    """Imports a file; returns the result, the robot, and what MuJoCo reads of its URDF."""
    result = import_urdf(file)
    assert not result.report.errors, [str(d) for d in result.report.errors]
    write_files(result.files, file.parent / "out")
    robot, warnings = compiled(file.parent / "out/robot.yaml")
    assert not warnings
    return result, robot, read_by_mujoco(emit(robot, ["urdf"])["urdf/robot.urdf"].decode())


def mass(robot: Robot) -> float:
    return float_sum(link.inertial.mass for link in robot.links if link.inertial is not None)


def wheels(result: UrdfImport, built: tuple[Any, Any], names: tuple[str, str]) -> float:
    """Returns the distance of two wheels in the built robot."""
    model, data = built
    left, right = (data.xpos[model.body(result.links[name]).id] for name in names)
    return float(np.linalg.norm(left - right))


def test_an_mjcf_file_is_what_mujoco_says(folder: Path) -> None:
    result, robot, built = imported(folder / "cart.xml")
    model = mujoco.MjModel.from_xml_path(str(folder / "cart.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert_same_bodies(result, (model, data), built)
    radius = model.geom_size[model.body("left_wheel").geomadr[0], 0]
    assert [w.radius for w in robot.wheels] == pytest.approx([radius, radius, 0.05], abs=1e-9)
    assert [w.driven for w in robot.wheels] == [True, True, False]
    assert wheels(result, built, ("left_wheel", "right_wheel")) == pytest.approx(0.4, abs=1e-9)
    assert said(result, "import-left-out") == [("cart.xml", 30, "<sensor> is not imported: <gyro>")]
    # The mesh lies where MuJoCo draws it.
    own = next(link for link in robot.links if link.name == result.links["chassis"])
    visual = next(v for v in own.visuals if isinstance(v.shape, MeshShape))
    assert isinstance(visual.shape, MeshShape)
    mesh = next(m for m in robot.meshes if m.name == visual.shape.mesh)
    points = [
        visual.pose.apply(tuple(s * x for s, x in zip(visual.shape.scale, point, strict=True)))  # type: ignore[arg-type]
        for point in mesh_vertices(mesh.name, mesh.data)
    ]
    lid = int(np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_MESH)[0])
    drawn = model.mesh_vert @ data.geom_xmat[lid].reshape(3, 3).T + data.geom_xpos[lid]
    chassis = model.body("chassis").id
    drawn = (drawn - data.xpos[chassis]) @ data.xmat[chassis].reshape(3, 3)
    for reach in (np.min, np.max):
        np.testing.assert_allclose(reach(points, axis=0), reach(drawn, axis=0), atol=1e-6)


def tensor(mass: float, center: Any, inertia: Any) -> np.ndarray:
    """Returns mass, moments and inertia in the frame of the chassis, as ``body`` does."""
    inertia = inertia + mass * (center @ center * np.eye(3) - np.outer(center, center))
    return np.concatenate([[mass], mass * center, inertia.ravel()])


def test_an_sdf_file_is_what_its_numbers_say(folder: Path) -> None:
    result, robot, built = imported(folder / "cart.sdf")
    c, s = np.cos(0.3), np.sin(0.3)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    chassis = turn @ np.array([[0.07, 0.001, 0], [0.001, 0.12, 0], [0, 0, 0.16]]) @ turn.T
    wheel = np.diag([0.005, 0.009, 0.005])  # on its side
    expected = {
        "chassis": tensor(8.25, np.array([-0.05, 0.01, 0.02]), chassis),
        "left": tensor(1.5, np.array([0.0, 0.21, 0.01]), wheel),
        "right": tensor(1.5, np.array([0.0, -0.21, 0.01]), wheel),
    }
    for name, values in expected.items():
        read = body(*built, [result.links[name]], result.links["chassis"])
        np.testing.assert_allclose(read, values, rtol=1e-9, atol=1e-9)
    assert mass(robot) == pytest.approx(8.25 + 1.5 + 1.5 + 0.25, abs=1e-9)
    assert [w.radius for w in robot.wheels] == pytest.approx([0.11, 0.11, 0.05], abs=1e-9)
    assert wheels(result, built, ("left", "right")) == pytest.approx(0.42, abs=1e-9)
    assert [(s.type, dict(s.properties)["rate"]) for s in robot.sensors] == [("lidar_2d", 12.0)]
    model, data = built
    lidar = data.xpos[model.body(result.links["lidar"]).id]
    lidar = lidar - data.xpos[model.body(result.links["chassis"]).id]
    np.testing.assert_allclose(lidar, [0.1, 0.0, 0.12], atol=1e-9)


def test_axes_before_sdf_1_5_are_in_the_frame_of_the_model(folder: Path) -> None:
    text = (folder / "cart.sdf").read_text().replace('version="1.9"', 'version="1.4"')
    text = text.replace("<xyz>0 0 1</xyz>", "<xyz>0 1 0</xyz>").replace(
        ' expressed_in="chassis"', ""
    )
    (folder / "cart.sdf").write_text(text)
    result, robot, built = imported(folder / "cart.sdf")
    assert [w.driven for w in robot.wheels] == [True, True, False]
    assert wheels(result, built, ("left", "right")) == pytest.approx(0.42, abs=1e-9)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("<pose>-0.05 0.01 0.02", '<pose relative_to="chassis">-0.05 0.01 0.02'),
        ("<pose>-0.05 0.01 0.02", '<pose relative_to="__model__">-0.05 0.01 0.12'),
        ("<pose>0.1 0 0.12 0", '<pose relative_to="left_joint">0.1 -0.11 -0.21 1.5707963267948966'),
        ('degrees="true">0.0', 'degrees="1">0.0'),
        ("<pose>0 0 0.1 0 0 0", '<pose rotation_format="quat_xyzw">0 0 0.1 0 0 0 2'),
        ("<parent>chassis</parent><child>right", "<parent>top</parent><child>right"),
    ],
)
def test_poses_have_several_forms(folder: Path, old: str, new: str) -> None:
    """The frame of the joint `left` has its y axis upwards: [x, y, z] there is [x, z, -y]."""
    text = (folder / "cart.sdf").read_text()
    assert old in text
    frame = '<frame name="top" attached_to="chassis"><pose>0 0 0.4 0 0 0</pose></frame>'
    text = text.replace("<link", f"{frame}<link", 1)
    (folder / "cart.sdf").write_text(text.replace(old, new))
    test_an_sdf_file_is_what_its_numbers_say(folder)


@pytest.mark.parametrize("name", ["cart.xml", "cart.sdf"])
def test_it_drives_a_metre(folder: Path, name: str) -> None:
    _, robot, _ = imported(folder / name)
    simulation = Simulation(robot, emit(robot, ["mjcf"]))
    run = simulation.run(5.0, Twist(0.2, 0.0, 0.0)).robots[0]
    assert run.path_true == pytest.approx(run.path_commanded, abs=0.05)
    assert run.path_true > 0.9


@pytest.mark.parametrize("name", ["2wd0ws_greenhouse", "4wd4ws_wide"])
@pytest.mark.parametrize("file", ["mjcf/robot.xml", "sdf/model.sdf"])
def test_our_own_build_has_the_mass_of_the_robot(tmp_path: Path, name: str, file: str) -> None:
    robot = example_robot(name)
    for path, content in emit(robot, ["mjcf", "sdf"], Report()).items():
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / path).write_bytes(content)
    result = import_urdf(tmp_path / file)
    write_files(result.files, tmp_path / "out")
    again, _ = compiled(tmp_path / "out/robot.yaml")
    assert mass(again) == pytest.approx(mass(robot), abs=1e-9)
    assert len(again.wheels) == len(robot.wheels)
    kinds = [(wheel.driven, wheel.steered) for wheel in robot.wheels if wheel.driven]
    assert [(w.driven, w.steered) for w in again.wheels if w.driven] == kinds


@pytest.mark.parametrize(
    ("file", "old", "new", "code", "line", "text"),
    [
        ("cart.xml", "</mujoco>", "", "import-value", 32, "no element found"),
        ("cart.xml", 'size="0.05"', 'sizes="0.05"', "import-value", 22, "unrecognized attribute"),
        ("cart.xml", "lid.stl", "lit.stl", "import-value", 10, "does not exist"),
        ("cart.xml", "../meshes", "../other", "import-value", 10, "not allowed"),
        ("cart.xml", "wheels.xml", "wheel.xml", "import-value", 19, "cannot be read"),
        ("cart.xml", "wheels.xml", "../w.xml", "import-value", 19, "not below the folder"),
        ("cart.xml", 'type="box"', 'class="%n%n%s"', "import-value", 1, "ended its reader"),
        ("cart.xml", 'type="sphere" size="0.05"', 'type="box" size="0.05 0.05 0.05"',
         "extra-joint-type", 21, "`ball`"),
        ("cart.xml", '<site name="imu"/>', '</body><body name="box">', "audit-description-broken",
         18, "one root link"),
        ("cart.sdf", "<sdf ", "<sdff ", "import-value", 44, "mismatched tag"),
        ("cart.sdf", "<child>left</child>", "<child>left_</child>", "audit-description-broken",
         31, "link `left_`, which does not exist"),
        ("cart.sdf", "<mass>8.25", "<mass>heavy", "extra-number", 9, "heavy"),
        ("cart.sdf", "<box><size>", "<plane><size>", "import-value", 12, "mismatched tag"),
        ("cart.sdf", "<wheel_radius>0.11", "<wheel_radius>0.13", "audit-wheel-radius", 41, "0.13"),
        ("cart.sdf", "<pose>0 0 0.1 0 0 0<", "<pose>0 0 0.1 0 0<", "import-value", 6, "six finite"),
        ("cart.sdf", "<pose>0 0 0.1 0 0 0<", "<pose>0 0 nan 0 0 0<", "import-value", 6, "finite"),
        ("cart.sdf", 'relative_to="chassis"', 'relative_to="chasis"', "import-value", 32,
         "no link, joint or frame `chasis`"),
        ("cart.sdf", 'expressed_in="chassis"', 'expressed_in="chasis"', "import-value", 36,
         "no link, joint or frame `chasis`"),
        ("cart.sdf", 'relative_to="chassis"', 'relative_to="left"', "import-value", 31, "circle"),
        ("cart.sdf", "<xyz>0 0 1<", "<xyz>0 0 nan<", "import-value", 33, "three finite numbers"),
        ("cart.sdf", "<plugin ", '<model name="arm"/><plugin ', "import-left-out", 39, "`arm`"),
        ("cart.xml", 'pos="-0.25 0 -0.06"', 'pos="-0.25 0 nan"', "import-value", 20, "finite"),
        ("cart.xml", "<light ", "<lihgt ", "import-left-out", 13, "<lihgt>"),
    ],
)  # fmt: skip
def test_what_is_wrong_has_a_place(
    folder: Path, file: str, old: str, new: str, code: str, line: int, text: str
) -> None:
    shutil.copytree(folder.parent / "meshes", folder.parent / "other")  # no folder of meshes
    content = (folder / file).read_text(encoding="utf-8")
    assert old in content
    (folder / file).write_text(content.replace(old, new), encoding="utf-8")
    result = import_urdf(folder / file)
    places = [place for *place, message in said(result, code) if text in message]
    assert [file, line] in places, [(d.span, d.message) for d in result.report]


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('meshdir="../meshes"/>', 'meshdir="../none"/><compiler meshdir="../meshes"/>'),
        ('meshdir="../meshes"/>', 'meshdir="../meshes" strippath="true"/>'),
    ],
)
def test_the_folder_of_meshes(folder: Path, old: str, new: str) -> None:
    text = (folder / "cart.xml").read_text()
    assert old in text
    name = "../elsewhere/lid.stl" if "strippath" in new else "lid.stl"
    (folder / "cart.xml").write_text(text.replace(old, new).replace("lid.stl", name))
    test_an_mjcf_file_is_what_mujoco_says(folder)


def test_the_command_takes_the_files(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def run(*words: str) -> int:
        monkeypatch.setattr("sys.argv", ["thorvaldc", *words])
        return run_command()

    monkeypatch.chdir(folder)
    assert run("import", "cart.sdf", "radius:=0.1", "-o", "out") == 2
    for name in ("cart.sdf", "cart.xml"):
        assert run("import", name, "-o", f"{name}.out") == 0
        assert run("check", f"{name}.out/robot.yaml") == 0


@pytest.mark.parametrize(
    ("name", "content", "text"),
    [
        ("a.xml", "<launch/>", "its root element is <launch>"),
        ("a.sdf", "<sdf><model name='m'/></sdf>", "no model with joints"),
        ("a.mjcf", "\0", "unclosed token"),
    ],
)
def test_a_file_without_a_robot(tmp_path: Path, name: str, content: str, text: str) -> None:
    (tmp_path / name).write_text(content)
    ((file, line, message),) = said(import_urdf(tmp_path / name), "import-value")
    assert (file, line) == (name, 1)
    assert text in message
