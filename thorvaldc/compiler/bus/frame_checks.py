"""Checks the positions of the signals in a CAN frame, and the physical range of the signals."""

from __future__ import annotations

from collections.abc import Sequence

from thorvaldc.compiler.bus.device_sections import Device, Wire, listed
from thorvaldc.compiler.source.node import Node
from thorvaldc.compiler.values.value_reader import entries
from thorvaldc.diagnostics import FIRST_USE, Label, Report, Span, did_you_mean
from thorvaldc.model import Signal

ROUNDING = 1e-9
FLOAT_LENGTHS = (32, 64)  # lengths (bits) of the floating-point formats of IEEE 754


def check_channels(device: Device, frame: Node, report: Report) -> None:
    """Checks that the module has all channels to which the CAN signals of the module refer."""
    known = list(entries(device.channels))
    for node in entries(frame.get("signals")).values():
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
    """Returns whether the positions and lengths of the signals in a CAN frame are valid.

    A CAN frame has at most 8 bytes.  The signals must be inside the CAN frame and must not overlap.
    The named values of a CAN signal must fit into the bits of the signal, and the multiplexer must
    be valid.

    - ``frame``: definition of the frame in the module document.
    - ``length``: length of the frame in bytes.
    - ``signals``: tuples (signal, name of the channel).
    """
    if not 0 <= length <= 8:
        length_node = frame.get("length") or frame
        report.add(
            "can-frame-length",
            f"the frame has {length} bytes; a CAN frame has 0 to 8 (64 bits)",
            length_node.span,
        )
        return False
    span_of = {name: node.where for name, node in entries(frame.get("signals")).items()}
    inside: list[Signal] = []
    for signal, _ in signals:
        room = 8 * length - signal.first_bit
        if signal.length > 0 <= signal.start and signal.length <= room:
            inside.append(signal)
        elif signal.big_endian:
            report.add(
                "can-signal-bounds",
                f"the big-endian signal `{signal.name}` starts at bit {signal.start} and has "
                f"{signal.length} bits; the frame has {max(room, 0)} from there on",
                span_of[signal.name],
                hint="`start` is the most significant bit: bit 7 is the first of byte 0, bit 15 of "
                "byte 1",
            )
        else:
            report.add(
                "can-signal-bounds",
                f"the signal `{signal.name}` starts at bit {signal.start} and has "
                f"{signal.length} bits; the frame has the bits 0 to {8 * length - 1}",
                span_of[signal.name],
            )
    return all(
        (
            len(inside) == len(signals),
            _floats_fit(inside, span_of, report),
            _choices_fit(inside, span_of, report),
            _selectors_fit(inside, span_of, report),
            _bits_are_apart(inside, span_of, report),
        )
    )


def _floats_fit(signals: Sequence[Signal], span_of: dict[str, Span], report: Report) -> bool:
    """Checks that a floating-point signal has a length of IEEE 754 and no keys of an integer."""
    fits = True
    for signal in signals:
        if not signal.floating_point:
            continue
        integer_keys = {
            "signed": signal.signed,
            "choices": signal.choices,
            "multiplexer": signal.multiplexer,
        }
        unsuited = [key for key, stated in integer_keys.items() if stated]
        if signal.length not in FLOAT_LENGTHS:
            text = f"has {signal.length} bits; a floating-point number has 32 or 64"
        elif unsuited:
            text = f"is a floating-point number, but has `{unsuited[0]}`, which is for integers"
        else:
            continue
        fits = False
        report.add(
            "can-signal-floating-point",
            f"the signal `{signal.name}` {text}",
            span_of[signal.name],
            hint=f"remove `{unsuited[0]}`"
            if signal.length in FLOAT_LENGTHS
            else "write `length: 32`, or remove `floating_point`",
        )
    return fits


def _choices_fit(signals: Sequence[Signal], span_of: dict[str, Span], report: Report) -> bool:
    fits = True
    for signal in signals:
        low, high = signal.raw_range
        for raw, choice in signal.choices:
            if not low <= raw <= high:
                fits = False
                report.add(
                    "can-choice-range",
                    f"`{choice}` is {raw}; the {signal.length} bits of `{signal.name}` "
                    f"have the range {low} to {high}",
                    span_of[signal.name],
                )
    return fits


def _selectors_fit(signals: Sequence[Signal], span_of: dict[str, Span], report: Report) -> bool:
    selectors = [signal for signal in signals if signal.multiplexer]
    fits = len(selectors) < 2
    for other in selectors[1:]:
        report.add(
            "can-multiplexer",
            f"the frame has two multiplexers, `{selectors[0].name}` and `{other.name}`",
            span_of[other.name],
            labels=[Label(span_of[selectors[0].name], "the first")],
        )
    for signal in signals:
        if not signal.selected_by:
            continue
        if not selectors or signal.multiplexer:
            fits = False
            report.add(
                "can-multiplexer",
                f"`{signal.name}` is selected by a multiplexer, but the frame has none",
                span_of[signal.name],
                hint="mark the signal that selects with `multiplexer: true`",
            )
            continue
        low, high = selectors[0].raw_range
        for value in signal.selected_by:
            if not low <= value <= high:
                fits = False
                report.add(
                    "can-multiplexer",
                    f"`{signal.name}` is selected by {value}; `{selectors[0].name}` "
                    f"has the range {low} to {high}",
                    span_of[signal.name],
                )
    return fits


def _bits_are_apart(signals: Sequence[Signal], span_of: dict[str, Span], report: Report) -> bool:
    """Checks that CAN signals share bits only if different multiplexer values select them."""
    fits = True
    always, all_bits, selected = 0, 0, dict[int, int]()  # selected: bits by multiplexer value
    for number, signal in enumerate(signals):
        values, mask = set(signal.selected_by), _mask(signal)
        used = always if values else all_bits
        for value in values:
            used |= selected.get(value, 0)
            selected[value] = selected.get(value, 0) | mask
        always |= 0 if values else mask
        all_bits |= mask
        if not used & mask:
            continue
        fits = False
        first = next(
            other
            for other in signals[:number]
            if _mask(other) & mask
            and (not values or not other.selected_by or values & {*other.selected_by})
        )
        report.add(
            "can-signal-overlap",
            f"the signals `{first.name}` ({_bits_text(first)}) and `{signal.name}` "
            f"({_bits_text(signal)}) share bits",
            span_of[signal.name],
            labels=[Label(span_of[first.name], FIRST_USE)],
        )
    return fits


def _mask(signal: Signal) -> int:
    return sum(1 << bit for bit in signal.bits)


def _bits_text(signal: Signal) -> str:
    order = ", big endian" if signal.big_endian else ""
    return f"bits {signal.bits[0]} to {signal.bits[-1]}{order}"


def check_scales(
    device: Device, frame: Node, signals: Sequence[tuple[Signal, str | None]], report: Report
) -> None:
    """Checks that CAN signals can represent the whole speed or angle range of their joint.

    - ``signals``: tuples (signal, name of the channel).
    """
    wires = {wire.channel: wire for wire in device.wires}
    nodes = entries(frame.get("signals"))
    for signal, channel in signals:
        if channel is not None and channel not in wires:
            continue
        node = nodes[signal.name]
        if signal.scale == 0.0:
            report.add(
                "can-scale",
                f"the scale of `{signal.name}` is 0, so every raw value means the same",
                (node.get("scale") or node).span,
            )
            continue
        if channel is None:
            continue
        joint_range = _joint_range(wires[channel], signal)
        if joint_range is None:
            continue
        low, high = physical_range(signal)
        slack = ROUNDING * max(abs(joint_range[0]), abs(joint_range[1]))
        if low <= joint_range[0] + slack and joint_range[1] - slack <= high:
            continue
        kind = (
            "floating-point" if signal.floating_point else "signed" if signal.signed else "unsigned"
        )
        field = f"{signal.length} {kind} bits"
        report.add(
            "can-scale",
            f"`{signal.name}` has the range {low:.4g} to {high:.4g} {signal.unit}; the joint "
            f"`{signal.joint}` needs {joint_range[0]:.4g} to {joint_range[1]:.4g} {signal.unit}",
            device.span,
            labels=[
                Label(node.where, f"{field}, {signal.scale:.4g} {signal.unit} per step"),
                Label(wires[channel].actuator.span, "the motor"),
            ],
            hint="a wider field, a coarser scale, or lower limits of the motor or joint",
        )


def _joint_range(wire: Wire, signal: Signal) -> tuple[float, float] | None:
    if signal.unit == "rad/s":
        # A signal whose minimum is stated as 0 is a limit of the speed in both directions.
        is_limit = signal.minimum is not None and signal.minimum >= 0.0
        return 0.0 if is_limit else -wire.actuator.max_velocity, wire.actuator.max_velocity
    if signal.unit == "rad" and wire.lower is not None and wire.upper is not None:
        # The calibration shifts the range of the steering signal by the offset of the steering
        # encoder.
        offset = wire.actuator.encoder_offset
        return wire.lower + offset, wire.upper + offset
    return None


def physical_range(signal: Signal) -> tuple[float, float]:
    """Returns the lowest and the highest value of a CAN signal."""
    ends = sorted(raw * signal.scale + signal.offset for raw in signal.raw_range)
    low = ends[0] if signal.minimum is None else max(ends[0], signal.minimum)
    high = ends[1] if signal.maximum is None else min(ends[1], signal.maximum)
    return low, high
