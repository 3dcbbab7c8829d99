"""The wire: arbitration, frame times, and the effects of errors."""

from __future__ import annotations

import pytest

from thorvaldc.can.frame import CanFrame, ErrorState
from thorvaldc.can.frame_bits import frame_bits
from thorvaldc.simulation.bus.simulated_robot import VirtualTimeInterface
from thorvaldc.simulation.bus.timeline import Timeline
from thorvaldc.simulation.bus.wire import CanController, Wire

RATE = 500_000
BIT = 2000  # ns


class Log:
    """Each valid frame: its end (ns), the frame, and the names of its senders."""

    def __init__(self, wire: Wire) -> None:
        self.entries: list[tuple[int, str, list[str]]] = []
        wire.observers.append(self)

    def __call__(self, time: int, frame: CanFrame, senders: list[CanController]) -> None:
        self.entries.append((time, str(frame), [s.name for s in senders]))


def make(*names: str, seed: int = 0) -> tuple[Wire, list[VirtualTimeInterface], Log]:
    wire = Wire(Timeline(), RATE, seed=seed)
    clients = [VirtualTimeInterface(wire, name) for name in names]
    log = Log(wire)
    clients[0].sleep(0.001)
    return wire, clients, log


def ids(log: Log) -> list[str]:
    return [entry[1].partition("#")[0] for entry in log.entries]


def test_a_frame_takes_its_bits() -> None:
    wire, (a, b), log = make("a", "b")
    frame = CanFrame(0x123, bytes(range(8)))
    start = wire.timeline.now
    assert a.send(frame)
    received = b.receive(1.0)
    assert received is not None
    assert received.frame == frame
    # Valid before the three bits of interframe space.
    assert received.time - start == (frame_bits(frame) - 3) * BIT
    assert log.entries == [(received.time, str(frame), ["a"])]
    a.sleep(0.001)
    assert wire.busy == frame_bits(frame) * BIT


def test_the_lowest_identifier_wins_and_the_others_follow() -> None:
    _, (a, b, c), log = make("a", "b", "c")
    a.send(CanFrame(0x300, b"\1"))
    b.send(CanFrame(0x100, b"\2"))
    c.send(CanFrame(0x200, b"\3"))
    a.sleep(0.01)
    assert ids(log) == ["100", "200", "300"]


def test_frames_follow_without_a_gap() -> None:
    _, (a, _), log = make("a", "b")
    frames = [CanFrame(0x100 + i, bytes([i])) for i in range(3)]
    for frame in frames:
        a.send(frame)
    a.sleep(0.01)
    times = [entry[0] for entry in log.entries]
    assert times[1] - times[0] == frame_bits(frames[1]) * BIT
    assert times[2] - times[1] == frame_bits(frames[2]) * BIT


def test_a_frame_on_the_wire_is_not_interrupted() -> None:
    _, (a, b), log = make("a", "b")
    a.send(CanFrame(0x700, bytes(8)))
    a.sleep(50e-6)
    b.send(CanFrame(0x001))
    a.send(CanFrame(0x100))
    a.sleep(0.01)
    assert ids(log) == ["700", "001", "100"]


def test_a_fifo_sends_in_the_order_of_queuing() -> None:
    wire, _, log = make("a")
    fifo = VirtualTimeInterface(wire, "fifo", fifo=True)
    fifo.sleep(0.001)
    for identifier in (0x300, 0x100, 0x200):
        fifo.send(CanFrame(identifier))
    fifo.sleep(0.01)
    assert ids(log) == ["300", "100", "200"]


def test_standard_wins_over_extended_and_data_over_remote() -> None:
    _, (a, b, c), log = make("a", "b", "c")
    a.send(CanFrame(0x100 << 18, b"\1", extended=True))
    b.send(CanFrame(0x100, remote=True))
    c.send(CanFrame(0x100, b"\1"))
    a.sleep(0.01)
    assert [entry[1] for entry in log.entries] == ["100#01", "100#R0", "04000000#01"]


def test_equal_frames_at_the_same_time_are_one_on_the_wire() -> None:
    wire, (a, b, c), log = make("a", "b", "c")
    a.send(CanFrame(0x7E4, bytes(8)))
    b.send(CanFrame(0x7E4, bytes(8)))
    a.sleep(0.01)
    assert [entry[2] for entry in log.entries] == [["a", "b"]]
    assert [len(x.received) for x in (a, b, c)] == [0, 0, 1]
    assert wire.errors == 0
    assert a.controller.pending == b.controller.pending == 0


def test_unequal_frames_of_one_identifier_end_in_error_passive() -> None:
    """Arbitration cannot separate them: both reach 128 errors, then the one with the 1 yields."""
    wire, (a, b, c), log = make("a", "b", "c")
    a.send(CanFrame(0x181, b"\0"))
    b.send(CanFrame(0x181, b"\1"))
    a.sleep(0.1)
    assert wire.errors == 16
    assert [entry[1:] for entry in log.entries] == [("181#00", ["a"]), ("181#01", ["b"])]
    assert [str(r.frame) for r in c.received] == ["181#00", "181#01"]
    # 16 errors of 8 each; then the frame of a is valid, and b loses once more before its own is.
    assert a.controller.transmit_errors == 127
    assert b.controller.transmit_errors == 128 + 8 - 1
    assert (a.state, b.state) == (ErrorState.ACTIVE, ErrorState.PASSIVE)


def test_a_lone_controller_gets_no_acknowledge() -> None:
    """The error repeats without end, but leads no further than error-passive (ISO 11898-1)."""
    wire, (a,), log = make("a")
    a.send(CanFrame(0x100, b"\1"))
    a.sleep(1.0)
    assert log.entries == []
    assert a.controller.transmit_errors == 128
    assert a.state is ErrorState.PASSIVE
    assert wire.errors > 1000
    receiver = VirtualTimeInterface(wire, "b")
    a.sleep(0.01)
    assert [str(r.frame) for r in receiver.received] == ["100#01"]


def test_a_listen_only_controller_does_not_acknowledge() -> None:
    wire, (a,), _ = make("a")
    monitor = VirtualTimeInterface(wire, "monitor", listen_only=True)
    a.send(CanFrame(0x100))
    a.sleep(0.01)
    assert len(monitor.received) == 0
    assert not monitor.send(CanFrame(0x200))


def test_a_full_receive_queue_drops_and_counts_frames() -> None:
    wire, (a,), _ = make("a")
    slow = VirtualTimeInterface(wire, "slow", receive_limit=2)
    a.sleep(0.001)
    for number in range(5):
        assert a.send(CanFrame(0x100 + number))
        a.sleep(0.001)
    assert [entry.frame.id for entry in slow.received] == [0x100, 0x101]
    assert slow.overruns == 3


def test_a_wrong_bitrate_destroys_frames_until_it_is_error_passive() -> None:
    wire, (a, b), log = make("a", "b")
    wrong = VirtualTimeInterface(wire, "wrong", 250_000)
    a.sleep(0.001)
    a.send(CanFrame(0x100, b"\1"))
    a.sleep(0.1)
    # Each destroyed frame adds 9 receive errors: the 15th exceeds 127.
    assert wire.errors == 15
    assert wrong.state is ErrorState.PASSIVE
    assert len(wrong.received) == 0
    assert [entry[1] for entry in log.entries] == ["100#01"]
    assert len(b.received) == 1


def test_a_sender_of_the_wrong_bitrate_goes_off_the_bus() -> None:
    wire, (a, b), log = make("a", "b")
    wrong = VirtualTimeInterface(wire, "wrong", 250_000)
    a.sleep(0.001)
    for _ in range(4):
        wrong.send(CanFrame(0x700, b"\1"))
    for _ in range(500):
        a.send(CanFrame(0x100, b"\2"))
        b.send(CanFrame(0x101, b"\3"))
        a.sleep(0.002)
    assert wrong.state is ErrorState.BUS_OFF
    assert not wrong.send(CanFrame(0x700))
    assert set(ids(log)) == {"100", "101"}
    # Each received frame reduces their error counters again.
    assert a.state is b.state is ErrorState.ACTIVE


def test_recovery_from_bus_off() -> None:
    wire, (a, b), _ = make("a", "b")
    automatic = CanController(wire, "automatic", RATE)
    wire.attach(automatic)
    automatic.switch_on()
    states: list[ErrorState] = []
    automatic.on_state = states.append
    automatic.go_bus_off()
    a.sleep(128 * 11 * BIT * 1e-9)
    assert states == [ErrorState.BUS_OFF, ErrorState.ACTIVE]
    b.controller.go_bus_off()
    a.sleep(1.0)
    assert b.state is ErrorState.BUS_OFF, "the controller of a program needs a restart"
    b.restart()
    assert b.state is ErrorState.ACTIVE


def test_the_recovery_takes_128_times_11_bits() -> None:
    wire, (a, _), _ = make("a", "b")
    automatic = CanController(wire, "automatic", RATE)
    wire.attach(automatic)
    automatic.switch_on()
    automatic.go_bus_off()
    a.sleep((128 * 11 - 1) * BIT * 1e-9)
    assert automatic.state is ErrorState.BUS_OFF
    a.sleep(BIT * 1e-9)
    assert automatic.state is ErrorState.ACTIVE


def test_a_controller_that_joins_waits_for_11_recessive_bits() -> None:
    wire, (a, b), log = make("a", "b")
    a.controller.switch_off()
    a.sleep(0.001)
    a.controller.switch_on()
    start = wire.timeline.now
    frame = CanFrame(0x123, bytes(8))
    a.send(frame)
    b.sleep(0.01)
    assert log.entries[-1][0] - start == (11 + frame_bits(frame) - 3) * BIT


def test_an_error_passive_sender_waits_8_more_bits() -> None:
    _, (a, b), log = make("a", "b")
    frames = [CanFrame(0x100, bytes(8)), CanFrame(0x101, bytes(8))]
    for errors, gap in ((127, 0), (200, 8)):
        a.controller.transmit_errors = errors
        for frame in frames:
            a.send(frame)
        b.sleep(0.01)
        first, second = (entry[0] for entry in log.entries[-2:])
        assert second - first == (frame_bits(frames[1]) + gap) * BIT


def test_error_counters_and_states() -> None:
    _, (a, b), _ = make("a", "b")
    controller = b.controller
    states: list[ErrorState] = []
    controller.on_state = states.append
    controller.count_errors(receive=127)
    assert states == []
    controller.count_errors(receive=1)
    assert (controller.receive_errors, states) == (128, [ErrorState.PASSIVE])
    controller.count_errors(receive=200)
    assert controller.receive_errors == 255
    for number, expected in enumerate((127, 126, 125)):
        a.send(CanFrame(0x100 + number))
        a.sleep(0.001)
        assert controller.receive_errors == expected
    assert states == [ErrorState.PASSIVE, ErrorState.ACTIVE]
    controller.count_errors(transmit=128)
    b.send(CanFrame(0x200))
    a.sleep(0.001)
    assert controller.transmit_errors == 127
    controller.count_errors(transmit=128)
    assert controller.state is ErrorState.PASSIVE, "255 is not yet bus-off"
    controller.count_errors(transmit=1)
    assert states[2:] == [
        *(ErrorState.PASSIVE, ErrorState.ACTIVE, ErrorState.PASSIVE),
        ErrorState.BUS_OFF,
    ]
    controller.restart()
    assert (controller.transmit_errors, controller.receive_errors) == (0, 0)


def test_counts_of_a_controller() -> None:
    wire, (a, b), _ = make("a", "b")
    wire.filters.append(lambda receiver, frame: frame.id != 0x101)
    for identifier in (0x100, 0x101, 0x102):
        a.send(CanFrame(identifier))
    assert a.controller.pending == 3
    a.sleep(0.01)
    assert (a.controller.sent, len(a.received)) == (3, 0)
    assert (b.controller.sent, len(b.received)) == (0, 2)
    a.controller.switch_off()
    assert not a.send(CanFrame(0x100))


def test_a_full_queue_refuses_the_newest() -> None:
    wire, (_,), log = make("a")
    small = VirtualTimeInterface(wire, "small", send_limit=3)
    small.sleep(0.001)
    taken = [small.send(CanFrame(0x100 + i)) for i in range(5)]
    assert taken == [True, True, True, False, False]
    assert small.send(CanFrame(0x110), timeout=0.01), "waits for room"
    small.sleep(0.01)
    assert ids(log) == ["100", "101", "102", "110"]


def test_a_full_receive_queue_loses_the_newest() -> None:
    wire, (a,), _ = make("a")
    slow = VirtualTimeInterface(wire, "slow", receive_limit=3)
    for i in range(5):
        a.send(CanFrame(0x100 + i))
    a.sleep(0.01)
    assert [r.frame.id for r in slow.received] == [0x100, 0x101, 0x102]
    assert slow.overruns == 2


def test_power_lost_in_a_frame_destroys_it() -> None:
    wire, (a, b), log = make("a", "b")
    wire.at_frame(1, a.controller.switch_off)
    a.send(CanFrame(0x100, bytes(8)))
    a.sleep(0.01)
    assert log.entries == []
    assert b.controller.receive_errors == 1
    a.controller.switch_on()
    b.send(CanFrame(0x200))
    b.sleep(0.01)
    assert ids(log) == ["200"]
    assert len(a.received) == 1


def test_a_controller_that_joins_during_a_frame_does_not_receive_it() -> None:
    wire, (a, b), _ = make("a", "b")
    late = VirtualTimeInterface(wire, "late")
    late.controller.switch_off()
    wire.at_frame(1, late.controller.switch_on)
    a.send(CanFrame(0x100, bytes(8)))
    a.send(CanFrame(0x101, bytes(8)))
    a.sleep(0.01)
    assert [r.frame.id for r in late.received] == [0x101]
    assert len(b.received) == 2


def test_frames_destroyed_by_noise_are_sent_again() -> None:
    wire, (a, b), log = make("a", "b", seed=3)
    wire.noise = 0.2
    for i in range(200):
        a.send(CanFrame(i, b"\1"))
        a.sleep(0.005)
    assert ids(log) == [f"{i:03x}" for i in range(200)]
    assert 30 < wire.errors < 80
    assert len(b.received) == 200


@pytest.mark.parametrize("seed", [1, 2])
def test_the_same_seed_gives_the_same_bus(seed: int) -> None:
    def run(seed: int) -> list[tuple[int, str, list[str]]]:
        wire, (a, b), log = make("a", "b", seed=seed)
        wire.noise = 0.3
        for i in range(50):
            a.send(CanFrame(0x100 + i))
            b.send(CanFrame(0x120 + i))
            a.sleep(0.001)
        return log.entries

    assert run(seed) == run(seed)
    assert run(seed) != run(seed + 10)


def test_an_event_cannot_wait_for_the_simulation() -> None:
    wire, (a,), _ = make("a")
    wire.timeline.at(0, lambda: a.sleep(1.0))
    with pytest.raises(RuntimeError, match="cannot wait"):
        a.sleep(0.001)
