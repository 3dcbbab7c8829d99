"""Metrics of a robot in a scenario: slip, steering limits, motor work and collisions."""

from __future__ import annotations

import math

from thorvaldc.runtime.calculators.base_geometry import BaseGeometry
from thorvaldc.simulation.control_loop import ControlLoop
from thorvaldc.simulation.physics.rolling_radii import RollingRadii
from thorvaldc.simulation.physics.scenario_base import ScenarioBase
from thorvaldc.simulation.run_result import RobotResult

UNITS = {
    "end_error": "m",
    "yaw_error": "rad",
    "path": "m",
    "length_ratio": "",
    "tilt": "rad",
    "slip": "m/s",
    "largest_slip": "m/s",
    "steering_limit_hits": "",
    "collisions": "",
    "energy": "J",
    "energy_per_metre": "J/m",
}
"""Names and units of all metrics, in the order of the output."""
_LIMIT_TOLERANCE = math.radians(0.2)
"""Distance (rad) from a steering limit within which the joint counts as at the limit."""
_LEAST_PATH = 1e-3
"""Path length (m) below which a ratio with it has no meaning."""


class ScenarioMetrics:
    """Accumulates the metrics of one robot over the ticks of a run.

    Slip is the sliding velocity (m/s) of the contact point of a driven wheel.  The slip vector
    in the frame of the steered wheel is::

        slip = (along - lateral s - r w, across + trail s)

    * ``along``, ``across``: ground velocity at the steering axis (m/s), along and across the
      wheel.
    * ``w``: wheel speed (rad/s).
    * ``r``: wheel radius (m).
    * ``s``: steering rate (rad/s).
    * ``lateral``, ``trail``: offsets of the contact point from the steering axis (m).
    """

    def __init__(self, loop: ControlLoop) -> None:
        base = loop.base
        if not isinstance(base, ScenarioBase):
            raise TypeError("metrics need the base of a scenario")
        self._loop = loop
        self._base = base
        wheels = BaseGeometry.from_robot(loop.robot).wheels
        self._rolling = [(i, w) for i, w in enumerate(wheels) if w.driven and not w.swivel]
        # (index, lower, upper) of each steered wheel.  The steering joint counts as not at a limit
        # between the angles lower and upper (rad).
        self._free_ranges = [
            (
                i,
                -math.inf if w.lower is None else w.lower + _LIMIT_TOLERANCE,
                math.inf if w.upper is None else w.upper - _LIMIT_TOLERANCE,
            )
            for i, w in enumerate(wheels)
            if w.steered
        ]
        # Views of the MuJoCo arrays from the first actuator of the robot to the last.  Creating a
        # view takes longer than reading it.
        motors, data = base.motors(), base.scene.data
        first, end = min(motors, default=0), max(motors, default=-1) + 1
        self._motors = [motor - first for motor in motors]
        self._forces = data.actuator_force[first:end]
        self._speeds = data.actuator_velocity[first:end]
        has_treads = any(wheel.treads for wheel in loop.robot.wheels)
        self._radii = RollingRadii(loop.robot, base.scene) if has_treads else None
        self._time = 0.0
        self._energy = 0.0
        self._slip_squares = 0.0
        self._slip_count = 0
        self._largest_square = 0.0
        self._limit_hits = 0
        self._at_limit = [False] * len(wheels)

    def update(self) -> None:
        """Updates the metrics with the state of the scene after a tick."""
        now = self._loop.driver.state.time
        dt, self._time = now - self._time, now
        forces, speeds = self._forces.tolist(), self._speeds.tolist()
        for motor in self._motors:
            power = forces[motor] * speeds[motor]
            if power > 0.0:
                self._energy += power * dt
        vx, vy, wz = self._base.true_twist()
        joints = self._base.true_joints
        radii = self._radii.current() if self._radii is not None else None
        for i, wheel in self._rolling:
            steering_rate = wheel.sign * joints.angle_rates[i]
            (l1, l2, l3), (t1, t2, t3) = wheel.rows(joints.angles[i])
            along, across = l1 * vx + l2 * vy + l3 * wz, t1 * vx + t2 * vy + t3 * wz
            radius = wheel.radius if radii is None else radii[i]
            along -= wheel.lateral * steering_rate + radius * joints.speeds[i]
            across += wheel.trail * steering_rate
            square = along * along + across * across
            self._slip_squares += square
            if square > self._largest_square:
                self._largest_square = square
        self._slip_count += len(self._rolling)
        for i, lower, upper in self._free_ranges:
            at_limit = not lower <= joints.angles[i] <= upper
            self._limit_hits += at_limit and not self._at_limit[i]
            self._at_limit[i] = at_limit

    def least_values(self) -> dict[str, float]:
        """Returns the metrics that never fall during a run, by name: their final values are not
        smaller."""
        return {
            "path": self._loop.path_true,
            "tilt": math.acos(max(self._loop.uprightness, -1.0)),
            "largest_slip": math.sqrt(self._largest_square),
            "steering_limit_hits": float(self._limit_hits),
            "energy": self._energy,
        }

    def values(self, result: RobotResult) -> dict[str, float]:
        """Returns the metrics of the finished run by name, in the order of ``UNITS``."""
        path, estimated_path = result.path_true, result.path_odometry
        has_moved = estimated_path > _LEAST_PATH and path > _LEAST_PATH
        values = {
            "end_error": result.end_error,
            "yaw_error": result.yaw_error,
            "path": path,
            "length_ratio": path / estimated_path if has_moved else 1.0,
            "tilt": result.largest_tilt,
            "slip": math.sqrt(self._slip_squares / max(self._slip_count, 1)),
            "largest_slip": math.sqrt(self._largest_square),
            "steering_limit_hits": float(self._limit_hits),
            "collisions": float(result.collisions),
            "energy": self._energy,
            "energy_per_metre": self._energy / path if path > _LEAST_PATH else math.inf,
        }
        return {name: values[name] for name in UNITS}
