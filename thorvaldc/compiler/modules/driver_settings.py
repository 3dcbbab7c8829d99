"""Reads the settings of the base driver and the named parameter sets of a robot document.

The motors limit the twist of the robot.  A wheel of the radius r (m) with the maximum wheel speed
omega (rad/s) has the maximum rolling speed v = omega r (m/s).  A wheel with the maximum rolling
speed v (m/s) at the distance d (m) from the centre of the robot allows the turning rate v / d
(rad/s).  The slowest wheel determines the maximum linear velocity and the maximum turning rate of
the robot.  The maximum accelerations of the wheels limit the acceleration of the robot in the same
way.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from thorvaldc.compiler.modules.value_reader import ValueReader, entries
from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.source.unit_table import QUANTITIES
from thorvaldc.diagnostics import Proposal, Report
from thorvaldc.diagnostics.suggest import did_you_mean
from thorvaldc.model.drive_settings import ARMING_TIMEOUT, AT_START, ON_ARMING
from thorvaldc.model.robot import (
    AUTOMATIC,
    REQUIRED,
    Actuator,
    BatterySettings,
    DriverSettings,
    ParameterSet,
    Wheel,
)
from thorvaldc.model.spatial import clean
from thorvaldc.model.statics.contact_point import contact_point

# Least and greatest cycle rate of the base driver in Hz.  In a longer cycle the reports of a motor
# are too old to supervise its motion (``motion_supervision``).  A CAN bus is too slow for control
# cycles shorter than 1 ms.
MIN_RATE, MAX_RATE = 5.0, 1000.0
# Default cycle rate of the base driver in Hz.  The base driver of the original system has the same
# default cycle rate.
DEFAULT_RATE = 50.0
# Default time-out of commanded twists in s.  The base driver of the original system has the same
# command time-out.
DEFAULT_TIMEOUT = 0.5
# Least distance (m) of a wheel from the centre of the robot in the computation of the maximum
# turning rate.  Without the least distance, a wheel near the centre of the robot would allow a
# nearly infinite turning rate.
MIN_LEVER = 0.05

LIMITS = {
    "max_linear_velocity": "velocity",
    "max_angular_velocity": "angular_velocity",
    "max_linear_acceleration": "acceleration",
    "max_angular_acceleration": "angular_acceleration",
}
# Quantity of each deceleration, and the acceleration that it equals by default.
DECELERATIONS = {
    "max_linear_deceleration": ("acceleration", "max_linear_acceleration"),
    "max_angular_deceleration": ("angular_acceleration", "max_angular_acceleration"),
}
BATTERY = {
    "warn": "ratio",
    "limit": "ratio",
    "stop": "ratio",
    "arm": "ratio",
    "speed": "ratio",
    "silence": "time",
}
NOISE = {
    "speed_ratio": "ratio",
    "angle": "angle",
    "speed_floor": "velocity",
    "slip_floor": "velocity",
    "skid_ratio": "ratio",
    "gyro": "angular_velocity",
    "correlation": "time",
    "radius_error": "ratio",
    "scale_error": "ratio",
    "steering_offset_error": "angle",
}
MEASURED_RADII = {"radius_error", "scale_error"}
"""Noise of the radii in a calibration file."""
MAY_BE_ZERO = ("correlation", "radius_error", "scale_error", "steering_offset_error")


class DriverSettingsReader:
    """Reads the sections ``driver`` and ``parameter_sets`` of a robot document.

    Parameters
    ----------
    document : the robot document.
    reader : reader of the values of the document.
    wheels : the wheels of the robot.
    actuators : actuators of the robot, by the name of the joint.
    tolerance : fraction by which a stated limit may exceed the limit of the motors without a
        warning.
    report : collects the diagnostics.
    measured_noise : noise of the calibration file; the robot document has precedence.
    """

    def __init__(
        self,
        document: Node,
        reader: ValueReader,
        wheels: Sequence[Wheel],
        actuators: Mapping[str, Actuator],
        tolerance: float,
        report: Report,
        measured_noise: Mapping[str, float] | None = None,
    ) -> None:
        self._document = document
        self._reader = reader
        self._wheels = wheels
        self._actuators = actuators
        self._tolerance = tolerance
        self._report = report
        self._measured_noise = dict(measured_noise or {})

    def driver(self) -> DriverSettings:
        """Returns the settings of the base driver.

        The limit of the robot's twist is the lower of the limit in the robot document and the limit
        of the motors.
        """
        node = self._document.get("driver") or Node({}, self._document.span)
        rate = self._reader.quantity(node.get("rate"), "frequency", DEFAULT_RATE)
        timeout = self._reader.quantity(node.get("command_timeout"), "time", DEFAULT_TIMEOUT)
        for key, value in (("rate", rate), ("command_timeout", timeout)):
            if value <= 0:
                self._report_not_positive(key, value, node.get(key))
        self._check_cycle(rate, timeout, node)
        limits: dict[str, Any] = {
            key: self._limit(node.get(key), key, LIMITS[key], motor_limit)
            for key, motor_limit in self._motor_limits(None).items()
        }
        return DriverSettings(
            rate=rate if rate > 0 else DEFAULT_RATE,
            command_timeout=timeout,
            noise=tuple((self._measured_noise | self._noise(node.get("noise"))).items()),
            stopping_distance=self._stopping_distance(node.get("stopping_distance")),
            battery=self._battery(node.get("battery")),
            arming=_choice(node.get("arming"), REQUIRED, AUTOMATIC),
            arming_timeout=self._arming_timeout(node.get("arming_timeout")),
            homing=_choice(node.get("homing"), ON_ARMING, AT_START),
            **limits,
            **self._decelerations(node, limits, None, node),
        )

    def _decelerations(
        self, node: Node, limits: Mapping[str, float], radii: str | None, driver: Node
    ) -> dict[str, float]:
        """Returns the decelerations of a stop; by default they equal the accelerations.

        ``node``: section ``driver``, or a parameter set, which inherits what ``driver`` states.
        The motors that bound the accelerations bound the decelerations too.
        """
        motor_limits = self._motor_limits(radii)
        values = {}
        for key, (quantity, acceleration) in DECELERATIONS.items():
            stated, motor_limit = node.get(key), motor_limits[acceleration]
            if stated is not None:
                values[key] = self._limit(stated, key, quantity, motor_limit)
            elif driver.get(key) is not None:
                inherited = self._reader.quantity(driver.get(key), quantity)
                values[key] = _finite(min(inherited, motor_limit))
            else:
                values[key] = limits[acceleration]
        return values

    def _arming_timeout(self, node: Node | None) -> float:
        time = self._reader.quantity(node, "time", ARMING_TIMEOUT)
        if time <= 0.0:
            self._report_not_positive("arming_timeout", time, node)
        return time

    def _stopping_distance(self, node: Node | None) -> float | None:
        if node is None:
            return None
        distance = self._reader.quantity(node, "length")
        if distance <= 0.0:
            self._report_not_positive("stopping_distance", distance, node)
            return None
        return distance

    def _battery(self, node: Node | None) -> BatterySettings:
        """Reads the thresholds of the batteries, which must be in the order stop, limit, warn."""
        values = {}
        defaults = BatterySettings()
        for key, quantity in BATTERY.items():
            entry = node.get(key) if node is not None else None
            values[key] = self._reader.quantity(entry, quantity, getattr(defaults, key))
            longest = math.inf if quantity == "time" else 1.0
            if entry is not None and not 0.0 <= values[key] <= longest:
                self._report.add(
                    "battery-threshold",
                    f"`{key}` is {values[key]:g}; a share is 0 % to 100 %, a time is 0 s or more",
                    entry.span,
                )
        settings = BatterySettings(**values)
        if node is not None and not settings.stop <= settings.limit <= settings.warn:
            self._report.add(
                "battery-threshold",
                f"the thresholds are stop {settings.stop:.3g}, limit {settings.limit:.3g} and warn "
                f"{settings.warn:.3g}; they must not fall in this order",
                node.where,
                hint="a battery that runs down reaches `warn`, then `limit`, then `stop`",
            )
        elif node is not None and settings.arm < settings.stop:
            self._report.add(
                "battery-threshold",
                f"`arm` is {settings.arm:.3g}, below `stop` with {settings.stop:.3g}: an armed "
                "robot would stop at once",
                node.where,
                hint="use an `arm` above `stop`",
            )
        return settings

    def _check_cycle(self, rate: float, timeout: float, node: Node) -> None:
        """Checks the rate and the command time-out of the base driver.

        The command time-out must be at least as long as one cycle of the base driver.
        """
        entry = node.get("rate") or node.get("command_timeout") or node
        if rate > 0.0 and not MIN_RATE <= rate <= MAX_RATE:
            self._report.add(
                "driver-cycle",
                f"the rate is {rate:g} Hz; the base driver runs at {MIN_RATE:g} to {MAX_RATE:g} Hz",
                entry.span,
            )
        elif rate > 0.0 and 0.0 < timeout < 1.0 / rate:
            self._report.add(
                "driver-cycle",
                f"the command time-out is {timeout:g} s, "
                f"shorter than one cycle of {1.0 / rate:g} s",
                (node.get("command_timeout") or entry).span,
                hint="every command would expire before the driver uses it",
            )

    def parameter_sets(self, driver: DriverSettings) -> tuple[ParameterSet, ...]:
        """Returns the named parameter sets of the robot.

        A parameter set contains the settings of the section ``driver`` with some changed values.
        """
        sets = entries(self._document.get("parameter_sets"))
        return tuple(self._parameter_set(name, entry, driver) for name, entry in sets.items())

    def _parameter_set(self, name: str, node: Node, driver: DriverSettings) -> ParameterSet:
        """Reads one named parameter set of the base driver."""
        radii_node = node.get("radii")
        radii = self._reader.text(radii_node) if radii_node is not None else None
        known = list(dict.fromkeys(key for wheel in self._wheels for key, _ in wheel.radii))
        if radii_node is not None and radii not in known:
            self._report.add(
                "parameter-set-radii",
                f"no wheel has radii named `{radii}`",
                radii_node.span,
                hint=did_you_mean(
                    str(radii),
                    known,
                    f"there are {', '.join(known)}" if known else "every wheel has one radius",
                ),
            )
        limits: dict[str, Any] = {}
        for key, motor_limit in self._motor_limits(radii).items():
            stated = node.get(key)
            limits[key] = (
                min(getattr(driver, key), _finite(motor_limit))
                if stated is None
                else self._limit(stated, key, LIMITS[key], motor_limit)
            )
        section = self._document.get("driver") or Node({}, self._document.span)
        limits |= self._decelerations(node, limits, radii, section)
        inherited = dict(driver.noise)
        if radii is not None:  # the calibration file states the errors of the ordinary radii
            for key in MEASURED_RADII:
                if inherited.get(key) == self._measured_noise.get(key):
                    inherited.pop(key, None)
        noise = tuple((inherited | self._noise(node.get("noise"))).items())
        return ParameterSet(name, radii, replace(driver, noise=noise, **limits), node.where)

    def _motor_limits(self, radii: str | None) -> dict[str, float]:
        """Returns the limits of the robot's twist that the slowest motors allow, by the key of the
        section ``driver``.

        ``radii``: name of the wheel radii, or ``None`` for the nominal radii.
        """
        speed = turning_rate = math.inf
        acceleration = turning_acceleration = math.inf
        for wheel in self._wheels:
            actuator = self._actuators.get(wheel.spin_joint)
            if actuator is None:
                continue
            radius = wheel.radius_named(radii)
            wheel_speed = actuator.max_velocity * radius
            wheel_acceleration = actuator.max_acceleration * radius
            lever = max(math.hypot(*contact_point(wheel)), MIN_LEVER)
            speed = min(speed, wheel_speed)
            turning_rate = min(turning_rate, wheel_speed / lever)
            acceleration = min(acceleration, wheel_acceleration)
            turning_acceleration = min(turning_acceleration, wheel_acceleration / lever)
        limits = (speed, turning_rate, acceleration, turning_acceleration)
        return dict(zip(LIMITS, limits, strict=True))

    def _limit(self, node: Node | None, key: str, quantity_name: str, motor_limit: float) -> float:
        """Returns the lower of the twist limit in the robot document and the twist limit of the
        motors.
        """
        stated = self._reader.quantity(node, quantity_name, motor_limit)
        quantity = QUANTITIES[quantity_name]
        if node is not None and stated <= 0:
            self._report_not_positive(key, stated, node)
        lowered = _rounded_down(motor_limit)
        if node is not None and stated > motor_limit * (1 + self._tolerance):
            self._report.add(
                "driver-limit-too-high",
                f"`{key}` is {quantity.format_value(stated)}; the slowest module allows "
                f"{quantity.format_value(motor_limit)}",
                node.span,
                hint=Proposal(
                    f"use `{quantity.format_value(lowered)}`, or leave it out to use the limit of"
                    " the modules",
                    quantity.format_value(lowered),
                ),
            )
        return _finite(min(stated, motor_limit))

    def _noise(self, node: Node | None) -> dict[str, float]:
        return read_noise(node, self._reader, self._report)

    def _report_not_positive(self, key: str, value: float, node: Node | None) -> None:
        _report_not_positive(key, value, node, self._report)


def read_noise(node: Node | None, reader: ValueReader, report: Report) -> dict[str, float]:
    """Returns the values of a `noise` section, which describes the errors in the odometry.

    The values are in SI units, by the key of the section.
    """
    noise: dict[str, float] = {}
    for key, entry in entries(node).items():
        if key not in NOISE:  # The schema check has already reported the unknown key.
            continue
        value = reader.quantity(entry, NOISE[key])
        if value > 0 or (value == 0 and key in MAY_BE_ZERO):
            noise[key] = clean(value)
        else:
            _report_not_positive(key, value, entry, report)
    return noise


def _report_not_positive(key: str, value: float, node: Node | None, report: Report) -> None:
    report.add(
        "size-not-positive",
        f"`{key}` is {value:g}; it must be positive",
        node.span if node is not None else None,
    )


def _choice(node: Node | None, default: str, other: str) -> str:
    """Returns one of two words; the schema check has reported all further words."""
    return other if node is not None and node.value == other else default


def _rounded_down(value: float) -> float:
    """Returns the value rounded down to three significant digits."""
    if not 0.0 < value < math.inf:
        return value
    step = 10.0 ** (math.floor(math.log10(value)) - 2)
    return math.floor(value / step) * step


def _finite(value: float) -> float:
    """Returns a limit of the robot's twist, or 0 if the robot has no driven wheels."""
    return clean(value) if math.isfinite(value) else 0.0
