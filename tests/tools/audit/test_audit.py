"""``thorvaldc audit``: a robot without contradictions, and the same robot with each of them."""

from __future__ import annotations

import json
import os
import re
import shutil
import time
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.backends.plans import stl
from tests.cli.conftest import Command, thorvaldc
from tests.examples import FLEETS, SAMPLED_ROBOTS, example_fleet, example_robot
from tests.slow import mostly_slow, one_quick_of
from thorvaldc.backends import TARGETS
from thorvaldc.compiler.pipeline import emit
from thorvaldc.diagnostics import CODES, Report
from thorvaldc.tools.audit.audit_run import audit

__all__ = ["thorvaldc"]
HERE = Path(__file__).parent
ROOT = HERE.parents[2]
CART = HERE / "robots/cart"
CONTRADICTIONS = yaml.safe_load((HERE / "contradictions.yaml").read_text(encoding="utf-8"))


@pytest.fixture
def cart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of the cart, in the working folder."""
    monkeypatch.chdir(tmp_path)
    shutil.copytree(CART, tmp_path / "cart")
    return tmp_path / "cart"


def change(path: Path, old: str, new: str) -> None:
    text = path.read_text(encoding="utf-8")
    assert old in text, f"{path} does not contain {old!r}"
    path.write_text(text.replace(old, new, 1), encoding="utf-8")


def findings(*names: str) -> list[tuple[str, str, int]]:
    return [
        (d.code.name, d.span.file, d.span.line)
        for d in audit(names).report.sorted()
        if d.span is not None
    ]


def test_a_robot_without_contradictions(cart: Path) -> None:
    result = audit(["cart"])
    assert list(result.report) == []
    assert [d.format for d in result.evidence.descriptions] == ["SDF", "MJCF", "URDF"]
    assert len(result.evidence.sections) == 8
    assert len(result.evidence.launches) == 4
    paths = sorted(path for path in cart.rglob("*") if path.is_file() and path.suffix != ".stl")
    assert list(audit([str(path.relative_to(cart.parent)) for path in paths]).report) == []


@pytest.mark.usefixtures("quick_xacro")
@pytest.mark.parametrize(
    "row", one_quick_of(4, CONTRADICTIONS), ids=lambda row: f"{row[3]}-{row[0]}"
)
def test_a_contradiction(cart: Path, row: list[Any]) -> None:
    file, old, new, code, place, line = row
    change(cart / file, old, new)
    assert (code, f"cart/{place}", line) in findings("cart"), list(audit(["cart"]).report)


def test_the_place_of_a_wheel_that_is_a_mesh_is_unknown(cart: Path) -> None:
    shutil.rmtree(cart / "models")
    change(cart / "config/controllers.yaml", "separation: 0.5", "separation: 0.55")
    assert [code for code, _, _ in findings("cart")] == ["audit-wheel-separation"]
    mesh = '<mesh filename="package://cart/meshes/lidar.stl" scale="0.001 0.001 0.001"/>'
    change(cart / "urdf/wheel.xacro", '<cylinder radius="${wheel_radius}" length="0.05"/>', mesh)
    assert findings("cart") == []


SWERVE = """
    <plugin filename="gz-sim-swerve-drive-system" name="gz::sim::systems::SwerveDrive">
      <front_left_joint>fl_drive_axle</front_left_joint>
      <front_right_joint>fr_drive_axle</front_right_joint>
      <back_left_joint>rl_drive_axle</back_left_joint>
      <back_right_joint>rr_drive_axle</back_right_joint>
      <front_left_steering_joint>fl_steering_joint</front_left_steering_joint>
      <wheelbase>1.098</wheelbase>
      <wheel_separation>1.6</wheel_separation>
      <wheel_radius>0.2</wheel_radius>
    </plugin>
  </model>"""


@pytest.mark.parametrize(
    ("old", "new", "code"),
    [
        ("1.098", "1.098", ""),
        ("1.098", "1.2", "audit-wheel-separation"),
        (">1.6<", ">1.5<", "audit-wheel-separation"),
        (">0.2<", ">0.25<", "audit-wheel-radius"),
        ("fl_steering_joint", "fl_steer", "audit-joint-unknown"),
    ],
)
def test_the_drive_system_for_four_steered_wheels(
    old: str, new: str, code: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A foreign model with the system SwerveDrive of Gazebo."""
    monkeypatch.chdir(tmp_path)
    model = emit(example_robot("4wd4ws_wide"), ["sdf"], Report())["sdf/model.sdf"].decode()
    model = re.sub(r"<plugin.*?</plugin>", "", model, flags=re.DOTALL)
    model = re.sub("<visual.*?</visual>", "", model, flags=re.DOTALL)
    plugin = SWERVE.replace(old, new)
    Path("model.sdf").write_text(model.replace("</model>", plugin), encoding="utf-8")
    assert {found for found, _, _ in findings("model.sdf")} == ({code} if code else set())


def test_a_flat_mesh_has_a_size(cart: Path) -> None:
    """A panel of 60 mm across the x axis, whose mesh is in millimetres, without a scale."""
    corners = [(0.0, 0.0, 0.0), (0.0, 60.0, 0.0), (0.0, 60.0, 60.0), (0.0, 0.0, 60.0)]
    triangles = [(corners[0], corners[i], corners[i + 1]) for i in (1, 2)]
    (cart / "meshes/lidar.stl").write_bytes(stl(*triangles))
    change(cart / "urdf/cart.urdf.xacro", ' scale="0.001 0.001 0.001"', "")
    assert ("length-unit", "cart/urdf/cart.urdf.xacro", 17) in findings("cart")


def test_a_launch_argument_decides_on_stamps(cart: Path) -> None:
    change(cart / "config/twist_mux.yaml", "use_stamped: true", "use_stamped: false")
    old = '{"frame_id": "lidar_link", '
    change(cart / "launch/cart.launch.py", old, old + '"use_stamped": LaunchConfiguration("s"), ')
    assert findings("cart") == []


def test_every_rule_has_a_contradiction() -> None:
    codes = {name for name in CODES if name.startswith("audit-")}
    codes |= {"inertia-too-large", "density-implausible", "length-unit", "angle-unit"}
    tested_elsewhere = {"audit-limit", "audit-nothing-found", "audit-footprint", "angle-unit"}
    assert codes - tested_elsewhere == {row[3] for row in CONTRADICTIONS}


def test_exit_status_and_formats(thorvaldc: Command, cart: Path) -> None:
    assert thorvaldc("audit", "cart").status == 0
    change(cart / "config/controllers.yaml", "wheel_radius: 0.1", "wheel_radius: 0.11")
    assert thorvaldc("audit", "cart").status == 0
    assert thorvaldc("audit", "cart", "--strict").status == 1
    output = thorvaldc("audit", "cart", "--format", "json")
    assert thorvaldc("audit", "cart", "--json").out == output.out
    (diagnostic,) = json.loads(output.out)["diagnostics"]
    assert diagnostic["code"] == "TV943"
    assert "drives 9.1 % less far than its odometry says" in diagnostic["message"]
    assert "TV943" in thorvaldc("audit", "cart", "--format", "sarif").out
    github = thorvaldc("audit", "cart", "--format", "github").out
    assert "file=cart/config/controllers.yaml,line=11" in github
    change(cart / "config/controllers.yaml", "[left_wheel_joint]", "[left_joint]")
    assert thorvaldc("audit", "cart").status == 1
    assert thorvaldc("audit", "missing").status == 1
    assert thorvaldc("audit").status == 2
    assert thorvaldc("audit", "cart", "--format", "xml").status == 2


@pytest.mark.parametrize("name", mostly_slow([FLEETS[0], *SAMPLED_ROBOTS]))
def test_our_own_output_has_no_contradictions(name: str, tmp_path: Path) -> None:
    model = example_fleet(name) if name in FLEETS else example_robot(name)
    for path, content in emit(model, list(TARGETS), Report()).items():
        file = tmp_path / "build" / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(content)
    result = audit([str(tmp_path / "build")])
    assert list(result.report) == []
    formats = {description.format for description in result.evidence.descriptions}
    assert formats == {"URDF", "SDF", "MJCF"}


# -- hostile folders --------------------------------------------------------------------


def test_links_pipes_and_other_files(cart: Path) -> None:
    os.symlink(cart, cart / "config/loop")
    os.symlink("self.yaml", cart / "config/self.yaml")
    os.mkfifo(cart / "config/pipe.yaml")
    (cart / "launch/binary.launch.py").write_bytes(b"\0generate_launch_description\xff")
    (cart / "urdf/latin.urdf").write_bytes(b'<robot name="\xe9"/>')
    (cart / "config/notes.yaml").write_text("ros__parameters: [1, 2", encoding="utf-8")
    (cart / "ignored").mkdir()
    (cart / "ignored/COLCON_IGNORE").touch()
    (cart / "ignored/drive.yaml").write_text("a: {ros__parameters: {frame_id: x}}", "utf-8")
    skipped = [file for code, file, _ in findings("cart") if code == "audit-file-skipped"]
    assert skipped == [
        "cart/config/notes.yaml",
        "cart/config/pipe.yaml",
        "cart/config/self.yaml",
        "cart/launch/binary.launch.py",
        "cart/urdf/latin.urdf",
    ]


def test_hostile_documents_end_in_bounded_time(cart: Path) -> None:
    bomb = "a: &a [1, 2, 3, 4, 5, 6, 7, 8, 9]\n"
    for previous, name in zip("abcdefgh", "bcdefghi", strict=True):
        bomb += f"{name}: &{name} [{', '.join([f'*{previous}'] * 9)}]\n"
    (cart / "config/bomb.yaml").write_text(f"n: {{ros__parameters: {{}}}}\n{bomb}", "utf-8")
    entity = '<!DOCTYPE x [<!ENTITY a "a"><!ENTITY b "&a;&a;">]><launch>&b;</launch>'
    (cart / "launch/entity.launch.xml").write_text(entity, "utf-8")
    (cart / "models/deep.xml").write_text("<mujoco>" + "<body>" * 5000, "utf-8")
    (cart / "models/code.xml").write_text('<?xml version="1.0" encoding="no"?><mujoco/>', "utf-8")
    loop = '<mujoco><include file="loop.xml"/><worldbody><body><joint/></body></worldbody></mujoco>'
    (cart / "models/loop.xml").write_text(loop, "utf-8")
    many = "<mujoco><worldbody>" + "<body><joint/></body>" * 50_000 + "</worldbody></mujoco>"
    (cart / "models/many.xml").write_text(many, "utf-8")
    named = '<mujoco><worldbody><body><geom class="%n%n%s"/><joint/></body></worldbody></mujoco>'
    (cart / "models/format.xml").write_text(named, "utf-8")
    nested = "def generate_launch_description():\n    return " + "(" * 5000
    (cart / "launch/nested.launch.py").write_text(nested, "utf-8")
    sums = "def generate_launch_description():\n    return Node(name=" + "'a' + " * 3000 + "'a')\n"
    (cart / "launch/sums.launch.py").write_text(sums, "utf-8")
    (cart / "config/alias.yaml").write_text("n: {ros__parameters: &x {y: *x}}\n", "utf-8")
    start = time.process_time()
    skipped = {Path(file).name for code, file, _ in findings("cart") if "skipped" in code}
    assert time.process_time() - start < 60.0
    assert skipped >= {
        "bomb.yaml",
        "code.xml",
        "entity.launch.xml",
        "format.xml",
        "deep.xml",
        "nested.launch.py",
        "many.xml",
    }


def test_a_file_that_ends_mujoco_is_skipped(cart: Path) -> None:
    """MuJoCo formats its messages with texts of the file."""
    named = (
        '<mujoco><worldbody><body name="50%"><geom size="1"/><joint/></body></worldbody></mujoco>'
    )
    (cart / "models/format.xml").write_text(named.replace("size", 'class="%n%n%s" size'), "utf-8")
    (cart / "models/named.xml").write_text(named, "utf-8")
    result = audit(["cart"])
    ((code, file, message),) = [
        (d.code.name, d.span.file, d.message) for d in result.report if d.span is not None
    ]
    assert (code, file) == ("audit-file-skipped", "cart/models/format.xml")
    assert "MuJoCo ended its reader process" in message
    assert any("50%" in description.links for description in result.evidence.descriptions)
    assert not list(cart.parent.glob("MUJOCO_LOG*"))


def test_the_place_of_a_macro_that_the_audit_calls(cart: Path) -> None:
    macro = """<robot xmlns:xacro="http://www.ros.org/wiki/xacro">
    <xacro:macro name="arm" params="mass:=-1"><link name="arm"><inertial><mass value="${mass}"/>
    <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link></xacro:macro>
    </robot>"""
    (cart / "urdf/arm.xacro").write_text(macro, "utf-8")
    (diagnostic,) = audit(["cart"]).report
    assert diagnostic.code.name == "audit-mass"
    spans = [diagnostic.span, *(label.span for label in diagnostic.labels)]
    places = [(span.file, span.line) for span in spans if span is not None]
    assert places == [("cart/urdf/arm.xacro", 2), ("cart/urdf/arm.xacro", 1)]


def test_launch_files_are_not_run(cart: Path) -> None:
    marker = cart / "marker"
    text = f"open({str(marker)!r}, 'w')\ndef generate_launch_description():\n    pass\n"
    (cart / "launch/evil.launch.py").write_text(text, "utf-8")
    evil = """<robot name="e" xmlns:xacro="http://www.ros.org/wiki/xacro">
    <link name="${().__class__.__base__.__subclasses__()}"/></robot>"""
    (cart / "urdf/evil.urdf.xacro").write_text(evil, "utf-8")
    assert [code for code, _, _ in findings("cart")] == ["audit-file-skipped"]
    assert not marker.exists()
