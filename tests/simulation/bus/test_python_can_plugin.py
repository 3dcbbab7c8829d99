"""The simulated bus with python-can and canopen, both unchanged."""

from __future__ import annotations

import os
import socket
import stat
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

import can
import canopen
import pytest

from tests.simulation.bus.robots import cia402_robot
from thorvaldc.can import simulated_bus_protocol as protocol
from thorvaldc.can.local_socket import pack_json
from thorvaldc.can.simulated_bus_client import SimulatedBusClient
from thorvaldc.model.scenario import Quirk
from thorvaldc.simulation.bus import python_can_plugin as interface
from thorvaldc.simulation.bus.bus_server import BusServer, serving
from thorvaldc.simulation.bus.simulated_robot import SimulatedRobot, VirtualTimeInterface
from thorvaldc.simulation.bus.timeline import Timeline
from thorvaldc.simulation.bus.wire import Wire


def message(identifier: int, data: bytes = b"", **more: Any) -> can.Message:
    return can.Message(arbitration_id=identifier, data=data, is_extended_id=False, **more)


@pytest.fixture(autouse=True)
def _known() -> None:
    interface.register()


@pytest.fixture
def channel(tmp_path: Path) -> str:
    return str(tmp_path / "bus.sock")


@pytest.fixture
def wire() -> Wire:
    return Wire(Timeline())


# -- virtual time, in one thread ---------------------------------------------------------------


def test_two_buses_on_a_wire(wire: Wire) -> None:
    with (
        can.Bus(interface="thorvaldc_sim", channel=wire) as a,
        interface.SimulatedBus(wire, name="b") as b,
    ):
        sent = message(0x123, b"\1\2\3")
        a.send(sent)
        got = b.recv(60.0)
        assert got is not None
        assert got.equals(sent, timestamp_delta=None, check_channel=False, check_direction=False)
        assert 0.0 < got.timestamp < 0.001, "virtual time: the duration of its bits"
        assert a.recv(0.0) is None
        assert a.state is can.BusState.ACTIVE


def test_time_outs_are_virtual(wire: Wire) -> None:
    with interface.SimulatedBus(wire) as bus:
        began = time.process_time()
        assert bus.recv(3600.0) is None
        assert bus.interface.now == pytest.approx(3600.0)
        assert time.process_time() - began < 1.0


def test_filters_do_not_shorten_or_lengthen_a_time_out(wire: Wire) -> None:
    filters = [{"can_id": 0x200, "can_mask": 0x7FF}]
    with interface.SimulatedBus(wire, can_filters=filters) as bus:
        node = VirtualTimeInterface(wire, "other")
        for k in range(20):
            wire.timeline.after((k + 1) * 10_000_000, lambda: node.send(interface.CanFrame(0x100)))
        assert bus.recv(0.1) is None
        assert bus.interface.now == pytest.approx(0.1)
        wire.timeline.after(1_000_000, lambda: node.send(interface.CanFrame(0x200)))
        got = bus.recv(60.0)
        assert got is not None
        assert got.arbitration_id == 0x200


def test_own_messages_and_remote_frames(wire: Wire) -> None:
    with (
        interface.SimulatedBus(wire, receive_own_messages=True) as a,
        interface.SimulatedBus(wire, name="b") as b,
    ):
        a.send(message(0x100, is_remote_frame=True, dlc=4))
        echo, received = a.recv(60.0), b.recv(60.0)
        assert echo is not None
        assert received is not None
        assert (echo.is_rx, received.is_rx) == (False, True)
        assert received.is_remote_frame
        assert received.dlc == 4


def test_a_full_queue_and_bus_off_are_errors_of_python_can(wire: Wire) -> None:
    with interface.SimulatedBus(wire) as bus:  # alone on the bus: no acknowledge
        for _ in range(32):
            bus.send(message(0x100))
        assert isinstance(bus.interface, VirtualTimeInterface)
        with pytest.raises(can.CanOperationError, match="full"):
            bus.send(message(0x100), timeout=0.0)
        assert bus.interface.now == 0.0
        with pytest.raises(can.CanOperationError, match="full"):
            bus.send(message(0x100))
        assert bus.interface.now == pytest.approx(1.0)
        assert bus.state is can.BusState.PASSIVE
        bus.interface.controller.go_bus_off()
        assert bus.state is can.BusState.ERROR
        with pytest.raises(can.CanOperationError, match="bus-off"):
            bus.send(message(0x100))
        bus.state = can.BusState.ACTIVE
        assert bus.state is can.BusState.ACTIVE
        with pytest.raises(can.CanOperationError, match="classical"):
            bus.send(message(0x100, bytes(12), is_fd=True))


def test_cyclic_sending_is_virtual(wire: Wire) -> None:
    with (
        interface.SimulatedBus(wire) as a,
        interface.SimulatedBus(wire, name="b") as b,
    ):
        task = a.send_periodic(message(0x100, b"\1"), 0.02)
        times = [m.timestamp for m in (b.recv(0.1) for _ in range(50)) if m is not None]
        assert times[-1] - times[0] == pytest.approx(49 * 0.02, abs=1e-4)
        task.modify_data(message(0x100, b"\2"))  # type: ignore[attr-defined]
        got = b.recv(60.0)
        assert got is not None
        assert got.data == b"\2"
        task.stop()
        assert b.recv(0.1) is None


# -- in real time, over a socket ---------------------------------------------------------------


@pytest.fixture
def robot(channel: str) -> Iterator[tuple[SimulatedRobot, str]]:
    simulated = SimulatedRobot(
        cia402_robot(),
        nonvolatile={"fr_controller": {"node_id": 255}, "rl_controller": {"node_id": 255}},
    )
    simulated.power_on()
    simulated.run(0.3)
    with serving(simulated.timeline, {channel: simulated.wire()}):
        yield simulated, channel


def test_canopen_reads_and_writes_our_objects(robot: tuple[SimulatedRobot, str]) -> None:
    simulated, channel = robot
    with canopen.Network() as network:
        network.connect(interface="thorvaldc_sim", channel=channel)
        node = network.add_node(1, canopen.ObjectDictionary())
        node.sdo.RESPONSE_TIMEOUT = 60.0
        assert node.sdo.upload(0x1018, 4) == b"\x01\x01\0\0"
        assert node.sdo.upload(0x1008, 0) == b"CiA 402 drive", "in segments"
        node.sdo.download(0x1017, 0, (50).to_bytes(2, "little"))
        assert node.sdo.upload(0x1017, 0) == b"\x32\0"
        with pytest.raises(canopen.SdoAbortedError) as refused:
            node.sdo.upload(0x5000, 0)
        assert refused.value.code == 0x06020000
        node.sdo.download(0x60FF, 0, (1000).to_bytes(4, "little"), force_segment=True)
        assert node.sdo.upload(0x60FF, 0) == b"\xe8\3\0\0"
        node.nmt.state = "OPERATIONAL"
        node.nmt.wait_for_heartbeat(2.0)
        assert node.nmt.state == "OPERATIONAL"
        drive = simulated.devices["fl_controller"]
        drive.timeline.at(0, lambda: drive.emergency(0x2310, 4))  # type: ignore[attr-defined]
        emergency = node.emcy.wait(0x2310, timeout=60.0)
        assert emergency is not None
        assert emergency.register == 5


def test_block_transfers_of_canopen(channel: str) -> None:
    """Only devices with the quirk know them; the others abort."""
    name = "battery_box_with_a_name_of_some_length"
    for quirks in ((Quirk.BLOCK_TRANSFERS,), ()):
        simulated = SimulatedRobot(cia402_robot(), quirks=quirks)
        simulated.power_on()
        simulated.run(0.3)
        objects = simulated.devices["fl_controller"].objects  # type: ignore[attr-defined]
        objects[0x1008, 0].value = name
        path = f"{channel}{len(quirks)}"
        with serving(simulated.timeline, {path: simulated.wire()}), canopen.Network() as network:
            network.connect(interface="thorvaldc_sim", channel=path)
            sdo = network.add_node(1, canopen.ObjectDictionary()).sdo
            sdo.RESPONSE_TIMEOUT = 60.0

            def upload(index: int, sdo: canopen.sdo.SdoClient = sdo) -> bytes:
                return bytes(sdo.open(index, 0, "rb", block_transfer=True, buffering=0).readall())

            if not quirks:
                with pytest.raises(canopen.SdoAbortedError) as refused:
                    upload(0x1008)
                assert refused.value.code == 0x05040001
                continue
            assert upload(0x1008) == name.encode()
            assert upload(0x1017) == b"\x64\0"
            with pytest.raises(canopen.SdoAbortedError) as refused:
                upload(0x5000)
            assert refused.value.code == 0x06020000
            with sdo.open(0x1017, 0, "wb", size=2, block_transfer=True, buffering=0) as stream:
                stream.write(b"\x32\0")
            assert sdo.upload(0x1017, 0) == b"\x32\0", "other transfers work afterwards"
            with pytest.raises(canopen.SdoAbortedError) as refused:
                sdo.open(0x1017, 0, "wb", size=4, block_transfer=True, buffering=0)
            assert refused.value.code == 0x06070010
            sdo.download(0x1017, 0, (70).to_bytes(2, "little"))
            assert upload(0x1017) == b"\x46\0"


def test_canopen_scans_for_nodes(robot: tuple[SimulatedRobot, str]) -> None:
    """It sends 127 requests in a row, more than the queue of a controller holds."""
    with canopen.Network() as network:
        network.connect(interface="thorvaldc_sim", channel=robot[1])
        network.scanner.search()
        time.sleep(0.3)
        # It takes frames of batteries for PDOs of nodes that do not exist.
        assert {1, 4} <= set(network.scanner.nodes)


@pytest.mark.slow
def test_lss_master_of_canopen(robot: tuple[SimulatedRobot, str]) -> None:
    simulated, channel = robot
    with canopen.Network() as network:
        network.connect(interface="thorvaldc_sim", channel=channel)
        master = network.lss
        assert master.send_switch_state_selective(0, 402, 65536, 0x104)
        assert master.inquire_node_id() == 4
        assert master.inquire_lss_address(0x5D) == 0x104
        master.configure_node_id(14)
        master.store_configuration()
        with pytest.raises(canopen.lss.LssError):
            master.configure_bit_timing(5)
        master.send_switch_state_global(master.WAITING_STATE)
        network.nmt.send_command(0x82)
        master.RESPONSE_TIMEOUT = 0.15
        # Two devices have no id: fastscan finds the one with the lower serial number first.
        for serial, node_id in ((0x102, 12), (0x103, 13)):
            # On a busy machine a response can come too late: repeat.
            found, identity = next(
                (scan for scan in (master.fast_scan() for _ in range(3)) if scan[0]), (False, None)
            )
            assert (found, identity) == (True, [0, 402, 65536, serial])
            master.configure_node_id(node_id)
            master.store_configuration()
            master.send_switch_state_global(master.WAITING_STATE)
            time.sleep(0.1)
        assert not master.fast_scan()[0]
    ids = [
        d.nonvolatile["node_id"] for n, d in simulated.devices.items() if n.endswith("_controller")
    ]
    assert ids == [1, 12, 13, 14]


def test_only_this_user_can_open_the_socket_of_a_bus(wire: Wire, channel: str) -> None:
    with serving(wire.timeline, {channel: wire}):
        assert stat.S_IMODE(os.stat(channel).st_mode) == 0o600


def test_several_programs_on_one_bus(wire: Wire, channel: str) -> None:
    with serving(wire.timeline, {channel: wire}):
        buses = [can.Bus(interface="thorvaldc_sim", channel=channel) for _ in range(3)]
        try:
            for k in range(200):
                buses[k % 3].send(message(k, bytes([k])), timeout=1.0)
            for i, bus in enumerate(buses):
                # In the order of arbitration, not of sending.
                expected = [k for k in range(200) if k % 3 != i]
                got = [m for m in (bus.recv(60.0) for _ in expected) if m is not None]
                assert sorted(m.arbitration_id for m in got) == expected
                assert got[0].timestamp == pytest.approx(time.time(), abs=5.0)
        finally:
            for bus in buses:
                bus.shutdown()


def test_a_message_takes_the_time_of_its_bits_in_real_time(channel: str) -> None:
    """200 frames of 8 bytes at 50 kbit/s take half a second, as on a real bus."""
    slow = Wire(Timeline(), 50_000)
    with serving(slow.timeline, {channel: slow}):
        a, b = SimulatedBusClient(channel, "a"), SimulatedBusClient(channel, "b")
        began = time.monotonic()
        for k in range(200):
            assert a.send(interface.CanFrame(0x100, bytes([0x55, k] * 4)), timeout=60.0)
        for _ in range(200):
            assert b.receive(60.0) is not None
        took = time.monotonic() - began
        a.close()
        b.close()
    assert took > 0.40, "at 500 kbit/s it would be 0.05 s"


def test_own_frames_over_the_socket(wire: Wire, channel: str) -> None:
    with (
        serving(wire.timeline, {channel: wire}),
        closing(SimulatedBusClient(channel, "a", receive_own=True)) as a,
        closing(SimulatedBusClient(channel, "b")) as b,
    ):
        frame = interface.CanFrame(0x100, b"\x01")
        assert a.send(frame)
        echo, received = a.receive(60.0), b.receive(60.0)
    assert echo is not None
    assert received is not None
    assert (echo.frame, echo.own) == (received.frame, True) == (frame, True)
    assert not received.own


def test_the_error_state_is_sent_over_the_socket(wire: Wire, channel: str) -> None:
    with (
        serving(wire.timeline, {channel: wire}),
        can.Bus(interface="thorvaldc_sim", channel=channel) as bus,
    ):
        for _ in range(32):
            bus.send(message(0x100))
        with pytest.raises(can.CanOperationError, match="full"):
            bus.send(message(0x100), timeout=0.0)
        bus.recv(0.3)
        assert bus.state is can.BusState.PASSIVE


def test_a_stopped_bus_is_reported(wire: Wire, channel: str) -> None:
    with serving(wire.timeline, {channel: wire}):
        bus = can.Bus(interface="thorvaldc_sim", channel=channel)
    with pytest.raises(can.CanOperationError, match="stopped"):
        bus.recv(1.0)
    with pytest.raises(can.CanOperationError):
        bus.send(message(0x100))
    bus.shutdown()
    assert not Path(channel).exists()


def test_no_bus_at_a_channel(channel: str) -> None:
    with pytest.raises(can.CanInitializationError, match="no bus runs"):
        can.Bus(interface="thorvaldc_sim", channel=channel)


def test_a_channel_in_use_is_refused_and_a_stale_one_is_replaced(wire: Wire, channel: str) -> None:
    with (
        serving(wire.timeline, {channel: wire}),
        pytest.raises(OSError, match=r"already runs at"),
    ):
        BusServer(Timeline(), {channel: wire})
    with socket.socket(socket.AF_UNIX) as dead:
        dead.bind(channel)
    with serving(wire.timeline, {channel: wire}):
        SimulatedBusClient(channel).close()


def test_a_file_that_is_not_a_socket_is_kept(wire: Wire, tmp_path: Path) -> None:
    precious = tmp_path / "robot.yaml"
    precious.write_text("thorvaldc: 1\n", encoding="utf-8")
    with pytest.raises(OSError, match="is not a socket"):
        BusServer(Timeline(), {str(precious): wire})
    assert precious.read_text(encoding="utf-8") == "thorvaldc: 1\n"


@pytest.fixture
def welcoming(
    channel: str,
) -> Iterator[Callable[[bytes], tuple[SimulatedBusClient, socket.socket]]]:
    """A scripted server: sends the welcome and more messages in one packet."""
    never_late = time.monotonic_ns() + 3600 * 10**9
    values = {"bitrate": 500_000, "epoch": 0.0, "now": 0, "start": never_late}
    welcome = pack_json(protocol.WELCOME, values)
    with socket.socket(socket.AF_UNIX) as listener, ExitStack() as ends:
        listener.bind(channel)
        listener.listen()

        def attach(more: bytes) -> tuple[SimulatedBusClient, socket.socket]:
            streams: list[socket.socket] = []

            def serve() -> None:
                stream = ends.enter_context(listener.accept()[0])
                stream.sendall(welcome + more)
                streams.append(stream)

            thread = threading.Thread(target=serve)
            thread.start()
            client = SimulatedBusClient(channel, send_limit=3)
            thread.join()
            ends.callback(client.close)
            return client, streams[0]

        yield attach


def test_frames_after_the_welcome_are_not_lost(
    welcoming: Callable[[bytes], tuple[SimulatedBusClient, socket.socket]],
) -> None:
    frames = [interface.CanFrame(k, bytes([k])) for k in range(1, 4)]
    stream = b"".join(protocol.pack_frame(protocol.FRAME, frame) for frame in frames)
    client, server = welcoming(stream[:-5])
    server.sendall(stream[-5:])
    assert [got.frame for got in (client.receive(60.0) for _ in frames) if got] == frames


def test_frames_on_the_way_to_the_server_count_as_queued(
    welcoming: Callable[[bytes], tuple[SimulatedBusClient, socket.socket]],
) -> None:
    """A STATE message reports dropped frames; the server cannot know those on the way to it."""
    client, server = welcoming(b"")
    assert all(client.send(interface.CanFrame(1)) for _ in range(3))
    passive = {"state": "error-passive", "dropped": 0}
    server.sendall(pack_json(protocol.STATE, passive))
    server.sendall(protocol.pack_frame(protocol.FRAME, interface.CanFrame(2)))
    assert client.receive(60.0) is not None
    assert not client.send(interface.CanFrame(1)), "three are on the way"
    active = {"state": "error-active", "dropped": 2}
    server.sendall(pack_json(protocol.STATE, active))
    server.sendall(protocol.pack_frame(protocol.FRAME, interface.CanFrame(2)))
    assert client.receive(60.0) is not None
    assert client.send(interface.CanFrame(1))


def test_after_a_restart_there_is_room_again(wire: Wire, channel: str) -> None:
    with serving(wire.timeline, {channel: wire}), closing(SimulatedBusClient(channel)) as client:
        while client.send(interface.CanFrame(1)):  # no acknowledge
            pass
        client.restart()
        assert client.send(interface.CanFrame(1), timeout=60.0)


def test_a_closed_client_receives_nothing(wire: Wire, channel: str) -> None:
    with serving(wire.timeline, {channel: wire}):
        client = SimulatedBusClient(channel)
        client.close()
        with pytest.raises(ConnectionError):
            client.receive(0.1)


def test_clients_are_served_while_the_simulation_lags(wire: Wire, channel: str) -> None:
    def slow() -> None:
        time.sleep(0.02)
        wire.timeline.after(5_000_000, slow)

    wire.timeline.at(0, slow)
    with serving(wire.timeline, {channel: wire}) as server:
        a, b = SimulatedBusClient(channel), SimulatedBusClient(channel)
        for k in range(5):
            assert a.send(interface.CanFrame(k), timeout=60.0)
            assert b.receive(60.0) is not None
        a.close()
        b.close()
    assert server.behind > 50_000_000


def test_frames_keep_their_times_while_the_server_runs_late(wire: Wire, channel: str) -> None:
    """The server does not run for 0.2 s; a client sends meanwhile, and knows that it is late."""
    stop = threading.Event()
    wire.observers.append(lambda *frame: frame[1].id == 0x700 and stop.wait(5.0))
    with (
        serving(wire.timeline, {channel: wire}),
        closing(SimulatedBusClient(channel)) as a,
        closing(SimulatedBusClient(channel)) as b,
    ):
        assert a.send(interface.CanFrame(0x700))
        a.sleep(0.05)
        stopped_at = a.received_until
        sent = []
        for k in range(60):
            sent.append(a.now)
            assert a.send(interface.CanFrame(k), timeout=0.0), "more than fit in the send queue"
            a.sleep(0.003)
        assert a.received_until == stopped_at
        assert b.receive(0.0) is None
        stop.set()
        received = [got for got in (b.receive(60.0) for _ in [0, *sent]) if got is not None]
        assert received.pop(0).frame.id == 0x700
        assert [got.frame.id for got in received] == list(range(60))
        delays = [got.time / 1e9 - time for got, time in zip(received, sent, strict=True)]
        assert min(delays) > 0.0
        assert max(delays) < 0.1, "and not when the server runs again"
        a.sleep(0.2)
        assert a.now - a.received_until < 0.2
        assert b.now == pytest.approx(a.now, abs=0.2)


def test_a_channel_name_too_long_for_a_socket(wire: Wire) -> None:
    with pytest.raises(OSError, match="longer than 100 bytes"):
        BusServer(Timeline(), {"/tmp/" + "x" * 120: wire})
