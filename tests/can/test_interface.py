"""The places on a bus through python-can, and what is said where there is none."""

from __future__ import annotations

import errno
import os
import pty
import select
import sys
import termios
import threading
import time
import tty
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import can
import pytest

from tests.robots import SPAN
from tests.simulation.bus.robots import cia402_robot
from thorvaldc.can.error_state import ErrorState
from thorvaldc.can.frame import CanFrame
from thorvaldc.can.open_interface import open_interface, open_interfaces
from thorvaldc.can.python_can_interface import PythonCanInterface
from thorvaldc.can.simulated_bus_client import SimulatedBusClient
from thorvaldc.diagnostics.error import DiagnosticError
from thorvaldc.model import Robot
from thorvaldc.model.bus import Bus
from thorvaldc.simulation.bus.bus_server import serving
from thorvaldc.simulation.bus.timeline import Timeline
from thorvaldc.simulation.bus.wire import Wire

HEARTBEAT = CanFrame(0x701, b"\x05")
ALL_KINDS = (
    HEARTBEAT,
    CanFrame(0x080),
    CanFrame(0x203, bytes(range(8))),
    CanFrame(0x1ABCDEF0, b"\x01\x02", extended=True),
    CanFrame(0x583, remote=True, requested=8),
)


@pytest.fixture
def bus() -> Bus:
    return Bus("can", 500_000, 0.02, (), (), SPAN)


def opened(spec: str, bus: Bus) -> PythonCanInterface:
    port = open_interface(spec, bus)
    assert isinstance(port, PythonCanInterface)
    return port


def refused(spec: str, bus: Bus) -> tuple[str, str]:
    with pytest.raises(DiagnosticError) as caught:
        open_interface(spec, bus)
    found = caught.value.diagnostic
    assert found.code.name == "bus-interface"
    assert found.code.outside
    assert "\n" not in found.message
    return found.message, found.hint or ""


# -- frames through python-can ----------------------------------------------------------------


@pytest.fixture
def pair(bus: Bus) -> Iterator[tuple[PythonCanInterface, PythonCanInterface]]:
    ports = opened("virtual:test_port", bus), opened("virtual:test_port", bus)
    yield ports
    for port in ports:
        port.close()


@pytest.mark.parametrize("frame", ALL_KINDS, ids=str)
def test_every_kind_of_frame_arrives_as_it_was_sent(
    frame: CanFrame, pair: tuple[PythonCanInterface, PythonCanInterface]
) -> None:
    one, other = pair
    before = time.monotonic_ns()
    assert one.send(frame)
    found = other.receive(1.0)
    assert found is not None
    assert found.frame == frame
    assert not found.own
    assert before - 5_000_000 <= found.time <= time.monotonic_ns()
    assert one.receive(0.0) is None


def test_without_a_frame_it_waits_for_the_time_out(
    pair: tuple[PythonCanInterface, PythonCanInterface],
) -> None:
    one, _ = pair
    before = one.now
    assert one.receive(0.05) is None
    assert 0.04 < one.now - before < 1.0
    one.sleep_until(one.now - 1.0)
    one.sleep(-1.0)
    at = one.now + 0.02
    one.sleep_until(at)
    assert one.now >= at


class Scripted(can.BusABC):
    """Gives what it is told to, or fails with it."""

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


def test_times_are_of_the_monotonic_clock_and_never_go_back() -> None:
    wall = time.time()
    stamps = [wall - 0.3, wall - 0.2, wall + 50.0, wall - 500.0, wall - 0.1]
    port = PythonCanInterface(Scripted(*(message(stamp) for stamp in stamps)))
    begun = time.monotonic()
    times = []
    for _ in stamps:
        found = port.receive(0.1)
        assert found is not None
        times.append(found.time / 1e9)
    port.close()
    assert times[0] == pytest.approx(begun - 0.3, abs=0.05)
    assert times[1] == pytest.approx(begun - 0.2, abs=0.05)
    # A clock that was set, or a device that counts from its own start, is not believed.
    assert times[2] == pytest.approx(begun, abs=0.05)
    assert times == sorted(times)


def error_frame(what: int, controller: int = 0) -> can.Message:
    data = bytes([0, controller, 0, 0, 0, 0, 0, 0])
    return can.Message(
        arbitration_id=what, data=data, is_error_frame=True, is_extended_id=True, timestamp=0.0
    )


def test_error_frames_tell_the_controllers_state() -> None:
    script = Scripted()
    port = PythonCanInterface(script)
    seen = []
    for item in (
        error_frame(0x04, 0x10),
        error_frame(0x04, 0x40),
        error_frame(0x04, 0x20),
        error_frame(0x40),
        error_frame(0x100),
    ):
        script.items.append(item)
        assert port.receive(0.0) is None
        seen.append(port.state)
    port.close()
    passive, active, off = ErrorState.PASSIVE, ErrorState.ACTIVE, ErrorState.BUS_OFF
    assert seen == [passive, active, passive, off, active]


def test_a_full_queue_is_said_and_a_lost_interface_raises() -> None:
    full = can.CanOperationError("Transmit buffer full", errno.ENOBUFS)
    unplugged = can.CanOperationError("Failed to transmit: No such device", errno.ENODEV)
    port = PythonCanInterface(Scripted(full, unplugged, unplugged, OSError(errno.EIO, "gone")))
    assert not port.send(HEARTBEAT)
    with pytest.raises(ConnectionError):
        port.send(HEARTBEAT)
    with pytest.raises(ConnectionError):
        port.receive(0.1)
    with pytest.raises(ConnectionError):
        port.receive(0.1)
    port.close()


def test_own_frames_that_come_back_are_left_out() -> None:
    """UDP multicast gives a program its own frames; another's with the same content stay."""
    wall = time.time()
    script = Scripted()
    port = PythonCanInterface(script, echoes=True)
    assert port.send(HEARTBEAT)
    script.items += [message(wall), message(wall), message(wall, b"\x7f")]
    found = [port.receive(0.0) for _ in range(3)]
    port.close()
    assert [f.frame.data for f in found if f is not None] == [b"\x05", b"\x7f"]


def test_frames_over_udp_between_two_programs(bus: Bus) -> None:
    """Each has the other's, and not its own that multicast gives back."""
    try:
        one, other = opened("udp:239.74.163.77", bus), opened("udp:239.74.163.77", bus)
    except DiagnosticError as fault:
        pytest.skip(f"no multicast here: {fault}")
    try:
        if not one.send(HEARTBEAT) or (found := other.receive(1.0)) is None:
            pytest.skip("multicast does not come back here")
        assert found.frame == HEARTBEAT
        assert one.receive(0.1) is None
        assert other.send(ALL_KINDS[2])
        back = one.receive(1.0)
        assert back is not None
        assert back.frame == ALL_KINDS[2]
    finally:
        one.close()
        other.close()


# -- slcan through a pair of pseudo-terminals -------------------------------------------------


@pytest.fixture
def serial_line() -> Iterator[tuple[int, str]]:
    """Our end of a serial line, and the path of the other."""
    ours, theirs = pty.openpty()
    tty.setraw(ours)
    tty.setraw(theirs)
    yield ours, os.ttyname(theirs)
    os.close(ours)
    os.close(theirs)


def read_until(ours: int, end: bytes) -> bytes:
    data = b""
    limit = time.monotonic() + 5.0
    while not data.endswith(end) and time.monotonic() < limit:
        if select.select([ours], [], [], 0.1)[0]:
            data += os.read(ours, 4096)
    return data


def test_slcan_sets_the_bitrate_and_passes_frames(serial_line: tuple[int, str], bus: Bus) -> None:
    ours, path = serial_line
    port = opened(f"slcan:{path}", bus)
    assert b"S6\r" in read_until(ours, b"O\r\rO\rO\r")
    assert port.send(CanFrame(0x203, b"\x01\xab"))
    assert read_until(ours, b"\r").endswith(b"t203201AB\r")
    os.write(ours, b"t1837")
    os.write(ours, b"01020304050607\r")
    found = port.receive(1.0)
    assert found is not None
    assert found.frame == CanFrame(0x183, bytes(range(1, 8)))
    port.close()


def test_a_serial_line_that_goes_away_is_a_lost_interface(bus: Bus) -> None:
    ours, theirs = pty.openpty()
    tty.setraw(ours, termios.TCSANOW)
    port = opened(f"slcan:{os.ttyname(theirs)}", bus)
    os.close(theirs)
    os.close(ours)
    with pytest.raises(ConnectionError):
        port.receive(5.0)
    port.close()


def test_one_thread_receives_while_another_sends(serial_line: tuple[int, str], bus: Bus) -> None:
    ours, path = serial_line
    port = opened(f"slcan:{path}", bus)
    seen: list[CanFrame] = []

    def take() -> None:
        while len(seen) < 50:
            found = port.receive(2.0)
            if found is None:
                return
            seen.append(found.frame)

    taker = threading.Thread(target=take)
    taker.start()
    for i in range(50):
        os.write(ours, f"t1811{i:02X}\r".encode())
        assert port.send(CanFrame(0x201, bytes([i])))
        read_until(ours, b"\r")
    taker.join(5.0)
    port.close()
    assert [frame.data[0] for frame in seen] == list(range(50))


# -- what cannot be opened --------------------------------------------------------------------


def test_an_interface_that_python_can_does_not_know(bus: Bus) -> None:
    message, hint = refused("socketkan:can0", bus)
    assert "no interface `socketkan`" in message
    assert "slcan" in hint


@pytest.mark.parametrize("spec", ["slcan", "slcan:", "sim:", "socketcan:"])
def test_without_a_channel(spec: str, bus: Bus) -> None:
    message, _ = refused(spec, bus)
    assert "needs" in message


def test_a_serial_port_that_is_not_there(bus: Bus) -> None:
    message, hint = refused("slcan:/nowhere/ttyACM0", bus)
    assert "/nowhere/ttyACM0: No such file or directory" in message
    assert "plugged in" in hint


def test_a_file_is_no_serial_port(tmp_path: Path, bus: Bus) -> None:
    (tmp_path / "port").write_text("")
    assert "is not a serial port" in refused(f"slcan:{tmp_path / 'port'}", bus)[0]
    assert "cannot use the bus" in refused("slcan:/dev/null", bus)[0]


def test_no_permission(
    serial_line: tuple[int, str], bus: Bus, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, path = serial_line
    monkeypatch.setattr(os, "access", lambda *_: False)  # root may open anything
    message, hint = refused(f"slcan:{path}", bus)
    assert f"no permission to use {path}" in message
    assert "dialout" in hint


def test_a_missing_package_is_named(bus: Bus, monkeypatch: pytest.MonkeyPatch) -> None:
    import can.interfaces.slcan

    monkeypatch.setattr(can.interfaces.slcan, "serial", None)
    message, hint = refused("slcan:COM3", bus)
    assert "serial module is not installed" in message
    assert "thorvaldc[serial]" in hint
    monkeypatch.setitem(sys.modules, "can.interfaces.udp_multicast", None)
    _, hint = refused("udp", bus)
    assert "thorvaldc[udp]" in hint


@pytest.mark.parametrize("channel", ["can77", "lo", "../net/lo"])
def test_a_network_interface_that_is_none_of_can(channel: str, bus: Bus) -> None:
    message, _ = refused(f"socketcan:{channel}", bus)
    assert "no network interface" in message or "is not a CAN interface" in message


def test_a_simulated_bus_that_nobody_runs(bus: Bus) -> None:
    message, hint = refused("sim:nobody", bus)
    assert "no bus runs at" in message
    assert "thorvaldc bus FILE --channel nobody" in hint


def test_a_driver_that_refuses(bus: Bus) -> None:
    strange = replace(bus, bitrate=123_456)
    ours, theirs = pty.openpty()
    try:
        assert "bitrate" in refused(f"slcan:{os.ttyname(theirs)}", strange)[0]
    finally:
        os.close(ours)
        os.close(theirs)


# -- several buses ----------------------------------------------------------------------------


def test_ports_of_several_buses_are_named(two_buses: Robot) -> None:
    ports = open_interfaces("left=virtual:l,right=virtual:r", two_buses)
    assert list(ports) == ["left", "right"]
    for port in ports.values():
        port.close()
    for spec in ("virtual:l", "left=virtual:l", "left=virtual:l,wrong=virtual:r", "left=,right="):
        with pytest.raises(DiagnosticError) as caught:
            open_interfaces(spec, two_buses)
        assert "left=socketcan:can0,right=socketcan:can1" in (caught.value.diagnostic.hint or "")


@pytest.fixture
def two_buses() -> Robot:
    buses = tuple(Bus(name, 500_000, 0.02, (), (), SPAN) for name in ("left", "right"))
    return replace(cia402_robot(), buses=buses)


def test_a_master_on_a_simulated_bus_sends_in_its_own_order(bus: Bus, tmp_path: Path) -> None:
    """As interfaces do: SYNC comes after the commands, whatever its identifier."""
    wire = Wire(Timeline())
    channel = str(tmp_path / "bus.sock")
    with (
        serving(wire.timeline, {channel: wire}),
        closing(open_interface(f"sim:{channel}", bus)) as master,
        closing(SimulatedBusClient(channel)) as other,
    ):
        sent = [CanFrame(k, bytes(8)) for k in (0x201, 0x202, 0x303, 0x304, 0x080)]
        for frame in sent:
            assert master.send(frame)
        assert [got.frame for got in (other.receive(2.0) for _ in sent) if got] == sent
