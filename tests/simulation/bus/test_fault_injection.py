"""Injected faults of a script: the effect of each on the bus, its beginning and its end."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import pytest

from tests.examples import example_robot
from tests.robots import SPAN
from tests.simulation.bus.master import Master
from tests.simulation.bus.robots import cia402_robot
from thorvaldc.can.frame import CanFrame, ErrorState
from thorvaldc.compiler.bus.injected_faults import read_faults
from thorvaldc.diagnostics import Report
from thorvaldc.model import Robot
from thorvaldc.model.scenario import FAULT_KINDS, BusFault, BusFaults
from thorvaldc.simulation.bus.fault_injection import FaultInjector
from thorvaldc.simulation.bus.simulated_robot import SimulatedRobot

EXAMPLE = Path(__file__).parents[3] / "examples" / "bus_faults" / "bad_day.yaml"
FL = "fl_controller"


class Run:
    """A bus with CiA 402 drives (ids 1 to 4) and injected faults."""

    def __init__(self, *faults: BusFault, robot: Robot | None = None, seed: int = 0) -> None:
        self.simulated = SimulatedRobot(robot or cia402_robot(), seed=seed)
        self.master = Master(self.simulated.interface(receive_limit=100_000))
        self.reports: list[tuple[float, str, bool]] = []
        self.faults = FaultInjector(
            self.simulated,
            BusFaults(faults),
            lambda time, fault, begins: self.reports.append((time, fault.kind, begins)),
        )
        self.simulated.power_on()

    def beats(self, node: int, seconds: float) -> int:
        """Returns the number of heartbeats of a node in the next ``seconds``."""
        return len(self.master.all(0x700 + node, seconds))


def fault(kind: str, node: str | None = FL, at: float | None = 1.0, **more: Any) -> BusFault:
    return BusFault(kind, "main", node, at, more.pop("frame", None), SPAN, **more)


def test_power_cut_of_one_device_and_back() -> None:
    run = Run(fault("power_cut", duration=1.0))
    run.simulated.run(1.0)
    run.master.interface.received.clear()
    assert run.beats(1, 0.9) == 0
    run.simulated.run(0.1)
    boots = run.master.all(0x701, 0.3)
    assert boots[0] == b"\0"
    assert run.reports == [(1.0, "power_cut", True), (2.0, "power_cut", False)]


def test_power_cut_of_the_whole_bus() -> None:
    run = Run(fault("power_cut", None, duration=1.0))
    run.simulated.run(1.001)
    assert not any(device.powered for device in run.simulated.devices.values())
    run.master.interface.received.clear()
    run.simulated.run(0.9)
    assert len(run.master.interface.received) == 0
    run.simulated.run(0.2)
    assert all(device.powered for device in run.simulated.devices.values())


@pytest.mark.parametrize("number", [1, 17, 40])
def test_power_cut_at_a_frame_destroys_that_frame(number: int) -> None:
    run = Run(fault("power_cut", None, at=None, frame=number))
    run.simulated.run(2.0)
    assert run.simulated.wire().frames == number - 1
    assert run.simulated.wire().errors >= 1


def test_a_delay_after_a_frame() -> None:
    run = Run(fault("power_cut", None, at=None, frame=10, delay=0.005))
    run.simulated.run(2.0)
    assert run.simulated.wire().frames >= 10
    time, _, _ = run.reports[0]
    assert 0.0 < time < 2.0


def test_mute_and_heartbeat_stop() -> None:
    run = Run(fault("mute", duration=1.0), fault("heartbeat_stop", "fr_controller", duration=1.0))
    run.simulated.run(1.0)
    run.master.interface.received.clear()
    assert run.beats(1, 0.99) == run.beats(2, 0.0) == 0
    run.simulated.run(0.01)
    assert run.beats(1, 1.0) == 10
    again = Run(fault("heartbeat_stop"))
    again.simulated.run(1.05)
    again.master.interface.received.clear()
    assert again.master.number(1, 0x1018, 4) == 0x101, "it answers, without heartbeats"


def test_duplicate_id() -> None:
    run = Run(fault("duplicate_id", id=2))
    run.simulated.run(1.3)
    run.master.interface.received.clear()
    run.master.send(0x602, struct.pack("<BHB4x", 0x40, 0x1018, 4))
    serials = {struct.unpack_from("<I", data, 4)[0] for data in run.master.all(0x582, 0.02)}
    assert serials == {0x101, 0x102}


def test_babble_takes_the_bus() -> None:
    run = Run(fault("babble", cob_id=0x001, period=150e-6, duration=1.0))
    run.simulated.run(1.0)
    run.master.interface.received.clear()
    assert run.beats(2, 1.0) <= 1, "frames of lower priority must wait"
    run.simulated.run(0.1)
    run.master.interface.received.clear()
    assert run.beats(2, 1.0) == 10


def test_emcy() -> None:
    run = Run(fault("emcy", code=0x2310, register=2))
    run.simulated.run(0.99)
    run.master.interface.received.clear()
    emergency = run.master.wait(0x081, 0.1)
    assert emergency is not None
    assert struct.unpack_from("<HB", emergency) == (0x2310, 3)


@pytest.mark.parametrize("kind", ["frozen_encoder", "blocked_motor"])
def test_motors_and_encoders(kind: str) -> None:
    robot = example_robot("4wd4ws_wide")
    run = Run(fault(kind, channel="propulsion"), robot=robot)
    run.simulated.run(0.3)
    run.master.nmt(1)
    node = next(n for n in robot.buses[0].nodes if n.name == FL)
    for k in range(150):
        run.master.send(0x200 + node.id, struct.pack("<ii", k, 500))
        run.simulated.run(0.02)
    # Stall, and for the encoder its own flag; both stop the motor.
    flags = run.master.all(0x380 + node.id, 0.2)[-1][0]
    assert flags == (0x99 if kind == "frozen_encoder" else 0x19)


def test_wrong_bitrate_ends_with_the_right_one() -> None:
    run = Run(fault("wrong_bitrate", bitrate=250_000, duration=2.0))
    run.simulated.run(1.0)
    run.master.interface.received.clear()
    assert run.beats(1, 1.9) == 0
    assert run.simulated.wire().errors > 10
    run.simulated.run(0.5)
    run.master.interface.received.clear()
    assert run.beats(1, 1.0) == 10
    assert run.beats(2, 1.0) == 10


def test_bus_off_recovers_automatically() -> None:
    run = Run(fault("bus_off"))
    states: list[ErrorState] = []
    controller = run.simulated.devices[FL].controller
    inner = controller.on_state

    def watch(state: ErrorState) -> None:
        states.append(state)
        if inner is not None:
            inner(state)

    controller.on_state = watch
    run.simulated.run(1.1)
    assert states == [ErrorState.BUS_OFF, ErrorState.ACTIVE]


def test_lost_frames_affect_one_receiver_only() -> None:
    run = Run(fault("lost_frames", at=0.5, cob_id=0x601, share=1.0, duration=1.0))
    run.simulated.run(0.6)
    run.master.send(0x601, struct.pack("<BHB4x", 0x40, 0x1000, 0))
    assert run.master.wait(0x581) is None
    assert run.master.number(2, 0x1000) == 0xFFFF0192
    assert run.simulated.wire().errors == 0
    run.simulated.run(1.0)
    assert run.master.number(1, 0x1000) == 0xFFFF0192


def test_late_and_repeated_frames() -> None:
    run = Run(
        fault("late_frames", None, at=0.5, cob_id=0x702, share=1.0, latency=0.05, duration=1.0),
        fault("repeated_frames", None, at=0.5, cob_id=0x703, share=1.0, duration=1.0),
    )
    run.simulated.run(0.5)
    sent: list[float] = []

    def note(time: int, frame: CanFrame, _: object) -> None:
        if frame.id == 0x702:
            sent.append(time / 1e9)

    run.simulated.wire().observers.append(note)
    run.master.interface.received.clear()
    run.simulated.run(0.9)
    frames = list(run.master.interface.received)
    arrivals = [received.time / 1e9 for received in frames if received.frame.id == 0x702]
    assert len(arrivals) > 5
    assert arrivals == pytest.approx([time + 0.05 for time in sent[: len(arrivals)]])
    counts = [sum(received.frame.id == 0x700 + k for received in frames) for k in (1, 3)]
    assert counts == [9, 18]
    run.simulated.run(0.3)
    run.master.interface.received.clear()
    assert run.beats(3, 0.95) in (9, 10), "the fault has ended"


def test_a_clone_answers_under_the_same_id_until_it_is_removed() -> None:
    run = Run(fault("clone", at=0.0, duration=1.5))
    run.simulated.run(1.0)
    run.master.interface.received.clear()
    assert run.beats(1, 0.49) in (8, 9, 10), "two nodes send the heartbeat 0x701, 5 times each"
    names = set(run.simulated.devices)
    run.simulated.run(0.02)
    assert names - set(run.simulated.devices) == {f"{FL}_clone"}
    run.master.interface.received.clear()
    assert run.beats(1, 0.5) == 5


def test_forged_frames() -> None:
    run = Run(
        fault("forged_frames", None, cob_id=0x77F, data=b"\x05", period=0.1, duration=1.0),
        fault("forged_frames", None, cob_id=0x123, period=0.1, duration=0.55),
        fault("forged_frames", None, cob_id=0x000, data=bytes([0x80, 0x00])),
    )
    run.simulated.run(0.99)
    run.master.interface.received.clear()
    run.simulated.run(2.0)
    frames = [received.frame for received in run.master.interface.received]
    assert [frame.data for frame in frames if frame.id == 0x77F] == [b"\x05"] * 10
    random_data = [frame.data for frame in frames if frame.id == 0x123]
    assert len(set(random_data)) == len(random_data) == 6, "new data in each frame"
    assert [frame.data for frame in frames if frame.id == 0x000] == [b"\x80\x00"]


def test_random_reports_have_the_length_of_the_reports_of_the_node() -> None:
    run = Run(fault("forged_frames", None, cob_id=0x181, at=0.0, period=0.1, duration=1.0))
    run.simulated.run(1.0)
    report = next(f for f in cia402_robot().buses[0].frames if f.cob_id == 0x181)
    lengths = {len(r.frame.data) for r in run.master.interface.received if r.frame.id == 0x181}
    assert lengths == {report.length}


def test_encoder_jump() -> None:
    run = Run(fault("encoder_jump", channel="steering", angle=0.5))
    run.simulated.run(0.9)
    encoder, motor = run.simulated.devices[FL].channel_motor(1)
    assert encoder is not None
    assert motor is not None
    before = encoder.measure(motor.read(0.9))[0]
    run.simulated.run(0.2)
    assert encoder.measure(motor.read(1.1))[0] == pytest.approx(before + 0.5)


def test_battery_charge() -> None:
    run = Run(fault("battery_charge", "battery", charge=0.04, duration=1.0))
    for start, percent in ((0.7, 90), (1.2, 4), (2.2, 90)):
        run.simulated.run(start - run.simulated.timeline.seconds)
        run.master.interface.received.clear()
        assert run.master.all(0x3E1, 0.2)[-1][0] == percent


def test_watchdog_lost_of_a_cia402_drive() -> None:
    run = Run(fault("watchdog_lost"))
    run.simulated.run(0.9)
    assert run.master.number(1, 0x1016, 1) > 0
    run.simulated.run(0.2)
    assert run.master.number(1, 0x1016, 1) == 0
    assert run.master.number(2, 0x1016, 1) > 0
    run.simulated.devices[FL].power_off()
    run.simulated.devices[FL].power_on()
    run.simulated.run(0.5)
    assert run.master.number(1, 0x1016, 1) > 0, "the stored value holds after power-on"


def test_an_object_is_overwritten_until_the_next_reset() -> None:
    """The drive sends heartbeats at half the rate, until its power is cut."""
    written = fault("object_written", index=0x1017, value=200)
    too_large = fault("object_written", index=0x1017, value=1 << 16)
    unknown = fault("object_written", index=0x5FFF, value=1)
    run = Run(written, too_large, unknown, fault("power_cut", at=3.0, duration=0.1))
    run.simulated.run(1.1)
    run.master.interface.received.clear()
    assert run.beats(1, 1.0) == 5
    run.simulated.run(1.5)
    run.master.interface.received.clear()
    assert run.beats(1, 1.0) == 10


def test_an_object_is_overwritten_for_a_time() -> None:
    run = Run(fault("object_written", index=0x1017, value=200, duration=1.1))
    run.simulated.run(2.3)
    run.master.interface.received.clear()
    assert run.beats(1, 1.0) == 10


@pytest.mark.parametrize("lost", [False, True])
def test_watchdog_lost_of_a_script(lost: bool) -> None:
    robot = example_robot("4wd4ws_wide")
    run = Run(*([fault("watchdog_lost", at=0.25)] if lost else []), robot=robot)
    run.simulated.run(0.3)
    run.master.nmt(1)
    node = next(n for n in robot.buses[0].nodes if n.name == FL)
    run.master.send(0x200 + node.id, struct.pack("<ii", 1, 500))
    run.simulated.run(2.0)
    _, motor = run.simulated.devices[FL].channel_motor(0)
    assert motor is not None
    assert (abs(motor.read(run.simulated.timeline.seconds).velocity) > 1.0) is lost


@pytest.mark.parametrize("kind", ["frozen_reports", "commands_ignored", "nmt_ignored"])
def test_a_task_that_hangs_before_the_start_hangs_until_the_next_reset(kind: str) -> None:
    """The fault once ended with the boot of the device."""
    robot = example_robot("4wd4ws_wide")
    run = Run(fault(kind, at=0.0), robot=robot)
    node = next(n for n in robot.buses[0].nodes if n.name == FL)
    _, motor = run.simulated.devices[FL].channel_motor(0)
    assert motor is not None

    def drive() -> tuple[bool, bool]:
        """Returns whether the wheel turns, and whether the reports show different speeds."""
        run.simulated.run(0.3)
        run.master.nmt(1)
        reports = set()
        for k in range(50):
            run.master.send(0x200 + node.id, struct.pack("<ii", k, 300 if k > 20 else 0))
            reports.update(run.master.all(0x180 + node.id, 0.02))
        turns = abs(motor.read(run.simulated.timeline.seconds).velocity) > 1.0
        return turns, len(reports) > 1

    assert drive() == (kind == "frozen_reports", False)
    run.simulated.devices[FL].power_off()
    run.simulated.devices[FL].power_on()
    assert drive() == (True, True)


def test_noise_costs_time_but_nothing_is_lost() -> None:
    noisy, quiet = Run(fault("noise", None, at=0.0, share=0.3)), Run()
    for run in (noisy, quiet):
        run.simulated.run(3.0)
    assert noisy.simulated.wire().errors > 50
    assert quiet.simulated.wire().errors == 0
    assert noisy.simulated.wire().frames == pytest.approx(quiet.simulated.wire().frames, abs=3)


# -- the document -----------------------------------------------------------------------------


def read(text: str, folder: Path) -> tuple[BusFaults | None, list[tuple[str, str]]]:
    path = folder / "faults.yaml"
    path.write_text("thorvaldc: 1\nfaults:\n" + text, encoding="utf-8")
    report = Report()
    script = read_faults(path, cia402_robot(), report)
    return script, [(d.code.name, d.message) for d in report]


def test_the_example_is_read() -> None:
    report = Report()
    script = read_faults(EXAMPLE, example_robot("4wd4ws_wide"), report)
    assert list(report) == []
    assert script is not None
    assert script.seed == 3
    assert [f.kind for f in script.faults] == [
        "noise", "power_cut", "frozen_encoder", "duplicate_id", "emcy", "power_cut",
    ]  # fmt: skip
    noise, cut, frozen, twice, emcy, whole = script.faults
    assert noise.share == pytest.approx(0.02)
    assert (cut.node, cut.time, cut.duration) == (FL, 5.0, 2.0)
    assert (frozen.channel, twice.id, emcy.code) == ("steering", 1, 0x3210)
    assert whole.node is None
    simulated = SimulatedRobot(example_robot("4wd4ws_wide"), seed=script.seed)
    FaultInjector(simulated, script)
    simulated.power_on()
    simulated.run(30.0)


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("  - {fault: mute, at: 1 s}", "missing-key"),
        ("  - {fault: mute, node: fl_controller}", "missing-key"),
        ("  - {fault: mute, node: fl_controller, at: 1 s, frame: 3}", "conflicting-keys"),
        ("  - {fault: mute, node: fl_controller, at: 1 s, share: 0.2}", "conflicting-keys"),
        ("  - {fault: noise, node: fl_controller, at: 1 s, share: 0.2}", "conflicting-keys"),
        ("  - {fault: bus_off, node: fl_controller, at: 1 s, for: 1 s}", "conflicting-keys"),
        ("  - {fault: noise, at: 1 s, share: 1.2}", "out-of-range"),
        ("  - {fault: noise, at: -1 s, share: 0.2}", "out-of-range"),
        ("  - {fault: duplicate_id, node: fl_controller, id: 0, at: 1 s}", "can-id-range"),
        ("  - {fault: duplicate_id, node: battery, id: 16, at: 1 s}", "can-id-range"),
        ("  - {fault: frozen_encoder, node: fl_controller, channel: x, at: 0}", "channel-unknown"),
        ("  - {fault: encoder_jump, node: fl_controller, channel: steering, at: 0}", "missing-key"),
        ("  - {fault: forged_frames, cob_id: 0x80, data: [256], at: 0}", "out-of-range"),
        ("  - {fault: forged_frames, node: battery, cob_id: 0x80, at: 0}", "conflicting-keys"),
        (
            "  - {fault: battery_charge, node: fl_controller, charge: 1, at: 0}",
            "bus-fault-unsuited",
        ),
        ("  - {fault: battery_charge, node: battery, charge: 2, at: 0}", "out-of-range"),
        ("  - {fault: watchdog_lost, node: battery, at: 0}", "bus-fault-unsuited"),
        (
            "  - {fault: object_written, node: battery, at: 0, index: 1, value: 1}",
            "bus-fault-unsuited",
        ),
        ("  - {fault: late_frames, share: 0.5, at: 0}", "missing-key"),
        ("  - {fault: mute, bus: other, node: fl_controller, at: 1 s}", "can-bus-unknown"),
        ("  - {fault: explode, node: fl_controller, at: 1 s}", "unknown-value"),
        ("  - {fault: mute, node: fl_controller, at: 1 kg}", "wrong-dimension"),
    ],
)
def test_errors_in_a_document_are_reported(text: str, code: str, tmp_path: Path) -> None:
    script, diagnostics = read(text, tmp_path)
    assert code in [name for name, _ in diagnostics], diagnostics
    assert script is None


def test_new_keys_are_read(tmp_path: Path) -> None:
    script, diagnostics = read(
        "  - {fault: forged_frames, cob_id: 0x181, data: [1, 0xFF], period: 10 ms, at: 0}\n"
        "  - {fault: encoder_jump, node: fl_controller, channel: steering, angle: -90 deg, at: 0}\n"
        "  - {fault: battery_charge, node: battery, charge: 5 %, at: 0}\n"
        "  - {fault: late_frames, share: 1, latency: 20 ms, at: 0}\n",
        tmp_path,
    )
    assert diagnostics == []
    assert script is not None
    forged, jump, battery, late = script.faults
    assert (forged.cob_id, forged.data, forged.period) == (0x181, b"\x01\xff", 0.01)
    assert jump.angle == pytest.approx(-1.5707963)
    assert (battery.charge, late.latency) == pytest.approx((0.05, 0.02))


def test_every_kind_of_fault_can_be_injected() -> None:
    """The injector knows every kind of the schema."""
    more: dict[str, Any] = {
        "id": 9, "cob_id": 0x400, "period": 0.01, "code": 0x1000, "channel": "steering",
        "bitrate": 125_000, "share": 0.5, "latency": 0.01, "angle": 0.1, "charge": 0.1,
        "speed": 0.5, "index": 0x6084, "value": 1,
    }  # fmt: skip
    faults = [
        fault(
            kind,
            None if spec.node == "no" else "battery" if "charge" in spec.needs else FL,
            duration=0.5 if spec.lasts else None,
            **more,
        )
        for kind, spec in FAULT_KINDS.items()
    ]
    run = Run(*faults)
    run.simulated.run(3.0)
    begun = [kind for _, kind, begins in run.reports if begins]
    assert begun == list(FAULT_KINDS)
    assert [f.kind for f in run.faults.active] == [
        "duplicate_id", "emcy", "watchdog_lost", "encoder_jump", "bus_off",
    ]  # fmt: skip
