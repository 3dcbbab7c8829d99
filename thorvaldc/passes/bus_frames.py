"""The frames of a device: its module's, and the CANopen objects that it has."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from thorvaldc.diagnostics import Label, Report, Span
from thorvaldc.model.robot import Frame, Signal
from thorvaldc.passes.bus_device import MASTER, Device, entries, integer, items
from thorvaldc.passes.frame_checks import check_channels, check_layout, check_scales
from thorvaldc.source.node import Node

HEARTBEAT_PERIOD = 0.1  # s, where the module does not say
NMT_STATES = ((0, "boot_up"), (4, "stopped"), (5, "operational"), (127, "pre_operational"))


def channel_names(device: Device) -> dict[str, dict[str, float | int]]:
    return {
        wire.channel: {
            "gear_ratio": wire.actuator.gear_ratio,
            "encoder_ppr": wire.actuator.encoder_ppr,
            "motor_max_speed": wire.actuator.motor_max_speed,
            "max_velocity": wire.actuator.max_velocity,
            "lower": -math.pi if wire.lower is None else wire.lower,
            "upper": math.pi if wire.upper is None else wire.upper,
        }
        for wire in device.wires
    }


def frames_of(device: Device, node_id: int, sync_period: float, report: Report) -> Iterator[Frame]:
    scope, name = device.scope, device.name
    for key, node in entries(device.can.get("frames")):
        cob_id = _cob_id(device, key, node, report)
        if cob_id is None:
            continue
        length = integer(scope, node.get("length"), 8)
        period = _period(device, node, sync_period, report)
        signals = tuple(_signals(device, node))
        check_channels(device, node, report)
        fits = check_layout(node, length, signals, report)
        kept = tuple(signal for signal, channel in signals if _is_wired(device, channel))
        sends = scope.text(node.get("direction"), "report") == "command"
        if sends and signals and not kept:
            period = None  # nothing to say: the motors that it is for are not there
        deadline = node.get("deadline")
        if fits:
            check_scales(device, node, signals, report)
            yield Frame(
                f"{name}_{key}",
                cob_id,
                scope.text(node.get("kind"), "pdo"),
                MASTER if sends else name,
                (name,) if sends else (MASTER,),
                length,
                period,
                period if deadline is None else _time(device, deadline, report),
                kept,
                node.where,
                scope.text(node.get("description")),
            )
    yield from _standard_frames(device, node_id, report)


def _standard_frames(device: Device, node_id: int, report: Report) -> Iterator[Frame]:
    """The CANopen objects that the device says it has (CiA 301, predefined connection set)."""
    found = device.can.get("canopen")
    if found is None or not isinstance(found.value, tuple):
        return
    name, here = device.name, found.where
    for item in found.value:
        if item.value == "emcy":
            yield Frame(
                f"{name}_emcy",
                0x080 + node_id,
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
            for way, base, producer, consumer in (
                ("request", 0x600, MASTER, name),
                ("response", 0x580, name, MASTER),
            ):
                yield Frame(
                    f"{name}_sdo_{way}",
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
                    f"Access to the object dictionary, {way}.",
                )
        elif item.value == "heartbeat":
            stated = device.can.get("heartbeat_period")
            every = HEARTBEAT_PERIOD if stated is None else _time(device, stated, report)
            yield heartbeat(name, 0x700 + node_id, name, (MASTER,), every or HEARTBEAT_PERIOD, here)


def heartbeat(
    prefix: str, cob_id: int, producer: str, consumers: tuple[str, ...], period: float, here: Span
) -> Frame:
    return Frame(
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
    """The signals of a frame, each with its channel."""
    scope = device.scope
    joints = {wire.channel: wire.actuator.joint for wire in device.wires}
    for name, node in entries(frame.get("signals")):
        if not isinstance(node.value, dict):
            continue
        get = node.value.get
        channel = scope.text(get("channel")) if "channel" in node.value else None
        wired = channel is None or channel in joints

        def value(key: str, otherwise: float | None, get: Any = get, wired: bool = wired) -> Any:
            # The numbers of a channel without a motor have no meaning and are not evaluated.
            found = get(key) if wired else None
            return otherwise if found is None else scope.quantity(found, "ratio", otherwise or 0.0)

        yield (
            Signal(
                name,
                integer(scope, get("start"), 0),
                integer(scope, get("length"), 1),
                scope.boolean(get("signed"), False),
                value("scale", 1.0),
                value("offset", 0.0),
                scope.text(get("unit")),
                value("minimum", None),
                value("maximum", None),
                joints.get(channel) if channel is not None else None,
                scope.boolean(get("multiplexer"), False),
                tuple(integer(scope, item, 0) for item in items(get("selected_by"))),
                tuple((integer(scope, raw, 0), choice) for choice, raw in entries(get("choices"))),
                scope.text(get("description")),
            ),
            channel,
        )


def _is_wired(device: Device, channel: str | None) -> bool:
    return channel is None or any(wire.channel == channel for wire in device.wires)


def _cob_id(device: Device, key: str, frame: Node, report: Report) -> int | None:
    node = frame.get("cob_id") or frame
    value = device.scope.quantity(node, "ratio", math.nan)
    if 0 <= value <= 0x7FF and value.is_integer():
        return int(value)
    if not math.isnan(value):  # else its fault is reported
        report.add(
            "can-cob-id-range",
            f"the frame `{key}` of `{device.path}` has the identifier {_hexadecimal(value)}; "
            "a standard frame has 0x0 to 0x7ff",
            node.span,
            labels=[Label(device.origin, "this device has it")],
        )
    return None


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
    """A time that is positive, or ``None`` with the fault reported."""
    time = device.scope.quantity(node, "time", math.nan)
    if time > 0.0:
        return time
    if not math.isnan(time):  # else its fault is reported
        report.add(
            "can-period",
            f"a frame of `{device.path}` has the period {time:g} s; it must be positive",
            node.span,
            hint="give a time, `cycle`, or `on_demand` for a frame that is sent when asked for",
        )
    return None
