"""The ROS 2 package: its manifest, its README, and its build by colcon."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest

from tests.backends.ros2.packages import install, variant, write
from tests.examples import SAMPLED_ROBOTS, example_fleet, example_robot
from tests.ros.environments import DISTROS, python_of
from tests.simulation.bus.robots import cia402_robot
from thorvaldc.backends.ros2 import Ros2, package_of
from thorvaldc.model.model_json import from_json


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
