"""The check that a robot has a CAN bus."""

from __future__ import annotations

from thorvaldc.diagnostics.error import DiagnosticError
from thorvaldc.model.robot import Robot


def require_bus(robot: Robot) -> None:
    """Raise ``DiagnosticError`` (``bus-missing``) if the robot has no CAN bus."""
    if not robot.buses:
        raise DiagnosticError(
            "bus-missing",
            f"{robot.name} has no devices, and so no bus",
            robot.span,
            hint="give its motors controllers; the assembly `assembly/steered_drive` contains one",
        )
