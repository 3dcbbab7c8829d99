"""CAN frames through python-can: kinds of frames, times, errors, echoes, and slcan adapters."""

from __future__ import annotations

import errno
import os
import pty
import select
import socket
import sys
import termios
import threading
import time
import tty
from collections.abc import Iterator
from contextlib import closing

import can
import msgpack
import pytest

from tests.can.interfaces import ALL_KINDS, HEARTBEAT, bus, open_python_can
from thorvaldc.can.frame import CanFrame, ErrorState, elapsed_ns
from thorvaldc.can.open_interface import UDP_GROUP
from thorvaldc.can.python_can_interface import PythonCanInterface
from thorvaldc.diagnostics import DiagnosticError
from thorvaldc.model import Bus

__all__ = ["bus"]

UDP_PORT = 43113  # of python-can


# -- frames through python-can ----------------------------------------------------------------


@pytest.fixture
def pair(bus: Bus) -> Iterator[tuple[PythonCanInterface, PythonCanInterface]]:
    interfaces = (
        open_python_can("virtual:test_port", bus),
        open_python_can("virtual:test_port", bus),
    )
    yield interfaces
    for interface in interfaces:
        interface.close()


@pytest.mark.parametrize("frame", ALL_KINDS, ids=str)
def test_every_kind_of_frame_arrives_as_it_was_sent(
    frame: CanFrame, pair: tuple[PythonCanInterface, PythonCanInterface]
) -> None:
    first, second = pair
    before = elapsed_ns()
    assert first.send(frame)
    received = second.receive(1.0)
    assert received is not None
    assert received.frame == frame
    assert not received.own
    assert before - 5_000_000 <= received.time <= elapsed_ns()
    assert first.receive(0.0) is None


def test_without_a_frame_it_waits_for_the_time_out(
    pair: tuple[PythonCanInterface, PythonCanInterface],
) -> None:
    first, _ = pair
    before = first.now
    assert first.receive(0.05) is None
    assert 0.04 < first.now - before < 1.0
    first.sleep_until(first.now - 1.0)
    first.sleep(-1.0)
    at = first.now + 0.02
    first.sleep_until(at)
    assert first.now >= at


class Scripted(can.BusABC):
    """A bus that receives the given messages, and raises the given exceptions."""

    def __init__(self, *items: can.Message | Exception) -> None:
        self.items = list(items)
        self.channel_info = "scripted"
        super().__init__(channel="scripted")

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if not self.items:
            return None, True
        item = self.items.pop(0)
        if isinstance(item, Exception):
            raise item
        return item, True

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        self._recv_internal(timeout)


def message(stamp: float, data: bytes = b"\x05") -> can.Message:
    return can.Message(
        arbitration_id=0x701, data=data, is_extended_id=False, timestamp=stamp, is_rx=True
    )


def test_frames_of_other_programs_of_this_computer() -> None:
    """socketcan marks frames of other local programs as sent; a second master is one of them."""
    frame = message(time.time())
    frame.is_rx = False
    for shared in (False, True):
        received = PythonCanInterface(Scripted(frame), shared=shared).receive(0.0)
        assert received is not None
        assert received.own is not shared


def test_times_are_monotonic() -> None:
    wall = time.time()
    stamps = [wall - 0.3, wall - 0.2, wall + 50.0, wall - 500.0, wall - 0.1]
    interface = PythonCanInterface(Scripted(*(message(stamp) for stamp in stamps)))
    begun = time.monotonic()
    times = []
    for _ in stamps:
        received = interface.receive(0.1)
        assert received is not None
        times.append(received.time / 1e9)
    interface.close()
    assert times[0] == pytest.approx(begun - 0.3, abs=5.0)
    assert times[1] == pytest.approx(begun - 0.2, abs=5.0)
    # Stamps of a clock that was set, or of a device that counts from its start, are ignored.
    assert times[2] == pytest.approx(begun, abs=5.0)
    assert times == sorted(times)


def error_frame(classes: int, controller: int = 0) -> can.Message:
    data = bytes([0, controller, 0, 0, 0, 0, 0, 0])
    return can.Message(
        arbitration_id=classes, data=data, is_error_frame=True, is_extended_id=True, timestamp=0.0
    )


def test_error_frames_report_the_controller_state() -> None:
    script = Scripted()
    interface = PythonCanInterface(script)
    seen = []
    for item in (
        error_frame(0x04, 0x10),
        error_frame(0x04, 0x40),
        error_frame(0x04, 0x20),
        error_frame(0x40),
        error_frame(0x100),
    ):
        script.items.append(item)
        assert interface.receive(0.0) is None
        seen.append(interface.state)
    interface.close()
    passive, active, off = ErrorState.PASSIVE, ErrorState.ACTIVE, ErrorState.BUS_OFF
    assert seen == [passive, active, passive, off, active]


def test_a_full_queue_returns_false_and_a_lost_interface_raises() -> None:
    full = can.CanOperationError("Transmit buffer full", errno.ENOBUFS)
    unplugged = can.CanOperationError("Failed to transmit: No such device", errno.ENODEV)
    interface = PythonCanInterface(Scripted(full, unplugged, unplugged, OSError(errno.EIO, "gone")))
    assert not interface.send(HEARTBEAT)
    with pytest.raises(ConnectionError):
        interface.send(HEARTBEAT)
    with pytest.raises(ConnectionError):
        interface.receive(0.1)
    with pytest.raises(ConnectionError):
        interface.receive(0.1)
    interface.close()


@pytest.mark.parametrize("relation", ["__cause__", "__context__"])
def test_a_lost_interface_is_known_by_the_cause_of_the_error(relation: str) -> None:
    """Some drivers put the error of the operating system beside their own, without its code."""
    error, late = can.CanOperationError("cannot send"), can.CanOperationError("cannot send")
    setattr(error, relation, OSError(errno.ENODEV, "No such device"))
    setattr(late, relation, TimeoutError(errno.ENODEV, "too late"))
    with closing(PythonCanInterface(Scripted(error, late))) as interface:
        with pytest.raises(ConnectionError):
            interface.send(HEARTBEAT)
        assert not interface.send(HEARTBEAT)


def test_it_waits_on_after_a_driver_that_returns_early() -> None:
    class Impatient(Scripted):
        def recv(self, timeout: float | None = None) -> can.Message | None:
            return self._recv_internal(timeout)[0]

    script = Impatient()
    with closing(PythonCanInterface(script)) as interface:
        for timeout in (None, 5.0):
            script.items[:] = [None, None, message(0.0)]  # type: ignore[list-item]
            received = interface.receive(timeout)
            assert received is not None
            assert received.frame == HEARTBEAT
        assert interface.receive(0.01) is None


def test_echoes_are_dropped() -> None:
    """One echo is dropped per sent frame; an equal frame of another node is kept."""
    wall = time.time()
    script = Scripted()
    interface = PythonCanInterface(script, datagrams=True)
    assert interface.send(HEARTBEAT)
    script.items += [message(wall), message(wall), message(wall, b"\x7f")]
    received = [interface.receive(0.0) for _ in range(3)]
    interface.close()
    assert [f.frame.data for f in received if f is not None] == [b"\x05", b"\x7f"]


UDP = pytest.mark.xdist_group("udp")
"""Two tests at the same time would receive each other's datagrams."""


@UDP
def test_frames_over_udp_between_two_programs(bus: Bus) -> None:
    """Each program receives the frame of the other one, and no echo of its own."""
    try:
        first, second = (
            open_python_can("udp:239.74.163.77", bus),
            open_python_can("udp:239.74.163.77", bus),
        )
    except DiagnosticError as error:
        pytest.skip(f"no multicast here: {error}")
    try:
        if not first.send(HEARTBEAT) or (received := second.receive(1.0)) is None:
            pytest.skip("multicast does not loop back here")
        assert received.frame == HEARTBEAT
        assert first.receive(0.1) is None
        assert second.send(ALL_KINDS[2])
        back = first.receive(1.0)
        assert back is not None
        assert back.frame == ALL_KINDS[2]
    finally:
        first.close()
        second.close()


@UDP
def test_groups_of_udp_are_apart(bus: Bus) -> None:
    try:
        sender, receiver = (
            open_python_can("udp:239.74.163.79", bus),
            open_python_can("udp:239.74.163.80", bus),
        )
    except DiagnosticError as error:
        pytest.skip(f"no multicast here: {error}")
    try:
        assert sender.send(HEARTBEAT)
        assert receiver.receive(0.2) is None
    finally:
        sender.close()
        receiver.close()


def datagram(**changes: object) -> bytes:
    """Returns a datagram of python-can with some changed values."""
    values = {"arbitration_id": 0x701, "dlc": 1, "data": b"\x05", "is_extended_id": False}
    return msgpack.packb({**values, **changes})


NO_FRAMES = [
    b"",
    b"garbage" * 500,
    b"\xc1",
    msgpack.packb([1, 2, 3]),
    msgpack.packb({"unknown": 1}),
    datagram(arbitration_id="x"),
    datagram(arbitration_id=769.0),
    datagram(arbitration_id=-1),
    datagram(data=b"123456789", dlc=9),
    datagram(data=None, dlc=2.0, is_remote_frame=True),
    datagram(is_error_frame=True, arbitration_id=0x40),  # would be bus-off
]


@UDP
@pytest.mark.parametrize("spec", ["udp", "udp:239.74.163.78"])
def test_datagrams_of_anyone_are_counted_and_dropped(spec: str, bus: Bus) -> None:
    try:
        sender, receiver = open_python_can(spec, bus), open_python_can(spec, bus)
    except DiagnosticError as error:
        pytest.skip(f"no multicast here: {error}")
    group = spec.partition(":")[2] or UDP_GROUP
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as anyone:
        if spec == "udp":
            loopback = socket.inet_aton("127.0.0.1")
            anyone.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, loopback)
        for data in NO_FRAMES:
            anyone.sendto(data, (group, UDP_PORT))
    try:
        if not sender.send(HEARTBEAT) or (received := receiver.receive(1.0)) is None:
            pytest.skip("multicast does not loop back here")
        assert received.frame == HEARTBEAT
        assert receiver.receive(0.0) is None
        assert receiver.undecodable == len(NO_FRAMES)
        assert receiver.state is ErrorState.ACTIVE
    finally:
        sender.close()
        receiver.close()


@pytest.mark.skipif(sys.platform != "linux", reason="other systems cannot bind a socket to lo")
@UDP
def test_udp_without_a_group_stays_on_this_computer(bus: Bus) -> None:
    """The frames of a program in the network's group do not arrive, and ours do not leave."""
    try:
        local, network = open_python_can("udp", bus), open_python_can(f"udp:{UDP_GROUP}", bus)
    except DiagnosticError as error:
        pytest.skip(f"no multicast here: {error}")
    try:
        assert network.send(HEARTBEAT)
        assert local.receive(0.2) is None
    finally:
        local.close()
        network.close()


# -- slcan through a pair of pseudo-terminals -------------------------------------------------


@pytest.fixture
def serial_line() -> Iterator[tuple[int, str]]:
    """Our end of a serial line, and the path of the other end."""
    ours, theirs = pty.openpty()
    tty.setraw(ours)
    tty.setraw(theirs)
    yield ours, os.ttyname(theirs)
    os.close(ours)
    os.close(theirs)


def read_until(ours: int, end: bytes) -> bytes:
    data = b""
    limit = time.monotonic() + 60.0
    while not data.endswith(end) and time.monotonic() < limit:
        if select.select([ours], [], [], 0.1)[0]:
            data += os.read(ours, 4096)
    assert data.endswith(end), data
    return data


@pytest.mark.slow
def test_slcan_sets_the_bitrate_and_passes_frames(serial_line: tuple[int, str], bus: Bus) -> None:
    ours, path = serial_line
    interface = open_python_can(f"slcan:{path}", bus)
    assert b"S6\r" in read_until(ours, b"O\rO\r")
    assert interface.send(CanFrame(0x203, b"\x01\xab"))
    assert read_until(ours, b"\r").endswith(b"t203201AB\r")
    os.write(ours, b"t1837")
    os.write(ours, b"01020304050607\r")
    received = interface.receive(1.0)
    assert received is not None
    assert received.frame == CanFrame(0x183, bytes(range(1, 8)))
    interface.close()


def test_a_serial_line_that_goes_away_is_a_lost_interface(bus: Bus) -> None:
    ours, theirs = pty.openpty()
    tty.setraw(ours, termios.TCSANOW)
    interface = open_python_can(f"slcan:{os.ttyname(theirs)}", bus)
    os.close(theirs)
    os.close(ours)
    with pytest.raises(ConnectionError):
        interface.receive(5.0)
    interface.close()


def test_one_thread_receives_while_another_sends(serial_line: tuple[int, str], bus: Bus) -> None:
    ours, path = serial_line
    interface = open_python_can(f"slcan:{path}", bus)
    seen: list[CanFrame] = []

    def take() -> None:
        while len(seen) < 50:
            received = interface.receive(60.0)
            if received is None:
                return
            seen.append(received.frame)

    taker = threading.Thread(target=take)
    taker.start()
    for i in range(50):
        os.write(ours, f"t1811{i:02X}\r".encode())
        # pyserial reports a time-out where this thread stands still after it has written all.
        assert interface.send(CanFrame(0x201, bytes([i])), timeout=60.0)
        read_until(ours, b"\r")
    taker.join(60.0)
    interface.close()
    assert [frame.data[0] for frame in seen] == list(range(50))
