"""Parameter files, loaded by rcl of real ROS 2: each value and type arrives as it was written."""

from __future__ import annotations

import contextlib
import json
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.backends.ros2.packages import launch, named, parameter_files, variant, write
from tests.child_process import ChildProcess
from tests.examples import SAMPLED_ROBOTS
from tests.ros.environments import ROOT, each_distro, python_of, variables
from thorvaldc.model import Robot

pytestmark = each_distro(both=True)
OF_EVERY_NODE = {"use_sim_time", "start_type_description_service"}
# Runs in the Python of ROS 2: creates each node with the file, and prints what it received.
PROGRAM = """
import json, sys
import rclpy
from rclpy.context import Context
from rclpy.node import Node

found = {}
for file, names in json.loads(sys.argv[1]).items():
    context = Context()
    rclpy.init(args=["--ros-args", "--params-file", file], context=context)
    for name in names:
        space, _, short = name.rpartition("/")
        node = Node(
            short,
            namespace=space or "/",
            context=context,
            allow_undeclared_parameters=True,
            automatically_declare_parameters_from_overrides=True,
            start_parameter_services=False,
            enable_rosout=False,
        )
        values = {}
        for key, parameter in node.get_parameters_by_prefix("").items():
            value = parameter.value
            values[key] = list(value) if hasattr(value, "__len__") and not isinstance(
                value, str
            ) else value
        found[file + " " + name] = values
        node.destroy_node()
    context.shutdown()
print("FOUND" + json.dumps(found))
"""


def test_rcl_reads_every_value_with_its_type(distro: str, tmp_path: Path) -> None:
    expected: dict[str, dict[str, Any]] = {}
    jobs: dict[str, list[str]] = {}
    for name in SAMPLED_ROBOTS:
        robot = variant(name, distro=distro, odom_tf="ekf", namespace="r1")
        for file, nodes in parameter_files(robot).items():
            config = f"config/{file}.yaml"
            folder = write(tmp_path / name, {config: named(robot, config).encode()})
            path = str(folder / config)
            jobs[path] = list(nodes)
            expected |= {f"{path} {node}": values for node, values in nodes.items()}
    result = subprocess.run(
        [python_of(distro), "-c", PROGRAM, json.dumps(jobs)],
        env=variables(tmp_path),
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert result.returncode == 0, result.stderr
    found = json.loads(result.stdout.partition("FOUND")[2])
    assert found.keys() == expected.keys()
    count = 0
    for key, values in expected.items():
        received = {n: value for n, value in found[key].items() if n not in OF_EVERY_NODE}
        assert received == values, key
        for name, value in values.items():
            assert type(received[name]) is type(value), f"{key} {name}"
            count += 1
    assert count > 70 * len(SAMPLED_ROBOTS)


@pytest.mark.slow
def test_the_launched_base_driver_drives_the_robot(distro: str, tmp_path: Path) -> None:
    robot = variant("4wd4ws_wide", distro=distro, namespace="r1")
    with launched(distro, robot, tmp_path):
        drive(distro, robot, tmp_path, "r1")


@pytest.mark.slow
def test_two_robots_of_one_package_drive(distro: str, tmp_path: Path) -> None:
    robot = variant("2wd0ws_greenhouse", distro=distro)
    spaces = ("a", "farm/b")
    with contextlib.ExitStack() as stack:
        for namespace in spaces:
            stack.enter_context(launched(distro, robot, tmp_path, namespace=namespace))
        for namespace in spaces:
            drive(distro, robot, tmp_path, namespace)


@contextlib.contextmanager
def launched(distro: str, robot: Robot, folder: Path, **options: str) -> Iterator[None]:
    """Runs the base driver with the files and arguments of the launch file."""
    started = launch(robot, folder, "ideal", **options).started
    driver = next(node for node in started if node.name == "base_driver")
    arguments = ["--ros-args", "-r", "__node:=base_driver", "-r", f"__ns:=/{driver.namespace}"]
    for file in driver.files:
        arguments += ["--params-file", str(file)]
    for name, value in driver.parameters.items():
        arguments += ["-p", f"{name}:={json.dumps(value)}"]
    program = folder / robot.ros.package / robot.ros.package / "base_driver.py"
    process = ChildProcess(
        [python_of(distro), str(program), *arguments],
        env=variables(folder),
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        yield
    finally:
        process.end()


def drive(distro: str, robot: Robot, folder: Path, namespace: str) -> None:
    """Drives the robot in a name space, whose frames and joints have its name."""
    stamped = str(robot.ros.stamped).lower()
    result = subprocess.run(
        [
            *(python_of(distro), "-m", "tests.backends.ros2.drive_package"),
            *(f"/{namespace}", f"{namespace}/base_link", f"{namespace}/odom", stamped),
        ],
        cwd=ROOT,
        env=variables(folder),
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert result.returncode == 0, result.stderr
