"""Which motor of a CiA 402 drive belongs to a channel."""

from __future__ import annotations

from thorvaldc.model.bus import OBJECT_TYPES, Bus, Node

FIRST_INDEX, STRIDE, MOTORS = 0x6000, 0x800, 8
"""First object index of motor 0, difference between the object indices of two successive motors,
and the largest number of motors (CiA 402)."""


def motor_numbers(bus: Bus, node: Node) -> tuple[int, ...]:
    """Return the number of the motor of each channel of a CiA 402 drive, from 0.

    The objects in the PDOs with the signals of a channel decide, and not the order in which the
    module lists its channels, because the driver finds a value by the name of its signal.  Without
    such PDOs the motors are numbered in the order of the channels.
    """
    channels = [channel.name for channel in node.channels]
    numbers: dict[str, int] = {}
    for frame in bus.frames:
        if not frame.mapping or node.name not in (frame.producer, *frame.consumers):
            continue
        signals, bit = {signal.start: signal.name for signal in frame.signals}, 0
        for index, _, kind in frame.mapping:
            name, number = signals.get(bit, ""), (index - FIRST_INDEX) // STRIDE
            bit += OBJECT_TYPES[kind][1]
            for channel in channels:
                if name.startswith(f"{channel}_") and 0 <= number < MOTORS:
                    numbers.setdefault(channel, number)
    in_order = tuple(numbers[channel] for channel in channels if channel in numbers)
    if len(set(in_order)) < len(channels):
        return tuple(range(len(channels)))
    return in_order
