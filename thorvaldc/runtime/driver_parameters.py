"""What can be changed while a robot drives: wheel radii, limits, noise."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

from thorvaldc.diagnostics.error import DiagnosticError
from thorvaldc.diagnostics.suggest import did_you_mean
from thorvaldc.model import DriverSettings, Robot
from thorvaldc.runtime.calculators import Noise
from thorvaldc.runtime.errors import ParameterError

LIMITS = (
    "max_linear_velocity",
    "max_angular_velocity",
    "max_linear_acceleration",
    "max_angular_acceleration",
)
LARGEST_RADIUS = 5.0
"""Radius (m) beyond which one was meant in another unit."""
_NOISE = tuple(field.name for field in dataclasses.fields(Noise))


@dataclass(frozen=True, slots=True)
class Parameters:
    """Radii (m) in the order of ``Robot.wheels``, and settings with limits and noise."""

    radii: tuple[float, ...]
    settings: DriverSettings

    @staticmethod
    def from_robot(robot: Robot, name: str | None = None) -> Parameters:
        """A set that the robot's file names; its ordinary values for ``None``.

        Raises ``DiagnosticError`` (``parameter-set-unknown``).
        """
        if name is None:
            return Parameters(tuple(w.radius for w in robot.wheels), robot.driver)
        for found in robot.parameter_sets:
            if found.name == name:
                radii = (w.radius_named(found.radii) for w in robot.wheels)
                return Parameters(tuple(radii), found.driver)
        known = [found.name for found in robot.parameter_sets]
        raise DiagnosticError(
            "parameter-set-unknown",
            f"{robot.name} has no parameter set `{name}`",
            robot.span,
            hint=did_you_mean(
                name, known, f"it has {', '.join(known)}" if known else "its file names none"
            ),
        )

    @property
    def noise(self) -> Noise:
        return Noise(**dict(self.settings.noise))

    def changed(
        self,
        robot: Robot,
        radii: Mapping[str, float] | None = None,
        noise: Mapping[str, float] | None = None,
        limits: Mapping[str, float] | None = None,
    ) -> Parameters:
        """These with some changed: radii (m) by wheel, noise and limits by name, in SI.

        Raises ``ParameterError`` where a name is not known or a value cannot be.
        """
        wheels = [w.name for w in robot.wheels]
        own = list(self.radii)
        for name, value in (radii or {}).items():
            _known("wheel", name, wheels)
            _positive(f"the radius of {name}", value, "m", LARGEST_RADIUS)
            own[wheels.index(name)] = float(value)
        for name, value in (limits or {}).items():
            _known("limit", name, LIMITS)
            _positive(name, value, "m/s" if "linear" in name else "rad/s", math.inf)
        errors = dict(self.settings.noise)
        for name, value in (noise or {}).items():
            _known("noise", name, _NOISE)
            if not (name == "correlation" and value == 0):
                _positive(f"the noise {name}", value, "", math.inf)
            errors[name] = float(value)
        settings = replace(
            self.settings,
            noise=tuple(errors.items()),
            **{name: float(value) for name, value in (limits or {}).items()},
        )
        return Parameters(tuple(own), settings)


def _known(what: str, name: str, known: list[str] | tuple[str, ...]) -> None:
    if name not in known:
        hint = did_you_mean(name, known, f"known: {', '.join(known)}")
        raise ParameterError(f"there is no {what} `{name}`; {hint}")


def _positive(what: str, value: float, unit: str, most: float) -> None:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ParameterError(f"{what} is {value!r}; it must be a number")
    if not 0.0 < value < math.inf:
        raise ParameterError(f"{what} is {value:g} {unit}".rstrip() + "; it must be positive")
    if value > most:
        raise ParameterError(f"{what} is {value:g} {unit}; it must be at most {most:g} {unit}")
