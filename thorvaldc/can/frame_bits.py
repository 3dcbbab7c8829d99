"""Length of CAN frames in bits on the bus, with stuff bits and CRC (ISO 11898-1).

The sender of a CAN frame inserts a stuff bit of the opposite value after five equal bits.  The
length of a CAN frame depends on its content, because stuff bits are inserted between the start of
the frame and the end of the CRC.  Fields of standard and extended CAN frames, with the length of
each field in bits:

    standard   SOF  id 11  RTR  IDE  r0  length 4  data  CRC 15 | delimiter 1  ACK 2  EOF 7  IFS 3
    extended   SOF  id 11  SRR  IDE  id 18  RTR  r1  r0  length 4  data  CRC 15 | the same tail
               '---------------- stuffed ----------------------------------'

The function ``frame_bits`` processes whole bytes with lookup tables, because a simulated bus calls
the function for every CAN frame.  Many CAN frames of a simulated bus are equal, so the last results
are kept.
"""

from __future__ import annotations

import functools
from typing import Final

from thorvaldc.can.frame import CanFrame

INTERFRAME_BITS: Final = 3
TAIL_BITS: Final = 10
"""Bits after the stuffed part: CRC delimiter, ACK slot and delimiter, 7 bits of end of frame."""

_POLYNOMIAL: Final = 0x4599
"""Polynomial of the 15-bit CRC without x^15: x^14 + x^10 + x^8 + x^7 + x^4 + x^3 + 1."""


@functools.lru_cache(maxsize=4096)
def frame_bits(frame: CanFrame) -> int:
    """Returns the exact number of bits of a CAN frame, including stuff bits and interframe space.

    The CRC of the CAN frame is computed, because the CRC may also contain stuff bits.
    """
    length = frame.length
    data = b"" if frame.remote else frame.data
    if frame.extended:
        # Header of an extended CAN frame: SOF, upper 11 bits of the identifier, SRR, IDE, lower 18
        # bits of the identifier, RTR, r1, r0, data length code.
        head = (frame.id >> 18) << 27 | 0b11 << 25 | (frame.id & 0x3FFFF) << 7
        head |= int(frame.remote) << 6 | length
        width = 39
    else:
        # Header of a standard CAN frame: SOF, 11 bits of the identifier, RTR, IDE, r0, data length
        # code.
        head = frame.id << 7 | int(frame.remote) << 6 | length
        width = 19
    # The CAN header is padded to whole bytes with leading zero bits, which do not change the CRC.
    crc = 0
    for byte in head.to_bytes(5, "big"):
        crc = (crc << 8 & 0x7FFF) ^ _CRC[crc >> 7 ^ byte]
    for byte in data:
        crc = (crc << 8 & 0x7FFF) ^ _CRC[crc >> 7 ^ byte]
    state, stuffed = _START, 0
    odd = width % 8  # the bits before the first whole byte are counted one by one
    for shift in range(width - 1, width - 1 - odd, -1):
        state, added = _STUFF_BIT[state][head >> shift & 1]
        stuffed += added
    for byte in (head & (1 << (width - odd)) - 1).to_bytes(width // 8, "big"):
        state, added = _STUFF_BYTE[state][byte]
        stuffed += added
    for byte in data:
        state, added = _STUFF_BYTE[state][byte]
        stuffed += added
    state, added = _STUFF_BYTE[state][crc >> 7]
    stuffed += added
    for shift in range(6, -1, -1):
        state, added = _STUFF_BIT[state][crc >> shift & 1]
        stuffed += added
    return width + 8 * len(data) + 15 + stuffed + TAIL_BITS + INTERFRAME_BITS


def first_difference(a: CanFrame, b: CanFrame) -> int:
    """Returns the number of equal bits at the start of two CAN frames with the same identifier.

    Only the bits of the CAN header and the data are counted, without stuff bits.  If two nodes send
    CAN frames with the same identifier at the same time, one node detects a bit error at the first
    bit that differs.
    """
    header = 39 if a.extended else 19
    if a.length != b.length:
        return header - (a.length ^ b.length).bit_length()
    for index, (byte_a, byte_b) in enumerate(zip(a.data, b.data, strict=True)):
        if byte_a != byte_b:
            return header + 8 * index + 8 - (byte_a ^ byte_b).bit_length()
    return header + 8 * len(a.data)


# -- tables -------------------------------------------------------------------------------


def _crc_table() -> tuple[int, ...]:
    table = []
    for byte in range(256):
        crc = byte << 7
        for _ in range(8):
            crc = (crc << 1 ^ _POLYNOMIAL) if crc & 0x4000 else crc << 1
        table.append(crc & 0x7FFF)
    return tuple(table)


# The state of the bit stuffing is stored as the number 2 * (run - 1) + bit: `bit` is the last sent
# bit, and `run` (1 to 4) is the number of equal bits up to the last sent bit.  After the fifth
# equal bit the sender inserts a stuff bit, from which equal bits are counted again.  The bit
# stuffing state `_START` means that no bit of the CAN frame was sent yet.
_START: Final = 8


def _next(state: int, bit: int) -> tuple[int, int]:
    """Returns the next state of the bit stuffing and the number of inserted stuff bits (0 or 1)."""
    last, run = (None, 0) if state == _START else (state & 1, (state >> 1) + 1)
    run = run + 1 if bit == last else 1
    if run == 5:
        return 1 - bit, 1  # the stuff bit is the first bit of the next run
    return 2 * (run - 1) + bit, 0


def _byte_step(state: int, byte: int) -> tuple[int, int]:
    stuffed = 0
    for shift in range(7, -1, -1):
        state, added = _next(state, byte >> shift & 1)
        stuffed += added
    return state, stuffed


_CRC: Final = _crc_table()
_STUFF_BIT: Final = tuple(tuple(_next(state, bit) for bit in (0, 1)) for state in range(9))
_STUFF_BYTE: Final = tuple(
    tuple(_byte_step(state, byte) for byte in range(256)) for state in range(9)
)
