"""Parameters that can change while a robot drives: wheel radii, limits and noise."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from thorvaldc.diagnostics.error import DiagnosticError
from thorvaldc.diagnostics.suggest import did_you_mean
from thorvaldc.model import DriverSettings, Robot
from thorvaldc.runtime.calculators import Noise
from thorvaldc.runtime.calculators.twist_fit import MAY_BE_ZERO
from thorvaldc.runtime.errors import ParameterError

LIMITS = {
    "max_linear_velocity": "m/s",
    "max_angular_velocity": "rad/s",
    "max_linear_acceleration": "m/s^2",
    "max_angular_acceleration": "rad/s^2",
}
"""Units of the limits."""
COMMAND_TIMEOUT = "command_timeout"
"""Time-out (s) of a commanded twist, which can be shortened like a limit.

The stopping distances in the robot file hold for the time-out of the file, so it cannot be
lengthened.
"""
LARGEST_RADIUS = 5.0
"""Largest valid wheel radius (m).

A larger radius is probably given in another unit, such as mm.
"""
LARGEST = 1e12
"""Largest valid limit or noise in SI units, as in a robot file.

The square of a larger number can be infinite.
"""
_NOISE = tuple(field.name for field in dataclasses.fields(Noise))


@dataclass(frozen=True, slots=True)
class Parameters:
    """Parameters of a base driver that can change while the robot drives.

    - ``radii``: wheel radii (m) in the order of ``Robot.wheels``.
    - ``settings``: settings of the base driver, including limits and measurement noise.
    """

    radii: tuple[float, ...]
    settings: DriverSettings

    @staticmethod
    def from_robot(robot: Robot, name: str | None = None) -> Parameters:
        """Returns a parameter set of the robot file.

        The name ``None`` selects the ordinary parameters of the robot file.

        Raises ``DiagnosticError`` (``parameter-set-unknown``) if the robot file has no such set.
        """
        if name is None:
            return Parameters(tuple(w.radius for w in robot.wheels), robot.driver)
        for parameter_set in robot.parameter_sets:
            if parameter_set.name == name:
                radii = (w.radius_named(parameter_set.radii) for w in robot.wheels)
                return Parameters(tuple(radii), parameter_set.driver)
        known = [parameter_set.name for parameter_set in robot.parameter_sets]
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
        """Returns a copy of the parameters with changed values.

        - ``radii``: wheel radii (m) by wheel name.
        - ``noise``: standard deviations of the measurement errors by name, see ``Noise``.
        - ``limits``: limits in SI units by name.

        Raises ``ParameterError`` if the name or the value of a parameter is invalid.
        """
        wheels = [w.name for w in robot.wheels]
        new_radii = list(self.radii)
        for name, value in (radii or {}).items():
            _check_name("wheel", name, wheels)
            _check_positive(f"the radius of {name}", value, "m", LARGEST_RADIUS)
            new_radii[wheels.index(name)] = float(value)
        for name, value in (limits or {}).items():
            if name == COMMAND_TIMEOUT:
                _check_positive(name, value, "s", robot.driver.command_timeout)
                continue
            _check_name("limit", name, list(LIMITS))
            _check_positive(name, value, LIMITS[name], LARGEST)
        new_noise = dict(self.settings.noise)
        for name, value in (noise or {}).items():
            _check_name("noise", name, _NOISE)
            if not (name in MAY_BE_ZERO and value == 0):
                _check_positive(f"the noise {name}", value, "", LARGEST)
            new_noise[name] = float(value)
        changes: dict[str, Any] = {name: float(value) for name, value in (limits or {}).items()}
        settings = replace(self.settings, noise=tuple(new_noise.items()), **changes)
        return Parameters(tuple(new_radii), settings)


def _check_name(kind: str, name: str, known: list[str] | tuple[str, ...]) -> None:
    if name not in known:
        hint = did_you_mean(name, known, f"known: {', '.join(known)}")
        raise ParameterError(f"there is no {kind} `{name}`; {hint}")


def _check_positive(quantity: str, value: float, unit: str, maximum: float) -> None:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ParameterError(f"{quantity} is {value!r}; it must be a number")
    if not 0.0 < value < math.inf:
        raise ParameterError(f"{quantity} is {value:g} {unit}".rstrip() + "; it must be positive")
    if value > maximum:
        unit = f" {unit}".rstrip()
        raise ParameterError(f"{quantity} is {value:g}{unit}; it must be at most {maximum:g}{unit}")
