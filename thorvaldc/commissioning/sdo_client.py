"""The client's side of SDO transfers (CiA 301), which counts every answer."""

from __future__ import annotations

import struct
from dataclasses import dataclass

from thorvaldc.can.frame import CanFrame
from thorvaldc.commissioning.bus_master import SDO_REQUEST, SDO_RESPONSE, BusMaster
from thorvaldc.model.bus import OBJECT_TYPES

_TEXTS = {
    0x06010001: "it can only be written",
    0x06010002: "it can only be read",
    0x06020000: "there is no such object",
    0x06040041: "the object cannot be mapped",
    0x06040042: "the mapping is too long",
    0x06070010: "the length is wrong",
    0x06090011: "there is no such subindex",
    0x06090030: "the value is out of range",
    0x08000020: "it cannot be stored",
    0x08000022: "not in the present state",
}


class SdoAborted(Exception):
    """The node aborted the transfer."""

    def __init__(self, code: int) -> None:
        super().__init__(f"{_TEXTS.get(code, 'refused')} ({code:#010x})")
        self.code = code


class SdoTimeout(Exception):
    """The node did not answer in time."""

    def __init__(self) -> None:
        super().__init__("no answer")


class SdoMultipleResponses(Exception):
    """More than one node answered."""

    def __init__(self, count: int) -> None:
        super().__init__(f"{count} answers to one request")


@dataclass(frozen=True, slots=True)
class Answer:
    """One node's answer to an upload: its value, or the abort code."""

    data: bytes = b""
    abort: int | None = None


class SdoClient:
    def __init__(self, master: BusMaster) -> None:
        self.master = master

    def every(self, node: int, index: int, subindex: int, *, timeout: float) -> list[Answer]:
        """Every answer to one request to read a number; text comes as its length."""
        request = struct.pack("<BHB4x", 0x40, index, subindex)
        frames = self._ask(node, request, timeout, self.master.timing.settle)
        return [_answer(frame.data) for frame in frames]

    def number(self, node: int, index: int, subindex: int, type_name: str) -> int:
        """Raises ``SdoAborted``, ``SdoTimeout`` or ``SdoMultipleResponses``."""
        request = struct.pack("<BHB4x", 0x40, index, subindex)
        answer = _answer(self._one(node, request))
        if answer.abort is not None:
            raise SdoAborted(answer.abort)
        bits = OBJECT_TYPES[type_name][1]
        length = max(bits // 8, 1)
        data = answer.data[:length].ljust(length, b"\0")
        return int.from_bytes(data, "little", signed=type_name.startswith("integer"))

    def text(self, node: int, index: int) -> str:
        """As ``number``, of a text of any length."""
        reply = self._one(node, struct.pack("<BHB4x", 0x40, index, 0))
        if reply[0] == 0x80:
            raise SdoAborted(struct.unpack_from("<I", reply, 4)[0])
        if reply[0] & 2:
            return _answer(reply).data.decode("latin-1").rstrip("\0")
        data, toggle = b"", 0
        while len(data) < 256:
            reply = self._one(node, bytes([0x60 | toggle << 4]) + bytes(7), segment=True)
            if reply[0] == 0x80:
                raise SdoAborted(struct.unpack_from("<I", reply, 4)[0])
            data += reply[1 : 8 - (reply[0] >> 1 & 7)]
            if reply[0] & 1:
                break
            toggle ^= 1
        return data.decode("latin-1").rstrip("\0")

    def write(
        self,
        node: int,
        index: int,
        subindex: int,
        type_name: str,
        value: int,
        timeout: float | None = None,
    ) -> None:
        """An expedited download.  Raises as ``number`` does."""
        size = max(OBJECT_TYPES[type_name][1] // 8, 1)
        data = (value & (1 << 8 * size) - 1).to_bytes(4, "little")
        head = 0x23 | (4 - size) << 2
        reply = self._one(node, struct.pack("<BHB", head, index, subindex) + data, timeout)
        if reply[0] == 0x80:
            raise SdoAborted(struct.unpack_from("<I", reply, 4)[0])

    # -- inside -----------------------------------------------------------------------------

    def _one(
        self, node: int, request: bytes, timeout: float | None = None, segment: bool = False
    ) -> bytes:
        """The one answer.  A second that comes later is in nobody's way: it fits no request."""
        frames = self._ask(node, request, timeout or self.master.timing.sdo, 0.0, segment)
        if not frames:
            raise SdoTimeout
        if len(frames) > 1:
            raise SdoMultipleResponses(len(frames))
        return frames[0].data

    def _ask(
        self,
        node: int,
        request: bytes,
        timeout: float,
        settle: float,
        segment: bool = False,
    ) -> list[CanFrame]:
        answer, place = SDO_RESPONSE + node, request[1:4]

        def fits(frame: CanFrame) -> bool:
            if frame.id != answer or len(frame.data) != 8:
                return False
            return segment or frame.data[1:4] == place

        return self.master.ask(SDO_REQUEST + node, request, fits, timeout, settle)


def _answer(data: bytes) -> Answer:
    if data[0] == 0x80:
        return Answer(abort=struct.unpack_from("<I", data, 4)[0])
    if data[0] & 2:
        return Answer(data[4 : 8 - (data[0] >> 2 & 3)] if data[0] & 1 else data[4:8])
    return Answer(data[4:8])
