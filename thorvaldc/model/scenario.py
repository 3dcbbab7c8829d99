"""A scenario: the inputs of a simulation run and the expected results. All values of the scenario
are in SI units."""

from __future__ import annotations

from dataclasses import dataclass, field

from thorvaldc.diagnostics import Span
from thorvaldc.model import Fleet

GROUPS = ("odometry", "truth", "twist", "joints")
"""Names of the groups of columns that a record of a run can contain."""


@dataclass(frozen=True, slots=True)
class Command:
    """A commanded twist of ``base_link``, valid from ``time`` (s) until the next command.

    - ``vx``, ``vy``: forward velocity and velocity to the left in m/s.
    - ``wz``: counterclockwise angular velocity in rad/s.
    - ``parameters``: name of the parameter set that the driver selects at ``time``, or empty to
      keep the selected parameter set.
    """

    time: float
    vx: float
    vy: float
    wz: float
    parameters: str = ""


@dataclass(frozen=True, slots=True)
class WheelFault:
    """An injected fault of a wheel.

    The base driver is not informed about the injected fault. The injected fault is active from the
    simulated time ``start`` until just before ``end``, in s. ``motor`` selects the affected motor
    of the wheel: ``drive`` or ``steering``. Meaning of ``value`` for each ``type`` of injected
    fault:

    - ``steering_offset``: true steering angle minus encoder angle, in rad.
    - ``radius_error``: (true radius - nominal radius) / nominal radius.
    - ``ice``: coefficient of friction under the wheel.
    - ``encoder_frozen``: no value; the encoder of the motor always returns the same position.
    - ``motor_lost``: no value; the motor has no torque.
    """

    type: str
    robot: str
    wheel: str
    motor: str
    value: float
    start: float
    end: float
    span: Span


@dataclass(frozen=True, slots=True)
class Noise:
    """Standard deviations of the random measurement errors of the simulated sensors.

    - ``seed``: seed of the random number generator.
    - ``wheel_speed``: standard deviation of the measured wheel speed in rad/s.
    - ``wheel_position``: standard deviation of the measured wheel position in rad.
    - ``steering_angle``: standard deviation of the measured steering angle in rad.
    - ``gyro``: standard deviation of the measured yaw rate in rad/s, or ``None`` for a robot
      without a gyroscope.
    - ``gyro_bias``: constant error of the measured yaw rate in rad/s.
    - ``encoder_counts``: true if positions are rounded to whole encoder counts.
    """

    seed: int = 0
    wheel_speed: float = 0.0
    wheel_position: float = 0.0
    steering_angle: float = 0.0
    gyro: float | None = None
    gyro_bias: float = 0.0
    encoder_counts: bool = False


@dataclass(frozen=True, slots=True)
class Expectation:
    """The allowed range of a metric of the run, checked for every robot of the scenario.

    - ``metric``: name of the metric.
    - ``least``, ``most``: smallest and largest allowed value of the metric, or ``None`` for no
      limit.
    """

    metric: str
    least: float | None
    most: float | None
    span: Span


@dataclass(frozen=True, slots=True)
class Scenario:
    """A simulation run with the robots of a fleet in the world of the fleet.

    - ``duration``: duration of the run in s.
    - ``commands``: the name of each robot with the commands of the robot, in order of time.
    - ``record``: names of the groups of columns in the record of the run.
    - ``every``: time between two rows of the record in s, or 0 to record every control tick.
    - ``open_loop``: ``True`` if the drive motors apply a voltage without speed control.
    """

    name: str
    description: str
    fleet: Fleet
    duration: float
    commands: tuple[tuple[str, tuple[Command, ...]], ...]
    faults: tuple[WheelFault, ...]
    noise: Noise
    expectations: tuple[Expectation, ...]
    span: Span
    record: tuple[str, ...] = field(default=GROUPS)
    every: float = 0.0
    open_loop: bool = False
