"""Frames of the model, compiled: bytes to values and back, little endian."""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping, Sequence

from thorvaldc.model.bus import FrameDefinition, Signal

_FORMATS = {
    (8, False): "B",
    (8, True): "b",
    (16, False): "H",
    (16, True): "h",
    (32, False): "I",
    (32, True): "i",
    (64, False): "Q",
    (64, True): "q",
}


class FrameCodec:
    """One frame's layout.  Values are physical, ``raw * scale + offset``, in the signals' order.

    A signal whose scale is 1 and offset 0 is a whole number.  Where all signals are whole
    bytes (most frames) a single ``struct`` does the work.
    """

    def __init__(self, frame: FrameDefinition) -> None:
        self.frame = frame
        self.cob_id = frame.cob_id
        self.length = frame.length
        self.names = tuple(signal.name for signal in frame.signals)
        self.places = {name: i for i, name in enumerate(self.names)}
        self._signals = frame.signals
        self._linear = tuple(
            (i, s.scale, s.offset)
            for i, s in enumerate(frame.signals)
            if s.scale != 1.0 or s.offset != 0.0
        )
        self._ranges = tuple(_range(signal) for signal in frame.signals)
        self._bounds = tuple((s.minimum, s.maximum) for s in frame.signals)
        self._struct, self._order = _compiled(frame)
        self._fields = tuple(
            (s.start, (1 << s.length) - 1, 1 << s.length - 1 if s.signed else 0)
            for s in frame.signals
        )
        chooser = next((i for i, s in enumerate(frame.signals) if s.multiplexer), None)
        self._chooser = chooser

    def decode(self, data: bytes) -> list[float]:
        """The values of all signals, also of those that a multiplexer says are not there.

        Raises ``ValueError`` where the frame is too short; what is too long is cut off.
        """
        if len(data) < self.length:
            raise ValueError(f"{self.frame.name} has {len(data)} bytes, not {self.length}")
        values: list[float]
        if self._struct is not None:
            found = self._struct.unpack_from(data)
            values = list(found) if self._order is None else [found[i] for i in self._order]
        else:
            bits = int.from_bytes(data[: self.length], "little")
            values = [((bits >> start & mask) ^ sign) - sign for start, mask, sign in self._fields]
        for i, scale, offset in self._linear:
            values[i] = values[i] * scale + offset
        return values

    def named(self, data: bytes) -> dict[str, float]:
        """By name, those that are there.  Raises ``ValueError``."""
        values = self.decode(data)
        if self._chooser is None:
            return dict(zip(self.names, values, strict=True))
        choice = values[self._chooser]
        return {
            signal.name: value
            for signal, value in zip(self._signals, values, strict=True)
            if not signal.selected_by or choice in signal.selected_by
        }

    def encode(self, values: Sequence[float]) -> bytes:
        """The frame with these values, in the signals' order.

        Values beyond a signal's bounds are drawn back to them.  Raises ``ValueError`` for a
        value that is not finite: nothing sensible can be sent then.
        """
        raw = []
        for value, signal, (low, high), (least, most) in zip(
            values, self._signals, self._ranges, self._bounds, strict=True
        ):
            if not math.isfinite(value):
                raise ValueError(f"{self.frame.name}: {signal.name} is {value}")
            if least is not None and value < least:
                value = least
            if most is not None and value > most:
                value = most
            whole = round((value - signal.offset) / signal.scale)
            raw.append(low if whole < low else high if whole > high else whole)
        if self._struct is not None:
            if self._order is not None:
                placed = [0] * len(raw)
                for value_at, place in zip(raw, self._order, strict=True):
                    placed[place] = value_at
                raw = placed
            return self._struct.pack(*raw)
        bits = 0
        for whole, (start, mask, _) in zip(raw, self._fields, strict=True):
            bits |= (whole & mask) << start
        return bits.to_bytes(self.length, "little")

    def encode_named(self, values: Mapping[str, float]) -> bytes:
        """The frame with these values; signals that are not named have the raw value 0."""
        return self.encode([values.get(s.name, s.offset) for s in self._signals])


def _range(signal: Signal) -> tuple[int, int]:
    if signal.signed:
        return -(1 << signal.length - 1), (1 << signal.length - 1) - 1
    return 0, (1 << signal.length) - 1


def _compiled(frame: FrameDefinition) -> tuple[struct.Struct | None, tuple[int, ...] | None]:
    """A ``struct`` for the frame and the place in it of each signal (``None``: as they stand)."""
    places = sorted(range(len(frame.signals)), key=lambda i: frame.signals[i].start)
    text, at = "<", 0
    for i in places:
        signal = frame.signals[i]
        letter = _FORMATS.get((signal.length, signal.signed))
        if letter is None or signal.start % 8 or signal.start < 8 * at:
            return None, None
        text += "x" * (signal.start // 8 - at) + letter
        at = signal.start // 8 + signal.length // 8
    if at > frame.length:
        return None, None
    text += "x" * (frame.length - at)
    order = [0] * len(places)
    for position, i in enumerate(places):
        order[i] = position
    return struct.Struct(text), None if order == list(range(len(order))) else tuple(order)
