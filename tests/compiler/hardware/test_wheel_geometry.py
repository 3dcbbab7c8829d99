"""Lowest point of a wheel, also under camber."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from thorvaldc.compiler.hardware.wheel_geometry import lowest_point
from thorvaldc.compiler.pipeline import compile_file
from thorvaldc.compiler.result import Compilation
from thorvaldc.model import Robot
from thorvaldc.runtime.se2 import Twist
from thorvaldc.simulation.episode import Episode


@settings(deadline=None, max_examples=100)
@given(
    st.floats(-math.pi, math.pi),
    st.floats(-1.2, 1.2),
    st.floats(0.05, 1.0),
)
def test_lowest_point_is_on_the_middle_circle(yaw: float, camber: float, radius: float) -> None:
    axis = (
        -math.sin(yaw) * math.cos(camber),
        math.cos(yaw) * math.cos(camber),
        math.sin(camber),
    )
    lowest = np.array(lowest_point((1.0, 2.0, 3.0), axis, radius)) - [1.0, 2.0, 3.0]
    assert np.linalg.norm(lowest) == pytest.approx(radius)
    assert lowest @ np.array(axis) == pytest.approx(0.0, abs=1e-9)
    # No other point of the circle is lower.
    across = np.cross(axis, lowest)
    for angle in np.linspace(0, 2 * math.pi, 60):
        point_of_circle = math.cos(angle) * lowest + math.sin(angle) * across
        assert point_of_circle[2] >= lowest[2] - 1e-9


def leaning(folder: Path, angle: float, noise: str = "") -> Compilation:
    """Returns a robot whose steering axes lean by an angle (deg) towards its sides."""
    corners = ("front_left", 3), ("front_right", 2), ("rear_left", 4), ("rear_right", 1)
    drives = "".join(
        f"  {name}: {{type: assembly/steered_drive, can: {can},"
        f" mount: {{port: frame.{name}, rpy: [{angle} deg, 0, 0]}}}}\n"
        for name, can in corners
    )
    path = folder / "robot.yaml"
    path.write_text(
        "thorvaldc: 1\nname: leaning\nmodules:\n"
        "  frame: {type: frame/tube_rectangular, params: {cross_members: [0]}}\n"
        f"{drives}"
        "  battery: {type: battery/enclosure, can: 1,"
        " mount: {parent: frame, xyz: [0, 0, 70 mm], rpy: [0, 0, 90 deg]}}\n"
        f"{noise}",
        encoding="utf-8",
    )
    return compile_file(path)


@pytest.mark.parametrize(
    ("angle", "noise", "warns"),
    [
        (2.0, "", False),
        (4.0, "", True),
        (4.0, "driver: {noise: {angle: 2 deg}}\n", False),
        (2.0, "driver: {noise: {angle: 0.2 deg}}\n", True),
    ],
)
def test_axes_that_lean_count_as_vertical_only_within_the_stated_covariance(
    tmp_path: Path, angle: float, noise: str, warns: bool
) -> None:
    """Steered by 90 deg, the wheel of radius r stands r sin(angle) further along its direction."""
    report = leaning(tmp_path, angle, noise).report
    diagnostics = [d for d in report if d.code.name == "steering-axis-leans"]
    assert len(diagnostics) == (4 if warns else 0)
    for diagnostic in diagnostics:
        assert f"leans by {angle:.1f} deg: steered by" in diagnostic.message
        shift = 200.0 * math.sin(math.radians(angle))
        assert f"stands {shift:.3g} mm off" in diagnostic.message


@pytest.mark.slow
def test_a_warned_robot_turns_further_than_its_odometry_says(tmp_path: Path) -> None:
    errors = {}
    for angle in (0.0, 2.0, 8.0):
        robot = leaning(tmp_path, angle).model
        assert isinstance(robot, Robot)
        episode = Episode(robot)
        episode.reset()
        episode.run(20.0, lambda sample: Twist(0.4, 0.0, 0.3))
        loop = episode.loops[episode.name]
        errors[angle] = abs(loop.driver.odometry.pose.yaw / loop.yaw_true - 1.0)
    assert errors[0.0] < 0.001
    assert errors[2.0] < 0.005 < errors[8.0]  # 0.5 %: four wheels of 1 %
