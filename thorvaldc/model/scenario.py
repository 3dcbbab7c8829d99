"""What a simulation does and what is expected of it: a scenario, everything in SI."""

from __future__ import annotations

from dataclasses import dataclass, field

from thorvaldc.diagnostics import Span
from thorvaldc.model.fleet import Fleet

GROUPS = ("odometry", "truth", "twist", "joints")
"""Groups of columns that a record can hold."""


@dataclass(frozen=True, slots=True)
class Command:
    """From ``time`` (s) on: forward and leftward m/s, turning rad/s of ``base_link``.

    ``parameters`` names the parameter set to drive by from then on (empty: as before).
    """

    time: float
    vx: float
    vy: float
    wz: float
    parameters: str = ""


@dataclass(frozen=True, slots=True)
class Fault:
    """What is wrong with a wheel from ``start`` to before ``end`` (s), unknown to the driver.

    ``type`` and ``value``: ``steering_offset`` (rad, true angle less the encoder's),
    ``radius_error`` (the share by which the true radius is larger), ``ice`` (coefficient
    of friction), ``encoder_frozen`` and ``motor_lost`` (none).  ``motor`` is ``drive`` or
    ``steering``.
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
    """Errors of the sensors, drawn by ``seed``: standard deviations of each reading.

    ``wheel_speed`` in rad/s, ``wheel_position`` and ``steering_angle`` in rad.  ``gyro``
    (rad/s) is that of the yaw rate, which nobody tells for ``None``, ``gyro_bias`` (rad/s)
    its constant error.  ``encoder_counts``: positions in whole counts of the encoders.
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
    """``metric`` of every robot is at least ``least`` and at most ``most`` (``None``: any)."""

    metric: str
    least: float | None
    most: float | None
    span: Span


@dataclass(frozen=True, slots=True)
class Scenario:
    """A run of ``duration`` s of the robots of ``fleet`` in its world.

    ``commands`` holds each robot's by its name, in order of time.  Of the record,
    ``record`` names the groups of columns and ``every`` (s) the time between two lines (0:
    every tick).
    """

    name: str
    description: str
    fleet: Fleet
    duration: float
    commands: tuple[tuple[str, tuple[Command, ...]], ...]
    faults: tuple[Fault, ...]
    noise: Noise
    expectations: tuple[Expectation, ...]
    span: Span
    record: tuple[str, ...] = field(default=GROUPS)
    every: float = 0.0
