"""Encodes and decodes the data of CAN frames with the frame definitions of the robot model."""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping, Sequence
from typing import Any, Final

from thorvaldc.can.frame import CanFrame
from thorvaldc.model import FrameDefinition, Signal

_FORMATS: Final = {
    (8, False): "B",
    (8, True): "b",
    (16, False): "H",
    (16, True): "h",
    (32, False): "I",
    (32, True): "i",
    (64, False): "Q",
    (64, True): "q",
}
"""Format letters of ``struct`` for integers, by length (bits) and ``True`` for signed."""
_FLOAT_FORMATS: Final = {32: "f", 64: "d"}
"""Format letters of ``struct`` for floating-point numbers, by length (bits)."""


class FrameCodec:
    """Encodes and decodes the signals of one CAN frame definition.

    The physical value of a CAN signal is ``raw * scale + offset``, where ``raw`` is the number in
    the data of the CAN frame.  Lists of signal values have the order of ``frame.signals``.  The
    physical value of an integer CAN signal with scale 1 and offset 0 is an integer.

    A CAN frame whose signals have one byte order, and start and end at byte boundaries, is
    converted by one fast call of ``struct``.  A CAN frame with other signals is converted with
    shifts and masks.
    """

    def __init__(self, frame: FrameDefinition) -> None:
        self.frame = frame
        self.key = frame.key
        self.length = frame.length
        self.names = tuple(signal.name for signal in frame.signals)
        self.indices = {name: i for i, name in enumerate(self.names)}
        """Index of each signal by its name."""
        self._signals = frame.signals
        self._linear = tuple(
            (i, s.scale, s.offset)
            for i, s in enumerate(frame.signals)
            if s.scale != 1.0 or s.offset != 0.0
        )
        self._raw_ranges = tuple(signal.raw_range for signal in frame.signals)
        self._bounds = tuple((s.minimum, s.maximum) for s in frame.signals)
        self._struct, self._order = _compile_struct(frame)
        self._fields = tuple(
            (
                _shift(s, frame.length),
                (1 << s.length) - 1,
                1 << s.length - 1 if s.signed else 0,
                s.big_endian,
            )
            for s in frame.signals
        )
        self._floats = tuple(
            (i, f"<{_FORMATS[s.length, False]}", f"<{_FLOAT_FORMATS[s.length]}")
            for i, s in enumerate(frame.signals)
            if s.floating_point
        )
        self._multiplexer = next((i for i, s in enumerate(frame.signals) if s.multiplexer), None)

    def decode(self, data: bytes) -> list[float]:
        """Returns the physical values of all signals in the data of a CAN frame.

        The returned list also contains the values of signals that the multiplexer signal does not
        select.  Surplus bytes in the data of the CAN frame are ignored.  Raises ``ValueError`` if
        ``data`` is shorter than the CAN frame definition, or if a floating-point signal is NaN or
        infinite.
        """
        if len(data) < self.length:
            raise ValueError(f"{self.frame.name} has {len(data)} bytes, not {self.length}")
        values: list[Any]
        if self._struct is not None:
            raw = self._struct.unpack_from(data)
            values = list(raw) if self._order is None else [raw[i] for i in self._order]
        else:
            little = int.from_bytes(data[: self.length], "little")
            big = int.from_bytes(data[: self.length], "big")
            # The expression `(x ^ sign) - sign` extends the sign bit of a signed integer field.
            # For an unsigned integer field `sign` is 0.
            values = [
                (((big if is_big else little) >> shift & mask) ^ sign) - sign
                for shift, mask, sign, is_big in self._fields
            ]
            for i, integer, float_format in self._floats:
                (values[i],) = struct.unpack(float_format, struct.pack(integer, values[i]))
        for i, _, _ in self._floats:
            if not math.isfinite(values[i]) and self._is_selected(i, values):
                raise ValueError(f"{self.frame.name}: {self.names[i]} is {values[i]}")
        for i, scale, offset in self._linear:
            values[i] = values[i] * scale + offset
        return values

    def is_finite(self, data: bytes) -> bool:
        """Returns whether no floating-point signal in the data of a CAN frame is NaN or infinite.

        ``data`` must not be shorter than the CAN frame definition.
        """
        if not self._floats:
            return True
        try:
            self.decode(data)
        except ValueError:
            return False
        return True

    def decode_named(self, data: bytes) -> dict[str, float]:
        """Returns the physical values of the signals in the data of a CAN frame by signal name.

        If the CAN frame has a multiplexer signal, only the signals that the multiplexer selects are
        returned.  Raises the same ``ValueError`` as ``decode``.
        """
        values = self.decode(data)
        if self._multiplexer is None:
            return dict(zip(self.names, values, strict=True))
        return {
            name: value
            for i, (name, value) in enumerate(zip(self.names, values, strict=True))
            if self._is_selected(i, values)
        }

    def _is_selected(self, index: int, values: Sequence[float]) -> bool:
        """Returns whether a CAN frame with the signal values ``values`` contains a signal."""
        selected_by = self._signals[index].selected_by
        if not selected_by or self._multiplexer is None:
            return True
        return values[self._multiplexer] in selected_by

    def encode(self, values: Sequence[float]) -> bytes:
        """Returns the data of a CAN frame with the given signal values.

        ``values``: one physical value for each signal, in the order of ``frame.signals``.  A value
        outside the limits of the CAN signal is replaced by the nearest limit.  Raises
        ``ValueError`` if a signal value is NaN or infinite, because no limit is a safe replacement.
        """
        # Integers must stay integers for `struct`; a variable of the type float would convert them.
        raw: list[int | float] = []
        for value, signal, (lowest, highest), (minimum, maximum) in zip(
            values, self._signals, self._raw_ranges, self._bounds, strict=True
        ):
            if not math.isfinite(value):
                raise ValueError(f"{self.frame.name}: {signal.name} is {value}")
            if minimum is not None and value < minimum:
                value = minimum
            if maximum is not None and value > maximum:
                value = maximum
            number = (value - signal.offset) / signal.scale
            rounded: int | float = number
            if not signal.floating_point:
                rounded = round(number)
            if rounded < lowest:
                rounded = lowest
            elif rounded > highest:
                rounded = highest
            raw.append(rounded)
        if self._struct is not None:
            if self._order is not None:
                sorted_raw: list[int | float] = [0] * len(raw)
                for raw_value, position in zip(raw, self._order, strict=True):
                    sorted_raw[position] = raw_value
                raw = sorted_raw
            return self._struct.pack(*raw)
        little = big = 0
        for i, integer, float_format in self._floats:
            (raw[i],) = struct.unpack(integer, struct.pack(float_format, raw[i]))
        for raw_value, (shift, mask, _, is_big) in zip(raw, self._fields, strict=True):
            bits = (int(raw_value) & mask) << shift
            little, big = (little, big | bits) if is_big else (little | bits, big)
        return (little | int.from_bytes(big.to_bytes(self.length, "big"), "little")).to_bytes(
            self.length, "little"
        )

    def encode_named(self, values: Mapping[str, float]) -> bytes:
        """Returns the data of a CAN frame with the given signal values by name.

        The raw value of a CAN signal that is missing in ``values`` is 0.
        """
        return self.encode([values.get(s.name, s.offset) for s in self._signals])

    def can_frame(self, data: bytes) -> CanFrame:
        """Returns the CAN frame with this definition and ``data``, ready to be sent."""
        return CanFrame(self.frame.cob_id, data, self.frame.extended)


def _shift(signal: Signal, length: int) -> int:
    """Returns the place of the least significant bit of a signal in the data of a CAN frame.

    The data of ``length`` bytes is read as one number, with the byte order of the signal.
    """
    first = signal.first_bit
    return 8 * length - first - signal.length if signal.big_endian else first


def _compile_struct(frame: FrameDefinition) -> tuple[struct.Struct | None, tuple[int, ...] | None]:
    """Returns a ``struct.Struct`` for the data of a CAN frame, and the position of each signal in
    the ``struct.Struct``.

    The ``struct.Struct`` is ``None`` if a signal does not start and end at byte boundaries, or if
    the signals have both byte orders.  The positions are ``None`` if the ``struct.Struct`` has the
    same order as the signals.
    """
    by_start = sorted(range(len(frame.signals)), key=lambda i: frame.signals[i].first_bit)
    orders = {signal.big_endian for signal in frame.signals}
    text, end = ">" if True in orders else "<", 0
    for i in by_start:
        signal = frame.signals[i]
        letter = (
            _FLOAT_FORMATS.get(signal.length)
            if signal.floating_point
            else _FORMATS.get((signal.length, signal.signed))
        )
        first = signal.first_bit
        if letter is None or first % 8 or first < 8 * end or len(orders) > 1:
            return None, None
        text += "x" * (first // 8 - end) + letter
        end = first // 8 + signal.length // 8
    if end > frame.length:
        return None, None
    text += "x" * (frame.length - end)
    positions = [0] * len(by_start)
    for position, i in enumerate(by_start):
        positions[i] = position
    in_order = positions == list(range(len(positions)))
    return struct.Struct(text), None if in_order else tuple(positions)
