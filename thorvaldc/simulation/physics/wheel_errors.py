"""Radius errors and steering offsets of the wheels of a simulated robot.

The model of the robot does not contain the wheel errors, and the driver does not correct the wheel
errors.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from thorvaldc.diagnostics.error import DiagnosticError
from thorvaldc.diagnostics.suggest import did_you_mean
from thorvaldc.model import Robot


@dataclass(frozen=True, slots=True)
class WheelErrors:
    """Errors of the wheels of a simulated robot, in the order of ``Robot.wheels``.

    * ``radius_ratios``: true wheel radius divided by the wheel radius in the model.
    * ``steering_offsets``: true angle of the steering joint minus the angle that the base reports
      (rad).  The simulated base reports the encoder reading plus the encoder offset in the robot
      model.
    """

    radius_ratios: tuple[float, ...]
    steering_offsets: tuple[float, ...]

    @staticmethod
    def none(robot: Robot) -> WheelErrors:
        """Returns radius ratios of 1 and steering offsets of 0 for all wheels."""
        n = len(robot.wheels)
        return WheelErrors((1.0,) * n, (0.0,) * n)

    @staticmethod
    def by_name(
        robot: Robot,
        radius_ratios: Mapping[str, float] | None = None,
        steering_offsets: Mapping[str, float] | None = None,
    ) -> WheelErrors:
        """Returns the wheel errors for radius ratios and steering offsets by wheel name.

        A wheel without a given radius ratio or steering offset has no wheel error.  Raises
        ``DiagnosticError`` (``hidden-error``) if the robot does not have a named wheel, if a wheel
        with a steering offset is not steered, or if a value is out of range.
        """
        ratios, offsets = radius_ratios or {}, steering_offsets or {}
        names = [wheel.name for wheel in robot.wheels]
        for name in (*ratios, *offsets):
            if name not in names:
                hint = did_you_mean(name, names, f"its wheels: {', '.join(names)}")
                raise _error(robot, f"{robot.name} has no wheel `{name}`", hint)
        for name, ratio in ratios.items():
            if not 0.5 <= ratio <= 2.0:
                raise _error(
                    robot,
                    f"the radius ratio of `{name}` is {ratio:g}; it must be 0.5 to 2",
                )
        for wheel in robot.wheels:
            offset = offsets.get(wheel.name)
            if offset is not None and wheel.steering_joint is None:
                raise _error(robot, f"the wheel `{wheel.name}` is not steered; it has no offset")
            if offset is not None and not -1.0 <= offset <= 1.0:
                raise _error(
                    robot,
                    f"the steering offset of `{wheel.name}` is {offset:g} rad; it must be -1 to 1",
                )
        return WheelErrors(
            tuple(ratios.get(name, 1.0) for name in names),
            tuple(offsets.get(name, 0.0) for name in names),
        )


def _error(robot: Robot, message: str, hint: str | None = None) -> DiagnosticError:
    return DiagnosticError("hidden-error", message, robot.span, hint=hint)
