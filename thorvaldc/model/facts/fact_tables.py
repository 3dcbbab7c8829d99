"""The facts about a robot as tables of short texts, for all outputs that people read."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

from thorvaldc.model import SourcedMass
from thorvaldc.model.facts.driving import Driving, SlopeLimits, Slopes
from thorvaldc.model.facts.electrics import BusFacts, Energy, Wire
from thorvaldc.model.facts.masses import NO_SOURCE, BillRow, ModuleMass, PurchaseFacts, source_kind
from thorvaldc.model.facts.robot_facts import RobotFacts
from thorvaldc.model.facts.size import Size
from thorvaldc.model.facts.stability import DIRECTIONS, SoilLoad, Stability, WheelLoad
from thorvaldc.model.robot import PARALLEL
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
    tables = (
        _size(facts.size),
        _mass(facts),
        _wheels(facts.wheels, facts.soil),
        _stability(facts.stability, facts.center_of_mass[2]),
        _driving(facts.driving),
        _energy(facts.energy),
        _slopes(facts.slopes),
        _standing(facts.standing),
        *_buses(facts.buses),
        _wiring(
            facts.wiring,
            has_battery=bool(facts.energy.batteries) and facts.energy.connection != PARALLEL,
        ),
        _modules(facts.modules),
        _bill(facts.bill),
        _purchase(facts.purchase),
        _sources(facts.bill),
    )
    return tuple(table for table in tables if table.rows)


def _length(value: float) -> str:
    return f"{value:.3f} m"


def _angle(value: float) -> str:
    return f"{math.degrees(value):.1f} deg"


def _mass_text(value: float) -> str:
    return f"{value:.2f} kg"


def _percent(value: float) -> str:
    return f"{100.0 * value:.0f} %"


def _size(size: Size) -> FactTable:
    rows = [
        ("length", _length(size.length)),
        ("width", _length(size.width)),
        ("height", _length(size.height)),
    ]
    if size.wheelbase is not None:
        rows.append(("wheelbase", _length(size.wheelbase)))
    if size.track is not None:
        rows.append(("track", _length(size.track)))
    if size.ground_clearance is not None:
        lowest = f" (`{size.lowest_module}`)" if size.lowest_module else ""
        rows.append(("ground clearance", _length(size.ground_clearance) + lowest))
    notes = []
    if size.meshes_left_out:
        count = len(size.meshes_left_out)
        notes.append(
            f"{count} mesh {'file is' if count == 1 else 'files are'} not part of this model file;"
            " the size leaves them out. The robot file gives the whole size."
        )
    return FactTable("size", "Size", (), tuple(rows), notes=tuple(notes))


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
    notes: tuple[str, ...] = ()
    if any(module.mass is None for module in facts.modules):
        notes = ("Modules that are wired but not mounted are not part of the mass.",)
    return FactTable("mass", "Mass", (), tuple(rows), notes=notes)


def _wheels(wheels: tuple[WheelLoad, ...], soil: SoilLoad | None) -> FactTable:
    rows = tuple(
        (
            wheel.name,
            f"{wheel.x:.3f}",
            f"{wheel.y:.3f}",
            f"{wheel.radius:.3f}",
            f"{wheel.load:.0f}",
            _load_range(wheel),
            _percent(wheel.share),
            ", ".join(
                word
                for word, holds in (("driven", wheel.driven), ("steered", wheel.steered))
                if holds
            )
            or "passive",
        )
        for wheel in wheels
    )
    columns = ("wheel", "x [m]", "y [m]", "r [m]", "load [N]", "range [N]", "share", "kind")
    notes: list[str] = []
    if soil is not None and soil.pressure is not None:
        notes.append(
            f"Largest nominal ground pressure, load over radius times width:"
            f" {soil.pressure / 1000.0:.1f} kPa."
        )
    undetermined = any(_is_undetermined(wheel) for wheel in wheels)
    if undetermined:
        notes.append(
            "The balance of forces does not determine the loads of wheels with a range: a pebble"
            " under one of them is enough to shift them within it. `load` is that of equal tyres"
            " under a rigid frame on a plane."
        )
    elif any(wheel.load_range is None for wheel in wheels):
        notes.append(
            "The balance of forces may not determine these loads: they are those of equal tyres"
            " under a rigid frame on a plane."
        )
    numeric = (1, 2, 3, 4, 6)
    table = FactTable("wheels", "Wheel loads", columns, rows, numeric=numeric, notes=tuple(notes))
    return _without_columns(table, *([] if undetermined else [5]))


def _is_undetermined(wheel: WheelLoad) -> bool:
    return wheel.load_range is not None and wheel.load_range[0] < wheel.load_range[1]


def _load_range(wheel: WheelLoad) -> str:
    if wheel.load_range is None or not _is_undetermined(wheel):
        return ""
    low, high = wheel.load_range
    return f"{low:.0f} to {high:.0f}"


def _stability(stability: Stability, height: float) -> FactTable:
    rows: list[Row]
    if stability.least is None:
        reason = (
            "the wheels do not span an area"
            if stability.margin is None
            else f"the centre of mass is {-stability.margin:.3f} m outside the area of the wheels"
        )
        rows = [("stands", f"no: {reason}")]
        return FactTable("stability", "Tip-over angles", (), tuple(rows))
    rows = [(name, _angle(angle)) for name, angle in stability.angles]
    least = stability.least
    rows.append(("least", f"{_angle(least.angle)} ({_direction(least.direction)})"))
    return FactTable(
        "stability",
        "Tip-over angles",
        (),
        tuple(rows),
        notes=(
            f"Rigid robot with the centre of mass {height:.3f} m above the ground; suspension, "
            "tyres and loose loads lower the angles.",
        ),
    )


def _direction(direction: float) -> str:
    """Return a direction in words, such as ``30.0 deg left of the front``."""
    for name, angle in DIRECTIONS.items():
        if abs(math.remainder(direction - angle, math.tau)) < math.radians(0.05):
            return name
    side = "left" if direction > 0.0 else "right"
    return f"{abs(math.degrees(direction)):.1f} deg {side} of the front"


def _driving(driving: Driving) -> FactTable:
    if not driving.forwards and driving.turn is None:
        return FactTable("driving", "Driving", (), (("top speed", "no wheel is driven"),))
    rows: list[Row] = [("forwards", _speed(driving.forwards))]
    rows.append(
        ("sideways", _speed(driving.sideways) if driving.sideways else "does not roll sideways")
    )
    if driving.forwards:
        rows.append(("acceleration", f"{driving.acceleration:.2f} m/s^2"))
    turn = driving.turn
    if turn is None:
        rows.append(("turning", "does not turn"))
        return FactTable("driving", "Driving", (), tuple(rows))
    rate = f"{math.degrees(turn.yaw_rate):.0f} deg/s ({turn.yaw_rate:.2f} rad/s)"
    kind = "by skidding" if turn.skids else "on the spot" if turn.radius < 1e-6 else ""
    radius = f"{_length(turn.radius)}{f' ({kind})' if kind else ''}"
    rows += [
        ("turning", rate),
        ("turning radius", radius),
        ("turning circle, wheels", _length(turn.wheel_circle)),
        ("turning circle, body", _length(turn.outer_circle)),
    ]
    return FactTable(
        "driving",
        "Driving",
        (),
        tuple(rows),
        notes=("The turning radius is that of `base_link`; turning is the rate in this turn.",),
    )


def _speed(value: float) -> str:
    return f"{value:.2f} m/s ({3.6 * value:.1f} km/h)"


def _slopes(slopes: Slopes | None) -> FactTable:
    title = "Steepest slopes"
    columns = ("uphill", "grip", "torque", "tip-over", "steepest", "stops downhill")
    if slopes is None:
        return FactTable("slopes", title, columns, ())
    rows = tuple(
        (name, *_slope_cells(limits))
        for name, limits in (("forwards", slopes.forwards), ("backwards", slopes.backwards))
    )
    friction, rolling = slopes.friction, slopes.rolling_resistance
    return FactTable(
        "slopes",
        title,
        columns,
        rows,
        numeric=(1, 2, 3, 4, 5),
        notes=(
            f"Straight up at a constant speed, all joints at 0; coefficient of friction"
            f" {_interval(friction)}, rolling resistance {_interval(rolling)}, largest torque of"
            " the motors.",
            "Stops downhill: up to this slope, a stop while driving straight downhill in this"
            " direction is no longer than the stopping distance of the robot file, or, without"
            " one, than on level ground.",
        ),
    )


def _standing(slopes: StandingSlopes | None) -> FactTable:
    rows: list[Row] = []
    if slopes is not None:
        rows.append(("stands with its motors off up to", _angle(slopes.motors_off)))
        braked = "no brakes" if slopes.braked is None else _angle(slopes.braked)
        rows.append(("with its brakes closed up to", braked))
    return FactTable(
        "standing",
        "Standing without power",
        (),
        tuple(rows),
        notes=("Facing straight uphill or downhill, the smaller one; all joints at 0.",),
    )


def _slope_cells(limits: SlopeLimits) -> Iterator[str]:
    for angle in (limits.grip, limits.torque):
        yield "over 80 deg" if angle is None else _angle(angle)
    yield _angle(limits.tip_over)
    yield _angle(limits.steepest)
    yield _angle(limits.stops)


def _interval(values: tuple[float, float]) -> str:
    low, high = values
    return f"{low:g}" if low == high else f"{low:g} to {high:g}"


def _energy(energy: Energy) -> FactTable:
    rows: list[Row] = [] if energy.batteries else [("battery", "none")]
    for battery in energy.batteries:
        if not battery.present:
            rows.append((battery.name, "empty enclosure"))
            continue
        parts = []
        if battery.voltage is not None:
            parts.append(f"{battery.voltage:g} V")
        if battery.capacity is not None:
            parts.append(f"{battery.capacity / 3600.0:g} Ah")
        if battery.energy is not None:
            parts.append(f"{battery.energy / 3600.0:.0f} Wh")
        rows.append((battery.name, ", ".join(parts) or "not stated"))
    if energy.connection and len(energy.batteries) > 1:
        source = [energy.connection]
        if energy.voltage is not None and energy.capacity is not None:
            source.append(f"{energy.voltage:g} V, {energy.capacity / 3600.0:g} Ah")
        rows.append(("connection", ", ".join(source)))
    if energy.energy is not None:
        rows.append(("energy", f"{energy.energy / 3600.0:.0f} Wh"))
    if energy.rolling_force > 0.0:
        rows.append(("rolling resistance", f"{energy.rolling_force:.1f} N on level ground"))
    if energy.range_bound is not None:
        rows.append(("range", f"less than {energy.range_bound / 1000.0:.0f} km"))
    if energy.standby is not None:
        current = energy.standby_current
        shown = f" and {current:.2g} A" if current is not None and len(energy.batteries) > 1 else ""
        rows.append(("standby", f"{energy.standby / 3600.0:.1f} h at {energy.power:g} W{shown}"))
    notes = []
    if energy.range_bound is not None:
        notes.append(
            "The bound of the range is the energy over the rolling resistance, without any loss."
        )
    if energy.missing:
        notes.append(f"Not stated by the modules: {'; '.join(energy.missing)}.")
    return FactTable("energy", "Energy and range", (), tuple(rows), notes=tuple(notes))


def _buses(buses: Iterable[BusFacts]) -> Iterator[FactTable]:
    buses = tuple(buses)
    rows = tuple(
        (
            bus.name,
            f"{bus.bitrate / 1000:g}",
            f"{bus.period * 1000:g}",
            f"{bus.frames}",
            f"{100 * bus.load:.1f} %",
            f"{bus.master_id}",
        )
        for bus in buses
    )
    columns = ("bus", "kbit/s", "cycle [ms]", "frames", "load", "master id")
    yield FactTable("buses", "Buses", columns, rows, numeric=(1, 2, 3, 4, 5))
    addresses = [address for bus in buses for address in bus.addresses]
    yield _without_columns(
        FactTable(
            "addresses",
            "Addresses",
            ("node", "bus", "address", "group", "protocol", "serial"),
            tuple(
                (
                    address.name,
                    address.bus,
                    f"{address.id} (0x{address.id:02X})" if address.id_space else "-",
                    address.id_space.replace("_", " ") or "-",
                    address.protocol,
                    address.serial or "",
                )
                for address in addresses
            ),
            notes=("The compiler chose the addresses that the robot file leaves out.",)
            * any(address.automatic for address in addresses),
        ),
        *([1] if len(buses) == 1 else []),
        *([] if any(address.serial for address in addresses) else [5]),
    )


def _wiring(wiring: tuple[Wire, ...], *, has_battery: bool) -> FactTable:
    rows = tuple(
        (
            wire.bus or "-",
            wire.node or "not wired",
            f"{wire.id}" if wire.node else "-",
            wire.channel or "-",
            wire.motor or "free",
            f"{wire.gear_ratio:g}:1" if wire.motor else "",
            f"{wire.encoder_ppr}" if wire.motor else "",
            f"{wire.max_torque:g}" if wire.motor else "",
        )
        for wire in wiring
    )
    table = FactTable(
        "wiring",
        "Wiring",
        ("bus", "controller", "id", "channel", "motor", "gear", "ppr", "N m"),
        rows,
        numeric=(2, 5, 6, 7),
        notes=(
            "An encoder (ppr: pulses per revolution of the motor) is wired to the channel of its"
            " motor."
            + " The robot file does not say which battery supplies which controller."
            * (has_battery and any(wire.node for wire in wiring)),
        ),
    )
    return _without_columns(table, *([0] if len({wire.bus for wire in wiring}) == 1 else []))


def _without_columns(table: FactTable, *left_out: int) -> FactTable:
    kept = [i for i in range(len(table.columns)) if i not in left_out]
    return replace(
        table,
        columns=tuple(table.columns[i] for i in kept),
        rows=tuple(tuple(row[i] for i in kept) for row in table.rows),
        numeric=tuple(new for new, old in enumerate(kept) if old in table.numeric),
    )


def _modules(modules: Iterable[ModuleMass]) -> FactTable:
    rows = tuple(
        (
            module.module or "-",
            module.type or "-",
            "-" if module.mass is None else f"{module.mass:.2f}",
            _kinds(module.sources),
        )
        for module in modules
    )
    columns = ("module", "type", "mass [kg]", "source")
    return FactTable("modules", "Mass by module", columns, rows, numeric=(2,))


def _bill(bill: Iterable[BillRow]) -> FactTable:
    rows = tuple(
        (
            row.type or "-",
            f"{row.count}",
            "-" if row.mass is None else f"{row.mass:.2f}",
            "-" if row.mass is None else f"{row.total:.2f}",
            _kinds(row.sources),
        )
        for row in bill
    )
    columns = ("type", "count", "mass [kg]", "total [kg]", "source")
    types = [row[0] for row in rows]
    notes = ("Modules of one type with different parameters can have different masses.",) * (
        len(set(types)) < len(types)
    )
    return FactTable("bill", "Bill of modules", columns, rows, numeric=(1, 2, 3), notes=notes)


def _purchase(purchase: PurchaseFacts) -> FactTable:
    """Return the prices by module type, without rows if no module states any purchase data."""
    columns = ("type", "count", "price", "total", "supplier", "lead time")
    title = "Purchase"
    stated = (
        item.currency or item.supplier or item.lead_time is not None for item in purchase.items
    )
    if not any(stated):
        return FactTable("purchase", title, columns, ())
    rows = [
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
    total = _money(purchase.price, purchase.currency)
    count = len([module for item in purchase.items for module in item.modules])
    rows.append(("robot", f"{count}", "", total, "", _days(purchase.lead_time)))
    notes = []
    if purchase.no_price:
        notes.append(f"There is no total: {purchase.no_price}.")
    if purchase.no_lead_time:
        notes.append(f"There is no longest lead time: {purchase.no_lead_time}.")
    return FactTable(
        "purchase", title, columns, tuple(rows), numeric=(1, 2, 3, 5), notes=tuple(notes)
    )


def _money(amount: float | None, currency: str) -> str:
    return "-" if amount is None else f"{amount:.2f} {currency}"


def _days(time: float | None) -> str:
    return "-" if time is None else f"{time / 86400.0:.4g} d"


def _kinds(sources: Iterable[SourcedMass]) -> str:
    return ", ".join(dict.fromkeys(source_kind(part.source) for part in sources)) or "-"


def _sources(bill: Iterable[BillRow]) -> FactTable:
    rows = tuple(
        (row.type or "-", f"{part.mass:.2f}", part.source or NO_SOURCE)
        for row in bill
        for part in row.sources
    )
    columns = ("type", "mass [kg]", "source of the number")
    return FactTable("sources", "Sources of the masses", columns, rows, numeric=(1,))
