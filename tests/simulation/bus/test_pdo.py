"""PDOs of a device: transmission types, timers, inhibit times, and writes to the configuration."""

from __future__ import annotations

import struct

import pytest

from thorvaldc.can.frame import CanFrame
from thorvaldc.can.sdo import AbortCode
from thorvaldc.simulation.bus.object_dictionary import Entry, ObjectDictionary, SdoAbort
from thorvaldc.simulation.bus.process_data import Pdo, PdoSet

WORD, BYTE = (0x2000, 1, 16), (0x2000, 2, 8)
OFF = 1 << 31


class Device:
    def __init__(self, transmission: int, event_ms: int = 0) -> None:
        self.objects = ObjectDictionary()
        self.word = Entry("u16", 0x1234, "rw")
        self.byte = Entry("u8", 7, "rw", upper=100)
        self.objects.add_record(0x2000, self.word, self.byte)
        self.objects.add(0x2001, 0, Entry("text", "name"))
        self.frames: list[tuple[int, bytes]] = []
        self.pdos = PdoSet(
            self.objects,
            [Pdo(1, 0x201, transmission, (WORD, (5, 0, 8), BYTE))],
            [Pdo(2, 0x281, transmission, (BYTE, WORD), event_ms)],
            lambda identifier, data: self.frames.append((identifier, data)),
        )

    def write(self, index: int, subindex: int, value: int) -> None:
        size = self.objects[index, subindex].size
        self.objects.download(index, subindex, value.to_bytes(size, "little"))

    def sent_at(self, *times: float) -> list[float]:
        """Returns the times of ``times`` at which the TPDO is sent."""
        sent = []
        for time in times:
            count = len(self.frames)
            self.pdos.tick(time)
            sent += [time] * (len(self.frames) - count)
        return sent


def refused(device: Device, index: int, subindex: int, value: int) -> int:
    with pytest.raises(SdoAbort) as raised:
        device.write(index, subindex, value)
    return raised.value.code


@pytest.mark.parametrize("transmission", [241, 254, 255])
def test_event_driven_values_apply_immediately(transmission: int) -> None:
    device = Device(transmission)
    assert device.pdos.cob_ids() == [0x201]
    assert not device.pdos.receive(CanFrame(0x202, bytes(4)))
    assert not device.pdos.receive(CanFrame(0x201, bytes(3))), "too short"
    assert device.pdos.receive(CanFrame(0x201, bytes([0xCD, 0xAB, 0xFF, 9, 0xEE])))
    assert (device.word.value, device.byte.value) == (0xABCD, 9)
    device.pdos.receive(CanFrame(0x201, bytes([1, 0, 0, 101])))
    assert (device.word.value, device.byte.value) == (1, 9), "101 is out of range"


@pytest.mark.parametrize("transmission", [0, 1, 240])
def test_synchronous_values_apply_at_the_sync(transmission: int) -> None:
    device = Device(transmission)
    assert device.pdos.receive(CanFrame(0x201, bytes([1, 0, 0, 2])))
    assert (device.word.value, device.byte.value) == (0x1234, 7)
    device.pdos.synchronise()
    assert (device.word.value, device.byte.value) == (1, 2)
    device.word.value = 5
    device.pdos.synchronise()
    assert device.word.value == 5
    assert device.sent_at(1.0, 2.0) == []


def test_synchronous_transmission() -> None:
    device = Device(3)
    for _ in range(7):
        device.pdos.synchronise()
    assert device.frames == [(0x281, b"\x07\x34\x12")] * 2
    device = Device(0)
    for value in (1, 1, 2, 2, 2, 1):
        device.byte.value = value
        device.pdos.synchronise()
    assert [data[0] for _, data in device.frames] == [1, 2, 1]
    device = Device(255)
    device.pdos.synchronise()
    assert device.frames == []


def test_event_timer() -> None:
    device = Device(255, event_ms=20)
    assert device.pdos.sent[0].event_period == 0.02
    times = [0.005 * k for k in range(13)]
    assert device.sent_at(*times) == pytest.approx([0.0, 0.02, 0.04, 0.06])
    assert device.sent_at(0.085, 0.1, 0.12, 0.2, 0.215, 0.22) == [0.085, 0.1, 0.12, 0.2, 0.22]
    device.pdos.sent[0].event.value = 50
    assert device.pdos.sent[0].event_period == 0.05
    device.write(0x1801, 1, OFF | 0x281)
    assert device.pdos.sent[0].event_period == 0.0
    assert device.sent_at(9.0) == []
    device.pdos.send_now(0)
    count = len(device.frames)
    device.write(0x1801, 1, 0x281)
    device.pdos.send_now(0)
    assert len(device.frames) == count + 1


def test_a_change_is_sent_not_before_the_inhibit_time() -> None:
    device = Device(255)
    device.write(0x1801, 3, 500)  # 50 ms
    assert device.sent_at(1.0, 1.01) == [1.0]
    device.byte.value = 8
    assert device.sent_at(1.02, 1.049, 1.05, 1.2) == [1.05]


def test_configuration_needs_a_pdo_that_is_switched_off() -> None:
    device = Device(255)
    assert refused(device, 0x1801, 1, 0x282) == AbortCode.STATE_REFUSED
    assert refused(device, 0x1A01, 0, 0) == AbortCode.STATE_REFUSED
    assert refused(device, 0x1A01, 1, 0x20000110) == AbortCode.STATE_REFUSED
    device.write(0x1801, 1, OFF | 0x282)
    assert device.pdos.sent[0].cob_id is None
    assert refused(device, 0x1A01, 1, 0x20000110) == AbortCode.STATE_REFUSED, "the number is not 0"
    device.write(0x1A01, 0, 0)
    assert refused(device, 0x1A01, 1, 0x20010008) == AbortCode.NOT_MAPPABLE
    assert refused(device, 0x1A01, 1, 0x20020008) == AbortCode.NOT_MAPPABLE
    for slot in (1, 2, 3, 4, 5):
        device.write(0x1A01, slot, 0x20000110)
    assert refused(device, 0x1A01, 0, 5) == AbortCode.MAPPING_TOO_LONG
    assert refused(device, 0x1A01, 0, 9) == AbortCode.VALUE_RANGE
    device.write(0x1A01, 0, 4)
    device.write(0x1801, 1, 0x282)
    device.pdos.send_now(0)
    assert device.frames == [(0x282, struct.pack("<4H", *[0x1234] * 4))]


def test_objects_of_a_pdo() -> None:
    device = Device(1, event_ms=30)
    values = {
        (0x1400, 0): 5,
        (0x1400, 1): 0x201,
        (0x1400, 2): 1,
        (0x1400, 3): 0,
        (0x1400, 5): 0,
        (0x1600, 0): 3,
        (0x1600, 1): 0x20000110,
        (0x1600, 2): 0x00050008,
        (0x1600, 3): 0x20000208,
        (0x1600, 8): 0,
        (0x1801, 1): 0x281,
        (0x1801, 5): 30,
        (0x1A01, 0): 2,
        (0x1A01, 1): 0x20000208,
    }
    assert {key: device.objects[key].value for key in values} == values
    assert (0x1600, 9) not in device.objects
    stored = set(device.objects.parameters())
    assert {"1400.01", "1400.02", "1400.03", "1400.05", "1600.00", "1600.08"} <= stored
