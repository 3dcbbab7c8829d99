"""Joint logs of simulated robots whose wheels are not as their drivers think."""

from __future__ import annotations

import io
import math
from collections.abc import Mapping, Sequence

from thorvaldc.model import Robot
from thorvaldc.runtime.se2 import Twist
from thorvaldc.simulation.manoeuvre import Segment
from thorvaldc.simulation.physics.wheel_errors import WheelErrors
from thorvaldc.simulation.records.joint_csv import JointLogWriter
from thorvaldc.simulation.simulation_run import Simulation

# Start (s), vx, vy (m/s), wz (rad/s): forwards, sideways and turns about places near by.
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
    """The log, as text: on ideal joints, or in MuJoCo from ``files``.

    ``radii`` are true ones over the model's, ``offsets`` the steering's in deg.
    """
    plan = [Segment(start, Twist(*twist)) for start, *twist in twists]
    turned = {name: math.radians(degrees) for name, degrees in (offsets or {}).items()}
    wheel_errors = (
        {robot.name: WheelErrors.by_name(robot, radii, turned)} if radii or offsets else {}
    )
    stream = io.StringIO()
    simulation = Simulation(robot, files, wheel_errors=wheel_errors, open_loop=open_loop)
    simulation.run(seconds, plan, None, JointLogWriter(robot, stream).on_tick)
    return stream.getvalue()
