"""Mass of a robot by module and by source, and the bill of modules."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from thorvaldc.model import quantities as si
from thorvaldc.model.module import SourcedMass
from thorvaldc.model.once_per_model import once_per_model
from thorvaldc.model.robot import Robot
from thorvaldc.model.spatial import clean

NO_SOURCE = "no source stated"


@dataclass(frozen=True, slots=True)
class MassShare:
    """The part of the robot's mass whose numbers have a source of one kind.

    - ``source``: first word of the source, such as ``datasheet``, ``measured`` or ``estimated``;
      ``NO_SOURCE`` for numbers without a source.
    - ``mass``: mass in kg.
    - ``share``: mass divided by the mass of the robot.
    """

    source: str
    mass: si.Kilograms
    share: si.Number


@dataclass(frozen=True, slots=True)
class ModuleMass:
    """The mass of a module.

    - ``module``: path of the module; empty for links that belong to no module.
    - ``type``: module type, or empty for an extra (a URDF or xacro file).
    - ``mass``: mass of its links in kg, or ``None`` for a module that is not mounted: its mass is
      not part of the robot's mass.
    - ``sources``: mass by source, in the order of the module file.
    """

    module: str
    type: str
    mass: si.Kilograms | None
    sources: tuple[SourcedMass, ...]


@dataclass(frozen=True, slots=True)
class BillRow:
    """Modules of one type and mass.

    - ``type``: module type, or the path of an extra.
    - ``count``: number of modules.
    - ``mass``: mass of one module in kg, or ``None`` for modules that are not mounted.
    - ``total``: mass of all of them in kg.
    - ``sources``: mass of one module by source.
    - ``modules``: paths of the modules.
    """

    type: str
    count: int
    mass: si.Kilograms | None
    total: si.Kilograms
    sources: tuple[SourcedMass, ...]
    modules: tuple[str, ...]


def source_kind(source: str) -> str:
    """Return the kind of a source: its first word, such as ``measured``."""
    return source.partition(":")[0].strip() or NO_SOURCE


@once_per_model
def masses_of(robot: Robot) -> tuple[ModuleMass, ...]:
    """Return the mass of each module in the order of the model, and of each extra after them."""
    masses: dict[str, float] = {}
    files: dict[str, str] = {}
    for link in robot.links:
        if link.inertial is not None:
            masses[link.module] = masses.get(link.module, 0.0) + link.inertial.mass
            files.setdefault(link.module, link.span.file)
    rows = [
        ModuleMass(
            module.name,
            module.type,
            clean(masses.pop(module.name, 0.0)) if module.mounted else None,
            module.masses,
        )
        for module in robot.modules
    ]
    for name, mass in masses.items():
        source = f"file: {files[name]}" if robot.modules else ""
        rows.append(ModuleMass(name, "", clean(mass), (SourcedMass(clean(mass), source),)))
    return tuple(rows)


def mass_by_source(modules: Iterable[ModuleMass]) -> tuple[MassShare, ...]:
    """Return the mass of the robot by kind of source, the largest first."""
    masses: dict[str, float] = {}
    for module in modules:
        for part in module.sources:
            kind = source_kind(part.source)
            masses[kind] = masses.get(kind, 0.0) + part.mass
    total = 0.0
    for mass in masses.values():
        total += mass
    ordered = sorted(masses.items(), key=lambda item: -clean(item[1]))
    return tuple(
        MassShare(kind, clean(mass), clean(mass / total) if total > 0.0 else 0.0)
        for kind, mass in ordered
    )


def bill_of(modules: Iterable[ModuleMass]) -> tuple[BillRow, ...]:
    """Return the bill of modules: modules of the same type and mass in one row."""
    groups: dict[tuple[str, float | None], list[ModuleMass]] = {}
    for module in modules:
        mass = None if module.mass is None else round(module.mass, 6)
        groups.setdefault((module.type or module.module, mass), []).append(module)
    return tuple(
        BillRow(
            type=name,
            count=len(group),
            mass=mass,
            total=clean((mass or 0.0) * len(group)),
            sources=group[0].sources,
            modules=tuple(module.module for module in group),
        )
        for (name, mass), group in groups.items()
    )
