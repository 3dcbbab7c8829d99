"""The result of a simulation run: numbers of each robot, as JSON and as a table.

This module stays interpreted in a compiled wheel: mypyc's frozen dataclasses cannot be copied or
passed on to another process.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from thorvaldc.diagnostics.text_layout import preformatted, text_table
from thorvaldc.runtime.se2 import Pose2, Twist


@dataclass(frozen=True, slots=True)
class RobotResult:
    """Result of one robot in a simulation run.

    Lengths are in m, angles in rad, masses in kg, and poses are relative to the start pose of
    the robot.  With ideal joints no independent true motion exists, so that the true values are
    equal to the values of the odometry.

    * ``name``: name of the robot in the scene.
    * ``mass``: mass of the robot.
    * ``wheels``: number of wheels.
    * ``driven``: number of wheels with a drive motor.
    * ``steered``: number of wheels with a steering motor.
    * ``path_commanded``: path length of ``base_link`` for the commanded twists, after the limits
      and ramps of the driver.
    * ``path_true``: path length of ``base_link`` in the simulated world.
    * ``path_odometry``: path length of ``base_link`` that the odometry computes.
    * ``end_error``: distance between the true and the estimated position at the end of the run.
    * ``yaw_error``: difference between the true and the estimated yaw at the end of the run.
    * ``pose_true``: pose of ``base_link`` in the simulated world at the end of the run.
    * ``pose_odometry``: pose that the odometry estimates at the end of the run.
    * ``largest_tilt``: largest tilt angle of the robot during the run.
    * ``infeasible``: largest part of a commanded twist that the wheels did not allow.
    * ``unreachable``: names of the wheels whose steering limits excluded a commanded twist.
    * ``tipped``: true if the robot fell over.
    * ``collisions``: number of collisions with other robots, the world or its own parts.
    * ``turn_commanded``: turn of ``base_link`` for the commanded twists.
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
    collisions: int = 0
    turn_commanded: float = 0.0


@dataclass(frozen=True, slots=True)
class SimulationResult:
    """Result of a simulation run with one or more robots.

    * ``physics``: ``mujoco`` or ``ideal`` (ideal joints).
    * ``duration``: requested duration of the run (s).
    * ``simulated``: simulated duration of the run (s).
    * ``real_time_factor``: simulated time divided by computing time.
    * ``diverged``: true if the simulation diverged.
    * ``robots``: result of each robot.
    """

    physics: str
    duration: float
    simulated: float
    real_time_factor: float
    diverged: bool
    robots: tuple[RobotResult, ...]

    def _repr_html_(self) -> str:
        """Returns the table of the run, which a notebook shows."""
        return preformatted(result_table([self]))

    def as_json(self) -> dict[str, Any]:
        """Returns the result as JSON values.

        Twists and poses become mappings from component names to numbers.
        """
        value = dataclasses.asdict(self)
        for robot_value, robot in zip(value["robots"], self.robots, strict=True):
            for key in ("pose_true", "pose_odometry", "infeasible"):
                robot_value[key] = getattr(robot, key)._asdict()
            robot_value["unreachable"] = list(robot.unreachable)
        value["robots"] = list(value["robots"])
        return value


def result_table(results: Sequence[SimulationResult], width: int | None = None) -> str:
    """Returns a text table with one line per robot.

    Path lengths are in m, errors in mm and masses in kg; a robot that is to turn on the spot has
    angles in place of path lengths.  A `-` replaces a value that is nan.
    ``width``: number of columns of the terminal, or ``None`` for one line per robot.
    """
    lines: list[tuple[str, ...]] = [
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
            _way(robot, robot.path_commanded, robot.turn_commanded),
            _way(robot, robot.path_true, robot.pose_true.yaw),
            _way(robot, robot.path_odometry, robot.pose_odometry.yaw),
            _cell(f"{robot.end_error * 1000:.1f} mm"),
            _cell(f"{result.real_time_factor:.0f}x"),
        )
        for result in results
        for robot in result.robots
    ]
    return text_table(lines, width, right=range(1, len(lines[0])))


def _way(robot: RobotResult, path: float, turn: float) -> str:
    turns_on_the_spot = robot.path_commanded < 1e-3 and robot.turn_commanded != 0.0
    return _cell(f"{math.degrees(turn):.1f} deg" if turns_on_the_spot else f"{path:.3f} m")


def _cell(text: str) -> str:
    return "-" if text.startswith("nan") else text
