"""A scenario: the inputs of a simulation run, the faults to inject, and the expected results.

All values are in SI units.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass, field
from typing import NamedTuple

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
class SensorSettings:
    """Settings of the simulated sensors (lidar, IMU, GNSS, camera) of all robots.

    - ``errors``: factor of the errors that the modules state; 0 for exact measurements.
    - ``images``: true if cameras draw images, which needs OpenGL.
    - ``for_filters``: true if the variances of an IMU are those for filters that take the errors of
      two readings as independent: they count how long its errors last.
    - ``noise``: its seed, and the errors of the gyro in place of those of the modules, if
      ``noise.gyro`` is not ``None``.
    """

    errors: float = 1.0
    images: bool = False
    for_filters: bool = False
    noise: Noise = Noise()


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

    - ``description``: text for people.
    - ``fleet``: the robots with their start poses, and the world.
    - ``duration``: duration of the run in s.
    - ``commands``: the name of each robot with the commands of the robot, in order of time.
    - ``faults``: faults of motors, encoders and wheels, each with its times.
    - ``noise``: errors of the measurements.
    - ``expectations``: bounds of the metrics.
    - ``record``: names of the groups of columns in the record of the run.
    - ``every``: time between two rows of the record in s, or 0 to record every control tick.
    - ``open_loop``: ``True`` if the drive motors apply a voltage without speed control.
    - ``sensors``: settings of the sensors of the modules, or ``None`` if they do not measure; their
      ``noise`` is that of the scenario.
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
    sensors: SensorSettings | None = None


# -- faults of a simulated CAN bus, and quirks of its devices ------------------------------------


class Quirk(enum.StrEnum):
    """A deviation of a simulated CANopen device from the default behaviour, as in real stacks.

    CiA 301 and CiA 305 permit most of this behaviour.  docs/simulated-bus.md describes each quirk.
    """

    LSS_RESPONDS_WHEN_SELECTED = "lss_responds_when_selected"
    """In the LSS state CONFIGURATION, the device responds to every fastscan request and to the last
    request of every selective switch, whatever the identity in the request."""
    LENGTH_ABORTS = "length_aborts"
    """A value that is too long or too short aborts with 0x06070012 or 0x06070013 instead of
    0x06070010."""
    ERROR_HISTORY_ABORTS = "error_history_aborts"
    """Reading an unused entry of object 0x1003 aborts with 0x08000024 instead of returning 0."""
    ONE_CONSUMER_PER_NODE = "one_consumer_per_node"
    """A second entry of object 0x1016 for the same node aborts with 0x06040043."""
    FIXED_COB_IDS = "fixed_cob_ids"
    """The COB-IDs of SYNC (object 0x1005) and of EMCY (object 0x1014) are read-only."""
    SEGMENTED_TRANSFERS = "segmented_transfers"
    """Values of up to 4 bytes are also uploaded in segments, and expedited downloads are refused
    with the abort code 0x05040001."""
    BLOCK_TRANSFERS = "block_transfers"
    """The device also supports block transfers, which the other devices abort with 0x05040001."""
    INHIBIT_TIMES = "inhibit_times"
    """The factory setting of the inhibit time of all TPDOs is 50 ms."""
    NO_INHIBIT_TIMES = "no_inhibit_times"
    """The TPDOs have no inhibit time (subindex 3)."""


class FaultKind(NamedTuple):
    """The fields that an injected fault of a certain kind, such as ``power_cut``, must or may have.

    - ``node``: ``yes`` if the fault affects one device, ``no`` if the fault affects the whole bus,
      ``maybe`` if both are possible.
    - ``needs``: names of the required fields.
    - ``may``: names of the optional fields.
    - ``lasts``: true if the fault may have a ``duration``.
    """

    node: str
    needs: tuple[str, ...] = ()
    may: tuple[str, ...] = ()
    lasts: bool = True


FAULT_KINDS = {
    "power_cut": FaultKind("maybe"),
    "mute": FaultKind("yes"),
    "heartbeat_stop": FaultKind("yes"),
    "duplicate_id": FaultKind("yes", ("id",), lasts=False),
    "clone": FaultKind("yes"),
    "babble": FaultKind("yes", ("cob_id", "period"), ("format",)),
    "emcy": FaultKind("yes", ("code",), ("register",), lasts=False),
    "forged_frames": FaultKind("no", ("cob_id",), ("data", "period", "format")),
    "battery_charge": FaultKind("yes", ("charge",)),
    "watchdog_lost": FaultKind("yes", lasts=False),
    "object_written": FaultKind("yes", ("index", "value"), ("subindex",)),
    "frozen_encoder": FaultKind("yes", ("channel",)),
    "encoder_jump": FaultKind("yes", ("channel", "angle"), lasts=False),
    "blocked_motor": FaultKind("yes", ("channel",)),
    "pushed_motor": FaultKind("yes", ("channel", "speed")),
    "runaway_motor": FaultKind("yes", ("channel", "speed")),
    "commands_ignored": FaultKind("yes"),
    "sync_ignored": FaultKind("yes"),
    "nmt_ignored": FaultKind("yes"),
    "frozen_reports": FaultKind("yes"),
    "wrong_bitrate": FaultKind("yes", ("bitrate",)),
    "bus_off": FaultKind("yes", lasts=False),
    "lost_frames": FaultKind("maybe", ("share",), ("cob_id", "format")),
    "late_frames": FaultKind("maybe", ("share", "latency"), ("cob_id", "format")),
    "repeated_frames": FaultKind("maybe", ("share",), ("cob_id", "format")),
    "noise": FaultKind("no", ("share",)),
}
FRAME_FORMATS = ("standard", "extended", "remote")
"""Formats of frames: data frames with 11 or 29 bits of identifier, remote frames with 11 bits."""


@dataclass(frozen=True, slots=True)
class BusFault:
    """A fault that the simulation injects into a CAN bus.

    The injected fault begins ``delay`` s after the simulated time ``time`` (s), or ``delay`` s
    after the middle of the CAN frame with the number ``frame``. The first CAN frame on the bus has
    the number 1. The injected fault lasts for ``duration`` s. If ``duration`` is ``None``, the
    injected fault lasts until the end of the simulation.

    - ``node``: name of the affected device, or ``None`` for all devices on the bus.
    - ``id``: node id that the device takes.
    - ``cob_id``: COB-ID of the frames that a babbling device or a foreign sender sends, or of the
      frames that are lost, late or repeated.  If ``cob_id`` is ``None``, CAN frames with any COB-ID
      can be lost, late or repeated.
    - ``data``: data of the forged frames, or ``None`` for new random data in each forged frame.
    - ``period``: period in s of the frames that a babbling device or a foreign sender sends.  If
      ``period`` is 0, a foreign sender sends one frame.
    - ``code``, ``register``: error code and error register of the injected emergency frame (EMCY).
    - ``channel``: name of the motor channel that is affected.
    - ``bitrate``: wrong bit rate of the device in bit/s.
    - ``share``: fraction of the frames that the fault affects, 0 to 1.
    - ``latency``: time in s by which late frames arrive late.
    - ``angle``: angle in rad at the joint by which the reading of an encoder jumps.
    - ``charge``: state of charge of the battery, 0 to 1.
    - ``speed``: speed in rad/s that something else adds to a pushed joint, or with which a runaway
      motor turns, whatever is commanded.
    - ``index``, ``subindex``, ``value``: object of the device that another interface of the device
      overwrites, and its new value.
    - ``format``: format of the frames with ``cob_id``, one of ``FRAME_FORMATS``.
    """

    kind: str
    bus: str
    node: str | None
    time: float | None
    frame: int | None
    span: Span
    delay: float = 0.0
    duration: float | None = None
    id: int = 0
    cob_id: int | None = None
    period: float = 0.0
    code: int = 0
    register: int = 0
    channel: str = ""
    bitrate: int = 0
    share: float = 0.0
    data: bytes | None = None
    latency: float = 0.0
    angle: float = 0.0
    charge: float = 0.0
    speed: float = 0.0
    index: int = 0
    subindex: int = 0
    value: int = 0
    format: str = "standard"


@dataclass(frozen=True, slots=True)
class BusFaults:
    """A list of faults to inject into the simulated CAN buses of a robot.

    - ``quirks``: quirks of all simulated CANopen devices;
    - ``seed``: seed of the random number generator of the faults.
    """

    faults: tuple[BusFault, ...]
    seed: int = 0
    description: str = ""
    quirks: tuple[Quirk, ...] = ()
