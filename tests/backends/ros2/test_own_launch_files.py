"""Launch files of the robot file in the ROS 2 package: started last, never replaced."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import pytest

from tests.backends.ros2.launch_double import run
from tests.backends.ros2.packages import install, package_of, write
from tests.cli.conftest import run_in_this_process
from thorvaldc.backends.ros2_package_files import LAUNCHES
from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.compiler.result import Compilation
from thorvaldc.model import Robot
from thorvaldc.model.model_json import from_json, to_json

SPRAYER = b"""\
from launch import LaunchDescription
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
def generate_launch_description():
    space = LaunchConfiguration("namespace")
    return LaunchDescription(
        [Node(package='spray_driver', executable="spray", name="spray", namespace=space)]
    )
"""
LAMP = b'<launch><node pkg="lamps" exec="lamp" name="lamp"/></launch>\n'
HORN = b"launch:\n- node:\n    pkg: horns\n    exec: horn\n"
ROBOT = """\
thorvaldc: 1
name: sprayer
ros: {launch: [%s]}
modules:
  frame: {type: frame/tube_rectangular}
  fl: {type: assembly/steered_drive, mount: frame.front_left}
  fr: {type: assembly/steered_drive, mount: frame.front_right}
  rl: {type: assembly/steered_drive, mount: frame.rear_left}
  rr: {type: assembly/steered_drive, mount: frame.rear_right}
"""


def compiled(folder: Path, *paths: str, **files: bytes) -> Compilation:
    """Compile a robot that names launch files; ``files``: their content by the stem of the name."""
    for path in paths:
        stem = Path(path).name.partition(".")[0]
        if stem in files:
            write(folder, {path: files[stem]})
    write(folder, {"robot.yaml": (ROBOT % ", ".join(paths)).encode()})
    return compile_file(folder / "robot.yaml")


def robot_of(compilation: Compilation) -> Robot:
    assert isinstance(compilation.model, Robot), list(compilation.report)
    return compilation.model


def test_the_real_robot_starts_them_last(tmp_path: Path) -> None:
    """With the name space of the robot; simulations start none."""
    robot = robot_of(compiled(tmp_path, "launch/spray.launch.py", spray=SPRAYER))
    shares = install(robot, tmp_path / "src")
    folder = shares["sprayer"] / "launch"
    nodes = run(folder / "robot.launch.py", shares, namespace="r2").started
    assert (nodes[-1].package, nodes[-1].executable) == ("spray_driver", "spray")
    assert {node.namespace for node in nodes} == {"r2"}
    for file in ("ideal", "mujoco", "virtual"):
        started = run(folder / f"{file}.launch.py", shares).started
        assert not any(node.package == "spray_driver" for node in started)


def test_the_package_has_them_as_they_are_with_what_they_need(tmp_path: Path) -> None:
    files = {"spray": SPRAYER, "lamp": LAMP, "horn": HORN}
    names = ("spray.launch.py", "sub/lamp.launch.xml", "horn.launch.yaml")
    compilation = compiled(tmp_path, *names, **files)
    robot = robot_of(compilation)
    assert from_json(to_json(robot)) == robot
    package = package_of(robot)
    for name in names:
        stem = Path(name).name.partition(".")[0]
        assert package[f"launch/{Path(name).name}"] == files[stem]
        assert f"| `{Path(name).name}` |".encode() in package["README.md"]
        assert tmp_path / name in compilation.files.values()
    manifest = ElementTree.fromstring(package["package.xml"])
    depends = {element.text for element in manifest.iter("exec_depend")}
    assert {"spray_driver", "lamps", "horns", "launch_xml", "launch_yaml"} <= depends


def test_a_licence_is_not_put_on_files_of_others(tmp_path: Path) -> None:
    compiled(tmp_path, "spray.launch.py", spray=SPRAYER)
    text = (tmp_path / "robot.yaml").read_text(encoding="utf-8")
    text = text.replace("ros: {", "ros: {license: MIT, ")
    (tmp_path / "robot.yaml").write_text(text, encoding="utf-8")
    package = package_of(robot_of(compile_file(tmp_path / "robot.yaml")))
    assert package["launch/spray.launch.py"] == SPRAYER
    assert package["launch/robot.launch.py"].startswith(b"# SPDX-License-Identifier: MIT")


@pytest.mark.parametrize("name", [f"{name}.launch.py" for name in LAUNCHES])
def test_a_name_of_a_generated_file_is_refused(name: str, tmp_path: Path) -> None:
    (taken,) = compiled(tmp_path, name, **{name.partition(".")[0]: SPRAYER}).report.errors
    assert taken.code.name == "conflicting-keys"
    assert "one is generated" in taken.message
    assert taken.span is not None
    assert (taken.span.line, taken.span.column) == (3, 16)


@pytest.mark.parametrize(
    ("paths", "code", "column"),
    [
        (["launch/spary.launch.py"], "file-not-found", 16),
        (["spray.launch.py", "sub/spray.launch.py"], "conflicting-keys", 33),
        (["spray.py"], "unknown-value", 16),
        (["/spray.launch.py"], "unknown-value", 16),
        (["latin.launch.py"], "yaml-encoding", 16),
        (["link.launch.py"], "file-unreadable", 16),
    ],
)
def test_a_mistake_is_reported_at_its_entry(
    paths: list[str], code: str, column: int, tmp_path: Path
) -> None:
    outside = write(tmp_path / "outside", {"a.launch.py": SPRAYER}) / "a.launch.py"
    folder = write(tmp_path / "robot", {"launch/spray.launch.py": SPRAYER})
    (folder / "link.launch.py").symlink_to(outside)
    files = {"spray": SPRAYER} if code != "file-not-found" else {}
    if not paths[0].startswith("/"):
        files["latin"] = b"# \xe9\n"
        compilation = compiled(folder, *paths, **files)
    else:
        compilation = compiled(folder, *paths)
    (mistake,) = compilation.report.errors
    assert mistake.code.name == code
    assert mistake.span is not None
    assert (mistake.span.line, mistake.span.column) == (3, column)


def test_a_build_neither_deletes_nor_replaces_files_in_its_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    thorvaldc = run_in_this_process(monkeypatch, tmp_path)
    build = ["build", "robot.yaml", "--target", "ros2", "-o", "b"]
    compiled(tmp_path, "spray.launch.py", spray=SPRAYER)
    assert thorvaldc(*build).status == 0
    mine = write(tmp_path / "b/ros2/launch", {"mine.launch.py": LAMP}) / "mine.launch.py"
    compiled(tmp_path, "horn.launch.yaml", horn=HORN)
    assert thorvaldc(*build).status == 0
    assert mine.read_bytes() == LAMP
    assert not (tmp_path / "b/ros2/launch/spray.launch.py").exists()
    compiled(tmp_path, "mine.launch.py", mine=SPRAYER)
    assert thorvaldc(*build).status == 3
    assert mine.read_bytes() == LAMP
    assert (tmp_path / "spray.launch.py").read_bytes() == SPRAYER
