"""A small CANopen master for tests: it shares no code with the devices."""

from __future__ import annotations

import struct

from thorvaldc.can.frame import CanFrame
from thorvaldc.simulation.bus.virtual_time_interface import VirtualTimeInterface


class Refused(Exception):
    """An SDO transfer was aborted, with this code."""

    def __init__(self, code: int) -> None:
        super().__init__(f"{code:#010x}")
        self.code = code


class Master:
    def __init__(self, client: VirtualTimeInterface) -> None:
        self.client = client

    def wait(self, identifier: int, timeout: float = 0.1) -> bytes | None:
        """The data of the next frame of that identifier; what comes before it is dropped."""
        limit = self.client.now + timeout
        while (left := limit - self.client.now) > 0.0:
            found = self.client.receive(left)
            if found is None:
                return None
            if found.frame.id == identifier:
                return found.frame.data
        return None

    def all(self, identifier: int, time: float) -> list[bytes]:
        """The data of every frame of that identifier for so long."""
        self.client.sleep(time)
        found = [r.frame.data for r in self.client.received if r.frame.id == identifier]
        self.client.received.clear()
        return found

    def send(self, identifier: int, data: bytes) -> None:
        assert self.client.send(CanFrame(identifier, data))

    def ask(self, identifier: int, data: bytes, answer: int) -> bytes:
        self.client.received.clear()
        self.send(identifier, data)
        found = self.wait(answer)
        assert found is not None, "no answer"
        return found

    def nmt(self, command: int, node: int = 0) -> None:
        self.send(0x000, bytes([command, node]))

    def read(self, node: int, index: int, subindex: int = 0) -> bytes:
        """An SDO upload, expedited or in segments."""
        ask = 0x600 + node, 0x580 + node
        reply = self.ask(ask[0], struct.pack("<BHB4x", 0x40, index, subindex), ask[1])
        if reply[0] == 0x80:
            raise Refused(struct.unpack_from("<I", reply, 4)[0])
        assert struct.unpack_from("<HB", reply, 1) == (index, subindex)
        if reply[0] & 2:
            return reply[4 : 8 - (reply[0] >> 2 & 3)]
        size = struct.unpack_from("<I", reply, 4)[0]
        data, toggle = b"", 0
        while True:
            reply = self.ask(ask[0], bytes([0x60 | toggle << 4]) + bytes(7), ask[1])
            if reply[0] == 0x80:
                raise Refused(struct.unpack_from("<I", reply, 4)[0])
            assert reply[0] >> 4 & 1 == toggle
            data += reply[1 : 8 - (reply[0] >> 1 & 7)]
            if reply[0] & 1:
                assert len(data) == size
                return data
            toggle ^= 1

    def number(self, node: int, index: int, subindex: int = 0, signed: bool = False) -> int:
        return int.from_bytes(self.read(node, index, subindex), "little", signed=signed)

    def write(self, node: int, index: int, subindex: int, value: int, size: int) -> None:
        """An expedited SDO download."""
        head = 0x23 | (4 - size) << 2
        data = (value & (1 << 8 * size) - 1).to_bytes(4, "little")
        request = struct.pack("<BHB", head, index, subindex) + data
        reply = self.ask(0x600 + node, request, 0x580 + node)
        if reply[0] == 0x80:
            raise Refused(struct.unpack_from("<I", reply, 4)[0])
        assert reply[0] == 0x60

    def lss(self, command: int, value: int = 0, more: bytes = b"") -> bytes | None:
        """An LSS request; the first answer, if any, with time for the others'."""
        self.client.received.clear()
        self.send(0x7E5, (struct.pack("<BI", command, value) + more).ljust(8, b"\0"))
        answers = self.all(0x7E4, 0.03)
        return answers[0] if answers else None

    def select(self, vendor: int, product: int, revision: int, serial: int) -> bool:
        answer = None
        for command, value in zip(
            range(0x40, 0x44), (vendor, product, revision, serial), strict=True
        ):
            answer = self.lss(command, value)
        return answer is not None and answer[0] == 0x44
