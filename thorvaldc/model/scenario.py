"""A scenario: the inputs of a simulation run and the expected results.  All values in SI."""

from __future__ import annotations

from dataclasses import dataclass, field

from thorvaldc.diagnostics import Span
from thorvaldc.model.fleet import Fleet

GROUPS = ("odometry", "truth", "twist", "joints")
"""Groups of columns that a record can have."""


@dataclass(frozen=True, slots=True)
class Command:
    """A commanded twist of ``base_link`` that applies from ``time`` (s) on.

    ``vx`` (forward) and ``vy`` (to the left) in m/s, ``wz`` (counterclockwise) in rad/s.
    ``parameters`` is the parameter set that applies from then on (empty: no change).
    """

    time: float
    vx: float
    vy: float
    wz: float
    parameters: str = ""


@dataclass(frozen=True, slots=True)
class WheelFault:
    """An injected fault of a wheel, active from ``start`` to before ``end`` (s).

    The driver does not know about it.  ``type`` is one of the following, with the meaning of
    ``value``:

    - ``steering_offset``: true angle minus encoder angle, rad.
    - ``radius_error``: (true radius - nominal radius) / nominal radius.
    - ``ice``: coefficient of friction under the wheel.
    - ``encoder_frozen``, ``motor_lost``: no value; ``motor`` is ``drive`` or ``steering``.
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
    """Random errors of the sensors: the standard deviation of each reading.

    ``seed`` is the random seed.  ``wheel_speed`` in rad/s, ``wheel_position`` and
    ``steering_angle`` in rad.  ``gyro`` is the noise of the measured yaw rate in rad/s
    (``None``: the robot has no gyroscope), ``gyro_bias`` its constant error in rad/s.
    ``encoder_counts``: positions are rounded to whole encoder counts.
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
    """The range, ``least`` to ``most``, of a metric of every robot (``None``: no limit)."""

    metric: str
    least: float | None
    most: float | None
    span: Span


@dataclass(frozen=True, slots=True)
class Scenario:
    """A simulation run of ``duration`` s with the robots of ``fleet`` in its world.

    ``commands`` has the commands of each robot by its name, in order of time.  ``record`` lists the
    groups of columns of the record, and ``every`` is the time between two rows in s (0: each
    control tick).
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
