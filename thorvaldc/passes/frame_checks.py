"""Checks of one frame of a module: its layout, and whether its scalings reach far enough."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

from thorvaldc.diagnostics import Label, Report
from thorvaldc.diagnostics.suggest import did_you_mean
from thorvaldc.model.robot import Signal
from thorvaldc.passes.bus_device import Device, Wire, entries, listed
from thorvaldc.source.node import Node

ROUNDING = 1e-9


def check_channels(device: Device, frame: Node, report: Report) -> None:
    """A signal's channel must be one of the module's."""
    known = [name for name, _ in entries(device.channels)]
    for _, node in entries(frame.get("signals")):
        channel = node.get("channel")
        if channel is not None and channel.value not in known:
            report.add(
                "channel-unknown",
                f"the module has no channel `{channel.value}`",
                channel.span,
                hint=did_you_mean(str(channel.value), known, listed(known)),
            )


def check_layout(
    frame: Node,
    length: int,
    signals: Sequence[tuple[Signal, str | None]],
    report: Report,
) -> bool:
    """Whether the signals lie in the frame, apart from each other, and are selected rightly."""
    before = len(report)
    if not 0 <= length <= 8:
        place = frame.get("length") or frame
        report.add(
            "can-frame-length",
            f"the frame has {length} bytes; a CAN frame has 0 to 8 (64 bits)",
            place.span,
        )
        return False
    span_of = {name: node.where for name, node in entries(frame.get("signals"))}
    selector: Signal | None = None
    for signal, _ in signals:
        here = span_of[signal.name]
        if signal.length < 1 or signal.start < 0 or signal.start + signal.length > 8 * length:
            report.add(
                "can-signal-bounds",
                f"the signal `{signal.name}` has the bits {signal.start} to "
                f"{signal.start + signal.length - 1}; the frame has 0 to {8 * length - 1}",
                here,
            )
        low, high = raw_range(signal)
        for raw, choice in signal.choices:
            if not low <= raw <= high:
                report.add(
                    "can-choice-range",
                    f"`{choice}` is {raw}; the {signal.length} bits of `{signal.name}` "
                    f"can say {low} to {high}",
                    here,
                )
        if signal.multiplexer and selector is not None:
            report.add(
                "can-multiplexer",
                f"the frame has two multiplexers, `{selector.name}` and `{signal.name}`",
                here,
                labels=[Label(span_of[selector.name], "the first")],
            )
        elif signal.multiplexer:
            selector = signal
    for signal, _ in signals:
        if signal.selected_by and (selector is None or selector is signal):
            report.add(
                "can-multiplexer",
                f"`{signal.name}` is selected by a multiplexer, but the frame has none",
                span_of[signal.name],
                hint="mark the signal that selects with `multiplexer: true`",
            )
        elif selector is not None:
            low, high = raw_range(selector)
            for value in signal.selected_by:
                if not low <= value <= high:
                    report.add(
                        "can-multiplexer",
                        f"`{signal.name}` is selected by {value}; `{selector.name}` "
                        f"can say {low} to {high}",
                        span_of[signal.name],
                    )
    for (first, _), (second, _) in itertools.combinations(signals, 2):
        if _overlap(first, second):
            report.add(
                "can-signal-overlap",
                f"the signals `{first.name}` (bits {first.start} to "
                f"{first.start + first.length - 1}) and `{second.name}` (bits {second.start} to "
                f"{second.start + second.length - 1}) share bits",
                span_of[second.name],
                labels=[Label(span_of[first.name], "first used here")],
            )
    return len(report) == before


def _overlap(a: Signal, b: Signal) -> bool:
    if a.start + a.length <= b.start or b.start + b.length <= a.start:
        return False
    if not a.selected_by or not b.selected_by:
        return True
    return any(value in b.selected_by for value in a.selected_by)


def raw_range(signal: Signal) -> tuple[int, int]:
    """Smallest and largest raw value of the field."""
    if signal.signed:
        return -(1 << (signal.length - 1)), (1 << (signal.length - 1)) - 1
    return 0, (1 << signal.length) - 1


def check_scales(
    device: Device, frame: Node, signals: Sequence[tuple[Signal, str | None]], report: Report
) -> None:
    """The full speed and the full angle of each joint must fit into its field."""
    wires = {wire.channel: wire for wire in device.wires}
    nodes = dict(entries(frame.get("signals")))
    for signal, channel in signals:
        if channel is not None and channel not in wires:
            continue
        node = nodes[signal.name]
        if signal.scale == 0.0:
            report.add(
                "can-scale",
                f"the scale of `{signal.name}` is 0: every value would be the same",
                (node.get("scale") or node).span,
            )
            continue
        if channel is None:
            continue
        wanted = _joint_range(wires[channel], signal.unit)
        if wanted is None:
            continue
        low, high = _physical_range(signal)
        slack = ROUNDING * max(abs(wanted[0]), abs(wanted[1]))
        if low <= wanted[0] + slack and wanted[1] - slack <= high:
            continue
        field = f"{signal.length} {'signed' if signal.signed else 'unsigned'} bits"
        report.add(
            "can-scale",
            f"`{signal.name}` can say {low:.4g} to {high:.4g} {signal.unit}; the joint "
            f"`{signal.joint}` has {wanted[0]:.4g} to {wanted[1]:.4g} {signal.unit}",
            device.origin,
            labels=[
                Label(node.where, f"{field}, {signal.scale:.4g} {signal.unit} a step"),
                Label(wires[channel].actuator.origin, "the motor"),
            ],
            hint="a wider field, a coarser scale, or lower limits of the motor or joint",
        )


def _joint_range(wire: Wire, unit: str) -> tuple[float, float] | None:
    if unit == "rad/s":
        return -wire.actuator.max_velocity, wire.actuator.max_velocity
    if unit == "rad" and wire.lower is not None and wire.upper is not None:
        return wire.lower, wire.upper
    return None


def _physical_range(signal: Signal) -> tuple[float, float]:
    ends = sorted(raw * signal.scale + signal.offset for raw in raw_range(signal))
    low = ends[0] if signal.minimum is None else max(ends[0], signal.minimum)
    high = ends[1] if signal.maximum is None else min(ends[1], signal.maximum)
    return low, high
