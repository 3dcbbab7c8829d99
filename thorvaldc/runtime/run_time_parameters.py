"""Parameters that can change while a robot drives: wheel radii, limits and noise.

The robot file bounds every value that a program may set: a program can make the robot slower and
gentler, but neither faster than the robot file allows nor unable to drive.  The decelerations of a
stop cannot be changed at all.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from thorvaldc.diagnostics import DiagnosticError, did_you_mean
from thorvaldc.model import DriverSettings, Robot
from thorvaldc.runtime.base_interface import ParameterError
from thorvaldc.runtime.calculators import Noise
from thorvaldc.runtime.calculators.twist_fit import MAY_BE_ZERO

LIMITS = {
    "max_linear_velocity": "m/s",
    "max_angular_velocity": "rad/s",
    "max_linear_acceleration": "m/s^2",
    "max_angular_acceleration": "rad/s^2",
}
"""Units of the limits."""
COMMAND_TIMEOUT = "command_timeout"
"""Time-out (s) of a commanded twist, which can be shortened like a limit."""
SMALLEST_SHARE = 0.01
"""Smallest limit, as a share of the limit in the robot file."""
RADIUS_RATIO = 1.5
"""Largest ratio of a wheel radius to the radius in the robot file, and the reverse."""
SHORTEST_TIMEOUT = 2.0
"""Shortest command time-out, in control cycles."""
LARGEST = 1e12
"""Largest valid noise in SI units, as in a robot file.

The square of a larger number can be infinite.
"""
_ROUNDING = 1e-9
_NOISE = tuple(field.name for field in dataclasses.fields(Noise))


@dataclass(frozen=True, slots=True)
class Parameters:
    """Parameters of a base driver that can change while the robot drives.

    - ``radii``: wheel radii (m) in the order of ``Robot.wheels``.
    - ``settings``: settings of the base driver, including limits and measurement noise.
    - ``name``: name of the parameter set of the robot file that bounds the values, or ``None`` for
      its ordinary values.
    """

    radii: tuple[float, ...]
    settings: DriverSettings
    name: str | None = None

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
                return Parameters(tuple(radii), parameter_set.driver, name)
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

    def range_of(self, limit: str) -> tuple[float, float]:
        """Returns the least and the greatest value (SI) of a limit that a program may set, if these
        are the parameters of the robot file.

        The stopping distances in the robot file hold for its command time-out, so that a program
        can only shorten it.
        """
        most = float(getattr(self.settings, limit))
        least = SMALLEST_SHARE * most
        if limit == COMMAND_TIMEOUT:
            least = min(SHORTEST_TIMEOUT / self.settings.rate, most)
        return least, most

    def radius_range(self, wheel: int) -> tuple[float, float]:
        """Returns the least and the greatest radius (m) of a wheel that a program may set, if these
        are the parameters of the robot file."""
        return self.radii[wheel] / RADIUS_RATIO, self.radii[wheel] * RADIUS_RATIO

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

        Raises ``ParameterError`` if the name of a parameter is unknown, or if a value is outside of
        the range that the robot file allows.
        """
        file = Parameters.from_robot(robot, self.name)
        wheels = [w.name for w in robot.wheels]
        new_radii = list(self.radii)
        for name, value in (radii or {}).items():
            _check_name("wheel", name, wheels)
            index = wheels.index(name)
            _check_range(f"the radius of {name}", value, "m", *file.radius_range(index))
            new_radii[index] = float(value)
        for name, value in (limits or {}).items():
            _check_name("limit", name, [*LIMITS, COMMAND_TIMEOUT])
            least, most = file.range_of(name)
            _check_range(name, value, LIMITS.get(name, "s"), least, most)
        new_noise = dict(self.settings.noise)
        for name, value in (noise or {}).items():
            _check_name("noise", name, _NOISE)
            if not (name in MAY_BE_ZERO and value == 0):
                _check_range(f"the noise {name}", value, "", 0.0, LARGEST)
            new_noise[name] = float(value)
        changes: dict[str, Any] = {name: float(value) for name, value in (limits or {}).items()}
        settings = replace(self.settings, noise=tuple(new_noise.items()), **changes)
        return Parameters(tuple(new_radii), settings, self.name)


def _check_name(kind: str, name: str, known: list[str] | tuple[str, ...]) -> None:
    if name not in known:
        hint = did_you_mean(name, known, f"known: {', '.join(known)}")
        raise ParameterError(f"there is no {kind} `{name}`; {hint}")


def _check_range(quantity: str, value: float, unit: str, least: float, most: float) -> None:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ParameterError(f"{quantity} is {value!r}; it must be a number")
    unit = f" {unit}".rstrip()
    if not 0.0 < value < math.inf:
        raise ParameterError(f"{quantity} is {value:g}{unit}; it must be positive")
    if value > most * (1.0 + _ROUNDING):
        raise ParameterError(f"{quantity} is {value:g}{unit}; it must be at most {most:g}{unit}")
    if value < least * (1.0 - _ROUNDING):
        raise ParameterError(f"{quantity} is {value:g}{unit}; it must be at least {least:g}{unit}")
