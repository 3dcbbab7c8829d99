"""Creates the definitions of the CAN frames of a device.

The section `can` of a module document lists the CAN frames of the module.  The CANopen services of
a device add further CAN frames, such as heartbeats.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

from thorvaldc.can.canopen import EMCY, HEARTBEAT, SDO_REQUEST, SDO_RESPONSE, NmtState
from thorvaldc.compiler.bus.device_sections import Device, Wire, integer, listed
from thorvaldc.compiler.bus.frame_checks import (
    check_channels,
    check_layout,
    check_scales,
    physical_range,
)
from thorvaldc.compiler.modules.module_parameters import Scope
from thorvaldc.compiler.source import dimensions
from thorvaldc.compiler.source.node import Node, insertion
from thorvaldc.compiler.source.unit_table import QUANTITIES, Dimension
from thorvaldc.compiler.source.units import UnitError, parse_unit
from thorvaldc.compiler.values.document_section import Section
from thorvaldc.compiler.values.value_reader import entries, items
from thorvaldc.diagnostics import Label, Proposal, Report, Span, did_you_mean
from thorvaldc.model import FrameDefinition, Signal
from thorvaldc.model.bus import MASTER, OBJECT_TYPES
from thorvaldc.schema import inlined

HEARTBEAT_PERIOD = 0.1  # default heartbeat period of a device in s
LAST_PDO = 512
LAST_EXTENDED = (1 << 29) - 1
_DIRECTED = tuple(
    QUANTITIES[kind].dimensions[0]
    for kind in ("angle", "angular_velocity", "angular_acceleration", "torque")
)
NMT_STATES = tuple((state.value, state.text.replace("-", "_")) for state in NmtState)


def channel_names(device: Device) -> dict[str, dict[str, float | int]]:
    """Returns the motor parameters for expressions in the section `can`, by channel.

    Motor speeds are in rad/s, motor accelerations in rad/s^2 and joint limits in rad.  The limits
    are those that the motor controller compares with its own positions, see ``_inverted``.
    """
    names: dict[str, dict[str, float | int]] = {}
    for wire in device.wires:
        lower = -math.pi if wire.lower is None else wire.lower
        upper = math.pi if wire.upper is None else wire.upper
        inverted = wire.actuator.inverted
        names[wire.channel] = {
            "gear_ratio": wire.actuator.gear_ratio,
            "encoder_ppr": wire.actuator.encoder_ppr,
            "motor_max_speed": wire.actuator.motor_max_speed,
            "max_velocity": wire.actuator.max_velocity,
            "max_acceleration": wire.actuator.max_acceleration,
            "lower": 0.0 - upper if inverted else lower,
            "upper": 0.0 - lower if inverted else upper,
        }
    return names


CHANNEL_DIMENSIONS = {
    "gear_ratio": dimensions.EXPECTED["ratio"],
    "encoder_ppr": dimensions.EXPECTED["number"],
    "motor_max_speed": dimensions.EXPECTED["angular_velocity"],
    "max_velocity": dimensions.EXPECTED["angular_velocity"],
    "max_acceleration": dimensions.EXPECTED["angular_acceleration"],
    "lower": dimensions.EXPECTED["angle"],
    "upper": dimensions.EXPECTED["angle"],
}
"""Dimensions of the values of ``channel_names``."""


def frames_of(
    device: Device, node_id: int, sync_period: float, report: Report
) -> Iterator[FrameDefinition]:
    """Yields the definitions of the CAN frames of a device.

    - ``node_id``: node id of the device.
    - ``sync_period``: control cycle in s.

    Reports an error for each invalid CAN frame, and leaves the CAN frame out of the result.
    """
    scope, name = device.scope, device.name
    can_schema = inlined("module")["properties"]["can"]
    schema = can_schema["properties"]["frames"]["additionalProperties"]
    for key, node in entries(device.can.get("frames")).items():
        labels = [Label(device.span, "this device has it")]
        known = identifier(f"`{key}` of `{device.path}`", node, scope, labels)
        if known is None:
            continue
        length = integer(scope, node.get("length"), 8)
        period = _period(device, node, sync_period, report)
        signals = tuple(_signals(device, node))
        check_channels(device, node, report)
        fits = check_layout(node, length, signals, report)
        kept = tuple(signal for signal, channel in signals if _is_wired(device, channel))
        sends = scope.text(node.get("direction"), "report") == "command"
        if sends and signals and not kept:
            # The robot has no motor on the channels of the CAN frame, so the CAN frame has no
            # content.
            period = None
        deadline = node.get("deadline")
        number, mapping = _pdo(device, node, length, report)
        if number is not None and (known[1] or any(s.big_endian for s, _ in signals)):
            report.add(
                "can-pdo-mapping",
                f"the frame `{key}` is a PDO of CANopen, which is a standard frame with "
                "little-endian signals",
                node.span,
                hint="remove `extended` and `big_endian`; or `pdo` and `mapping`, if the device "
                "does not speak CANopen",
            )
        synchronous = scope.boolean(node.get("synchronous"), False)
        if synchronous and (node.get("period") or node).value != "cycle":
            report.add(
                "can-period",
                f"the frame `{key}` is synchronous, so its period must be the control cycle",
                (node.get("period") or node.get("synchronous") or node).span,
                hint=Proposal("write `period: cycle`", "cycle")
                if node.get("period") is not None
                else insertion("add `period: cycle`", node, "period", "cycle", is_example=False),
            )
        if number is not None and not sends and not synchronous and period == sync_period:
            period = _by_timer(sync_period)
        if fits:
            check_scales(device, node, signals, report)
            yield FrameDefinition(
                f"{name}_{key}",
                known[0],
                scope.text(node.get("kind"), "pdo"),
                MASTER if sends else name,
                (name,) if sends else (MASTER,),
                length,
                period,
                period if deadline is None else _time(device, deadline, report),
                kept,
                node.where,
                scope.text(node.get("description")),
                minimum_interval(Section(node, schema, scope)) if period is None else None,
                pdo=number,
                mapping=mapping,
                synchronous=synchronous,
                extended=known[1],
            )
    stated = device.can.get("heartbeat_period")
    heartbeat_period = HEARTBEAT_PERIOD if stated is None else _time(device, stated, report)
    services = device.can.get("canopen")
    yield from standard_frames(name, node_id, services, heartbeat_period or HEARTBEAT_PERIOD)


def _by_timer(cycle: float) -> float:
    """Rounds the period (s) of a CAN frame down to whole milliseconds.

    The event timer of a CANopen PDO has a resolution of 1 ms.  The period is rounded down so that a
    CAN frame arrives in each control cycle.
    """
    return max(math.floor(cycle * 1000 + 1e-6), 1) / 1000


def minimum_interval(frame: Section) -> float | None:
    """Returns the minimum time (s) between two CAN frames with the same identifier.

    Returns ``None`` if the document sets no `rate` for the CAN frame.
    """
    rate: float | None = frame["rate"]
    return None if rate is None else 1.0 / rate


def standard_frames(
    name: str, node_id: int, services: Node | None, heartbeat_period: float
) -> Iterator[FrameDefinition]:
    """Yields the CAN frames of the CANopen services of a device.

    The COB-IDs of CANopen services follow the predefined connection set of CiA 301.

    - ``name``: name of the device.
    - ``services``: list with the names of the services in the document.
    - ``heartbeat_period``: period of the heartbeat in s.
    """
    if services is None:
        return
    here = services.where
    for item in items(services):
        if item.value == "emcy":
            yield FrameDefinition(
                f"{name}_emcy",
                EMCY + node_id,
                "emcy",
                name,
                (MASTER,),
                8,
                None,
                None,
                (
                    Signal("error_code", 0, 16),
                    Signal("error_register", 16, 8),
                    Signal("manufacturer_error", 24, 40),
                ),
                here,
                "Emergency: a fault has come or gone.",
            )
        elif item.value == "sdo":
            for direction, base, producer, consumer in (
                ("request", SDO_REQUEST, MASTER, name),
                ("response", SDO_RESPONSE, name, MASTER),
            ):
                yield FrameDefinition(
                    f"{name}_sdo_{direction}",
                    base + node_id,
                    "sdo",
                    producer,
                    (consumer,),
                    8,
                    None,
                    None,
                    (
                        Signal("command", 0, 8),
                        Signal("index", 8, 16),
                        Signal("subindex", 24, 8),
                        Signal("data", 32, 32),
                    ),
                    here,
                    f"Access to the object dictionary, {direction}.",
                )
        elif item.value == "heartbeat":
            yield heartbeat(name, HEARTBEAT + node_id, name, (MASTER,), heartbeat_period, here)


def heartbeat(
    prefix: str, cob_id: int, producer: str, consumers: tuple[str, ...], period: float, here: Span
) -> FrameDefinition:
    """Returns the definition of a heartbeat frame (CiA 301).

    - ``prefix``: first part of the name of the frame.
    - ``producer``: node that sends the heartbeat.
    - ``consumers``: nodes that monitor the heartbeat.
    - ``period``: heartbeat period in s.
    """
    return FrameDefinition(
        f"{prefix}_heartbeat",
        cob_id,
        "heartbeat",
        producer,
        consumers,
        1,
        period,
        period,
        (Signal("state", 0, 7, choices=NMT_STATES),),
        here,
        "Sign of life with the state of the network management.",
    )


def _signals(device: Device, frame: Node) -> Iterator[tuple[Signal, str | None]]:
    """Yields a tuple (signal, name of the motor controller channel) for each signal of a CAN frame.

    The channel name is ``None`` if the signal does not belong to a motor controller channel.
    """
    scope = device.scope
    wires = {wire.channel: wire for wire in device.wires}
    commands = scope.text(frame.get("direction"), "report") == "command"
    for name, node in entries(frame.get("signals")).items():
        if not isinstance(node.value, dict):
            continue
        get = node.value.get
        channel = scope.text(get("channel")) if "channel" in node.value else None
        wire = wires.get(channel) if channel is not None else None
        unit = scope.text(get("unit"))
        # Numbers can use the parameters of the motor on the channel.  Without a motor, they cannot
        # be evaluated.
        numbers = Node({}, node.span) if channel is not None and wire is None else node
        number_of = partial(_signal_number, scope, numbers, unit)
        signal = Signal(
            name,
            integer(scope, get("start"), 0),
            integer(scope, get("length"), 1),
            scope.boolean(get("signed"), False),
            number_of("scale", 1.0),
            number_of("offset", 0.0),
            unit,
            number_of("minimum", None),
            number_of("maximum", None),
            wire.actuator.joint if wire is not None else None,
            scope.boolean(get("multiplexer"), False),
            tuple(integer(scope, item, 0) for item in items(get("selected_by"))),
            tuple(
                (integer(scope, raw, 0), choice) for choice, raw in entries(get("choices")).items()
            ),
            scope.text(get("description")),
            scope.boolean(get("floating_point"), False),
            scope.boolean(get("big_endian"), False),
        )
        if wire is not None and wire.actuator.inverted and _has_direction(signal):
            signal = _inverted(signal)
        if wire is not None and wire.actuator.encoder_offset and signal.unit == "rad":
            signal = _calibrated(signal, wire, commands)
        yield signal, channel


def _signal_number(
    scope: Scope, numbers: Node, unit: str, key: str, otherwise: float | None
) -> Any:
    """Returns a number of a CAN signal, in the unit of the signal."""
    number = numbers.get(key)
    if number is None:
        return otherwise
    allowed = _si_dimension(unit) if unit and isinstance(number.value, str) else ()
    return scope.quantity(number, "ratio", otherwise or 0.0, *allowed)


def _si_dimension(unit_name: str) -> tuple[Dimension, ...]:
    """Returns the dimension that a number of a signal may have, beside none.

    A number of a signal is in the unit of the signal.  It may be a quantity in SI if the unit is
    one of SI, such as `rad/s`, but not if the unit is another, such as `rev/s`.
    """
    try:
        unit = parse_unit(unit_name)
    except UnitError:
        return ()
    is_si = unit.numerator == unit.denominator and not unit.pi_power and not unit.offset
    return (dimensions.without_angle(unit.dimension),) if is_si else ()


def _has_direction(signal: Signal) -> bool:
    """Returns whether the sign of a CAN signal of a motor depends on the direction of the motor.

    This is so for positions, speeds, accelerations and torques (``%``: a share of the largest one)
    which can be negative.  A speed limit has no direction, and neither has a current or a power,
    whose sign says whether the motor takes or returns energy.
    """
    if physical_range(signal)[0] >= 0.0:
        return False
    try:
        return signal.unit == "%" or parse_unit(signal.unit).dimension in _DIRECTED
    except UnitError:
        return False


def _inverted(signal: Signal) -> Signal:
    """Returns a CAN signal of a motor that is mounted the other way round.

    The module document describes the signal as the motor controller counts.  The value of the CAN
    signal is that in the direction of the joint.  The sign is changed only in this function and for
    the limits in ``channel_names``; nothing is written to the motor controller.
    """
    low, high = signal.minimum, signal.maximum
    return replace(
        signal,
        scale=-signal.scale,
        offset=0.0 - signal.offset,  # not -0.0
        minimum=None if high is None else 0.0 - high,
        maximum=None if low is None else 0.0 - low,
    )


def _calibrated(signal: Signal, wire: Wire, commands: bool) -> Signal:
    """Returns a CAN signal whose offset includes the calibrated offset of the steering encoder.

    The CAN frame contains the angle that the steering encoder measures.  The value of the CAN
    signal is the steering joint position: ``position = encoder + encoder_offset``.  The encoder
    offset is applied only in this function, so all other code reads and writes steering joint
    positions.  The limits of a steering command signal are the limits of the steering joint plus
    the encoder offset.
    """
    offset = wire.actuator.encoder_offset
    low, high = signal.minimum, signal.maximum
    if commands:
        low = wire.lower if low is None else low
        high = wire.upper if high is None else high
    return replace(
        signal,
        offset=signal.offset + offset,
        minimum=None if low is None else low + offset,
        maximum=None if high is None else high + offset,
    )


def _pdo(
    device: Device, frame: Node, length: int, report: Report
) -> tuple[int | None, tuple[tuple[int, int, str], ...]]:
    """Returns the PDO number and the PDO mapping of a CAN frame.

    The PDO mapping contains a tuple (index, subindex, object type) for each mapped object.  If the
    CAN frame is not a PDO, or if the PDO has an error, returns ``(None, ())``.
    """
    pdo_node = frame.get("pdo")
    if pdo_node is None:
        return None, ()
    scope = device.scope
    number = integer(scope, pdo_node, 1)
    if not 1 <= number <= LAST_PDO:
        report.add(
            "can-pdo-mapping", f"a PDO's number is 1 to {LAST_PDO}, not {number}", pdo_node.span
        )
        return None, ()
    mapping: list[tuple[int, int, str]] = []
    for item in items(frame.get("mapping")):
        index, subindex, kind = items(item)
        mapped_object = (integer(scope, index, 0), integer(scope, subindex, 0), scope.text(kind))
        if mapped_object[2] not in OBJECT_TYPES:
            report.add(
                "can-pdo-mapping",
                f"`{mapped_object[2]}` is not an object type",
                kind.span,
                hint=did_you_mean(mapped_object[2], list(OBJECT_TYPES), listed(OBJECT_TYPES)),
            )
            return None, ()
        if not (0 <= mapped_object[0] <= 0xFFFF and 0 <= mapped_object[1] <= 0xFE):
            report.add(
                "can-pdo-mapping",
                f"{mapped_object[0]:#x}:{mapped_object[1]} is not an object; "
                "an index is 0 to 0xffff, a subindex 0 to 254",
                item.span,
            )
            return None, ()
        mapping.append(mapped_object)
    bits = sum(OBJECT_TYPES[kind][1] for _, _, kind in mapping)
    if bits != 8 * length:
        stated = frame.get("length") or frame
        report.add(
            "can-pdo-mapping",
            f"the objects of the PDO have {bits} bits, the frame has {8 * length}"
            + ("; a PDO has at most 64" if bits > 64 else ""),
            (frame.get("mapping") or frame).span,
            labels=[Label(stated.span, "the frame's length")],
        )
        return None, ()
    return number, tuple(mapping)


def _is_wired(device: Device, channel: str | None) -> bool:
    return channel is None or any(wire.channel == channel for wire in device.wires)


def identifier(
    name: str, frame: Node, scope: Scope, labels: Sequence[Label] = ()
) -> tuple[int, bool] | None:
    """Returns the identifier of a frame, and whether it has 29 bits.

    Reports an invalid identifier and returns ``None``.

    - ``name``: name of the frame for messages.
    """
    node, report = frame.get("cob_id"), scope.report
    if node is None:
        return None  # the schema check reports a missing identifier
    if isinstance(node.value, dict):
        return _j1939_identifier(name, frame, node, scope)
    extended = scope.boolean(frame.get("extended"), False)
    value = scope.quantity(node, "ratio", math.nan)
    if 0 <= value < 1 << (29 if extended else 11) and value.is_integer():
        return round(value), extended
    if not math.isnan(value):  # NaN means that an invalid identifier is already reported
        fits = not extended and 0 <= value <= LAST_EXTENDED
        report.add(
            "can-cob-id-range",
            f"the frame {name} has the identifier {_hexadecimal(value)}; "
            f"{'an extended' if extended else 'a standard'} frame has 0x0 to "
            f"{LAST_EXTENDED if extended else 0x7FF:#x}",
            node.span,
            labels=labels,
            hint=insertion("add `extended: true`", frame, "extended", "true", is_example=False)
            if fits
            else None,
        )
    return None


def _j1939_identifier(name: str, frame: Node, node: Node, scope: Scope) -> tuple[int, bool] | None:
    """Returns the 29-bit identifier of a frame of SAE J1939-21.

    ```
    bits 28..26   priority
    bits 25..8    parameter group number (PGN): reserved bit, data page, PDU format, PDU specific
    bits 7..0     source address
    ```

    If the PDU format is below 240 (PDU1), the PDU specific field is the destination address.
    """
    limits = {"priority": 7, "pgn": 0x3FFFF, "source": 0xFF, "destination": 0xFF}
    numbers = {key: integer(scope, node.get(key), 0) for key in limits}
    wrong = [key for key, most in limits.items() if not 0 <= numbers[key] <= most]
    pgn, has_destination = numbers["pgn"], node.get("destination") is not None
    to_one = (pgn >> 8 & 0xFF) < 0xF0
    problem = ""
    hint: str | None = None
    if wrong:
        problem = f"the {wrong[0]} {numbers[wrong[0]]}; it must be 0 to {limits[wrong[0]]}"
    elif to_one and pgn & 0xFF:
        problem = f"the PGN {pgn:#x}, whose lower 8 bits are those of the destination"
        hint = f"the PGN without them is {pgn & ~0xFF:#x}, with `destination: {pgn & 0xFF}`"
        if has_destination:
            written, without = node.get("pgn") or node, f"{pgn & ~0xFF:#x}"
            hint = Proposal(f"write `pgn: {without}`", without, span=written.span)
    elif to_one is not has_destination:
        problem = f"the PGN {pgn:#x} and {'no' if to_one else 'a'} `destination`"
        hint = "a PGN with a PDU format below 240 (0xF0) has one, others have none"
    elif not scope.boolean(frame.get("extended"), True):
        problem, hint = "an identifier of J1939, which has 29 bits", "remove `extended: false`"
    if problem:
        text = f"the frame {name} has {problem}"
        scope.report.add("can-cob-id-range", text, node.where, hint=hint)
        return None
    parameter_group = pgn | numbers["destination"]
    return numbers["priority"] << 26 | parameter_group << 8 | numbers["source"], True


def _hexadecimal(value: float) -> str:
    return f"{int(value):#x}" if value.is_integer() and abs(value) < 1 << 32 else f"{value:g}"


def _period(device: Device, frame: Node, sync_period: float, report: Report) -> float | None:
    node = frame.get("period")
    if node is None or node.value == "on_demand":
        return None
    if node.value == "cycle":
        return sync_period
    return _time(device, node, report)


def _time(device: Device, node: Node, report: Report) -> float | None:
    """Returns the value of a time (s) in a module document.

    If the time in the module document is not positive, reports an error and returns ``None``.
    """
    time = device.scope.quantity(node, "time", math.nan)
    if time > 0.0:
        return time
    if not math.isnan(time):  # NaN means that an invalid time is already reported
        report.add(
            "can-period",
            f"a frame of `{device.path}` has the period {time:g} s; it must be positive",
            node.span,
            hint="give a time, `cycle`, or `on_demand` for a frame that is sent on request",
        )
    return None
