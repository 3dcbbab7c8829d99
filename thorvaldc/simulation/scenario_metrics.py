"""Metrics of a robot in a scenario: slip, steering limits, motor work and collisions."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from thorvaldc.compiler.scenario.scenario_compilation import metric_units
from thorvaldc.runtime.calculators.base_geometry import BaseGeometry, WheelGeometry
from thorvaldc.simulation.control_loop import ControlLoop
from thorvaldc.simulation.physics.mujoco_scene import RollingRadii
from thorvaldc.simulation.physics.scenario_base import ScenarioBase
from thorvaldc.simulation.simulation_result import RobotResult

Array = NDArray[np.float64]

_LIMIT_TOLERANCE = math.radians(0.2)
"""Distance (rad) from a steering limit within which the joint counts as at the limit."""
_LEAST_PATH = 1e-3
"""Path length (m) below which a ratio with it has no meaning."""
_MOST_TICKS = 512
"""Number of stored ticks after which the metrics are computed, to bound the memory."""


class _Ticks:
    """State of a robot in a MuJoCo scene after each of several ticks.

    - ``times``: times of the ticks (s).
    - ``yaws``: yaw angles of the robot (rad).
    - ``radii``: radii (m) of all wheels, if the robot has wheels with treads.
    """

    def __init__(self, base: ScenarioBase) -> None:
        motors, data = base.motors(), base.scene.data
        first, end = min(motors, default=0), max(motors, default=-1) + 1
        self._motors = [motor - first for motor in motors]
        # Views of MuJoCo arrays, and arrays with a copy of each view per tick.
        self._views = (
            data.actuator_force[first:end],
            data.actuator_velocity[first:end],
            base.positions,
            base.velocities,
        )
        self._copies = tuple(np.empty((_MOST_TICKS, len(view))) for view in self._views)
        self._forces, self._motor_speeds, self._positions, self._velocities = self._copies
        self._wheels = len(base.robot.wheels)
        self._spin, self._steering = base.spin_joints, base.steering_joints
        self.clear()

    def clear(self) -> None:
        """Removes all ticks."""
        self.times: list[float] = []
        self.yaws: list[float] = []
        self.radii: list[list[float]] = []

    def add(self, time: float, yaw: float) -> None:
        """Adds the present state, ``time`` (s) and the yaw angle (rad) of the robot."""
        k = len(self.times)
        for copies, view in zip(self._copies, self._views, strict=True):
            copies[k] = view
        self.times.append(time)
        self.yaws.append(yaw)

    @property
    def power(self) -> Array:
        """Power (W) of each motor, with the shape (ticks, motors)."""
        n = len(self.times)
        power: Array = (self._forces[:n] * self._motor_speeds[:n])[:, self._motors]
        return power

    @property
    def velocity(self) -> Array:
        """Velocity of the base in the world frame (m/s), and about its own axes (rad/s), with the
        shape (6, ticks)."""
        return self._velocities[: len(self.times), :6].T

    @property
    def speeds(self) -> Array:
        """Wheel speeds (rad/s), with the shape (ticks, wheels)."""
        return self._of_wheels(self._velocities, [(i, v) for i, _, v in self._spin])

    @property
    def angles(self) -> Array:
        """Steering angles (rad), with the shape (ticks, wheels)."""
        return self._of_wheels(self._positions, [(i, q) for i, q, _ in self._steering])

    @property
    def rates(self) -> Array:
        """Steering rates (rad/s), with the shape (ticks, wheels)."""
        return self._of_wheels(self._velocities, [(i, v) for i, _, v in self._steering])

    def _of_wheels(self, copies: Array, columns: Sequence[tuple[int, int]]) -> Array:
        """Returns the columns of ``copies`` by wheel: ``columns`` are (wheel, column)."""
        n = len(self.times)
        values = np.zeros((n, self._wheels))
        for wheel, column in columns:
            values[:, wheel] = copies[:n, column]
        return values


class _WheelArrays:
    """Constants of wheels as arrays, with the names of ``WheelGeometry``."""

    def __init__(self, wheels: Sequence[WheelGeometry]) -> None:
        self.x, self.y = np.array([w.x for w in wheels]), np.array([w.y for w in wheels])
        self.heading = np.array([w.heading for w in wheels])
        self.sign = np.array([w.sign for w in wheels])
        self.radius = np.array([w.radius for w in wheels])
        self.trail = np.array([w.trail for w in wheels])
        self.lateral = np.array([w.lateral for w in wheels])


def exact(function: Callable[[float], float], values: Array) -> Array:
    """Returns ``function`` of each value, with the shape of ``values``.

    ``function`` is a function of the module ``math``.  The functions of numpy differ from it in the
    last bit, depending on the processor and on the version of numpy.
    """
    flat = values.ravel().tolist()
    return np.fromiter(map(function, flat), np.float64, len(flat)).reshape(values.shape)


def _total(start: float, values: Array) -> float:
    """Returns the sum of ``start`` and the values, added one after the other."""
    return float(np.add.accumulate(np.concatenate([[start], values.ravel()]))[-1])


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
        wheels = BaseGeometry.from_robot(loop.robot).wheels
        self._rolling = [i for i, w in enumerate(wheels) if w.driven and not w.swivel]
        self._wheels = _WheelArrays([wheels[i] for i in self._rolling])
        self._steered = [i for i, w in enumerate(wheels) if w.steered]
        # The steering joint counts as not at a limit between these angles (rad).
        steered = [wheels[i] for i in self._steered]
        self._lower = np.array([-math.inf if w.lower is None else w.lower for w in steered])
        self._upper = np.array([math.inf if w.upper is None else w.upper for w in steered])
        self._lower += _LIMIT_TOLERANCE
        self._upper -= _LIMIT_TOLERANCE
        self._ticks = _Ticks(base)
        has_treads = any(wheel.treads for wheel in loop.robot.wheels)
        self._radii = RollingRadii(loop.robot, base.scene) if has_treads else None
        self._time = 0.0
        self._energy = 0.0
        self._slip_squares = 0.0
        self._slip_count = 0
        self._largest_square = 0.0
        self._limit_hits = 0
        self._at_limit = np.zeros(len(self._steered), dtype=bool)

    def update(self) -> None:
        """Stores the state of the scene after a tick.

        The metrics are computed for many ticks at once, which takes less time.
        """
        self._ticks.add(self._loop.driver.state.time, self._loop.pose_true.yaw)
        if self._radii is not None:
            self._ticks.radii.append(self._radii.current())
        if len(self._ticks.times) == _MOST_TICKS:
            self._add_ticks()

    def _add_ticks(self) -> None:
        """Adds the stored ticks to the metrics, in the order of time."""
        ticks = self._ticks
        if not ticks.times:
            return
        times = np.array([self._time, *ticks.times])
        durations = (times[1:] - times[:-1])[:, np.newaxis]
        power, angles = ticks.power, ticks.angles
        self._energy = _total(self._energy, np.where(power > 0.0, power * durations, 0.0))
        squares = self._slips(angles)
        self._slip_squares = _total(self._slip_squares, squares)
        self._slip_count += squares.size
        # A slip that is not a number is not the largest.
        largest = np.fmax.reduce(squares, axis=None, initial=self._largest_square)
        self._largest_square = float(largest)
        steered = angles[:, self._steered]
        at_limit = ~((self._lower <= steered) & (steered <= self._upper))
        before = np.concatenate([self._at_limit[np.newaxis], at_limit[:-1]])
        self._limit_hits += int(np.count_nonzero(at_limit & ~before))
        self._at_limit = at_limit[-1]
        self._time = ticks.times[-1]
        ticks.clear()

    def _slips(self, angles: Array) -> Array:
        """Returns the squared slip (m^2/s^2) of each driven wheel, with the shape (ticks, wheels).

        ``angles`` are the steering angles (rad) of all wheels.
        """
        ticks, wheels, rolling = self._ticks, self._wheels, self._rolling
        yaws = np.array(ticks.yaws)
        c, s = exact(math.cos, yaws), exact(math.sin, yaws)
        vx, vy, wz = ticks.velocity[[0, 1, 5]]
        vx, vy = (c * vx + s * vy)[:, np.newaxis], (c * vy - s * vx)[:, np.newaxis]
        wz = wz[:, np.newaxis]
        speeds, rates = ticks.speeds[:, rolling], ticks.rates[:, rolling] * wheels.sign
        radii = np.array(ticks.radii)[:, rolling] if ticks.radii else wheels.radius
        # The rows of ``WheelGeometry.rows``.
        direction = wheels.heading + wheels.sign * angles[:, rolling]
        c, s = exact(math.cos, direction), exact(math.sin, direction)
        along = c * vx + s * vy + (s * wheels.x - c * wheels.y - wheels.lateral) * wz
        across = -s * vx + c * vy + (c * wheels.x + s * wheels.y + wheels.trail) * wz
        along -= wheels.lateral * rates + radii * speeds
        across += wheels.trail * rates
        squares: Array = along * along + across * across
        return squares

    def least_value(self, metric: str) -> float | None:
        """Returns the present value of a metric that never falls during a run, so that its final
        value is not smaller, or ``None`` for other metrics."""
        if metric == "path":
            return self._loop.path_true
        if metric == "tilt":
            return math.acos(max(self._loop.uprightness, -1.0))
        if metric not in ("largest_slip", "steering_limit_hits", "energy"):
            return None
        self._add_ticks()
        return {
            "largest_slip": math.sqrt(self._largest_square),
            "steering_limit_hits": float(self._limit_hits),
            "energy": self._energy,
        }[metric]

    def values(self, result: RobotResult) -> dict[str, float]:
        """Returns the metrics of the finished run by name, in the order of ``metric_units``."""
        self._add_ticks()
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
        return {name: values[name] for name in metric_units()}
