"""The search for devices without node id, with devices of this test."""

from __future__ import annotations

import functools
import struct

import pytest

from tests.commissioning.bench import four_drives
from thorvaldc.can.frame import CanFrame, to_ns
from thorvaldc.can.lss import Identity
from thorvaldc.commissioning.bus_master import BusMaster, Timing
from thorvaldc.commissioning.lss_master import MAXIMUM_SLAVES, LssError, LssMaster
from thorvaldc.simulation.bus.simulated_robot import VirtualTimeInterface
from thorvaldc.simulation.bus.timeline import Timeline
from thorvaldc.simulation.bus.wire import Wire


class Slaves:
    """Devices without node id, which respond to fastscan requests (CiA 305) as one sender."""

    interface: type[VirtualTimeInterface] = VirtualTimeInterface
    """Interface of the master."""

    def __init__(self, identities: list[Identity]) -> None:
        self.wire = Wire(Timeline())
        self.sender = VirtualTimeInterface(self.wire, "slaves")
        self.parts = dict.fromkeys(identities, 0)
        self.requests = 0
        self.wire.observers.append(self.take)

    def take(self, time: int, frame: CanFrame, senders: object) -> None:
        if frame.id != 0x7E5 or frame.data[0] != 0x51:
            return
        self.requests += 1
        number, bit, part, next_part = struct.unpack_from("<IBBB", frame.data, 1)
        if bit == 0x80:
            self.parts = dict.fromkeys(self.parts, 0)
            confirmed = list(self.parts)
        else:
            confirmed = [
                identity
                for identity, at in self.parts.items()
                if at == part and identity[part] >> bit == number >> bit
            ]
            if bit == 0:
                self.parts.update(dict.fromkeys(confirmed, next_part))
        if confirmed:
            self.sender.send(CanFrame(0x7E4, b"\x4f" + bytes(7)))

    def search(self, known: tuple[Identity, ...] = ()) -> list[Identity]:
        interface = self.interface(self.wire, "master")
        interface.sleep(0.001)
        master = BusMaster(interface, four_drives().buses[0], Timing(fastscan=0.001))
        return LssMaster(master).find_without_id(known)


class LateBus(VirtualTimeInterface):
    """A bus whose process runs late: each frame arrives after the time-out of its request."""

    delay = 0.05

    @property
    def received_until(self) -> float:
        return self.now - self.delay

    def _queue_received(self, frame: CanFrame, own: bool = False) -> None:
        arrive = functools.partial(super()._queue_received, frame, own)
        self.timeline.after(to_ns(self.delay), arrive)


SLAVES = [
    Identity(7, 1, 0x00010002, 0xFFFFFFFF),
    Identity(7, 1, 0x00010002, 5),
    Identity(7, 2, 0x00010002, 5),
    Identity(0x80000000, 1, 3, 0),
]


def test_slaves_that_differ_in_each_part() -> None:
    assert sorted(Slaves(SLAVES).search()) == sorted(SLAVES)


def test_slaves_on_a_bus_whose_process_runs_late() -> None:
    slaves = Slaves(SLAVES)
    slaves.interface = LateBus
    assert sorted(slaves.search()) == sorted(SLAVES)


def test_no_slaves_on_a_bus_whose_process_has_stopped() -> None:
    class StoppedBus(LateBus):
        delay = 1e6

    slaves = Slaves(SLAVES)
    slaves.interface = StoppedBus
    assert slaves.search() == []


def test_known_slaves_are_not_searched_for() -> None:
    slaves = Slaves(SLAVES)
    assert slaves.search((SLAVES[0], SLAVES[3])) == [SLAVES[1], SLAVES[2]]
    every = Slaves(SLAVES)
    assert every.search(tuple(SLAVES)) == []
    assert every.requests < slaves.requests


def test_an_unknown_identity_takes_at_most_two_requests_for_a_bit() -> None:
    slaves = Slaves(SLAVES[1:2])
    assert slaves.search() == SLAVES[1:2]
    assert slaves.requests < 2 * 128 + 20


def test_the_search_ends_at_the_largest_number_of_slaves() -> None:
    identities = [Identity(7, 1, 2, serial) for serial in range(MAXIMUM_SLAVES)]
    assert MAXIMUM_SLAVES == 126
    assert Slaves(identities).search() == identities
    with pytest.raises(LssError, match="more than 126 devices without id respond"):
        Slaves([*identities, Identity(7, 1, 2, 126)]).search()


def test_slaves_that_respond_to_every_serial_number_end_the_search() -> None:
    class Babbling(Slaves):
        def take(self, time: int, frame: CanFrame, senders: object) -> None:
            number = struct.unpack_from("<IBBB", frame.data.ljust(8, b"\0"), 1)
            is_serial = number[2] == 3 and number[:2] != (0, 0)
            if is_serial and frame.id == 0x7E5 and frame.data[0] == 0x51:
                self.requests += 1
                self.sender.send(CanFrame(0x7E4, b"\x4f" + bytes(7)))
            else:
                super().take(time, frame, senders)

    slaves = Babbling([Identity(7, 1, 2, 1)])
    with pytest.raises(LssError):
        slaves.search()
    assert slaves.requests < 1000


@pytest.mark.parametrize("lost", range(3, 150, 7))
def test_a_search_with_a_lost_response_is_repeated(lost: int) -> None:
    class Forgetful(Slaves):
        def take(self, time: int, frame: CanFrame, senders: object) -> None:
            if self.requests == lost and frame.id == 0x7E5:
                self.requests += 1
            else:
                super().take(time, frame, senders)

    assert Forgetful(SLAVES[1:2]).search() == SLAVES[1:2]
