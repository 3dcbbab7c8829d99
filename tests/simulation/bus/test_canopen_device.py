"""CANopen devices: NMT states, heartbeats, SDO, emergencies, LSS and storing."""

from __future__ import annotations

import struct
from typing import Any

import pytest

from tests.simulation.bus.master import Master, Refused
from tests.simulation.bus.specifications import specification
from thorvaldc.can.canopen import NmtState
from thorvaldc.simulation.bus.canopen_device import CanopenDevice
from thorvaldc.simulation.bus.simulated_robot import VirtualTimeInterface
from thorvaldc.simulation.bus.timeline import Timeline
from thorvaldc.simulation.bus.wire import Wire

RATE = 500_000
SAVE, LOAD = 0x65766173, 0x64616F6C
NAME = "a name that takes more than one segment"


class NamedDevice(CanopenDevice):
    """A CANopen device with a long name."""

    device_name = NAME


def device_on(wire: Wire, node: int, serial: int | None = 0x1001, **more: Any) -> NamedDevice:
    numbers = {"vendor_id": 0x469, "product_code": 2, "revision_number": 3, "device_type": 0x192}
    memory = {} if serial is None else {"serial": hex(serial)}
    return NamedDevice(
        specification(
            wire, node, heartbeat=0.1, nonvolatile=memory, lss=serial is not None, **numbers, **more
        )
    )


class Bench:
    """A wire with a master and one device for each id."""

    def __init__(self, *ids: int, **more: Any) -> None:
        self.wire = Wire(Timeline(), RATE)
        self.master = Master(VirtualTimeInterface(self.wire, "master"))
        self.devices = [
            device_on(self.wire, node, 0x1001 + i, name=f"d{i}", **more)
            for i, node in enumerate(ids)
        ]
        for device in self.devices:
            device.power_on()
        self.boots = self.sleep(0.15)

    def sleep(self, seconds: float) -> list[tuple[int, bytes]]:
        """Lets time run; returns identifier and data of the frames received meanwhile."""
        self.master.interface.sleep(seconds)
        frames = [(r.frame.id, r.frame.data) for r in self.master.interface.received]
        self.master.interface.received.clear()
        return frames


def test_boot_up_then_heartbeats() -> None:
    bench = Bench(5)
    assert bench.boots == [(0x705, b"\0")]
    beats = bench.sleep(1.0)
    assert beats == [(0x705, b"\x7f")] * 10
    bench.master.nmt(1, 5)
    assert bench.sleep(0.1)[-1] == (0x705, b"\5")
    bench.master.nmt(2)
    assert bench.sleep(0.1)[-1] == (0x705, b"\4")
    bench.master.nmt(1, 6)
    assert bench.sleep(0.1)[-1] == (0x705, b"\4"), "the command is for another node"
    bench.master.nmt(129, 5)
    assert bench.sleep(0.25)[:1] == [(0x705, b"\0")], "it boots again"


def test_heartbeat_period_is_an_object() -> None:
    bench = Bench(5)
    assert bench.master.number(5, 0x1017) == 100
    bench.master.write(5, 0x1017, 0, 20, 2)
    bench.sleep(0.2)
    assert len(bench.sleep(1.0)) == 50
    bench.master.write(5, 0x1017, 0, 0, 2)
    bench.sleep(0.1)
    assert bench.sleep(1.0) == []


def test_sdo_reads_small_and_large() -> None:
    bench = Bench(5)
    assert bench.master.number(5, 0x1000) == 0x192
    assert [bench.master.number(5, 0x1018, i) for i in range(5)] == [4, 0x469, 2, 3, 0x1001]
    assert bench.master.read(5, 0x1008) == NAME.encode()


@pytest.mark.parametrize(
    ("index", "subindex", "value", "size", "code"),
    [
        (0x1000, 0, 1, 4, 0x06010002),  # read only
        (0x2345, 0, 1, 4, 0x06020000),  # no such object
        (0x1017, 7, 1, 2, 0x06090011),  # no such subindex
        (0x1017, 0, 1, 4, 0x06070010),  # too long
        (0x1029, 1, 9, 1, 0x06090030),  # out of range
        (0x1010, 1, 1, 4, 0x08000020),  # not the signature
    ],
)
def test_sdo_aborts_with_the_code_of_the_standard(
    index: int, subindex: int, value: int, size: int, code: int
) -> None:
    bench = Bench(5)
    with pytest.raises(Refused) as refused:
        bench.master.write(5, index, subindex, value, size)
    assert refused.value.code == code


def test_sdo_block_transfer_is_refused_with_its_code() -> None:
    bench = Bench(5)
    reply = bench.master.request(0x605, struct.pack("<BHB4x", 0xA0, 0x1008, 0), 0x585)
    assert reply[0] == 0x80
    assert struct.unpack_from("<I", reply, 4)[0] == 0x05040001


def test_a_stopped_node_does_not_answer_sdo() -> None:
    bench = Bench(5)
    bench.master.nmt(2, 5)
    bench.sleep(0.01)
    bench.master.send(0x605, struct.pack("<BHB4x", 0x40, 0x1000, 0))
    assert bench.master.wait(0x585) is None


def test_parameters_survive_only_when_they_are_saved() -> None:
    bench = Bench(5)
    bench.master.write(5, 0x1017, 0, 250, 2)
    bench.devices[0].power_off()
    bench.devices[0].power_on()
    bench.sleep(0.2)
    assert bench.master.number(5, 0x1017) == 100
    bench.master.write(5, 0x1017, 0, 250, 2)
    bench.master.write(5, 0x1010, 1, SAVE, 4)
    bench.devices[0].power_off()
    bench.devices[0].power_on()
    bench.sleep(0.2)
    assert bench.master.number(5, 0x1017) == 250
    bench.master.write(5, 0x1011, 1, LOAD, 4)
    assert bench.master.number(5, 0x1017) == 250, "restored by the next reset, not before"
    bench.master.nmt(129)
    bench.sleep(0.2)
    assert bench.master.number(5, 0x1017) == 100


def test_the_response_to_save_follows_the_write() -> None:
    bench = Bench(5)
    start = bench.master.interface.now
    bench.master.write(5, 0x1010, 1, SAVE, 4)
    assert bench.master.interface.now - start > bench.devices[0].write_time


@pytest.mark.parametrize("torn", [False, True])
def test_power_lost_while_writing(torn: bool) -> None:
    """The memory contains the old values, or none with torn writes."""
    bench = Bench(5)
    device = bench.devices[0]
    device.torn_writes = torn
    device.store({"node_id": 9})
    bench.sleep(device.write_time / 2)
    device.power_off()
    device.power_on()
    assert (0x705, b"\0") in bench.sleep(0.2) or torn
    assert device.node_id == (255 if torn else 5)


def test_heartbeat_consumer() -> None:
    bench = Bench(5, 6)
    device = bench.devices[0]
    bench.master.write(5, 0x1016, 1, 6 << 16 | 250, 4)
    bench.master.nmt(1)
    bench.sleep(1.0)
    assert device.state is NmtState.OPERATIONAL
    bench.devices[1].heartbeat_stopped = True
    at = bench.master.interface.now
    emergency = bench.master.wait(0x085, 1.0)
    assert emergency is not None
    assert struct.unpack_from("<H", emergency)[0] == 0x8130
    assert 0.15 < bench.master.interface.now - at < 0.30
    assert device.state is NmtState.PRE_OPERATIONAL, "default of 0x1029"
    assert bench.master.number(5, 0x1001) & 0x10


def test_0x1029_defines_the_reaction_to_a_lost_heartbeat() -> None:
    for reaction, state in ((1, NmtState.OPERATIONAL), (2, NmtState.STOPPED)):
        bench = Bench(5, 6)
        bench.master.write(5, 0x1029, 1, reaction, 1)
        bench.master.write(5, 0x1016, 1, 6 << 16 | 250, 4)
        bench.master.nmt(1)
        bench.sleep(0.3)
        bench.devices[1].power_off()
        bench.sleep(0.5)
        assert bench.devices[0].state is state


def test_errors_are_reported_and_recorded() -> None:
    bench = Bench(5)
    bench.devices[0].emergency(0x3210, 0x04, b"\x11\x22")
    emergency = bench.master.wait(0x085)
    assert emergency == b"\x10\x32\x05\x11\x22\0\0\0"
    assert bench.master.number(5, 0x1003, 0) == 1
    assert bench.master.number(5, 0x1003, 1) == 0x3210
    bench.devices[0].emergency(0)
    assert bench.master.wait(0x085) == bytes(8)
    bench.master.write(5, 0x1003, 0, 0, 1)
    assert bench.master.number(5, 0x1003, 0) == 0


def test_bus_off_and_back() -> None:
    bench = Bench(5, 6)
    bench.master.nmt(1)
    bench.sleep(0.05)
    bench.devices[0].controller.go_bus_off()
    emergencies = [data for identifier, data in bench.sleep(0.1) if identifier == 0x085]
    assert [struct.unpack_from("<H", data)[0] for data in emergencies] == [0x8140]
    assert bench.devices[0].state is NmtState.PRE_OPERATIONAL


def test_two_nodes_with_one_id_answer_twice_and_without_an_error() -> None:
    """Duplicates cause no error on the bus: other nodes answer once, this id twice."""
    bench = Bench(5, 6, 6)
    assert sorted(bench.boots) == [(0x705, b"\0"), (0x706, b"\0"), (0x706, b"\0")]
    answers = {}
    for node in (5, 6):
        for subindex in (1, 4):
            bench.master.send(0x600 + node, struct.pack("<BHB4x", 0x40, 0x1018, subindex))
            answers[node, subindex] = bench.master.all(0x580 + node, 0.02)
    assert [len(answers[5, i]) for i in (1, 4)] == [1, 1]
    assert len(answers[6, 1]) == 2, "equal, but rarely at the same time"
    serials = [struct.unpack_from("<I", data, 4)[0] for data in answers[6, 4]]
    assert sorted(serials) == [0x1002, 0x1003], "an identity that changes"
    assert bench.wire.errors == 0
    beats = [identifier for identifier, _ in bench.sleep(1.0)]
    assert beats.count(0x706) == 2 * beats.count(0x705)


# -- LSS ------------------------------------------------------------------------------------


def test_an_lss_id_takes_effect_at_the_reset_and_survives_when_stored() -> None:
    bench = Bench(5, 6)
    master, device = bench.master, bench.devices[0]
    assert not master.select(0x469, 2, 3, 0x9999)
    assert master.select(0x469, 2, 3, 0x1001)
    assert master.lss(0x5E) == b"\x5e\x05" + bytes(6)
    assert master.lss(0x5D) == b"\x5d" + struct.pack("<I", 0x1001) + bytes(3)
    assert master.lss(0x11, 200) == b"\x11\x01" + bytes(6), "not a valid id"
    assert master.lss(0x11, 7) == b"\x11\x00" + bytes(6)
    assert device.node_id == 5, "pending"
    assert master.lss(0x17) == b"\x17\x00" + bytes(6)
    master.lss(0x04, 0)
    assert master.number(5, 0x1018, 4) == 0x1001
    bench.master.nmt(130, 5)
    assert (0x707, b"\0") in bench.sleep(0.2)
    device.power_off()
    device.power_on()
    assert (0x707, b"\0") in bench.sleep(0.2)


def test_an_id_that_is_not_stored_is_lost_with_the_power() -> None:
    bench = Bench(5)
    assert bench.master.select(0x469, 2, 3, 0x1001)
    bench.master.lss(0x11, 7)
    bench.master.lss(0x04, 0)
    bench.master.nmt(130, 0)
    bench.sleep(0.1)
    assert bench.devices[0].node_id == 7
    bench.devices[0].power_off()
    bench.devices[0].power_on()
    bench.sleep(0.2)
    assert bench.devices[0].node_id == 5


def test_an_unconfigured_node_is_silent_and_its_first_id_needs_no_reset() -> None:
    bench = Bench(255)
    assert bench.boots == []
    assert bench.master.lss(0x4C) == b"\x50" + bytes(7)
    bench.master.lss(0x04, 1)
    bench.master.lss(0x11, 9)
    bench.master.send(0x7E5, b"\x04" + bytes(7))
    assert (0x709, b"\0") in bench.sleep(0.1)
    assert bench.master.lss(0x4C) is None


def test_identify_by_ranges() -> None:
    bench = Bench(5)
    master = bench.master

    def identify(low: int, high: int) -> bool:
        master.lss(0x46, 0x469)
        master.lss(0x47, 2)
        master.lss(0x48, 0)
        master.lss(0x49, 9)
        master.lss(0x4A, low)
        return master.lss(0x4B, high) == b"\x4f" + bytes(7)

    assert identify(0x1000, 0x2000)
    assert not identify(0x1002, 0x2000)
    assert not identify(0, 0x1000)


def fastscan(master: Master) -> list[int] | None:
    """Finds the lowest of all identities bit by bit (CiA 305)."""

    def request(number: int, bit: int, part: int, following: int) -> bool:
        more = bytes([bit, part, following])
        return master.lss(0x51, number, more) == b"\x4f" + bytes(7)

    if not request(0, 0x80, 0, 0):
        return None
    numbers = []
    for part in range(4):
        number = 0
        for bit in reversed(range(32)):
            if not request(number, bit, part, part):
                number |= 1 << bit
        assert request(number, 0, part, (part + 1) % 4)
        numbers.append(number)
    return numbers


def test_fastscan_finds_unconfigured_nodes_one_by_one() -> None:
    bench = Bench(255, 7, 255)
    identities = []
    for node_id in (11, 12):
        identity = fastscan(bench.master)
        assert identity is not None
        identities.append(identity)
        assert bench.master.lss(0x5E) == b"\x5e\xff" + bytes(6), "exactly one is in configuration"
        bench.master.lss(0x11, node_id)
        bench.master.lss(0x04, 0)
        bench.sleep(0.05)
    assert fastscan(bench.master) is None
    assert identities == [[0x469, 2, 3, 0x1001], [0x469, 2, 3, 0x1003]]
    assert [device.node_id for device in bench.devices] == [11, 7, 12]


def test_all_devices_change_the_bitrate_at_the_same_time() -> None:
    bench = Bench(5, 6)
    master = bench.master
    master.lss(0x04, 1)
    master.send(0x7E5, b"\x13\0\x05" + bytes(5))
    assert [data[:2] for data in master.all(0x7E4, 0.02)] == [b"\x13\1"] * 2, "5 is reserved"
    master.send(0x7E5, b"\x13\0\x03" + bytes(5))
    assert [data[:2] for data in master.all(0x7E4, 0.02)] == [b"\x13\0"] * 2
    master.lss(0x17)
    master.send(0x7E5, b"\x15" + struct.pack("<H", 100) + bytes(5))
    bench.sleep(0.1)
    master.interface.controller.bitrate = 250_000
    master.interface.restart()
    assert [i for i, _ in bench.sleep(0.2)].count(0x705) <= 1, "silent for another 100 ms"
    master.lss(0x04, 0)
    assert master.number(5, 0x1018, 4) == 0x1001
    assert bench.wire.errors == 0
    bench.devices[0].power_off()
    bench.devices[0].power_on()
    bench.sleep(0.2)
    assert bench.devices[0].controller.bitrate == 250_000


def test_a_device_without_a_serial_number_has_no_lss() -> None:
    wire = Wire(Timeline(), RATE)
    master = Master(VirtualTimeInterface(wire, "master"))
    device = device_on(wire, 5, None)
    device.power_on()
    master.interface.sleep(0.2)
    assert master.number(5, 0x1018, 0) == 3
    with pytest.raises(Refused):
        master.read(5, 0x1018, 4)
    master.lss(0x04, 1)
    assert master.lss(0x5E) is None
