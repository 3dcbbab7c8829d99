"""The LSS services of a device (CiA 305), by the bytes of requests and responses."""

from __future__ import annotations

import struct
from collections.abc import Callable

import pytest

from thorvaldc.can.lss import Identity
from thorvaldc.simulation.bus.sdo_server import LssSlave

IDENTITY = Identity(0x11, 0x22, 0x33, 0x80000001)


class Slave:
    def __init__(self, node_id: int = 255, *, responds: bool = False) -> None:
        self.responses: list[bytes] = []
        self.calls: list[tuple[str, object]] = []
        self.slave = LssSlave(
            IDENTITY,
            self.responses.append,
            lambda: node_id,
            set_id=lambda value: self.calls.append(("id", value)),
            set_bitrate=self._set_bitrate,
            activate=lambda delay: self.calls.append(("activate", delay)),
            store=self._store,
            left=lambda: self.calls.append(("left", None)),
            responds_when_selected=responds,
        )

    def _set_bitrate(self, rate: int) -> bool:
        self.calls.append(("bitrate", rate))
        return rate != 1_000_000

    def _store(self, on_stored: Callable[[int], None]) -> None:
        self.calls.append(("store", None))
        on_stored(2)

    def ask(self, *data: int) -> bytes | None:
        """Returns the response to a request, ``None`` if there is none."""
        self.responses.clear()
        self.slave.request(bytes(data).ljust(8, b"\0"))
        assert len(self.responses) <= 1
        return self.responses[0] if self.responses else None

    def number(self, command: int, number: int) -> bytes | None:
        return self.ask(*struct.pack("<BI", command, number))

    def fastscan(self, number: int, bit: int, part: int, following: int) -> bool:
        response = self.ask(*struct.pack("<BIBBB", 0x51, number, bit, part, following))
        assert response in (None, b"\x4f" + bytes(7))
        return response is not None

    def select(self, identity: Identity = IDENTITY) -> bytes | None:
        responses = [self.number(0x40 + k, number) for k, number in enumerate(identity)]
        assert responses[:3] == [None] * 3
        return responses[3]


def test_requests_of_another_length_are_ignored() -> None:
    slave = Slave()
    for length in (0, 7):
        slave.slave.request(b"\x4c".ljust(length, b"\0")[:length])
    assert slave.responses == []
    assert slave.ask(0x4C) == b"\x50" + bytes(7)


def test_selection_by_identity() -> None:
    slave = Slave()
    for part in range(4):
        wrong = [*IDENTITY]
        wrong[part] ^= 1
        assert slave.select(Identity(*wrong)) is None
        assert not slave.slave.configuring
    for command, number in ((0x40, 0x11), (0x42, 0x33), (0x43, 0x80000001)):  # one is missing
        assert slave.number(command, number) is None
    assert slave.select() == b"\x44" + bytes(7)
    assert slave.slave.configuring
    assert slave.ask(0x5E) == b"\x5e\xff" + bytes(6)
    assert slave.calls == []
    slave.ask(0x04, 0)
    assert slave.calls == [("left", None)]
    slave.ask(0x04, 0)
    assert slave.calls == [("left", None)], "it was waiting"
    assert slave.ask(0x5E) is None
    slave.ask(0x04, 1)
    assert slave.slave.configuring


@pytest.mark.parametrize(
    ("ranges", "identified"),
    [
        ((0x11, 0x22, 0x33, 0x33, 0x80000001, 0x80000001), True),
        ((0x11, 0x22, 0, 0xFFFF, 0, 0xFFFFFFFF), True),
        ((0x12, 0x22, 0, 0xFFFF, 0, 0xFFFFFFFF), False),
        ((0x11, 0x23, 0, 0xFFFF, 0, 0xFFFFFFFF), False),
        ((0x11, 0x22, 0x34, 0xFFFF, 0, 0xFFFFFFFF), False),
        ((0x11, 0x22, 0, 0x32, 0, 0xFFFFFFFF), False),
        ((0x11, 0x22, 0, 0xFFFF, 0x80000002, 0xFFFFFFFF), False),
        ((0x11, 0x22, 0, 0xFFFF, 0, 0x80000000), False),
    ],
)
def test_identification_by_ranges(ranges: tuple[int, ...], identified: bool) -> None:
    slave = Slave()
    for _ in range(2):
        responses = [slave.number(0x46 + k, number) for k, number in enumerate(ranges)]
        assert responses[:5] == [None] * 5
        assert responses[5] == (b"\x4f" + bytes(7) if identified else None)


def test_identification_without_node_id() -> None:
    assert Slave(255).ask(0x4C) == b"\x50" + bytes(7)
    assert Slave(5).ask(0x4C) is None


def test_fastscan() -> None:
    slave = Slave()
    assert slave.fastscan(0, 0x80, 0, 0)
    assert slave.fastscan(0, 31, 0, 0)
    assert not slave.fastscan(0x80000000, 31, 0, 0)
    assert not slave.fastscan(0, 32, 0, 0)
    assert not slave.fastscan(0x22, 0, 1, 1), "part 0 comes first"
    for part, number in enumerate(IDENTITY[:3]):
        assert slave.fastscan(number & ~3, 2, part, part)
        assert not slave.fastscan(number ^ 1, 0, part, part + 1)
        assert slave.fastscan(number, 0, part, part + 1)
    assert slave.fastscan(0x80000000, 31, 3, 3)
    assert not slave.fastscan(0, 31, 3, 3)
    assert slave.fastscan(0x80000001, 0, 3, 3)
    assert not slave.slave.configuring
    assert not slave.fastscan(0, 0, 4, 4)
    assert slave.fastscan(0x80000001, 0, 3, 0)
    assert slave.slave.configuring
    assert not slave.fastscan(0, 0x80, 0, 0), "it is selected"
    assert not Slave(5).fastscan(0, 0x80, 0, 0), "it has a node id"


def test_a_selected_slave_that_responds_to_every_request() -> None:
    slave = Slave(responds=True)
    slave.select()
    assert slave.fastscan(0x12345678, 0, 2, 3)
    assert slave.number(0x43, 0) == b"\x44" + bytes(7)
    assert slave.number(0x42, 0) is None


@pytest.mark.parametrize(
    ("node_id", "valid"), [(0, False), (1, True), (127, True), (128, False), (255, True)]
)
def test_node_id(node_id: int, valid: bool) -> None:
    slave = Slave()
    assert slave.ask(0x11, node_id) is None, "it is waiting"
    slave.select()
    assert slave.ask(0x11, node_id) == bytes([0x11, 0 if valid else 1, 0, 0, 0, 0, 0, 0])
    assert slave.calls == ([("id", node_id)] if valid else [])


def test_bit_timing_storing_and_inquiries() -> None:
    slave = Slave()
    slave.select()
    assert slave.ask(0x13, 0, 2) == b"\x13" + bytes(7)
    assert slave.calls.pop() == ("bitrate", 500_000)
    assert slave.ask(0x13, 0, 0) == b"\x13\x01" + bytes(6), "the device does not support it"
    assert slave.calls.pop() == ("bitrate", 1_000_000)
    for table, index in ((1, 2), (0, 5), (0, 9)):
        assert slave.ask(0x13, table, index) == b"\x13\x01" + bytes(6)
    assert slave.calls == []
    assert slave.ask(0x15, 0xE8, 0x03) is None
    assert slave.calls.pop() == ("activate", 1.0)
    assert slave.ask(0x17) == b"\x17\x02" + bytes(6)
    for k, number in enumerate(IDENTITY):
        assert slave.ask(0x5A + k) == struct.pack("<BI3x", 0x5A + k, number)
