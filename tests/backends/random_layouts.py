"""Random layouts of CAN frames, as YAML text of a module, and their comparison with other readers.

A layout has standard or extended identifiers, and signals of both byte orders, signed, unsigned or
floating-point, with scale and offset.  The bits of a signal are counted here as the DBC format
describes them, and not with the functions of the package.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any, NamedTuple

from tests.devices import Bench
from thorvaldc.backends.can.dbc import dbc_text
from thorvaldc.model import Bus, FrameDefinition
from thorvaldc.runtime.can_base.signal_codec import FrameCodec

FRAMES = 25
"""Frames of one module."""
SAMPLES = 4
"""Random contents of each frame."""
HEAD = """
description: A device with random frames.
can:
  protocol: mine
  id_space: mine
  ids: [1, 127]
  frames:
"""
SCALES = (1.0, 0.1, 0.001, 0.25, -0.5, 3.7, 1e-6, 1000.0)
OFFSETS = (0.0, 0.0, -40.0, 12.5)

Decode = Callable[[bytes], Mapping[str, float]]


class Reader(NamedTuple):
    """What another program has read in a DBC file.

    - ``decoders``: function that decodes a frame, by (identifier, extended).
    - ``encode_again``: function that decodes a frame and encodes the raw values again, or ``None``.
    """

    decoders: dict[tuple[int, bool], Decode]
    encode_again: Callable[[tuple[int, bool], bytes], bytes] | None = None


def signal_bits(start: int, length: int, big_endian: bool) -> list[int]:
    """Returns the bits of a signal as a DBC file numbers them.

    A big-endian signal goes down in a byte, and from bit 0 of a byte to bit 7 of the next one.
    """
    bits = [start]
    while len(bits) < length:
        last = bits[-1]
        bits.append(last + 1 if not big_endian else last - 1 if last % 8 else last + 15)
    return bits


def random_signals(draw: random.Random, size: int) -> list[str]:
    """Returns the YAML text of signals that do not overlap, in a frame of ``size`` bytes."""
    signals: list[str] = []
    used: set[int] = set()
    for _ in range(draw.randint(1, 12)):
        big, is_float = draw.random() < 0.5, draw.random() < 0.1
        length = draw.choice((32, 64)) if is_float else draw.choice((*range(1, 65), 8, 16, 16, 32))
        start = draw.randrange(8 * size)
        if draw.random() < 0.4:
            start = start // 8 * 8 + 7 * big  # at the limit of a byte
        bits = signal_bits(start, length, big)
        if max(bits) >= 8 * size or used & {*bits}:
            continue
        used |= {*bits}
        keys = {
            "start": start,
            "length": length,
            "scale": draw.choice(SCALES),
            "offset": draw.choice(OFFSETS),
        }
        flags = {
            "big_endian": big,
            "floating_point": is_float,
            "signed": not is_float and draw.random() < 0.5,
        }
        text = [f"{key}: {value!r}" for key, value in keys.items()]
        text += [f"{flag}: true" for flag, stated in flags.items() if stated]
        signals.append(f"s{len(signals)}: {{{', '.join(text)}}}")
    return signals


def random_module(draw: random.Random) -> str:
    """Returns the text of a module; some of its frames differ only in the length of the id."""
    lines, known = [], set[tuple[int, bool]]()
    key = (draw.randrange(0x800), False)
    for number in range(FRAMES):
        key = (key[0], not key[1])
        if draw.random() < 0.6 or key in known or (key[0] > 0x7FF and not key[1]):
            extended = draw.random() < 0.5
            key = (draw.randrange(1 << (29 if extended else 11)), extended)
        if key in known:
            continue
        known.add(key)
        size = draw.randint(1, 8)
        extended_key = "extended: true, " if key[1] else ""
        lines.append(
            f"    f{number}: {{cob_id: {key[0]:#x}, {extended_key}kind: broadcast, direction: "
            f"report, length: {size}, period: on_demand, signals: "
            f"{{{', '.join(random_signals(draw, size))}}}}}\n"
        )
    return HEAD + "".join(lines)


def compiled_bus(text: str) -> Bus:
    bench = Bench()
    bench.add("my/device", 1, text=text)
    (bus,) = bench.build()
    assert not list(bench.report), [d.message for d in bench.report]
    return bus


def compare(draw: random.Random, read: Iterable[Callable[[str], Reader]]) -> Iterator[bool]:
    """Yields, for each frame of a random module, whether all readers agree with our codec."""
    bus = compiled_bus(random_module(draw))
    readers = [reader(dbc_text(bus)) for reader in read]
    for frame in bus.frames:
        yield all(_agrees(draw, frame, reader) for reader in readers)


def _agrees(draw: random.Random, frame: FrameDefinition, reader: Reader) -> bool:
    codec, key = FrameCodec(frame), (frame.cob_id, frame.extended)
    for _ in range(SAMPLES):
        data = draw.randbytes(frame.length)
        try:
            ours = codec.decode_named(data)
        except ValueError:
            continue  # a floating-point number that is not finite
        if not _equal(ours, reader.decoders[key](data)):
            return False
        try:
            written = codec.encode_named(ours)
            again = codec.decode_named(written)
        except ValueError:
            continue  # scaled to infinity
        if not _equal(again, reader.decoders[key](written)):
            return False
        if reader.encode_again is not None and reader.encode_again(key, written) != written:
            return False
    return True


def _equal(ours: Mapping[str, float], theirs: Mapping[str, float]) -> bool:
    return ours.keys() == theirs.keys() and all(
        math.isclose(value, float(theirs[name]), rel_tol=1e-12, abs_tol=1e-12)
        for name, value in ours.items()
    )


def read_by_cantools(text: str) -> Reader:
    import cantools.database

    database: Any = cantools.database.load_string(text, "dbc", strict=True)
    messages = {(m.frame_id, m.is_extended_frame): m for m in database.messages}

    def encode_again(key: tuple[int, bool], data: bytes) -> bytes:
        raw = messages[key].decode(data, decode_choices=False, scaling=False)
        encoded: bytes = messages[key].encode(raw, scaling=False, strict=False)
        return encoded

    return Reader({key: message.decode for key, message in messages.items()}, encode_again)
