"""Bits of a frame, compared with an independent count, bit by bit."""

from __future__ import annotations

import itertools
import random

import pytest

from thorvaldc.can.frame import CanFrame
from thorvaldc.can.frame_bits import first_difference, frame_bits
from thorvaldc.model.bus_timing import worst_case_bits


def bits_one_by_one(frame: CanFrame) -> list[int]:
    """Returns the bits that are stuffed: start, header, data and checksum (ISO 11898-1)."""
    bits = [0]

    def put(value: int, count: int) -> None:
        bits.extend(value >> i & 1 for i in reversed(range(count)))

    if frame.extended:
        put(frame.id >> 18, 11)
        put(0b11, 2)
        put(frame.id & 0x3FFFF, 18)
        put(int(frame.remote), 1)
        put(0, 2)
    else:
        put(frame.id, 11)
        put(int(frame.remote), 1)
        put(0, 2)
    put(frame.length, 4)
    for byte in frame.data:
        put(byte, 8)
    crc = 0
    for bit in bits:
        invert = bit ^ crc >> 14
        crc = crc << 1 & 0x7FFF
        if invert:
            crc ^= 0x4599
    put(crc, 15)
    return bits


def reference(frame: CanFrame) -> int:
    count, run, last = 0, 0, -1
    for bit in bits_one_by_one(frame):
        count += 1
        run = run + 1 if bit == last else 1
        last = bit
        if run == 5:
            count += 1
            last, run = 1 - bit, 1
    return count + 1 + 2 + 7 + 3


def random_frames(count: int) -> list[CanFrame]:
    rng = random.Random(11)
    frames = []
    for _ in range(count):
        extended, remote = rng.random() < 0.3, rng.random() < 0.1
        length = rng.randrange(9)
        bytes_ = (rng.choice((0, 255, 0x3C, 0xF0, rng.randrange(256))) for _ in range(length))
        data = b"" if remote else bytes(bytes_)
        identifier = rng.randrange(1 << (29 if extended else 11))
        frames.append(CanFrame(identifier, data, extended, remote, length if remote else 0))
    return frames


def test_bits_match_the_reference() -> None:
    for frame in random_frames(3000):
        assert frame_bits(frame) == reference(frame), frame


def test_no_frame_is_longer_than_the_worst_case() -> None:
    for frame in random_frames(3000):
        assert frame_bits(frame) <= worst_case_bits(len(frame.data), frame.extended)


@pytest.mark.parametrize(
    ("length", "extended", "bits"),
    [(0, False, 55), (1, False, 65), (8, False, 135), (8, True, 160)],
)
def test_worst_case_of_the_textbooks(length: int, extended: bool, bits: int) -> None:
    assert worst_case_bits(length, extended) == bits


def test_the_worst_case_is_a_tight_bound() -> None:
    """Runs of four bits add a stuff bit after every run: within 3 % of the bound."""
    assert max(frame_bits(CanFrame(i, bytes([0x3C] * 8))) for i in range(2048)) > 0.97 * 135


def test_arbitration_orders_frames_as_the_wire_does() -> None:
    frames = random_frames(400)
    for a, b in itertools.pairwise(frames):
        if (a.id, a.extended) == (b.id, b.extended):
            continue
        first, second = (bits_one_by_one(f)[1:33] for f in (a, b))
        # The first bit in which they differ decides: zero is dominant.
        assert (a.arbitration < b.arbitration) == (first < second), (a, b)


def test_first_difference_is_the_index_of_the_first_unequal_bit() -> None:
    one = CanFrame(0x181, bytes([1, 2, 3]))
    for other in (
        CanFrame(0x181, bytes([1, 2, 7])),
        CanFrame(0x181, bytes([0x81, 2, 3])),
        CanFrame(0x181, bytes([1, 2])),
        CanFrame(0x181, bytes(8)),
    ):
        a, b = bits_one_by_one(one), bits_one_by_one(other)
        index = next(i for i, (x, y) in enumerate(zip(a, b, strict=False)) if x != y)
        assert first_difference(one, other) == first_difference(other, one) == index
    assert first_difference(one, one) == 19 + 24
