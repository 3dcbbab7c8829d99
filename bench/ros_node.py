"""CPU time that ROS adds to a control cycle of the node, as a share of the period.

A mission in MuJoCo over the topics of the node, and the same mission without ROS.
"""

from __future__ import annotations

import json
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path

from bench.figure import EXAMPLE, Figure
from tests.ros.environments import DISTROS, ENVIRONMENTS, variables
from thorvaldc.compiler.pipeline import compile_file, emit
from thorvaldc.model import Robot


def figures() -> Iterator[Figure]:
    robot = compile_file(EXAMPLE).model
    assert isinstance(robot, Robot)
    for distro in DISTROS:
        python = ENVIRONMENTS / distro / "bin" / "python"
        if not python.exists():
            continue
        with tempfile.TemporaryDirectory() as folder:
            for path, data in emit(robot, ["mjcf"]).items():
                (Path(folder) / path).parent.mkdir(parents=True, exist_ok=True)
                (Path(folder) / path).write_bytes(data)
            command = [str(python), "-m", "tests.ros.mission", f"{folder}/model.json"]
            environment = variables(Path(folder))
            output = subprocess.run(
                command, env=environment, check=True, capture_output=True, text=True
            ).stdout
        result = json.loads(output)
        period = 1e3 / robot.driver.rate
        yield Figure(
            f"ROS ({distro}) per cycle",
            100.0 * (result["cycle"] - result["bare"]) / period,
            "%",
            10.0,
            "lower",
            f"of the period of {period:.0f} ms: cycle and messages {result['cycle']:.2f} ms of CPU,"
            f" without ROS {result['bare']:.2f} ms; paths {result['distance'] * 1e3:.3g} mm apart",
            timed=True,
        )
