"""What the modules of a robot cost, and how long their delivery takes."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from thorvaldc.model import quantities as si
from thorvaldc.model.float_sum import float_sum
from thorvaldc.model.module import NOT_STATED, Purchase
from thorvaldc.model.robot import Robot
from thorvaldc.model.spatial import clean


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
