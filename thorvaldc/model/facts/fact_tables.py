"""The facts about a robot as tables of short texts, for all outputs that people read."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, NamedTuple

from thorvaldc.model import SourcedMass
from thorvaldc.model.facts import electrics
from thorvaldc.model.facts.driving import Driving, Slopes
from thorvaldc.model.facts.masses import NO_SOURCE, BillRow, ModuleMass, PurchaseFacts, source_kind
from thorvaldc.model.facts.robot_facts import RobotFacts
from thorvaldc.model.facts.size import Size
from thorvaldc.model.facts.stability import DIRECTIONS, UNEVEN, SoilLoad, Stability, WheelLoad
from thorvaldc.model.statics.slope import StandingSlopes

Row = tuple[str, ...]


@dataclass(frozen=True, slots=True)
class FactTable:
    """A table of facts.

    - ``key``: short name of the table, for links.
    - ``columns``: titles of the columns, or empty for a list of names and values.
    - ``numeric``: numbers of the columns that contain numbers, counted from 0.
    - ``notes``: sentences below the table, such as the assumptions.
    """

    key: str
    title: str
    columns: Row
    rows: tuple[Row, ...]
    numeric: tuple[int, ...] = ()
    notes: tuple[str, ...] = ()


def fact_tables(facts: RobotFacts) -> tuple[FactTable, ...]:
    """Return the facts about a robot as tables. Tables without rows are left out."""
    has_battery = bool(facts.energy.batteries) and not facts.energy.has_common_source
    tables = (
        _size(facts.size),
        _mass(facts),
        _wheels(facts.wheels, facts.soil),
        _stability(facts.stability),
        _driving(facts.driving),
        _energy(facts.energy),
        _slopes(facts.slopes),
        _standing(facts.standing),
        _buses(facts.buses),
        _addresses(facts.buses),
        _wiring(facts.wiring, has_battery),
        _modules(facts.modules),
        _bill(facts.bill),
        _purchase(facts.purchase),
        _sources(facts.bill),
    )
    return tuple(table for table in tables if table.rows)


def overview(facts: RobotFacts) -> FactTable:
    """Return the numbers that are asked for first."""
    size, driving, least = facts.size, facts.driving, facts.stability.least
    turn, uphill, energy = driving.turn, facts.slopes and facts.slopes.forwards, facts.energy.energy
    return _values(
        "overview",
        "",
        [
            ("size", f"{size.length:.2f} x {size.width:.2f} x {size.height:.2f} m"),
            ("mass", _mass_text(facts.mass)),
            ("ground clearance", _length(size.ground_clearance)),
            ("top speed", _speed(driving.forwards)),
            ("turning circle", "does not turn" if turn is None else _length(turn.outer_circle)),
            ("tips over at", "does not stand" if least is None else _angle(least.angle)),
            ("climbs", _angle(uphill.steepest) if uphill else None),
            (f"time at {STATED_USE:.0f} W", None if energy is None else f"{_hours(energy):.1f} h"),
        ],
    )


class _Column(NamedTuple):
    """A column of a table: its title, and a function that returns the text for an item."""

    title: str
    text: Callable[[Any], str]
    numeric: bool = False
    shown: bool = True


def _table(
    key: str, title: str, items: Iterable[Any], columns: Iterable[_Column], *notes: str
) -> FactTable:
    """Return a table with a row for each item, without columns that are not shown and empty
    notes."""
    shown = [column for column in columns if column.shown]
    return FactTable(
        key,
        title,
        tuple(column.title for column in shown),
        tuple(tuple(column.text(item) for column in shown) for item in items),
        tuple(i for i, column in enumerate(shown) if column.numeric),
        tuple(filter(None, notes)),
    )


def _values(key: str, title: str, rows: Iterable[tuple[str, str | None]], *notes: str) -> FactTable:
    """Return a list of names and values, without values that are ``None`` and empty notes."""
    stated = tuple((name, text) for name, text in rows if text is not None)
    return FactTable(key, title, (), stated, notes=tuple(filter(None, notes)))


# -- numbers with their units; `None` or a dash for an unknown number -----------------------------


# -- numbers with their units; `None` or a dash for an unknown number -----------------------------
def _length(value: float | None) -> str | None:
    return None if value is None else f"{value:.3f} m"


def _angle(value: float) -> str:
    return f"{math.degrees(value):.1f} deg"


def _mass_text(value: float) -> str:
    return f"{value:.2f} kg"


def _percent(value: float) -> str:
    return f"{100.0 * value:.0f} %"


def _speed(value: float) -> str:
    return f"{value:.2f} m/s ({3.6 * value:.1f} km/h)"


def _kilograms(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


def _money(amount: float | None, currency: str) -> str:
    return "-" if amount is None else f"{amount:.2f} {currency}"


def _days(time: float | None) -> str:
    return "-" if time is None else f"{time / 86400.0:.4g} d"


def _interval(values: tuple[float, float]) -> str:
    low, high = values
    return f"{low:g}" if low == high else f"{low:g} to {high:g}"


def _direction(direction: float) -> str:
    """Return a direction in words, such as ``30.0 deg left of the front``."""
    for name, angle in DIRECTIONS.items():
        if abs(math.remainder(direction - angle, math.tau)) < math.radians(0.05):
            return name
    side = "left" if direction > 0.0 else "right"
    return f"{abs(math.degrees(direction)):.1f} deg {side} of the front"


def _kinds(sources: Iterable[SourcedMass]) -> str:
    return ", ".join(dict.fromkeys(source_kind(part.source) for part in sources)) or "-"


# -- tables -----------------------------------------------------------------------------------


def _size(size: Size) -> FactTable:
    clearance = _length(size.ground_clearance)
    if clearance is not None and size.lowest_module:
        clearance += f" ({size.lowest_module})"
    count = len(size.meshes_left_out)
    return _values(
        "size",
        "Size",
        [
            ("length", _length(size.length)),
            ("width", _length(size.width)),
            ("height", _length(size.height)),
            ("wheelbase", _length(size.wheelbase)),
            ("track", _length(size.track)),
            ("ground clearance", clearance),
        ],
        f"{count} mesh {'file is' if count == 1 else 'files are'} not part of this model file;"
        " the size leaves them out. The robot file gives the whole size."
        if count
        else "",
    )


def _mass(facts: RobotFacts) -> FactTable:
    x, y, z = facts.center_of_mass
    rows = [
        ("mass", _mass_text(facts.mass)),
        ("centre of mass", f"x {x:.3f} m, y {y:.3f} m, z {z:.3f} m"),
    ]
    rows += [
        (f"  {share.source}", f"{_mass_text(share.mass)} ({_percent(share.share)})")
        for share in facts.mass_sources
    ]
    wired = any(module.mass is None for module in facts.modules)
    note = "Modules that are wired but not mounted are not part of the mass."
    return _values("mass", "Mass", rows, note if wired else "")


def _wheels(wheels: tuple[WheelLoad, ...], soil: SoilLoad | None) -> FactTable:
    undetermined = any(_is_undetermined(wheel) for wheel in wheels)
    loads = pressure = ""
    if soil is not None and soil.pressure is not None:
        pressure = (
            f"Largest nominal ground pressure, load over radius times width:"
            f" {soil.pressure / 1000.0:.1f} kPa."
        )
    if undetermined:
        loads = (
            "`load` is that on a plane, with equal tyres. The balance of forces allows all loads of"
            " the range: a pebble under a wheel is enough to shift them within it. The range of a"
            f" robot on springs is that of ground uneven by {1000.0 * UNEVEN:.0f} mm."
        )
    elif any(wheel.load_range is None for wheel in wheels):
        loads = (
            "The balance of forces may not determine these loads: they are those of equal tyres"
            " under a rigid frame on a plane."
        )
    columns = (
        _Column("wheel", lambda wheel: wheel.name),
        _Column("x [m]", lambda wheel: f"{wheel.x:.3f}", numeric=True),
        _Column("y [m]", lambda wheel: f"{wheel.y:.3f}", numeric=True),
        _Column("r [m]", lambda wheel: f"{wheel.radius:.3f}", numeric=True),
        _Column("load [N]", lambda wheel: f"{wheel.load:.0f}", numeric=True),
        _Column("range [N]", _load_range, shown=undetermined),
        _Column("share", lambda wheel: _percent(wheel.share), numeric=True),
        _Column("kind", _wheel_kind),
    )
    return _table("wheels", "Wheel loads", wheels, columns, pressure, loads)


def _wheel_kind(wheel: WheelLoad) -> str:
    kinds = [kind for kind in ("driven", "steered") if getattr(wheel, kind)]
    return ", ".join(kinds) or "passive"


def _is_undetermined(wheel: WheelLoad) -> bool:
    return wheel.load_range is not None and wheel.load_range[0] < wheel.load_range[1]


def _load_range(wheel: WheelLoad) -> str:
    if wheel.load_range is None or not _is_undetermined(wheel):
        return ""
    low, high = wheel.load_range
    return f"{low:.0f} to {high:.0f}"


def _stability(stability: Stability) -> FactTable:
    title, least = "Tip-over angles", stability.least
    if least is None:
        reason = (
            "the wheels do not span an area"
            if stability.margin is None
            else f"the centre of mass is {-stability.margin:.3f} m outside the area of the wheels"
        )
        return _values("stability", title, [("stands", f"no: {reason}")])
    return _values(
        "stability",
        title,
        [
            *((name, _angle(angle)) for name, angle in stability.angles),
            ("least", f"{_angle(least.angle)} ({_direction(least.direction)})"),
        ],
        "Those of a rigid robot; suspension, tyres and loose loads lower the angles.",
    )


def _driving(driving: Driving) -> FactTable:
    key, title, turn = "driving", "Driving", driving.turn
    if not driving.forwards and turn is None:
        return _values(key, title, [("top speed", "no wheel is driven")])
    sideways = _speed(driving.sideways) if driving.sideways else "does not roll sideways"
    acceleration = f"{driving.acceleration:.2f} m/s^2" if driving.forwards else None
    rows: list[tuple[str, str | None]] = [
        ("forwards", _speed(driving.forwards)),
        ("sideways", sideways),
        ("acceleration", acceleration),
    ]
    if turn is None:
        return _values(key, title, [*rows, ("turning", "does not turn")])
    kind = " (by skidding)" if turn.skids else " (on the spot)" if turn.radius < 1e-6 else ""
    rows += [
        ("turning", f"{math.degrees(turn.yaw_rate):.0f} deg/s ({turn.yaw_rate:.2f} rad/s)"),
        ("turning radius", f"{_length(turn.radius)}{kind}"),
        ("turning circle, wheels", _length(turn.wheel_circle)),
        ("turning circle, body", _length(turn.outer_circle)),
    ]
    note = "The turning radius is that of `base_link`; turning is the rate in this turn."
    return _values(key, title, rows, note)


def _slopes(slopes: Slopes | None) -> FactTable:
    if slopes is None:
        return FactTable("slopes", "Steepest slopes", (), ())

    def limit(field: str) -> Callable[[Any], str]:
        def text(direction: str) -> str:
            angle = getattr(getattr(slopes, direction), field)
            return "over 80 deg" if angle is None else _angle(angle)

        return text

    titles = ("grip", "torque", "tip-over", "steepest", "stops downhill")
    fields = ("grip", "torque", "tip_over", "steepest", "stops")
    columns = [_Column("uphill", lambda direction: str(direction))]
    columns += [
        _Column(title, limit(field), numeric=True)
        for title, field in zip(titles, fields, strict=True)
    ]
    return _table(
        "slopes",
        "Steepest slopes",
        [n for n in ("forwards", "backwards", "left", "right") if getattr(slopes, n) is not None],
        columns,
        f"Straight up at a constant speed, all joints at 0; coefficient of friction"
        f" {_interval(slopes.friction)}, rolling resistance"
        f" {_interval(slopes.rolling_resistance)}, largest torque of the motors.",
        "Stops downhill: up to this slope, a stop while driving straight downhill in this"
        " direction is no longer than the stopping distance of the robot file, or, without"
        " one, than on level ground.",
    )


def _standing(slopes: StandingSlopes | None) -> FactTable:
    rows = []
    if slopes is not None:
        braked = "no brakes" if slopes.braked is None else _angle(slopes.braked)
        rows = [
            ("stands with its motors off up to", _angle(slopes.motors_off)),
            ("with its brakes closed up to", braked),
        ]
    note = "Facing straight uphill or downhill, the smaller one; all joints at 0."
    return _values("standing", "Standing without power", rows, note)


STATED_USE = 500.0
"""Power (W) for which the time and the range are shown, as an example."""


def _hours(energy: float) -> float:
    return energy / STATED_USE / 3600.0


def _energy(energy: electrics.Energy) -> FactTable:
    several = len(energy.batteries) > 1
    rows: list[tuple[str, str | None]] = [] if energy.batteries else [("battery", "none")]
    for battery in energy.batteries:
        source = _source(battery.voltage, battery.capacity, battery.energy) or "not stated"
        rows.append((battery.name, source if battery.present else "empty enclosure"))
    if energy.connection and several:
        both = energy.voltage is not None and energy.capacity is not None
        source = f", {_source(energy.voltage, energy.capacity, None)}" if both else ""
        rows.append(("connection", energy.connection + source))
    if energy.energy is not None:
        rows.append(("energy", _source(None, None, energy.energy)))
    if energy.rolling_force > 0.0:
        per_kilometre = energy.rolling_force * 1000.0 / 3600.0
        rows.append(("rolling resistance", f"{energy.rolling_force:.1f} N on level ground"))
        rows.append(("energy for rolling", f"{per_kilometre:.1f} Wh/km"))
    if energy.energy is not None:
        hours = _hours(energy.energy)
        rows.append((f"at {STATED_USE:.0f} W", f"{hours:.1f} h, {3.6 * hours:.0f} km at 1 m/s"))
    if energy.standby is not None:
        current = energy.standby_current
        shown = f" and {current:.2g} A" if current is not None and several else ""
        rows.append(("standby", f"{energy.standby / 3600.0:.1f} h at {energy.power:g} W{shown}"))
    loss = "Motors, computers and tools use more than rolling does: measure the power of your work."
    bounded = energy.energy is not None and energy.rolling_force > 0.0
    missing = f"Not stated by the modules: {'; '.join(energy.missing)}." if energy.missing else ""
    return _values("energy", "Energy and range", rows, loss if bounded else "", missing)


def _source(voltage: float | None, capacity: float | None, energy: float | None) -> str:
    """Return the stated ones of the voltage (V), the capacity (A s) and the energy (J)."""
    parts = (
        "" if voltage is None else f"{voltage:g} V",
        "" if capacity is None else f"{capacity / 3600.0:g} Ah",
        "" if energy is None else f"{energy / 3600.0:.0f} Wh",
    )
    return ", ".join(filter(None, parts))


def _buses(buses: Iterable[electrics.BusFacts]) -> FactTable:
    columns = (
        _Column("bus", lambda bus: bus.name),
        _Column("kbit/s", lambda bus: f"{bus.bitrate / 1000:g}", numeric=True),
        _Column("cycle [ms]", lambda bus: f"{bus.period * 1000:g}", numeric=True),
        _Column("frames", lambda bus: f"{bus.frames}", numeric=True),
        _Column("load", lambda bus: f"{100 * bus.load:.1f} %", numeric=True),
        _Column("master id", lambda bus: f"{bus.master_id}", numeric=True),
    )
    return _table("buses", "Buses", buses, columns)


def _addresses(buses: tuple[electrics.BusFacts, ...]) -> FactTable:
    addresses = [address for bus in buses for address in bus.addresses]
    serials, chosen = (
        any(getattr(address, field) for address in addresses) for field in ("serial", "automatic")
    )
    columns = (
        _Column("node", lambda node: node.name),
        _Column("bus", lambda node: node.bus, shown=len(buses) != 1),
        _Column("address", lambda n: f"{n.id} (0x{n.id:02X})" if n.id_space else "-"),
        _Column("group", lambda node: node.id_space.replace("_", " ") or "-"),
        _Column("protocol", lambda node: node.protocol),
        _Column("serial", lambda node: node.serial or "", shown=serials),
    )
    note = "The compiler chose the addresses that the robot file leaves out."
    return _table("addresses", "Addresses", addresses, columns, note if chosen else "")


def _wiring(wiring: tuple[electrics.Wire, ...], has_battery: bool) -> FactTable:
    inverted = any(wire.inverted for wire in wiring)
    columns = (
        _Column("bus", lambda wire: wire.bus or "-", shown=len({w.bus for w in wiring}) != 1),
        _Column("controller", lambda wire: wire.node or "not wired"),
        _Column("id", lambda wire: f"{wire.id}" if wire.node else "-", numeric=True),
        _Column("channel", lambda wire: wire.channel or "-"),
        _Column("motor", lambda wire: wire.motor or "free"),
        _Column("gear", lambda w: f"{w.gear_ratio:g}:1" if w.motor else "", numeric=True),
        _Column("ppr", lambda wire: f"{wire.encoder_ppr}" if wire.motor else "", numeric=True),
        _Column("N m", lambda wire: f"{wire.max_torque:g}" if wire.motor else "", numeric=True),
        _Column("inverted", lambda wire: "yes" if wire.inverted else "", shown=inverted),
    )
    note = (
        "An encoder (ppr: pulses per revolution of the motor) is wired to the channel of its motor."
    )
    if has_battery and any(wire.node for wire in wiring):
        note += " The robot file does not say which battery supplies which controller."
    return _table("wiring", "Wiring", wiring, columns, note)


def _modules(modules: Iterable[ModuleMass]) -> FactTable:
    columns = (
        _Column("module", lambda module: module.module or "-"),
        _Column("type", lambda module: module.type or "-"),
        _Column("mass [kg]", lambda module: _kilograms(module.mass), numeric=True),
        _Column("source", lambda module: _kinds(module.sources)),
    )
    return _table("modules", "Mass by module", modules, columns)


def _bill(bill: tuple[BillRow, ...]) -> FactTable:
    columns = (
        _Column("type", lambda row: row.type or "-"),
        _Column("count", lambda row: f"{row.count}", numeric=True),
        _Column("mass [kg]", lambda row: _kilograms(row.mass), numeric=True),
        _Column("total [kg]", lambda r: "-" if r.mass is None else f"{r.total:.2f}", numeric=True),
        _Column("source", lambda row: _kinds(row.sources)),
    )
    several = len({row.type for row in bill}) < len(bill)
    note = "Modules of one type with different parameters can have different masses."
    return _table("bill", "Bill of modules", bill, columns, note if several else "")


def _purchase(purchase: PurchaseFacts) -> FactTable:
    """Return the prices by module type, without rows if no module states any purchase data."""
    columns = ("type", "count", "price", "total", "supplier", "lead time")
    rows: list[Row] = [
        (
            item.type,
            f"{item.count}",
            _money(item.price, item.currency),
            _money(item.total, item.currency),
            item.supplier or "-",
            _days(item.lead_time),
        )
        for item in purchase.items
    ]
    notes = []
    if not any(i.currency or i.supplier or i.lead_time is not None for i in purchase.items):
        rows = []
    else:
        total = _money(purchase.price, purchase.currency)
        count = len([module for item in purchase.items for module in item.modules])
        rows.append(("robot", f"{count}", "", total, "", _days(purchase.lead_time)))
    if purchase.no_price:
        notes.append(f"There is no total: {purchase.no_price}.")
    if purchase.no_lead_time:
        notes.append(f"There is no longest lead time: {purchase.no_lead_time}.")
    return FactTable("purchase", "Purchase", columns, tuple(rows), (1, 2, 3, 5), tuple(notes))


def _sources(bill: Iterable[BillRow]) -> FactTable:
    parts = [(row.type or "-", part) for row in bill for part in row.sources]
    columns = (
        _Column("type", lambda item: str(item[0])),
        _Column("mass [kg]", lambda item: f"{item[1].mass:.2f}", numeric=True),
        _Column("source of the number", lambda item: item[1].source or NO_SOURCE),
    )
    return _table("sources", "Sources of the masses", parts, columns)
