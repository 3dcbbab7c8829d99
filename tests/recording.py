"""Joint logs of simulated robots with wheel errors."""

from __future__ import annotations

import io
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from thorvaldc.diagnostics import DiagnosticError, Report
from thorvaldc.model import Robot
from thorvaldc.runtime.se2 import Twist
from thorvaldc.simulation.control_loop import Segment
from thorvaldc.simulation.physics.sim_base import WheelErrors
from thorvaldc.simulation.records.joint_csv import JointLogWriter, read_log
from thorvaldc.simulation.simulation_run import Simulation

# Start (s), vx, vy (m/s), wz (rad/s): forwards, sideways and turns about near points.
TURNS = (
    (0.0, 0.8, 0.0, 0.0),
    (3.0, 0.6, 0.0, 0.6),
    (8.0, 0.5, 0.4, -0.5),
    (13.0, 0.0, 0.6, 0.3),
    (18.0, 0.0, 0.0, 0.0),
)


def record(
    robot: Robot,
    *,
    twists: Sequence[Sequence[float]] = TURNS,
    seconds: float = 20.0,
    radii: Mapping[str, float] | None = None,
    offsets: Mapping[str, float] | None = None,
    open_loop: bool = True,
    files: Mapping[str, bytes] | None = None,
) -> str:
    """Returns the joint log as text, of a run on ideal joints, or in MuJoCo from ``files``.

    ``radii`` are ratios of true to model radius, ``offsets`` steering offsets in deg.
    """
    plan = [Segment(start, Twist(*twist)) for start, *twist in twists]
    angles = {name: math.radians(degrees) for name, degrees in (offsets or {}).items()}
    wheel_errors = (
        {robot.name: WheelErrors.by_name(robot, radii, angles)} if radii or offsets else {}
    )
    stream = io.StringIO()
    simulation = Simulation(robot, files, wheel_errors=wheel_errors, open_loop=open_loop)
    simulation.run(seconds, plan, None, JointLogWriter(robot, stream).on_tick)
    return stream.getvalue()


def logged(robot: Robot, case: dict[str, Any], report: Report) -> Any:
    """Returns the joints.csv of a case, which is recorded first if it has a ``record``."""
    path = Path("joints.csv")
    if "record" in case:
        try:
            path.write_text(record(robot, **case["record"]), encoding="utf-8")
        except DiagnosticError as error:
            report.put(error.diagnostic)
            return None
    return read_log(path, path.name, robot, report)
