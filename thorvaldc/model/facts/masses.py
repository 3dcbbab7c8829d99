"""Mass of a robot by module and by source, the bill of modules, prices and delivery times."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from thorvaldc.model import Purchase, Robot, SourcedMass
from thorvaldc.model import quantities as si
from thorvaldc.model.result_cache import once_per_model
from thorvaldc.model.robot import NOT_STATED
from thorvaldc.model.spatial import clean
from thorvaldc.model.sums import float_sum

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


# -- what the modules of a robot cost, and how long their delivery takes ------------------------


@dataclass(frozen=True, slots=True)
class PurchaseItem:
    """Modules of one type with the same price, supplier and lead time.

    - ``type``: module type, or the path of an extra (a URDF or xacro file).
    - ``count``: number of modules.
    - ``price``: price of one module in ``currency``, or ``None`` if it is not stated.
    - ``currency``: code of ISO 4217, or empty without a price.
    - ``total``: price of all of them, or ``None``.
    - ``supplier``: name of the supplier, or empty.
    - ``lead_time``: time from order to delivery in s, or ``None`` if it is not stated.
    - ``modules``: paths of the modules.
    """

    type: str
    count: int
    price: si.Money | None
    currency: str
    total: si.Money | None
    supplier: str
    lead_time: si.Seconds | None
    modules: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class PurchaseFacts:
    """Price and lead time of a robot.

    - ``price``: sum of the prices in ``currency``, or ``None`` for the reason ``no_price``.
    - ``currency``: currency of all prices, or empty.
    - ``lead_time``: longest lead time in s, or ``None`` for the reason ``no_lead_time``.
    - ``no_price``, ``no_lead_time``: why there is no price or lead time, or empty.
    - ``without_price``, ``without_lead_time``: types that do not state it.
    - ``items``: the modules by type.
    """

    price: si.Money | None
    currency: str
    lead_time: si.Seconds | None
    no_price: str
    no_lead_time: str
    without_price: tuple[str, ...]
    without_lead_time: tuple[str, ...]
    items: tuple[PurchaseItem, ...]


def purchase_of(robot: Robot) -> PurchaseFacts:
    """Return the price and the lead time of a robot."""
    items = tuple(_items(robot))
    currencies = tuple(dict.fromkeys(item.currency for item in items if item.currency))
    without_price = _types(item for item in items if item.price is None)
    without_lead_time = _types(item for item in items if item.lead_time is None)
    no_price = _reason(items, without_price, "price")
    if not no_price and len(currencies) > 1:
        no_price = f"the prices are in {' and '.join(currencies)}"
    no_lead_time = _reason(items, without_lead_time, "lead time")
    return PurchaseFacts(
        price=None if no_price else clean(float_sum(item.total or 0.0 for item in items)),
        currency=currencies[0] if len(currencies) == 1 else "",
        lead_time=None if no_lead_time else max(item.lead_time or 0.0 for item in items),
        no_price=no_price,
        no_lead_time=no_lead_time,
        without_price=without_price,
        without_lead_time=without_lead_time,
        items=items,
    )


def _items(robot: Robot) -> list[PurchaseItem]:
    groups: dict[tuple[str, Purchase], list[str]] = {}
    for module in robot.modules:
        groups.setdefault((module.type, module.purchase), []).append(module.name)
    known = {module.name for module in robot.modules}
    if robot.modules:
        for link in robot.links:
            if link.module and link.module not in known:
                groups.setdefault((link.module, NOT_STATED), [link.module])
    return [
        PurchaseItem(
            type=name,
            count=len(modules),
            price=purchase.price,
            currency=purchase.currency,
            total=None if purchase.price is None else clean(purchase.price * len(modules)),
            supplier=purchase.supplier,
            lead_time=purchase.lead_time,
            modules=tuple(modules),
        )
        for (name, purchase), modules in groups.items()
    ]


def _types(items: Iterable[PurchaseItem]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(item.type for item in items))


def _reason(items: tuple[PurchaseItem, ...], without: tuple[str, ...], word: str) -> str:
    if not items:
        return f"the model states no {word}"
    if not without:
        return ""
    shown = ", ".join(f"`{name}`" for name in without[:3])
    more = f" and {len(without) - 3} more" if len(without) > 3 else ""
    verb = "has" if len(without) == 1 else "have"
    return f"{shown}{more} {verb} no {word}"
