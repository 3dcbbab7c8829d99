"""Opening the CAN interface that a user names, and the diagnostics where that fails."""

from __future__ import annotations

import os
import pty
import socket
import stat
import sys
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest

from tests.can.interfaces import HEARTBEAT, bus, open_python_can, refusal
from tests.robots import SPAN
from tests.simulation.bus.robots import cia402_robot
from thorvaldc.can.frame import CanFrame
from thorvaldc.can.local_socket import socket_path
from thorvaldc.can.open_interface import bus_lock, open_interface, open_interfaces
from thorvaldc.can.simulated_bus_client import SimulatedBusClient
from thorvaldc.diagnostics import DiagnosticError
from thorvaldc.diagnostics.installation import install_command
from thorvaldc.model import Bus, Robot
from thorvaldc.simulation.bus.bus_server import serving
from thorvaldc.simulation.bus.timeline import Timeline
from thorvaldc.simulation.bus.wire import Wire

__all__ = ["bus"]


# -- what cannot be opened --------------------------------------------------------------------


def test_an_interface_unknown_to_python_can(bus: Bus) -> None:
    message, hint = refusal("socketkan:can0", bus)
    assert "no interface `socketkan`" in message
    assert "slcan" in hint


@pytest.mark.parametrize("spec", ["slcan", "slcan:", "sim:", "socketcan:"])
def test_without_a_channel(spec: str, bus: Bus) -> None:
    message, _ = refusal(spec, bus)
    assert "needs" in message


def test_a_serial_port_that_is_not_there(bus: Bus) -> None:
    message, hint = refusal("slcan:/nowhere/ttyACM0", bus)
    assert "/nowhere/ttyACM0: No such file or directory" in message
    assert "plugged in" in hint


def test_a_file_is_not_a_serial_port(tmp_path: Path, bus: Bus) -> None:
    (tmp_path / "port").write_text("")
    assert "is not a serial port" in refusal(f"slcan:{tmp_path / 'port'}", bus)[0]
    assert "cannot use the bus" in refusal("slcan:/dev/null", bus)[0]


def test_no_permission(bus: Bus, monkeypatch: pytest.MonkeyPatch) -> None:
    path = "/dev/null"
    monkeypatch.setattr(os, "access", lambda *_: False)  # root may open anything
    message, hint = refusal(f"slcan:{path}", bus)
    assert f"no permission to use {path}" in message
    assert "dialout" in hint


def test_a_missing_package_is_named(bus: Bus, monkeypatch: pytest.MonkeyPatch) -> None:
    import can.interfaces.slcan

    monkeypatch.setattr(can.interfaces.slcan, "serial", None)
    message, hint = refusal("slcan:COM3", bus)
    assert message.startswith("cannot use the bus `slcan:COM3`: ")
    assert "serial module is not installed" in message
    assert hint == install_command("serial")
    monkeypatch.setitem(sys.modules, "can.interfaces.udp_multicast", None)
    _, hint = refusal("udp", bus)
    assert hint == install_command("udp")


@pytest.mark.parametrize("channel", ["can77", "lo", "../net/lo"])
def test_a_network_interface_that_is_not_a_can_interface(channel: str, bus: Bus) -> None:
    message, _ = refusal(f"socketcan:{channel}", bus)
    assert "no network interface" in message or "is not a CAN interface" in message


@pytest.mark.parametrize(("flags", "is_down"), [("0x40080", True), ("0x400c1", False)])
def test_a_can_interface_that_is_down(
    bus: Bus, monkeypatch: pytest.MonkeyPatch, flags: str, is_down: bool
) -> None:
    """As the kernel shows a CAN interface; the loopback interface stands for it."""
    read_text = Path.read_text
    shown = {"/sys/class/net/lo/type": "280\n", "/sys/class/net/lo/flags": f"{flags}\n"}
    monkeypatch.setattr(
        Path, "read_text", lambda path, *a, **k: shown.get(str(path)) or read_text(path, *a, **k)
    )
    message, hint = refusal("socketcan:lo", bus)
    assert ("lo is down" in message) is is_down
    assert ("sudo ip link set lo up type can bitrate 500000" in hint) is is_down


def test_a_simulated_bus_that_does_not_run(bus: Bus) -> None:
    message, hint = refusal("sim:nobody", bus)
    assert "no bus runs at" in message
    assert "thorvaldc bus FILE --channel nobody" in hint
    _, hint = refusal(f"sim:nobody.{bus.name}", bus)  # one of several buses
    assert hint.endswith("--channel nobody")


def test_one_bus_of_a_simulated_robot_with_several_buses_has_another_name(
    bus: Bus, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    socket_path(f"rover.{bus.name}").touch()
    assert refusal("sim:rover", bus)[1].endswith(f"is sim:rover.{bus.name}")


def test_a_simulated_bus_that_does_not_answer(
    bus: Bus, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("thorvaldc.can.simulated_bus_client.ANSWER_TIME", 0.05)
    channel = str(tmp_path / "silent.sock")
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(channel)
        server.listen()
        assert "the bus does not answer" in refusal(f"sim:{channel}", bus)[0]


def test_only_a_serial_line_has_time_to_write(bus: Bus, monkeypatch: pytest.MonkeyPatch) -> None:
    """A full send queue of another interface refuses a frame at once."""
    timeouts: list[float] = []
    with closing(open_python_can("virtual:writes", bus)) as interface:
        monkeypatch.setattr(interface.bus, "send", lambda _, timeout: timeouts.append(timeout))
        assert interface.send(HEARTBEAT)
        assert interface.send(HEARTBEAT, 0.5)
    assert timeouts == [0.0, 0.5]


def test_a_driver_that_refuses(bus: Bus) -> None:
    strange = replace(bus, bitrate=123_456)
    ours, theirs = pty.openpty()
    try:
        spec = f"slcan:{os.ttyname(theirs)}"
        message = refusal(spec, strange)[0]
        assert message.startswith(f"cannot use the bus `{spec}`: ")
        assert "bitrate" in message
    finally:
        os.close(ours)
        os.close(theirs)


# -- several buses ----------------------------------------------------------------------------


def test_a_robot_with_several_buses_needs_an_interface_for_each(two_buses: Robot) -> None:
    interfaces = open_interfaces("left=virtual:l,right=virtual:r", two_buses)
    assert list(interfaces) == ["left", "right"]
    for interface in interfaces.values():
        interface.close()
    for spec in ("virtual:l", "left=virtual:l", "left=virtual:l,wrong=virtual:r", "left=,right="):
        with pytest.raises(DiagnosticError) as caught:
            open_interfaces(spec, two_buses)
        assert "left=socketcan:can0,right=socketcan:can1" in (caught.value.diagnostic.hint or "")


@pytest.fixture
def two_buses() -> Robot:
    buses = tuple(Bus(name, 500_000, 0.02, (), (), SPAN) for name in ("left", "right"))
    return replace(cia402_robot(), buses=buses)


def test_a_master_on_a_simulated_bus_sends_in_its_own_order(bus: Bus, tmp_path: Path) -> None:
    """As real interfaces do: SYNC follows the commands, although its priority is higher."""
    wire = Wire(Timeline())
    channel = str(tmp_path / "bus.sock")
    with (
        serving(wire.timeline, {channel: wire}),
        closing(open_interface(f"sim:{channel}", bus)) as master,
        closing(SimulatedBusClient(channel)) as second,
    ):
        sent = [CanFrame(k, bytes(8)) for k in (0x201, 0x202, 0x303, 0x304, 0x080)]
        for frame in sent:
            assert master.send(frame)
        assert [got.frame for got in (second.receive(2.0) for _ in sent) if got] == sent


# The lock of a CAN bus on systems without abstract sockets: a file in the user's folder.


def test_a_lock_file_is_held_until_the_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setattr(sys, "platform", "darwin")
    for _ in range(2):
        with bus_lock("slcan:/dev/ttyACM0"):
            with (
                pytest.raises(DiagnosticError, match="uses the bus"),
                bus_lock("slcan:/dev/ttyACM0"),
            ):
                pass
            with bus_lock("slcan:/dev/ttyACM1"):
                pass
    for file in tmp_path.rglob("*.lock"):
        assert stat.S_IMODE(file.stat().st_mode) == 0o600
