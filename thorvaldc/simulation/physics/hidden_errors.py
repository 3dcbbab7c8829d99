"""How a simulated robot differs from its model, unknown to whoever drives it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from thorvaldc.diagnostics.error import DiagnosticError
from thorvaldc.diagnostics.suggest import did_you_mean
from thorvaldc.model import Robot


@dataclass(frozen=True, slots=True)
class HiddenErrors:
    """Errors of a simulated robot's wheels, in the order of ``Robot.wheels``.

    ``radius_ratios``: the radius that a wheel has over the one in the model.
    ``steering_offsets`` (rad): the steering joint's true position less the one
    that the base tells, which is the encoder's reading with the model's own
    offset added.
    """

    radius_ratios: tuple[float, ...]
    steering_offsets: tuple[float, ...]

    @staticmethod
    def none(robot: Robot) -> HiddenErrors:
        n = len(robot.wheels)
        return HiddenErrors((1.0,) * n, (0.0,) * n)

    @staticmethod
    def of(
        robot: Robot,
        radius_ratios: Mapping[str, float] | None = None,
        steering_offsets: Mapping[str, float] | None = None,
    ) -> HiddenErrors:
        """Errors by the wheels' names; of the others there are none.

        Raises ``DiagnosticError`` (``hidden-error``) for a wheel that the robot does not
        have, or that is not steered, and for values that no wheel has.
        """
        ratios, offsets = radius_ratios or {}, steering_offsets or {}
        names = [wheel.name for wheel in robot.wheels]
        for name in (*ratios, *offsets):
            if name not in names:
                hint = did_you_mean(name, names, f"its wheels: {', '.join(names)}")
                raise _fault(robot, f"{robot.name} has no wheel `{name}`", hint)
        for name, ratio in ratios.items():
            if not 0.5 <= ratio <= 2.0:
                raise _fault(
                    robot,
                    f"the radius ratio of `{name}` is {ratio:g}; it must be 0.5 to 2",
                )
        for wheel in robot.wheels:
            offset = offsets.get(wheel.name)
            if offset is not None and wheel.steering_joint is None:
                raise _fault(robot, f"the wheel `{wheel.name}` is not steered; it has no offset")
            if offset is not None and not -1.0 <= offset <= 1.0:
                raise _fault(
                    robot,
                    f"the steering offset of `{wheel.name}` is {offset:g} rad; it must be -1 to 1",
                )
        return HiddenErrors(
            tuple(ratios.get(name, 1.0) for name in names),
            tuple(offsets.get(name, 0.0) for name in names),
        )


def _fault(robot: Robot, message: str, hint: str | None = None) -> DiagnosticError:
    return DiagnosticError("hidden-error", message, robot.span, hint=hint)
