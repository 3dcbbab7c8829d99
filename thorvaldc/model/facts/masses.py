"""Mass of a robot by module."""

from __future__ import annotations

from dataclasses import dataclass

from thorvaldc.model.robot import Robot


@dataclass(frozen=True, slots=True)
class ModuleMass:
    """A module of the robot and the mass of its links in kg. ``module`` is empty for links that
    belong to no module."""

    module: str
    mass: float


def masses_of(robot: Robot) -> tuple[ModuleMass, ...]:
    """Return the mass of each module with links, in the order of the model."""
    masses: dict[str, float] = {}
    for link in robot.links:
        if link.inertial is not None:
            masses[link.module] = masses.get(link.module, 0.0) + link.inertial.mass
    return tuple(ModuleMass(module, mass) for module, mass in masses.items())
