"""Reads the settings of the base driver, its parameter sets, and the sources and locks of twists.

The motors limit the twist of the robot.  A wheel of the radius r (m) with the maximum wheel speed
omega (rad/s) has the maximum rolling speed v = omega r (m/s).  A wheel with the maximum rolling
speed v (m/s) at the distance d (m) from the centre of the robot allows the turning rate v / d
(rad/s).  The slowest wheel determines the maximum linear velocity and the maximum turning rate of
the robot.  The maximum accelerations of the wheels limit the acceleration of the robot in the same
way.

Each twist source and each twist lock has a priority.  An active twist lock stops all twist sources
of the same or a lower priority.  The ROS node twist_mux stops only the twist sources of a lower
priority.  A twist source must therefore not have the priority of a twist lock, so that the base
driver and twist_mux stop the same twist sources.

A stop lock is a twist lock that stops every twist source: ``safety_stop``, and a twist lock of the
priority 255.  Every twist source must have a lower priority than every stop lock.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from typing import Any, NamedTuple

from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.values.document_section import Section
from thorvaldc.diagnostics import Label, Proposal, Report, did_you_mean
from thorvaldc.model import Actuator, DriverSettings, ParameterSet, TwistInput, Wheel
from thorvaldc.model.number_origins import least
from thorvaldc.model.settings import (
    RAMP_FIRST,
    SAFETY_STOP,
    STOP_PRIORITY,
    ZERO_FIRST,
    BatterySettings,
)
from thorvaldc.model.spatial import clean

# Least distance (m) of a wheel from the centre of the robot in the computation of the maximum
# turning rate.  Without the least distance, a wheel near the centre of the robot would allow a
# nearly infinite turning rate.
MIN_LEVER = 0.05

LIMITS = (
    "max_linear_velocity",
    "max_angular_velocity",
    "max_linear_acceleration",
    "max_angular_acceleration",
)
# The acceleration that each deceleration equals by default.
DECELERATIONS = {
    "max_linear_deceleration": "max_linear_acceleration",
    "max_angular_deceleration": "max_angular_acceleration",
}
MEASURED_RADII = {"radius_error", "scale_error"}
"""Noise of the radii in a calibration file."""


class DriverSettingsReader(NamedTuple):
    """Reads the sections ``driver`` and ``parameter_sets`` of a robot document.

    Parameters
    ----------
    section : the section ``driver`` of the robot document.
    sets : the section ``parameter_sets``.
    wheels : the wheels of the robot.
    actuators : actuators of the robot, by the name of the joint.
    tolerance : fraction by which a stated limit may exceed the limit of the motors without a
        warning.
    report : collects the diagnostics.
    measured_noise : noise of the calibration file; the robot document has precedence.
    """

    section: Section
    sets: Section
    wheels: Sequence[Wheel]
    actuators: Mapping[str, Actuator]
    tolerance: float
    report: Report
    measured_noise: Mapping[str, float]

    def driver(self) -> DriverSettings:
        """Returns the settings of the base driver.

        The limit of the robot's twist is the lower of the limit in the robot document and the limit
        of the motors.
        """
        section = self.section
        self._check_cycle()
        motor_limits = self._motor_limits(None)
        limits: dict[str, Any] = {
            key: self._limit(section, key, motor_limits[key]) for key in LIMITS
        }
        return DriverSettings(
            rate=section["rate"],
            command_timeout=section["command_timeout"],
            noise=tuple({**self.measured_noise, **noise_of(section)}.items()),
            stopping_distance=section["stopping_distance"],
            battery=self._battery(section["battery"]),
            arming=section["arming"],
            arming_timeout=section["arming_timeout"],
            homing=section["homing"],
            **limits,
            **self._decelerations(section, limits, None),
        )

    def _decelerations(
        self, section: Section, limits: Mapping[str, float], radii: str | None
    ) -> dict[str, float]:
        """Returns the decelerations of a stop; by default they equal the accelerations.

        ``section``: section ``driver``, or a parameter set, which inherits what ``driver`` states.
        The motors that bound the accelerations bound the decelerations too.
        """
        motor_limits = self._motor_limits(radii)
        values = {}
        for key, acceleration in DECELERATIONS.items():
            motor_limit = motor_limits[acceleration]
            if key in section:
                values[key] = self._limit(section, key, motor_limit)
            elif key in self.section:
                values[key] = _finite(min(self.section[key], motor_limit))
            else:
                values[key] = limits[acceleration]
        return values

    def _battery(self, section: Section) -> BatterySettings:
        """Reads the thresholds of the batteries, which must be in the order stop, limit, warn."""
        keys = (field.name for field in fields(BatterySettings))
        settings = BatterySettings(**{key: section[key] for key in keys})
        if not settings.stop <= settings.limit <= settings.warn:
            self.report.add(
                "battery-threshold",
                f"the thresholds are stop {settings.stop:.3g}, limit {settings.limit:.3g} and warn "
                f"{settings.warn:.3g}; they must not fall in this order",
                section.node.where,
                hint="a battery that runs down reaches `warn`, then `limit`, then `stop`",
            )
        elif settings.arm < settings.stop:
            self.report.add(
                "battery-threshold",
                f"`arm` is {settings.arm:.3g}, below `stop` with {settings.stop:.3g}: an armed "
                "robot would stop at once",
                section.node.where,
                hint="use an `arm` above `stop`",
            )
        return settings

    def _check_cycle(self) -> None:
        """Reports a command time-out that is shorter than one cycle of the base driver."""
        rate, timeout = self.section["rate"], self.section["command_timeout"]
        if timeout < 1.0 / rate:
            entry = self.section.node.get("command_timeout") or self.section.entry("rate")
            self.report.add(
                "driver-cycle",
                f"the command time-out is {timeout:g} s, "
                f"shorter than one cycle of {1.0 / rate:g} s",
                entry.span,
                hint="every command would expire before the driver uses it",
            )

    def parameter_sets(self, driver: DriverSettings) -> tuple[ParameterSet, ...]:
        """Returns the named parameter sets of the robot.

        A parameter set contains the settings of the section ``driver`` with some changed values.
        """
        sets = self.sets.items()
        return tuple(self._parameter_set(name, section, driver) for name, section in sets)

    def _parameter_set(self, name: str, section: Section, driver: DriverSettings) -> ParameterSet:
        """Reads one named parameter set of the base driver."""
        radii = section.get("radii", None)
        known = list(dict.fromkeys(key for wheel in self.wheels for key, _ in wheel.radii))
        if radii is not None and radii not in known:
            self.report.add(
                "parameter-set-radii",
                f"no wheel has radii named `{radii}`",
                section.entry("radii").span,
                hint=did_you_mean(
                    str(radii),
                    known,
                    f"there are {', '.join(known)}" if known else "every wheel has one radius",
                ),
            )
        limits: dict[str, Any] = {}
        for key, motor_limit in self._motor_limits(radii).items():
            limits[key] = (
                self._limit(section, key, motor_limit)
                if key in section
                else min(getattr(driver, key), _finite(motor_limit))
            )
        limits |= self._decelerations(section, limits, radii)
        inherited = dict(driver.noise)
        if radii is not None:  # the calibration file states the errors of the ordinary radii
            for key in MEASURED_RADII:
                if inherited.get(key) == self.measured_noise.get(key):
                    inherited.pop(key, None)
        noise = tuple((inherited | noise_of(section)).items())
        return ParameterSet(name, radii, replace(driver, noise=noise, **limits), section.node.where)

    def _motor_limits(self, radii: str | None) -> dict[str, float]:
        """Returns the limits of the robot's twist that the slowest motors allow, by the key of the
        section ``driver``.

        ``radii``: name of the wheel radii, or ``None`` for the nominal radii.
        """
        speed = turning_rate = math.inf
        acceleration = turning_acceleration = math.inf
        for wheel in self.wheels:
            actuator = self.actuators.get(wheel.spin_joint)
            if actuator is None:
                continue
            radius = wheel.radius_named(radii)
            wheel_speed = actuator.max_velocity * radius
            wheel_acceleration = actuator.max_acceleration * radius
            lever = max(math.hypot(*wheel.contact_point), MIN_LEVER)
            speed = least(speed, wheel_speed)
            turning_rate = least(turning_rate, wheel_speed / lever)
            acceleration = least(acceleration, wheel_acceleration)
            turning_acceleration = least(turning_acceleration, wheel_acceleration / lever)
        limits = (speed, turning_rate, acceleration, turning_acceleration)
        return dict(zip(LIMITS, limits, strict=True))

    def _limit(self, section: Section, key: str, motor_limit: float) -> float:
        """Returns the lower of the twist limit in the robot document and the twist limit of the
        motors.
        """
        stated = section.get(key, motor_limit)
        lowered = _rounded_down(motor_limit)
        if stated > motor_limit * (1 + self.tolerance):
            self.report.add(
                "driver-limit-too-high",
                f"`{key}` is {section.shown(key, stated)}; the slowest module allows "
                f"{section.shown(key, motor_limit)}",
                section.entry(key).span,
                hint=Proposal(
                    f"use `{section.shown(key, lowered)}`, or leave it out to use the limit of"
                    " the modules",
                    section.shown(key, lowered),
                ),
            )
        return _finite(min(stated, motor_limit))


def noise_of(section: Section) -> dict[str, float]:
    """Returns the stated values of `noise` in a section, the errors in the odometry in SI units."""
    return {key: clean(value) for key, value in section["noise"].items()}


def _rounded_down(value: float) -> float:
    """Returns the value rounded down to three significant digits."""
    if not 0.0 < value < math.inf:
        return value
    step = 10.0 ** (math.floor(math.log10(value)) - 2)
    return math.floor(value / step) * step


def _finite(value: float) -> float:
    """Returns a limit of the robot's twist, or 0 if the robot has no driven wheels."""
    return clean(value) if math.isfinite(value) else 0.0


# -- sources and locks of twists ---------------------------------------------------------

# The default twist sources and twist locks have the same names, priorities and ROS topics as in the
# twist multiplexer of the original system.  Commanded twists of the joystick have a higher priority
# than commanded twists of the navigation.  Nav2 begins each motion with a ramp (ADR 22).
DEFAULT_SOURCES = {
    "teleop_joy": (100, "teleop_joy/cmd_vel", ZERO_FIRST),
    "auto_nav": (10, "auto_nav/cmd_vel", RAMP_FIRST),
}
DEFAULT_LOCKS = {
    SAFETY_STOP: (STOP_PRIORITY, "safety_stop/lock", ZERO_FIRST),
    "auto_nav_pause": (50, "auto_nav/pause", ZERO_FIRST),
}
TwistInputs = tuple[TwistInput, ...]


def read_twist_inputs(
    driver: Section, command_timeout: float, report: Report
) -> tuple[TwistInputs, TwistInputs]:
    """Returns the sources of commanded twists, such as the joystick, and the twist locks.

    Each entry of the sections ``twist_sources`` and ``twist_locks`` of ``driver`` changes a default
    twist source or twist lock, or adds a new one.  ``command_timeout``: default time-out of a twist
    source (s).  A twist lock with the time-out 0 s never times out.
    """
    stated_sources, stated_locks = (
        dict(driver[key].items()) for key in ("twist_sources", "twist_locks")
    )
    sources = _inputs(DEFAULT_SOURCES, stated_sources, "cmd_vel", command_timeout)
    locks = _inputs(DEFAULT_LOCKS, stated_locks, "lock", 0.0)
    _check_priorities(sources, stated_sources, report)
    for source, lock in itertools.product(sources.values(), locks.values()):
        # The values of the robot file can be corrected; the default values cannot.
        sections = (stated_sources.get(source.name), stated_locks.get(lock.name))
        stated = [s.entry("priority") for s in sections if s is not None]
        _check_lock(source, lock, stated, report)
    return tuple(sources.values()), tuple(locks.values())


def _inputs(
    defaults: Mapping[str, tuple[int, str, str]],
    stated: dict[str, Section],
    topic: str,
    timeout: float,
) -> dict[str, TwistInput]:
    """Returns the default twist sources or twist locks, with the values of a robot document."""
    inputs = {n: TwistInput(n, t, p, timeout, first) for n, (p, t, first) in defaults.items()}
    for name, section in stated.items():
        default = inputs.get(name) or TwistInput(name, f"{name}/{topic}", 0, timeout)
        # The schema check has already reported a missing priority.
        inputs[name] = replace(default, **{"priority": 0, **dict(section.items())})
    return inputs


def _check_priorities(
    sources: dict[str, TwistInput], stated: dict[str, Section], report: Report
) -> None:
    """Reports two twist sources with the same priority.

    With equal priorities, the order of the twist sources in the document would decide which twist
    source drives the robot.
    """
    first_names: dict[int, str] = {}
    # Default twist sources are checked first.  An error is then reported at a twist source in the
    # robot file, where the user can correct the error.
    for name in [*(name for name in sources if name not in stated), *stated]:
        priority = sources[name].priority
        first = first_names.setdefault(priority, name)
        if first != name and priority > 0:
            report.add(
                "twist-priority-duplicate",
                f"`{name}` has the priority {priority}, as `{first}` has",
                stated[name].entry("priority").span,
                hint="give each source its own priority",
            )


def _check_lock(
    source: TwistInput, lock: TwistInput, stated: Sequence[Node], report: Report
) -> None:
    """Reports a twist source that is not below a stop lock, or has the priority of another lock.

    ``stated``: priorities of the source and of the lock in the robot document.
    """
    if source.priority < lock.priority or source.priority <= 0 or lock.priority <= 0:
        return
    message = f"`{source.name}` has the priority {source.priority}"
    if lock.is_stop_lock:
        message += (
            f"; the stop lock `{lock.name}` of the priority {lock.priority} would not stop it"
        )
        hint = f"a source has a lower priority than `{lock.name}`: at most {lock.priority - 1}"
    elif source.priority == lock.priority:
        message += f", as the lock `{lock.name}` has"
        hint = f"give the source at most the priority {lock.priority - 1}, if `{lock.name}` shall"
        hint += " stop it"
    else:
        return
    labels = [Label(node.where, "the lock") for node in stated[1:]]
    span = stated[0].span if stated else None
    report.add("twist-priority-lock", message, span, hint=hint, labels=labels)
