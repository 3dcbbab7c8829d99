"""A CAN frame, and exactly how many bits it takes on the wire (ISO 11898-1, classical frames)."""

from __future__ import annotations

from typing import NamedTuple

INTERFRAME_BITS = 3
TAIL_BITS = 10
"""What follows the stuffed part: CRC delimiter, ACK slot and delimiter, 7 bits of end of frame."""

_POLYNOMIAL = 0x4599

SEND_LIMIT = 32
RECEIVE_LIMIT = 1024


class CanFrame(NamedTuple):
    """A data or remote frame.  ``requested`` is the length that a remote frame asks for."""

    id: int
    data: bytes = b""
    extended: bool = False
    remote: bool = False
    requested: int = 0

    @property
    def length(self) -> int:
        """Data length code: 0 to 8."""
        return self.requested if self.remote else len(self.data)

    @property
    def arbitration(self) -> int:
        """The arbitration field as a number: at the same instant the lowest wins.

        Standard: identifier, RTR, IDE = 0.  Extended: the upper 11 bits, SRR = 1,
        IDE = 1, the lower 18, RTR.
        """
        if self.extended:
            return (self.id >> 18) << 21 | 0b11 << 19 | (self.id & 0x3FFFF) << 1 | int(self.remote)
        return self.id << 21 | int(self.remote) << 20

    def __str__(self) -> str:
        name = f"{self.id:08x}" if self.extended else f"{self.id:03x}"
        return f"{name}#R{self.requested}" if self.remote else f"{name}#{self.data.hex()}"


class ReceivedFrame(NamedTuple):
    """A frame and when (ns) it was complete; ``own``: the program's own, come back."""

    time: int
    frame: CanFrame
    own: bool = False


def worst_case_bits(length: int, extended: bool = False) -> int:
    """Bits of a frame of ``length`` bytes with as much stuffing as can be, interframe space too."""
    stuffed = (54 if extended else 34) + 8 * length
    return stuffed + (stuffed - 1) // 4 + TAIL_BITS + INTERFRAME_BITS


def frame_bits(frame: CanFrame) -> int:
    """Bits of this very frame with its stuff bits, from start of frame to the interframe space.

    Bit for bit as a controller sends it: the checksum is computed and stuffed too.
    """
    length = frame.length
    data = b"" if frame.remote else frame.data
    if frame.extended:
        # SOF, 11 bits, SRR, IDE, 18 bits, RTR, r1, r0, length.
        head = (frame.id >> 18) << 27 | 0b11 << 25 | (frame.id & 0x3FFFF) << 7
        head |= int(frame.remote) << 6 | length
        width = 39
    else:
        # SOF, 11 bits, RTR, IDE, r0, length.
        head = frame.id << 7 | int(frame.remote) << 6 | length
        width = 19
    # Leading zeros do not change the checksum, so that whole bytes can be taken.
    crc = 0
    for byte in head.to_bytes(5, "big"):
        crc = (crc << 8 & 0x7FFF) ^ _CRC[crc >> 7 ^ byte]
    for byte in data:
        crc = (crc << 8 & 0x7FFF) ^ _CRC[crc >> 7 ^ byte]
    state, stuffed = _START, 0
    odd = width % 8  # the bits before the first whole byte, one at a time
    for shift in range(width - 1, width - 1 - odd, -1):
        state, more = _STUFF_BIT[state][head >> shift & 1]
        stuffed += more
    for byte in (head & (1 << (width - odd)) - 1).to_bytes(width // 8, "big"):
        state, more = _STUFF_BYTE[state][byte]
        stuffed += more
    for byte in data:
        state, more = _STUFF_BYTE[state][byte]
        stuffed += more
    state, more = _STUFF_BYTE[state][crc >> 7]
    stuffed += more
    for shift in range(6, -1, -1):
        state, more = _STUFF_BIT[state][crc >> shift & 1]
        stuffed += more
    return width + 8 * len(data) + 15 + stuffed + TAIL_BITS + INTERFRAME_BITS


def first_difference(one: CanFrame, other: CanFrame) -> int:
    """Where two frames of the same identifier part: bits of header and data before it, unstuffed.

    Equal frames give the bits of the whole of both.
    """
    header = 39 if one.extended else 19
    if one.length != other.length:
        unlike = one.length ^ other.length
        return header - unlike.bit_length()
    for place, (a, b) in enumerate(zip(one.data, other.data, strict=True)):
        if a != b:
            return header + 8 * place + 8 - (a ^ b).bit_length()
    return header + 8 * len(one.data)


# -- tables -------------------------------------------------------------------------------


def _crc_table() -> tuple[int, ...]:
    table = []
    for byte in range(256):
        crc = byte << 7
        for _ in range(8):
            crc = (crc << 1 ^ _POLYNOMIAL) if crc & 0x4000 else crc << 1
        table.append(crc & 0x7FFF)
    return tuple(table)


# The state of the stuffing: the last bit sent and how often in a row, as 2 * (run - 1) + bit;
# a run of five is followed by a stuff bit at once.  `_START`: nothing has been sent.
_START = 8


def _next(state: int, bit: int) -> tuple[int, int]:
    last, run = (None, 0) if state == _START else (state & 1, (state >> 1) + 1)
    run = run + 1 if bit == last else 1
    if run == 5:
        return 1 - bit, 1  # the stuff bit is the first of the next run
    return 2 * (run - 1) + bit, 0


def _byte_step(state: int, byte: int) -> tuple[int, int]:
    stuffed = 0
    for shift in range(7, -1, -1):
        state, more = _next(state, byte >> shift & 1)
        stuffed += more
    return state, stuffed


_CRC = _crc_table()
_STUFF_BIT = tuple(tuple(_next(state, bit) for bit in (0, 1)) for state in range(9))
_STUFF_BYTE = tuple(tuple(_byte_step(state, byte) for byte in range(256)) for state in range(9))
