"""Environments on MuJoCo Warp, and the program of the page for Newton, both on the CPU."""

from __future__ import annotations

import json
import os
import re
import subprocess
from pathlib import Path

import numpy as np
import pytest

from tests.outside_tools import path_of_warp_python
from thorvaldc.compiler.pipeline import compile_file, emit

ROOT = Path(__file__).resolve().parents[3]
SLIM = ROOT / "examples/4wd4ws_slim/robot.yaml"
CART = ROOT / "examples/2wd0ws_greenhouse/robot.yaml"
WIDE = ROOT / "examples/4wd4ws_wide/robot.yaml"
SCENARIO = f"""thorvaldc: 1
scenario: blocked
robots: {{cart: {{robot: {SLIM}}}}}
duration: 1 s
noise: {{wheel_speed: 0.01 rad/s}}
world:
  obstacles:
    post: {{shape: box, xyz: [1.2 m, 0, 0], size: [200 mm, 2 m, 1 m]}}
"""
# In the process of the readers of MJCF: Warp compiles its kernels once, for more than a minute.
pytestmark = [pytest.mark.slow, pytest.mark.xdist_group("readers")]


NO_GPU = "Warp CUDA warning: "


def run(folder: Path, *arguments: str) -> tuple[str, str]:
    """What a Python with Warp prints, and its errors without the warning that there is no GPU."""
    process = subprocess.run(
        [path_of_warp_python(), *arguments],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert process.returncode == 0, process.stderr[-2000:]
    errors = process.stderr.splitlines(keepends=True)
    return process.stdout, "".join(line for line in errors if not line.startswith(NO_GPU))


def test_environments_on_warp_are_those_of_mujoco(tmp_path: Path) -> None:
    blocked = tmp_path / "blocked.yaml"
    blocked.write_text(SCENARIO, encoding="utf-8")
    files = [str(file) for file in (SLIM, CART, blocked)]
    program = str(Path(__file__).with_name("warp_program.py"))
    out, err = run(tmp_path, program, *files)
    assert err == ""
    results = json.loads(out)
    for file, result in results.items():
        assert result["first"] < 1e-6, file
        assert result["ends"] > 0, file
        assert max(result[key] for key in ("observation", "reward", "pose")) < 1e-4, result
    assert [result["collisions"] > 0 for result in results.values()] == [False, False, True]


def test_the_program_of_the_page_drives_robots_in_newton(tmp_path: Path) -> None:
    robot = compile_file(WIDE).model
    assert robot is not None
    for name, data in emit(robot, ["mjcf"]).items():
        path = tmp_path / "build/wide" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    program = ROOT / "examples/scenarios/robots_in_newton.py"
    lines = run(tmp_path, str(program))[0].splitlines()[-4:]
    numbers = [
        [float(text) for text in re.findall(r"-?\d+\.\d*(?:e-?\d+)?", line)] for line in lines
    ]
    assert len(numbers) == 4
    for world, (true_x, true_y, x, y, yaw) in enumerate(numbers):
        assert np.hypot(true_x - x, true_y - y) < 0.02  # the robot moves on after the last tick
        assert yaw == pytest.approx(0.16 * world, abs=0.04)
        assert 0.7 < np.hypot(x, y) < 0.9
