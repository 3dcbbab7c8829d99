"""What the base driver goes by: its limits and noise, and the sets of them to switch between."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

from thorvaldc.compiler.geometry.static_loads import contact_point
from thorvaldc.compiler.modules.scope import Scope
from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.source.unit_table import QUANTITIES
from thorvaldc.diagnostics import Report
from thorvaldc.diagnostics.suggest import did_you_mean
from thorvaldc.model.robot import Actuator, DriverSettings, ParameterSet, Wheel
from thorvaldc.model.spatial import clean

MIN_RATE, MAX_RATE = 1.0, 1000.0  # Hz; a shorter cycle than 1 ms is not for a bus
DEFAULT_RATE = 50.0  # Hz, facts of the original: the base driver's `rate`
DEFAULT_TIMEOUT = 0.5  # s, the original's command time-out

LIMITS = {
    "max_linear_velocity": "velocity",
    "max_angular_velocity": "angular_velocity",
    "max_linear_acceleration": "acceleration",
    "max_angular_acceleration": "angular_acceleration",
}
NOISE = {
    "speed_ratio": "ratio",
    "angle": "angle",
    "speed_floor": "velocity",
    "slip_floor": "velocity",
    "skid_ratio": "ratio",
    "gyro": "angular_velocity",
    "correlation": "time",
}


class DriverParameters:
    """Reads ``driver`` and ``parameter_sets`` of a robot document.

    ``tolerance`` is the share by which a stated limit may exceed what the
    modules allow before it is said.
    """

    def __init__(
        self,
        document: Node,
        scope: Scope,
        wheels: Sequence[Wheel],
        actuators: Mapping[str, Actuator],
        tolerance: float,
        report: Report,
    ) -> None:
        self._document = document
        self._scope = scope
        self._wheels = wheels
        self._actuators = actuators
        self._tolerance = tolerance
        self._report = report

    def driver(self) -> DriverSettings:
        """The limits that the modules allow together, lowered by what the file says."""
        node = self._document.get("driver") or Node({}, self._document.span)
        rate = self._scope.quantity(node.get("rate"), "frequency", DEFAULT_RATE)
        timeout = self._scope.quantity(node.get("command_timeout"), "time", DEFAULT_TIMEOUT)
        for key, value in (("rate", rate), ("command_timeout", timeout)):
            if value <= 0:
                self._not_positive(key, value, node.get(key))
        self._check_cycle(rate, timeout, node)
        limits = {
            key: self._limit(node.get(key), key, allowed)
            for key, allowed in self._allowed(None).items()
        }
        return DriverSettings(
            rate=rate if rate > 0 else DEFAULT_RATE,
            command_timeout=timeout,
            noise=self._noise(node.get("noise"), ()),
            **limits,
        )

    def _check_cycle(self, rate: float, timeout: float, node: Node) -> None:
        place = node.get("rate") or node.get("command_timeout") or node
        if rate > 0.0 and not MIN_RATE <= rate <= MAX_RATE:
            self._report.add(
                "driver-cycle",
                f"the rate is {rate:g} Hz; the base driver runs at {MIN_RATE:g} to {MAX_RATE:g} Hz",
                place.span,
            )
        elif rate > 0.0 and 0.0 < timeout < 1.0 / rate:
            self._report.add(
                "driver-cycle",
                f"the command time-out is {timeout:g} s, "
                f"shorter than one cycle of {1.0 / rate:g} s",
                (node.get("command_timeout") or place).span,
                hint="every command would be stale at once",
            )

    def sets(self, driver: DriverSettings) -> tuple[ParameterSet, ...]:
        """The named sets: the robot's own settings with what each changes."""
        node = self._document.get("parameter_sets")
        entries = node.value if node is not None and isinstance(node.value, dict) else {}
        return tuple(self._set(name, entry, driver) for name, entry in entries.items())

    def _set(self, name: str, node: Node, driver: DriverSettings) -> ParameterSet:
        radii = node.get("radii")
        chosen = self._scope.text(radii) if radii is not None else None
        known = list(dict.fromkeys(key for wheel in self._wheels for key, _ in wheel.radii))
        if radii is not None and chosen not in known:
            self._report.add(
                "parameter-set-radii",
                f"no wheel has radii named `{chosen}`",
                radii.span,
                hint=did_you_mean(
                    str(chosen),
                    known,
                    f"there are {', '.join(known)}" if known else "every wheel has one radius",
                ),
            )
        limits = {}
        for key, allowed in self._allowed(chosen).items():
            stated = node.get(key)
            limits[key] = (
                min(getattr(driver, key), _finite(allowed))
                if stated is None
                else self._limit(stated, key, allowed)
            )
        noise = self._noise(node.get("noise"), driver.noise)
        return ParameterSet(name, chosen, replace(driver, noise=noise, **limits), node.where)

    def _allowed(self, radii: str | None) -> dict[str, float]:
        """The limits that the slowest motors set with these radii."""
        speed = turn = math.inf
        acceleration = turn_acceleration = math.inf
        for wheel in self._wheels:
            actuator = self._actuators.get(wheel.spin_joint)
            if actuator is None:
                continue
            radius = wheel.radius_named(radii)
            v = actuator.max_velocity * radius
            a = actuator.max_acceleration * radius
            arm = max(math.hypot(*contact_point(wheel)), 0.05)
            speed, turn = min(speed, v), min(turn, v / arm)
            acceleration, turn_acceleration = min(acceleration, a), min(turn_acceleration, a / arm)
        return dict(zip(LIMITS, (speed, turn, acceleration, turn_acceleration), strict=True))

    def _limit(self, node: Node | None, key: str, allowed: float) -> float:
        stated = self._scope.quantity(node, LIMITS[key], allowed)
        shown = QUANTITIES[LIMITS[key]].shown
        if node is not None and stated <= 0:
            self._not_positive(key, stated, node)
        if node is not None and stated > allowed * (1 + self._tolerance):
            self._report.add(
                "driver-limit-too-high",
                f"`{key}` is {shown(stated)}; the slowest module allows {shown(allowed)}",
                node.span,
                hint="lower it, or leave it out to have what the modules allow",
            )
        return _finite(min(stated, allowed))

    def _noise(
        self, node: Node | None, before: tuple[tuple[str, float], ...]
    ) -> tuple[tuple[str, float], ...]:
        entries = node.value if node is not None and isinstance(node.value, dict) else {}
        found = dict(before)
        for key, entry in entries.items():
            if key not in NOISE:  # the schema has said so
                continue
            value = self._scope.quantity(entry, NOISE[key])
            if value > 0 or (value == 0 and key == "correlation"):
                found[key] = clean(value)
            else:
                self._not_positive(key, value, entry)
        return tuple(found.items())

    def _not_positive(self, key: str, value: float, node: Node | None) -> None:
        self._report.add(
            "size-not-positive",
            f"`{key}` is {value:g}; it must be positive",
            node.span if node is not None else None,
        )


def _finite(value: float) -> float:
    return clean(value) if math.isfinite(value) else 0.0
