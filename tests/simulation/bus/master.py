"""A small CANopen master for tests.  It shares no code with the simulated devices."""

from __future__ import annotations

import struct

from thorvaldc.can.frame import CanFrame
from thorvaldc.simulation.bus.simulated_robot import VirtualTimeInterface


class Refused(Exception):
    """The node aborted an SDO transfer with this code."""

    def __init__(self, code: int) -> None:
        super().__init__(f"{code:#010x}")
        self.code = code


class Master:
    def __init__(self, interface: VirtualTimeInterface) -> None:
        self.interface = interface

    def wait(self, identifier: int, timeout: float = 0.1) -> bytes | None:
        """Returns the data of the next frame with this identifier; drops earlier frames."""
        limit = self.interface.now + timeout
        while (left := limit - self.interface.now) > 0.0:
            received = self.interface.receive(left)
            if received is None:
                return None
            if received.frame.id == identifier:
                return received.frame.data
        return None

    def all(self, identifier: int, time: float) -> list[bytes]:
        """Returns the data of all frames with this identifier in the next ``time`` s."""
        self.interface.sleep(time)
        data = [r.frame.data for r in self.interface.received if r.frame.id == identifier]
        self.interface.received.clear()
        return data

    def send(self, identifier: int, data: bytes) -> None:
        assert self.interface.send(CanFrame(identifier, data))

    def request(self, identifier: int, data: bytes, answer: int) -> bytes:
        self.interface.received.clear()
        self.send(identifier, data)
        response = self.wait(answer)
        assert response is not None, "no answer"
        return response

    def nmt(self, command: int, node: int = 0) -> None:
        self.send(0x000, bytes([command, node]))

    def read(self, node: int, index: int, subindex: int = 0) -> bytes:
        """Reads an object by SDO, expedited or in segments."""
        ids = 0x600 + node, 0x580 + node
        reply = self.request(ids[0], struct.pack("<BHB4x", 0x40, index, subindex), ids[1])
        if reply[0] == 0x80:
            raise Refused(struct.unpack_from("<I", reply, 4)[0])
        assert struct.unpack_from("<HB", reply, 1) == (index, subindex)
        if reply[0] & 2:
            return reply[4 : 8 - (reply[0] >> 2 & 3)]
        size = struct.unpack_from("<I", reply, 4)[0]
        data, toggle = b"", 0
        while True:
            reply = self.request(ids[0], bytes([0x60 | toggle << 4]) + bytes(7), ids[1])
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
        """Writes an object by expedited SDO download."""
        head = 0x23 | (4 - size) << 2
        data = (value & (1 << 8 * size) - 1).to_bytes(4, "little")
        request = struct.pack("<BHB", head, index, subindex) + data
        reply = self.request(0x600 + node, request, 0x580 + node)
        if reply[0] == 0x80:
            raise Refused(struct.unpack_from("<I", reply, 4)[0])
        assert reply[0] == 0x60

    def lss(self, command: int, value: int = 0, more: bytes = b"") -> bytes | None:
        """Sends an LSS request, waits for all responses, and returns the first."""
        self.interface.received.clear()
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
