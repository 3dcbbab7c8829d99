"""Results of simulation runs: path lengths, pose errors and tilt of each robot, and their table."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from thorvaldc.runtime.se2 import Pose2, Twist


@dataclass(frozen=True, slots=True)
class RobotResult:
    """Result of one robot.  Lengths in m, angles in rad, poses relative to the start pose.

    ``path_commanded`` is the path length of ``base_link`` for the commanded twists after the
    driver's limits and ramps, ``path_true`` its path length in the simulated world, and
    ``path_odometry`` the path length estimated from the joints.  ``end_error`` is the distance
    between the true and the estimated position at the end, ``yaw_error`` the difference of
    the headings.  With ideal joints there is no independent truth: the true values are those
    of the odometry.
    """

    name: str
    mass: float
    wheels: int
    driven: int
    steered: int
    path_commanded: float
    path_true: float
    path_odometry: float
    end_error: float
    yaw_error: float
    pose_true: Pose2
    pose_odometry: Pose2
    largest_tilt: float
    infeasible: Twist
    unreachable: tuple[str, ...]
    tipped: bool


@dataclass(frozen=True, slots=True)
class SimulationResult:
    """Result of a run: requested and simulated duration (s), and the results of the robots.

    ``physics`` is ``mujoco``, ``ideal`` (ideal joints) or ``record`` (a replayed record).
    ``real_time_factor`` is simulated time over computing time.
    """

    physics: str
    duration: float
    simulated: float
    real_time_factor: float
    diverged: bool
    robots: tuple[RobotResult, ...]

    def as_json(self) -> dict[str, Any]:
        """Returns the result as plain values; twists and poses become named mappings."""
        value = dataclasses.asdict(self)
        for robot_value, robot in zip(value["robots"], self.robots, strict=True):
            for key in ("pose_true", "pose_odometry", "infeasible"):
                robot_value[key] = getattr(robot, key)._asdict()
            robot_value["unreachable"] = list(robot.unreachable)
        value["robots"] = list(value["robots"])
        return value


def result_table(results: Sequence[SimulationResult]) -> str:
    """Returns a text table with a line per robot; lengths in m, mass in kg; `-` stands for nan."""
    lines = [
        (
            "robot",
            "mass",
            "wheels driven/steered",
            "commanded",
            "true",
            "odometry",
            "end error",
            "real time",
        )
    ]
    lines += [
        (
            robot.name,
            f"{robot.mass:.1f} kg",
            f"{robot.wheels}: {robot.driven}/{robot.steered}",
            _cell(f"{robot.path_commanded:.3f} m"),
            _cell(f"{robot.path_true:.3f} m"),
            _cell(f"{robot.path_odometry:.3f} m"),
            _cell(f"{robot.end_error * 1000:.1f} mm"),
            _cell(f"{result.real_time_factor:.0f}x"),
        )
        for result in results
        for robot in result.robots
    ]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    return "\n".join(
        "  ".join(
            cell.ljust(width) if column == 0 else cell.rjust(width)
            for column, (cell, width) in enumerate(zip(line, widths, strict=True))
        ).rstrip()
        for line in lines
    )


def _cell(text: str) -> str:
    return "-" if text.startswith("nan") else text
