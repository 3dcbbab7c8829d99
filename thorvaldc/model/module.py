"""The modules of a robot: which types of the module library it consists of."""

from __future__ import annotations

from dataclasses import dataclass

from thorvaldc.diagnostics import Span
from thorvaldc.model import quantities as si
from thorvaldc.model.element import Element


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class SourcedMass(Element):
    """The mass of all parts of a module whose numbers have the same source.

    - ``mass``: mass in kg.
    - ``source``: source of the numbers as in the module file, such as ``datasheet: VLP-16``, or
      empty if the module file states no source.
    """

    mass: si.Kilograms
    source: str


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Purchase(Element):
    """What a module costs and how long its delivery takes, as far as the files state it.

    - ``price``: price of one module in ``currency``, or ``None``.
    - ``currency``: code of ISO 4217, such as ``EUR``; empty without a price.
    - ``supplier``: name of the supplier, or empty.
    - ``lead_time``: time from order to delivery in s, or ``None``.
    """

    price: si.Money | None
    currency: str
    supplier: str
    lead_time: si.Seconds | None


NOT_STATED = Purchase(None, "", "", None)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Module(Element):
    """A module of the robot: one use of a module type that is not an assembly.

    - ``name``: path of the module, such as ``fl.steering``.
    - ``type``: name of the module type, such as ``steering/standard``.
    - ``parent``: path of the module that carries it, or empty for the root module and for a module
      that is not mounted.
    - ``mounted``: true if the module is a body of the robot. A module that is only wired, such as a
      motor controller without a mount, has no links and no mass.
    - ``masses``: mass by source, in the order of the module file.
    - ``purchase``: price, supplier and lead time.
    """

    name: str
    type: str
    parent: str
    mounted: bool
    masses: tuple[SourcedMass, ...]
    span: Span
    purchase: Purchase = NOT_STATED
