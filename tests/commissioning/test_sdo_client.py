"""SDO transfers with a node of this test: segments, aborts, frames of others."""

from __future__ import annotations

import struct

import pytest

from tests.commissioning.bench import four_drives
from thorvaldc.can.frame import CanFrame
from thorvaldc.commissioning.bus_master import BusMaster, SdoAborted, SdoClient, SdoTimeout, Timing
from thorvaldc.simulation.bus.simulated_robot import VirtualTimeInterface
from thorvaldc.simulation.bus.timeline import Timeline
from thorvaldc.simulation.bus.wire import Wire

NODE = 5
NAME = 0x1008


class Server:
    """A node whose name is read in segments; ``abort_at``: index of the segment it aborts."""

    def __init__(self, text: bytes, abort_at: int = 1000) -> None:
        self.wire = Wire(Timeline())
        self.sender = VirtualTimeInterface(self.wire, "node")
        self.text, self.abort_at = text, abort_at
        self.segments = 0
        self.wire.observers.append(self.take)

    def client(self) -> SdoClient:
        interface = VirtualTimeInterface(self.wire, "master")
        interface.sleep(0.001)
        return SdoClient(BusMaster(interface, four_drives().buses[0], Timing()))

    def respond(self, data: bytes) -> None:
        self.sender.send(CanFrame(0x580 + NODE, data.ljust(8, b"\0")))

    def take(self, time: int, frame: CanFrame, senders: object) -> None:
        if frame.id != 0x600 + NODE:
            return
        if frame.data[0] == 0x40:
            self.respond(struct.pack("<BHBI", 0x41, NAME, 0, len(self.text)))
        elif self.segments == self.abort_at:
            self.respond(struct.pack("<BHBI", 0x80, NAME, 0, 0x08000022))
        else:
            start = 7 * self.segments
            part = self.text[start : start + 7]
            self.segments += 1
            assert frame.data[0] == 0x60 | (self.segments - 1 & 1) << 4
            last = start + 7 >= len(self.text)
            command = frame.data[0] & 0x10 | (7 - len(part)) << 1 | last
            self.respond(bytes([command]) + part)


@pytest.mark.parametrize("length", [5, 7, 8, 40])
def test_a_text_is_read_in_segments(length: int) -> None:
    server = Server(bytes(range(65, 65 + length)))
    assert server.client().read_text(NODE, NAME) == server.text.decode()


def test_an_abort_in_a_segment_is_an_error() -> None:
    with pytest.raises(SdoAborted) as raised:
        Server(b"a text of some length", abort_at=1).client().read_text(NODE, NAME)
    assert raised.value.code == 0x08000022
    (response,) = (
        Server(b"another text", abort_at=0).client().upload_all(NODE, NAME, 0, timeout=0.1)
    )
    assert response.abort == 0x08000022


def test_the_client_stops_reading_a_text_without_end() -> None:
    server = Server(b"x" * 10_000)
    assert server.client().read_text(NODE, NAME) == "x" * 259  # 37 segments of 7 bytes
    assert server.segments == 37


def test_a_first_response_to_another_object_is_not_taken() -> None:
    server = Server(b"a text of some length")
    client = server.client()
    with pytest.raises(SdoTimeout):
        client.read_number(NODE, 0x1000, 0, "unsigned32")
    assert client.upload_all(NODE, 0x1000, 0, timeout=0.1) == []


def test_two_nodes_respond_with_lengths_or_aborts() -> None:
    server = Server(b"a text of some length")
    spare = VirtualTimeInterface(server.wire, "spare")
    spare_data = [0x41]

    def respond(time: int, frame: CanFrame, senders: object) -> None:
        if frame.id == 0x600 + NODE:
            data = struct.pack("<BHBI", spare_data[0], NAME, 0, 0x06020000)
            spare.send(CanFrame(0x580 + NODE, data))

    server.wire.observers.append(respond)
    client = server.client()
    lengths = client.upload_all(NODE, NAME, 0, timeout=0.1)
    assert sorted(r.data for r in lengths) == [bytes([0, 0, 2, 6]), bytes([21, 0, 0, 0])]
    spare_data[0] = 0x80
    aborts = client.upload_all(NODE, NAME, 0, timeout=0.1)
    assert {r.abort for r in aborts} == {None, 0x06020000}
