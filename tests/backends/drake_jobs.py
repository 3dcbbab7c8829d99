"""Starts Drake in its own environment, for many jobs at once."""

from __future__ import annotations

import json
import math
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tests.outside_tools import path_of_drake_python
from thorvaldc.model import Robot

READER = Path(__file__).with_name("drake_reader.py")


def read_by_drake(jobs: Sequence[dict[str, Any]]) -> list[Any]:
    process = subprocess.run(
        [path_of_drake_python(), str(READER)],
        input=json.dumps(jobs),
        capture_output=True,
        text=True,
    )
    assert process.returncode == 0, process.stderr
    result: list[Any] = json.loads(process.stdout)
    return result


def wheel_targets(robot: Robot, twist: tuple[float, float, float]) -> list[dict[str, Any]]:
    """The angles and speeds of steered wheels: each rolls across the line to the centre."""
    vx, vy, wz = twist
    targets = []
    for wheel in robot.wheels:
        ux, uy = vx - wz * wheel.y, vy + wz * wheel.x
        speed = math.hypot(ux, uy) / wheel.radius
        angle = math.remainder(math.atan2(uy, ux) - wheel.heading, math.tau)
        if abs(angle) > math.pi / 2 + 1e-9:
            angle, speed = math.remainder(angle + math.pi, math.tau), -speed
        angle *= wheel.steering_sign
        targets.append(
            {"drive": wheel.spin_joint, "speed": speed}
            | {"steering": wheel.steering_joint, "angle": angle}
        )
    return targets
