"""The ROS 2 package: its manifest, its README, and its build by colcon."""

from __future__ import annotations

import ast
import dataclasses
import importlib
import os
import re
import subprocess
import sys
import venv
from pathlib import Path
from xml.etree import ElementTree

import pytest

from tests.backends.ros2.packages import install, package_of, variant, write
from tests.examples import ROBOTS, SAMPLED_ROBOTS, example_fleet, example_robot
from tests.ros.environments import DISTROS, ROOT, python_of
from tests.simulation.bus.robots import cia402_robot
from thorvaldc.backends.ros2 import Ros2
from thorvaldc.model.model_json import from_json

ROSDEP_KEYS = {"python3-venv"}
"""Dependencies that are packages of Debian and Ubuntu, in rosdep/python.yaml of rosdistro."""


@pytest.mark.parametrize("name", SAMPLED_ROBOTS)
def test_manifest(name: str) -> None:
    robot = example_robot(name)
    files = package_of(robot)
    manifest = ElementTree.fromstring(files["package.xml"])
    assert manifest.get("format") == "3"
    assert manifest.findtext("name") == robot.ros.package
    assert manifest.findtext("export/build_type") == "ament_python"
    depends = [element.text for element in manifest.iter("exec_depend")]
    assert depends == sorted(set(depends), key=str)
    assert robot.ros.package not in depends
    assert f"resource/{robot.ros.package}" in files


def dependencies(manifest: bytes) -> set[str]:
    return {str(element.text) for element in ElementTree.fromstring(manifest).iter("exec_depend")}


@pytest.mark.parametrize("name", ROBOTS)
def test_every_dependency_is_released(name: str) -> None:
    lines = (
        (Path(__file__).parent / "released_packages.txt").read_text(encoding="utf-8").split("\n")
    )
    released = {line for line in lines if line and not line.startswith("#")}
    depends = dependencies(package_of(variant(name, odom_tf="ekf"))["package.xml"])
    assert depends - ROSDEP_KEYS <= released


def test_the_packages_that_the_base_driver_imports_are_dependencies() -> None:
    imported = set()
    for path in Path(importlib.import_module("thorvaldc.ros").__path__[0]).glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom):
                imported.add(str(node.module).partition(".")[0])
            elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith("optional_type"):
                imported.add(ast.literal_eval(node.args[0]))
    of_ros = imported - sys.stdlib_module_names - {"thorvaldc"}
    assert {"rclpy", "rcl_interfaces", "can_msgs", "tf2_msgs"} < of_ros
    assert of_ros <= dependencies(package_of(cia402_robot())["package.xml"])


def test_the_manifest_says_what_the_robot_file_says() -> None:
    robot = variant(
        "car", license="MIT", maintainer='Bo "B" & Co <b@example.org>', version="1.20.0"
    )
    robot = dataclasses.replace(robot, description="Steers with <two> wheels\n& drives two.")
    files = package_of(robot)
    manifest = ElementTree.fromstring(files["package.xml"])
    maintainer = manifest.find("maintainer")
    assert maintainer is not None
    assert manifest.findtext("description") == robot.description
    stated = [manifest.findtext(key) for key in ("license", "version")]
    stated += [maintainer.text, maintainer.get("email")]
    assert stated == ["MIT", "1.20.0", 'Bo "B" & Co', "b@example.org"]
    setup = ast.parse(files["setup.py"])
    calls = [node for node in ast.walk(setup) if isinstance(node, ast.Call)]
    (call,) = (node for node in calls if ast.unparse(node.func) == "setup")
    values = {keyword.arg: keyword.value for keyword in call.keywords}
    keys = ("license", "version", "maintainer", "maintainer_email")
    assert [ast.literal_eval(values[key]) for key in keys] == stated


def test_python_files_name_their_licence() -> None:
    plain = package_of(variant("car"))
    stated = package_of(variant("car", license="MIT", maintainer="Bo <b@example.org>"))
    header = b"# Copyright (c) Bo\n# SPDX-License-Identifier: MIT\n\n"
    for path in [path for path in plain if path.endswith(".py") and path != "setup.py"]:
        assert stated[path] == (header if plain[path] else b"") + plain[path], path
    assert stated["setup.py"].startswith(header)
    assert not any(b"SPDX" in data for data in plain.values())


def test_a_robot_with_foreign_devices_depends_on_their_messages() -> None:
    for robot, depends in ((cia402_robot(), True), (example_robot("4wd4ws_wide"), False)):
        manifest = package_of(robot)["package.xml"].decode()
        assert ("<exec_depend>can_msgs</exec_depend>" in manifest) is depends


def test_the_model_of_the_package_is_that_of_the_build() -> None:
    robot = variant("4wd4ws_wide", namespace="r1")
    assert from_json(package_of(robot)["config/model.json"].decode()) == robot


def test_every_relative_file_of_the_readme_exists() -> None:
    robot = example_robot("4wd4ws_wide")
    files = package_of(robot)
    text = files["README.md"].decode()
    for name in set(re.findall(r"(\w+\.launch\.py)", text)):
        assert f"launch/{name}" in files
    assert "@" not in re.sub(r"\S+@\S+", "", text)


def test_the_readme_names_what_is_left_out() -> None:
    bare = package_of(example_robot("9wd9ws"))["README.md"].decode()
    assert "- slam_toolbox: the robot has no 2d lidar." in bare
    assert "- Nav2: no lidar" in bare
    full = package_of(variant("4wd4ws_wide", odom_tf="ekf"))["README.md"].decode()
    assert all(f"- {part}" not in full for part in ("slam_toolbox", "Nav2", "ekf", "GNSS"))


def test_each_robot_of_a_fleet_and_the_fleet_have_a_package() -> None:
    files = Ros2().emit_fleet(example_fleet("fleet_of_four"))
    manifests = [path for path in files if path.endswith("package.xml")]
    names = [ElementTree.fromstring(files[path]).findtext("name") for path in manifests]
    assert len(names) == len(set(names)) == 5
    fleet = ElementTree.fromstring(files["ros2/package.xml"])
    depends = {element.text for element in fleet.iter("exec_depend")}
    assert set(names) - {"fleet_of_four_fleet"} <= depends


@pytest.mark.slow
@pytest.mark.parametrize("distro", DISTROS)
def test_colcon_builds_the_package(distro: str, tmp_path: Path) -> None:
    """All files of the package are installed, and the program of the base driver is found."""
    program = Path(python_of(distro)).with_name("colcon")
    robot = variant("4wd4ws_wide", distro=distro)
    shares = install(robot, tmp_path / "src")
    package = robot.ros.package
    places = [
        *("--base-paths", str(tmp_path / "src"), "--build-base", str(tmp_path / "build")),
        *("--install-base", str(tmp_path / "install")),
    ]
    for verb in ("build", "test"):
        result = subprocess.run(
            [str(program), "--log-base", str(tmp_path / "log"), verb, *places],
            cwd=tmp_path,
            env={**os.environ, "PATH": f"{program.parent}:{os.environ['PATH']}"},
            capture_output=True,
            text=True,
            timeout=300,
            check=False,
        )
        assert result.returncode == 0, result.stdout + result.stderr
    suite = ElementTree.parse(tmp_path / "build" / package / "pytest.xml").find("testsuite")
    assert suite is not None
    files = [path for path in package_of(robot) if path.endswith((".launch.py", ".yaml"))]
    assert suite.get("tests") == str(len(files))
    assert (suite.get("failures"), suite.get("errors")) == ("0", "0")
    prefix = tmp_path / "install" / package
    installed = prefix / "share" / package
    for path in package_of(robot):
        if "/" in path and not path.startswith(("resource/", "test/", f"{package}/")):
            assert (installed / path).read_bytes() == (shares[package] / path).read_bytes()
    assert (prefix / "share/ament_index/resource_index/packages" / package).is_file()
    assert os.access(prefix / "lib" / package / "base_driver", os.X_OK)
    assert list(prefix.glob(f"lib/python3*/site-packages/{package}/base_driver.py"))


def test_the_program_says_where_thorvaldc_is_missing(tmp_path: Path) -> None:
    robot = example_robot("car")
    folder = write(tmp_path, package_of(robot))
    result = subprocess.run(
        [sys.executable, "-S", "-m", f"{robot.ros.package}.base_driver"],
        cwd=folder,
        env={"PATH": os.environ["PATH"]},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert result.returncode == 1
    assert "has no package thorvaldc" in result.stderr
    assert "Traceback" not in result.stderr


def test_the_program_finds_thorvaldc_in_an_environment(tmp_path: Path) -> None:
    """Without a variable of the shell."""
    robot = example_robot("car")
    folder = write(tmp_path, package_of(robot))
    environment = tmp_path / "thorvaldc-env"
    venv.create(environment, with_pip=False, symlinks=True)
    (site,) = environment.glob("lib/python3*/site-packages")
    (site / "checkout.pth").write_text(f"{ROOT}\n", encoding="utf-8")
    result = subprocess.run(
        [sys.executable, "-S", "-m", f"{robot.ros.package}.base_driver", "--ros-args"],
        cwd=folder,
        env={"PATH": os.environ["PATH"], "HOME": str(tmp_path)},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert f"rclpy of ROS 2 is missing in {environment}/bin/python" in result.stderr
    assert result.returncode == 3
