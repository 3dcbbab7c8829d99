"""URDF files of others become robots: equal masses, poses and radii, and they drive."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import trimesh

from thorvaldc import Simulation, Twist
from thorvaldc.cli.main import run_command
from thorvaldc.compiler.pipeline import compile_file, emit
from thorvaldc.model import Robot
from thorvaldc.tools.importer.urdf_import import UrdfImport, import_urdf, write_files

# -- descriptions, written for these tests ------------------------------------------------


def link(name: str, mass: float, shape: str, rpy: str = "0 0 0", size: float = 0.3) -> str:
    """A link with an oblique inertia that no solid has, and one shape."""
    i = mass * size * size / 10
    return f"""
  <link name="{name}">
    <inertial>
      <origin xyz="{size / 50} {-size / 70} {size / 90}" rpy="0.1 -0.2 0.3"/>
      <mass value="{mass}"/>
      <inertia ixx="{i}" iyy="{1.3 * i}" izz="{1.1 * i}" ixy="{i / 20}" ixz="{-i / 30}" iyz="0"/>
    </inertial>
    <visual><origin rpy="{rpy}"/><geometry>{shape}</geometry></visual>
    <collision><origin rpy="{rpy}"/><geometry>{shape}</geometry></collision>
  </link>"""


def joint(
    name: str, kind: str, parent: str, child: str, xyz: str, rpy: str = "0 0 0", rest: str = ""
) -> str:
    return f"""
  <joint name="{name}" type="{kind}">
    <origin xyz="{xyz}" rpy="{rpy}"/><parent link="{parent}"/><child link="{child}"/>{rest}
  </joint>"""


WHEEL = '<cylinder radius="{r}" length="0.05"/>'
SPIN, BACK = '<axis xyz="0 0 1"/>', '<axis xyz="0 0 -1"/>'
BASE = link("chassis", 20.0, '<box size="0.8 0.4 0.2"/>', size=0.4)
LYING = "-1.5707963267948966 0 0"


def differential() -> str:
    """Two wheels, whose links lie on their side, a ball, a scanner, and an IMU without mass."""
    wheels = "".join(
        link(f"{side}_wheel", 1.0, WHEEL.format(r=0.12), size=0.1)
        + joint(f"{side}_spin", "continuous", "chassis", f"{side}_wheel",
                f"0.1 {y} -0.08", LYING, SPIN)
        for side, y in (("left", 0.3), ("right", -0.3))
    )  # fmt: skip
    return f"""<robot name="cart">
  <link name="footprint"/>{joint("up", "fixed", "footprint", "chassis", "0 0 0.2")}
  {BASE}{wheels}
  {link("rear_caster", 0.5, '<sphere radius="0.05"/>', size=0.03)}
  {joint("rear", "fixed", "chassis", "rear_caster", "-0.3 0 -0.15", "0.3 0.2 0.1")}
  {link("front_laser", 0.4, '<box size="0.06 0.06 0.06"/>', size=0.05)}
  {joint("mast", "fixed", "chassis", "front_laser", "0.3 0 0.2", "0 0 1")}
  <link name="imu_link"/>{joint("imu", "fixed", "chassis", "imu_link", "0 0 0.1")}
  <gazebo reference="front_laser"><sensor name="scan" type="gpu_ray"><update_rate>12</update_rate>
    <ray><scan><horizontal><samples>361</samples><min_angle>-1.5</min_angle>
    <max_angle>1.5</max_angle></horizontal></scan>
    <range><min>0.1</min><max>8</max></range></ray></sensor></gazebo>
  <gazebo reference="chassis"><sensor name="bump" type="contact"/></gazebo>
</robot>"""


def skid(right_axis: str = SPIN) -> str:
    """Four driven wheels; the right ones can turn about the opposite axis."""
    wheels = "".join(
        link(f"{name}_wheel", 2.0, WHEEL.format(r=0.15), size=0.1)
        + joint(f"{name}_spin", "continuous", "chassis", f"{name}_wheel",
                f"{x} {y} -0.1", LYING, axis)
        for name, x, y, axis in (
            ("front_left", 0.3, 0.3, SPIN), ("front_right", 0.3, -0.3, right_axis),
            ("rear_left", -0.3, 0.3, SPIN), ("rear_right", -0.3, -0.3, right_axis),
        )
    )  # fmt: skip
    control = "".join(
        f'<joint name="{n}_spin"><command_interface name="velocity"/></joint>'
        for n in ("front_left", "front_right", "rear_left", "rear_right")
    )
    return (
        f'<robot name="skid">{BASE}{wheels}<ros2_control name="c" type="system">{control}'
        "</ros2_control></robot>"
    )


def steered() -> str:
    """Two steered wheels of a mesh whose middle is beside its link, and two swivel casters."""
    text = f'<robot name="steered">{BASE}'
    turn = '<axis xyz="0 0 1"/><limit lower="-2" upper="2" effort="30" velocity="3"/>'
    mesh = '<mesh filename="package://steered/tyre.stl"/>'
    for side, y in (("left", 0.3), ("right", -0.3)):
        text += link(f"{side}_leg", 1.5, '<box size="0.05 0.05 0.2"/>', size=0.1)
        text += joint(f"{side}_turn", "revolute", "chassis", f"{side}_leg", f"0.3 {y} 0", rest=turn)
        text += link(f"{side}_wheel", 2.0, mesh, size=0.1)
        text += joint(f"{side}_spin", "continuous", f"{side}_leg", f"{side}_wheel",
                      "0 0 -0.1", rest='<axis xyz="0 1 0"/>')  # fmt: skip
        text += link(f"{side}_fork", 0.5, '<box size="0.05 0.05 0.05"/>', size=0.05)
        text += joint(f"{side}_swivel", "continuous", "chassis", f"{side}_fork",
                      f"-0.3 {y} 0", rest='<axis xyz="0 0 1"/>')  # fmt: skip
        text += link(f"{side}_roll", 0.5, WHEEL.format(r=0.1), "1.5707963267948966 0 0", size=0.05)
        text += joint(f"{side}_roll", "continuous", f"{side}_fork", f"{side}_roll",
                      "-0.05 0 -0.15", rest='<axis xyz="0 1 0"/>')  # fmt: skip
    return text + "</robot>"


ROBOTS = {"cart": differential(), "skid": skid(), "steered": steered()}
# What is true of these robots, and no fault of the import.
DESERVED = {"cart": set[str](), "skid": {"skid-steering"}, "steered": set[str]()}
RADII = {"cart": [0.12, 0.12, 0.05], "skid": [0.15] * 4}


def written(tmp_path: Path, name: str, text: str) -> Path:
    (tmp_path / "package.xml").write_text("<package><name>steered</name></package>")
    tyre = trimesh.creation.cylinder(radius=0.15, height=0.05, sections=64)
    tyre.apply_transform(trimesh.transformations.rotation_matrix(math.pi / 2, [1, 0, 0]))
    tyre.apply_translation([0.0, 0.01, 0.0])
    tyre.export(tmp_path / "tyre.stl")
    path = tmp_path / f"{name}.urdf"
    path.write_text(text, encoding="utf-8")
    return path


def imported(tmp_path: Path, name: str, text: str = "") -> tuple[UrdfImport, Path]:
    result = import_urdf(written(tmp_path, name, text or ROBOTS[name]))
    assert not result.report.errors, [str(d) for d in result.report.errors]
    write_files(result.files, tmp_path / "out")
    return result, tmp_path / "out" / "robot.yaml"


def compiled(path: Path) -> tuple[Robot, set[str]]:
    compilation = compile_file(path)
    assert isinstance(compilation.model, Robot), [str(d) for d in compilation.report]
    return compilation.model, {d.code.name for d in compilation.report.warnings}


# -- MuJoCo reads both files --------------------------------------------------------------


def read_by_mujoco(text: str) -> tuple[Any, Any]:
    """Reads bodies and joints; a link above the root keeps MuJoCo from leaving the root out."""
    root = ET.fromstring(text)
    for element in list(root):
        if element.tag not in ("link", "joint"):
            root.remove(element)
        for child in element.findall("visual") + element.findall("collision"):
            element.remove(child)
    children = {e.attrib["link"] for e in root.iter("child")}
    top = next(e.attrib["name"] for e in root.iter("link") if e.attrib["name"] not in children)
    ET.SubElement(root, "link", name="above")
    fixed = ET.SubElement(root, "joint", name="above", type="fixed")
    ET.SubElement(fixed, "parent", link="above")
    ET.SubElement(fixed, "child", link=top)
    options = {"fusestatic": "false", "boundmass": "1e-15", "boundinertia": "1e-15"}
    ET.SubElement(ET.SubElement(root, "mujoco"), "compiler", options)
    model = mujoco.MjModel.from_xml_string(ET.tostring(root, encoding="unicode"))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def body(model: Any, data: Any, names: list[str], frame: str) -> np.ndarray:
    """Returns mass, moments and inertia of bodies together, in the frame of a body."""
    base = model.body(frame).id
    turn = data.xmat[base].reshape(3, 3)
    values = np.zeros(13)
    for name in names:
        index = model.body(name).id
        mass, center = model.body_mass[index], turn.T @ (data.xipos[index] - data.xpos[base])
        axes = turn.T @ data.ximat[index].reshape(3, 3)
        inertia = axes @ np.diag(model.body_inertia[index]) @ axes.T
        inertia += mass * (center @ center * np.eye(3) - np.outer(center, center))
        values += np.concatenate([[mass], mass * center, inertia.ravel()])
    return values


def assert_same_bodies(result: UrdfImport, before: tuple[Any, Any], after: tuple[Any, Any]) -> None:
    """Compares masses, inertias and poses in the frame of the first link."""
    root = next(iter(result.links))
    for link_name, own in result.links.items():
        names = [own]
        if own.endswith("_mount"):  # a ball: two bodies share its mass
            stem = own.removesuffix("mount")
            names = [own, f"{stem}swivel", f"{stem}ball"]
        expected = body(*before, [link_name], root)
        np.testing.assert_allclose(
            body(*after, names, result.links[root]), expected, rtol=1e-9, atol=1e-9
        )
        poses = []
        for (model, data), one, other in (
            (before, link_name, root),
            (after, own, result.links[root]),
        ):
            base, index = model.body(other).id, model.body(one).id
            turn = data.xmat[base].reshape(3, 3)
            place = turn.T @ (data.xpos[index] - data.xpos[base])
            poses.append(np.column_stack([turn.T @ data.xmat[index].reshape(3, 3), place]))
        np.testing.assert_allclose(poses[1], poses[0], atol=1e-9)
    masses = [model.body_mass[model.body_mass > 1e-9].sum() for model, _ in (before, after)]
    assert masses[0] == pytest.approx(masses[1], abs=1e-9)


@pytest.mark.parametrize("name", ROBOTS)
def test_masses_poses_and_radii_return(tmp_path: Path, name: str) -> None:
    result, path = imported(tmp_path, name)
    robot, warnings = compiled(path)
    assert warnings == DESERVED[name]
    built = emit(robot, ["urdf"])["urdf/robot.urdf"].decode()
    assert_same_bodies(result, read_by_mujoco(ROBOTS[name]), read_by_mujoco(built))
    tyre = trimesh.load(tmp_path / "tyre.stl").vertices
    largest = float(np.hypot(tyre[:, 0], tyre[:, 2]).max())
    radii = RADII.get(name, [largest, 0.1] * 2)
    assert [w.radius for w in robot.wheels] == pytest.approx(radii, abs=1e-9)
    stl = [n for n in result.files if n.endswith(".stl")]
    assert len(stl) == (name == "steered"), "the two equal wheels are one module with one mesh"


@pytest.mark.parametrize("name", ROBOTS)
def test_it_drives_a_metre(tmp_path: Path, name: str) -> None:
    _, path = imported(tmp_path, name)
    robot, _ = compiled(path)
    simulation = Simulation(robot, emit(robot, ["mjcf"]))
    run = simulation.run(5.0, Twist(0.2, 0.0, 0.0)).robots[0]
    assert run.path_true == pytest.approx(run.path_commanded, abs=0.05)
    assert run.path_true > 0.9
    assert run.end_error < 0.05


def test_wheels_steering_casters_and_sensors_are_recognised(tmp_path: Path) -> None:
    for name in ("cart", "steered"):
        (tmp_path / name).mkdir()
    cart, _ = compiled(imported(tmp_path / "cart", "cart")[1])
    assert [(s.type, dict(s.properties)) for s in cart.sensors] == [
        (
            "lidar_2d",
            {
                "rate": 12.0,
                "range": 8.0,
                "minimum_range": 0.1,
                "field_of_view": 3.0,
                "angular_resolution": pytest.approx(3.0 / 360),
            },
        ),
        ("imu", {}),
    ]
    assert [(w.driven, w.swivel_joint is not None) for w in cart.wheels] == [
        (True, False), (True, False), (False, True),
    ]  # fmt: skip
    robot, _ = compiled(imported(tmp_path / "steered", "steered")[1])
    kinds = [(w.driven, w.steered, w.swivel_joint is not None) for w in robot.wheels]
    assert kinds == [(True, True, False), (False, False, True)] * 2
    steering = [a for a in robot.actuators if a.role == "steering"]
    assert [(a.max_torque, a.max_velocity) for a in steering] == [(30.0, 3.0)] * 2


# -- what is named ------------------------------------------------------------------------


def said(result: UrdfImport, code: str) -> list[tuple[str, int, str]]:
    """Returns file, line and message of the diagnostics with a code."""
    return [
        (Path(d.span.file).name, d.span.line, d.message)
        for d in result.report
        if d.code.name == code and d.span is not None
    ]


CONTROLLERS = """\
drive:
  ros__parameters:
    left_wheel_names: [front_left_spin, rear_left_spin]
    right_wheel_names: [front_right_spin, rear_rigt_spin]
    wheel_radius: 0.16
    wheel_separation: 0.6
    linear.x.max_velocity: 0.7
"""


def test_contradictions_of_the_controllers_are_named(tmp_path: Path) -> None:
    path = written(tmp_path, "skid", skid(right_axis=BACK))
    yaml = tmp_path / "controllers.yaml"
    yaml.write_text(CONTROLLERS)
    result = import_urdf(path, yaml)
    ((file, line, text),) = said(result, "audit-joint-unknown")
    assert (file, line) == ("controllers.yaml", 4)
    assert "rear_rigt_spin" in text
    assert not result.files
    yaml.write_text(CONTROLLERS.replace("rigt", "right"))
    result = import_urdf(path, yaml)
    ((file, line, text),) = said(result, "audit-wheel-radius")
    assert (file, line) == ("controllers.yaml", 5)
    assert "0.15 m" in text
    assert {place[0] for place in said(result, "wheel-axes-opposite")} == {"skid.urdf"}
    assert "max_linear_velocity: 0.7 m/s" in result.files["robot.yaml"].decode()  # type: ignore[union-attr]


def test_opposite_axes_drive_straight(tmp_path: Path) -> None:
    robot, warnings = compiled(imported(tmp_path, "skid", skid(right_axis=BACK))[1])
    assert "wheel-axes-opposite" in warnings
    simulation = Simulation(robot, emit(robot, ["mjcf"]))
    run = simulation.run(4.0, Twist(0.2, 0.0, 0.0)).robots[0]
    assert run.end_error < 0.05
    assert run.path_true > 0.7


def test_what_is_not_recognised_or_assumed_is_named(tmp_path: Path) -> None:
    limits = '<axis xyz="0 1 0"/><limit lower="0" upper="1" effort="5" velocity="1"/>'
    arm = joint("lift", "revolute", "chassis", "hand", "0 0 0.3", rest=limits)
    text = differential().replace(
        "</robot>", link("hand", 0.3, '<box size="0.1 0.1 0.1"/>', size=0.05) + arm + "</robot>"
    )
    result, path = imported(tmp_path, "cart", text)
    assert any("`lift`" in message for *_, message in said(result, "import-assumed"))
    assert any("`contact`" in message for *_, message in said(result, "import-left-out"))
    assert any("which wheels have motors" in m for *_, m in said(result, "import-assumed"))
    assert "# Assumed, not read from the file: speed 1 m/s." in path.read_text()
    robot, _ = compiled(path)
    assert not any(
        j.name == "lift" or ("hand" in j.name and j.type != "fixed") for j in robot.joints
    )


@pytest.mark.parametrize(
    ("change", "code"),
    [
        (("_wheel", "_mecanum_wheel"), "import-no-base"),
        (('type="continuous"', 'type="fixed"'), "import-no-base"),
        (('<link name="footprint"/>', '<link name="footprint"/><link name="b"/>'),
         "audit-description-broken"),
        (('child link="left_wheel"', 'child link="left_whel"'), "audit-description-broken"),
        (('radius="0.12"', 'radius="0"'), "extra-number"),
        (("</robot>", ""), "extra-xml"),
        (('type="continuous"', 'type="floating"'), "extra-joint-type"),
        (("-0.3 0 -0.15", "0.1 0 -0.15"), "unstable"),
        (('mass value="1.0"', 'mass value="-1.0"'), "audit-mass"),
    ],
)  # fmt: skip
def test_no_half_robot(tmp_path: Path, change: tuple[str, str], code: str) -> None:
    assert change[0] in differential()
    result = import_urdf(written(tmp_path, "cart", differential().replace(*change)))
    places = said(result, code)
    assert places
    assert not result.files
    assert all(file == "cart.urdf" for file, *_ in places)


def test_the_command_writes_a_new_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def run(*words: str) -> int:
        monkeypatch.setattr("sys.argv", ["thorvaldc", "import", *words])
        return run_command()

    path, out = written(tmp_path, "cart", differential()), tmp_path / "out"
    assert run(str(path)) == 2
    assert run(str(path), "-o", str(out)) == 0
    assert compiled(out / "robot.yaml")[0].name == "cart"
    assert run(str(path), "-o", str(out)) == 3


def test_arguments_of_a_xacro_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    text = differential().replace('radius="0.12"', 'radius="$(arg radius)"')
    (tmp_path / "cart.xacro").write_text(text)
    monkeypatch.chdir(tmp_path)

    def run(*words: str) -> int:
        monkeypatch.setattr("sys.argv", ["thorvaldc", "import", "cart.xacro", *words])
        return run_command()

    assert run("-o", "cart") == 1
    assert "`thorvaldc import cart.xacro radius:=VALUE -o FOLDER`" in capsys.readouterr().err
    assert run("radius:=0.12", "radus:=0.13", "-o", "cart") == 0
    assert "the xacro file does not use the argument `radus`" in capsys.readouterr().err
    assert {w.radius for w in compiled(tmp_path / "cart" / "robot.yaml")[0].wheels} >= {0.12}
    assert run("a.yaml", "b.yaml", "-o", "new") == 2


def test_a_macro_that_is_called_twice_with_one_name_is_an_error(tmp_path: Path) -> None:
    marker = '<xacro:macro name="marker"><link name="marker"/></xacro:macro>'
    calls = "<xacro:marker/><xacro:marker/>"
    text = differential().replace("</robot>", f"{marker}{calls}</robot>")
    text = text.replace("<robot ", '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" ')
    path = written(tmp_path, "cart", text)
    result = import_urdf(path.rename(path.with_suffix(".xacro")))
    assert "link `marker` is defined twice" in said(result, "audit-description-broken")[0][2]
    assert not result.files
