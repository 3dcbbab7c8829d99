"""The CAN bus of a robot that the option ``--bus`` selects."""

from __future__ import annotations

import typer

from thorvaldc.model import Bus, Robot


def select_bus(robot: Robot, spec: str) -> tuple[Bus, str]:
    """Returns the CAN bus of the robot and the CAN interface that the option ``--bus`` selects.

    For a robot with several CAN buses, ``--bus`` must name the bus and its interface, as in
    ``left=socketcan:can0``. For a robot with one CAN bus, ``--bus`` needs only the CAN interface.
    Raises ``DiagnosticError`` for a robot without a CAN bus. Raises ``typer.BadParameter`` if
    ``--bus`` does not name a CAN bus of the robot.
    """
    robot.require_bus()
    buses = {bus.name: bus for bus in robot.buses}
    name, equals, interface = spec.partition("=")
    if equals and name in buses:
        return buses[name], interface
    if len(buses) == 1:
        return robot.buses[0], spec
    example = (interface if equals else spec) or "socketcan:can0"
    problem = f"the robot has no bus {name}, but" if equals else "the robot has the buses"
    raise typer.BadParameter(
        f"{problem} {', '.join(buses)}; select one: {robot.buses[0].name}={example}",
        param_hint="'--bus'",
    )
