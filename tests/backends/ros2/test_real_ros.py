"""Parameter files, loaded by rcl of real ROS 2: each value and type arrives as it was written."""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path
from typing import Any

import pytest

from tests.backends.ros2.packages import parameter_files, variant, write
from tests.examples import ROBOTS
from thorvaldc.backends.ros2 import package_of

ENVIRONMENTS = Path(__file__).parents[3] / ".venv-ros"

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


def python_of(distro: str) -> Path:
    python = ENVIRONMENTS / distro / "bin" / "python"
    if not python.is_file():
        pytest.skip(f"no wheels of ROS 2 {distro} are installed")
    return python


@pytest.mark.parametrize("distro", ["jazzy", "kilted"])
def test_rcl_reads_every_value_with_its_type(distro: str, tmp_path: Path) -> None:
    expected: dict[str, dict[str, Any]] = {}
    jobs: dict[str, list[str]] = {}
    for name in ROBOTS:
        robot = variant(name, distro=distro, odom_tf="ekf", namespace="r1")
        folder = write(tmp_path / name, package_of(robot))
        for file, nodes in parameter_files(robot).items():
            path = str(folder / "config" / f"{file}.yaml")
            jobs[path] = list(nodes)
            expected |= {f"{path} {node}": values for node, values in nodes.items()}
    python = python_of(distro)
    result = subprocess.run(
        [str(python), "-c", PROGRAM, json.dumps(jobs)],
        env={
            "PATH": f"{python.parent}:{os.environ['PATH']}",
            "HOME": str(tmp_path),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "ROS_DOMAIN_ID": "77",
            "ROS_LOG_DIR": str(tmp_path / "log"),
        },
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
    assert count > 1000
