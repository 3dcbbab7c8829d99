"""Flash: guards, resume, rollback, and the steps of the operator."""

from __future__ import annotations

import dataclasses
import itertools
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.commissioning.bench import (
    NODES,
    QUICK,
    SWAPPED,
    Bench,
    MemoryStorage,
    four_drives,
)
from tests.commissioning.robots import without_serials
from tests.commissioning.situations import stop_halfway
from tests.examples import example_robot
from tests.full_disk import full_disk
from tests.simulation.bus.robots import cia402_robot
from thorvaldc.can.frame import CanFrame
from thorvaldc.commissioning.bus_configuration import from_json
from thorvaldc.commissioning.flash import Flash
from thorvaldc.commissioning.journal import Journal, JournalFile
from thorvaldc.commissioning.plan import AddressStep, AttachStep
from thorvaldc.commissioning.planner import make_plan
from thorvaldc.commissioning.verify import verify
from thorvaldc.diagnostics import DiagnosticError
from thorvaldc.simulation.bus.simulated_robot import VirtualOperator, VirtualTimeInterface


def code_of(work: Callable[[], object]) -> str:
    with pytest.raises(DiagnosticError) as raised:
        work()
    return raised.value.diagnostic.code.name


def writes(bench: Bench) -> Callable[[], int]:
    """Returns a counter of frames that may change a device: SDO downloads, LSS, NMT."""
    seen: list[CanFrame] = []

    def watch(time: int, frame: CanFrame, senders: object) -> None:
        lss = frame.id == 0x7E5 and frame.data[0] in (0x11, 0x13, 0x17)
        if lss or frame.id == 0 or (0x600 < frame.id < 0x680 and frame.data[0] >> 5 == 1):
            seen.append(frame)

    bench.wire.observers.append(watch)
    return lambda: len(seen)


def test_the_order_of_a_swap() -> None:
    plan = Bench(four_drives(), SWAPPED, timing=QUICK).plan()
    moves = [(s.node, s.before, s.after) for s in plan.steps if isinstance(s, AddressStep)]
    assert moves == [
        ("rl_controller", 255, 3),
        ("rr_controller", 255, 4),
        ("fl_controller", 2, 112),
        ("fr_controller", 1, 2),
        ("fl_controller", 112, 1),
    ]


def test_a_chain_needs_no_parking() -> None:
    """1 to 2, 2 to 3, 3 to 4, 4 elsewhere: the last one moves first."""
    kept = {name: {"node_id": i} for i, name in zip((30, 1, 2, 3), NODES, strict=True)}
    bench = Bench(four_drives(), kept, timing=QUICK)
    moves = [(s.before, s.after) for s in bench.plan().steps if isinstance(s, AddressStep)]
    assert moves == [(3, 4), (2, 3), (1, 2), (30, 1)]
    bench.apply()
    assert not bench.watch.doubles


def test_a_ring_of_four() -> None:
    kept = {name: {"node_id": i} for i, name in zip((2, 3, 4, 1), NODES, strict=True)}
    bench = Bench(four_drives(), kept, timing=QUICK)
    plan = bench.apply()
    assert sum(isinstance(s, AddressStep) for s in plan.steps) == 5
    assert [bench.state()[n][0] for n in NODES] == [1, 2, 3, 4]
    assert not bench.watch.doubles


def test_new_drives_that_all_have_the_same_id() -> None:
    """Factory state; serial numbers distinguish them, and doubles only become fewer."""
    bench = Bench(four_drives(), {name: {"node_id": 1} for name in NODES}, timing=QUICK)
    bench.apply()
    assert [bench.state()[n][0] for n in NODES] == [1, 2, 3, 4]


def test_a_second_flash_has_nothing_to_do() -> None:
    bench = Bench(four_drives(), SWAPPED, timing=QUICK)
    bench.apply()
    data, count = bench.storage.data, writes(bench)
    assert bench.apply().steps == ()
    assert bench.storage.data == data
    assert count() == 4, "a reset of each node, and nothing else"


def test_a_plan_is_for_the_scanned_devices() -> None:
    bench, another_bench = (Bench(four_drives(), kept, timing=QUICK) for kept in (SWAPPED, None))
    assert bench.plan().hash == Bench(four_drives(), SWAPPED, timing=QUICK).plan().hash
    assert bench.plan().hash != another_bench.plan().hash
    assert (
        from_json(json.loads(json.dumps(dataclasses.asdict(bench.configuration))))
        == bench.configuration
    )


def test_a_device_of_another_type_gets_no_id() -> None:
    """Its identity fits, and its type can be read only when it has an id, which it loses again."""
    bench = Bench(four_drives(), SWAPPED, timing=QUICK)
    device = bench.devices()["rl_controller"]
    device.power_off()
    node = device.specification.node
    device.specification.node = dataclasses.replace(node, device_type=0x30191)
    device.power_on()
    bench.simulated.run(0.5)
    with pytest.raises(DiagnosticError) as raised:
        bench.apply()
    assert "its device type is 0x30191, not 0xffff0192; it gets no id" in str(raised.value)
    assert bench.state()["rl_controller"][0] == 255
    bench.simulated.run(1.0)
    assert device.node_id == 255
    assert not bench.watch.doubles


# -- guards: nothing is written -------------------------------------------------------------


def test_the_wrong_robots_file_writes_nothing() -> None:
    """Another robot of the same kind differs only in its serial numbers."""
    bench = Bench(four_drives(), SWAPPED, timing=QUICK)
    for device, serial in zip(bench.devices().values(), (0x901, 0x902, 0x903, 0x904), strict=True):
        device.power_off()
        device.specification.nonvolatile = {"serial": hex(serial)}
        device.power_on()
    bench.simulated.run(0.2)
    count = writes(bench)
    assert code_of(bench.apply) == "bus-wrong-robot"
    assert count() == 0
    assert not bench.storage.data


def test_another_kind_of_robot_writes_nothing() -> None:
    bench = Bench(example_robot("4wd4ws_wide"), delivered=False, timing=QUICK)
    target = Bench(cia402_robot(), timing=QUICK).configuration
    count = writes(bench)
    assert code_of(lambda: bench.run(lambda f: f.apply(), target=target)) == "bus-wrong-robot"
    assert count() == 0


@pytest.mark.parametrize("how", ["operational", "by its statusword"])
def test_a_drive_that_may_move_stops_it(how: str) -> None:
    """The heartbeat reports it, or the status word."""
    bench = Bench(cia402_robot(), delivered=False, still=False)
    driver = bench.simulated.interface(name="driver")
    if how == "operational":
        driver.send(CanFrame(0, b"\1\0"))
    else:
        for word in (6, 7, 15):
            driver.send(CanFrame(0x601, b"\x2b\x40\x60\x00" + bytes([word, 0, 0, 0])))
            bench.simulated.run(0.05)
    bench.simulated.run(0.1)
    count = writes(bench)
    with pytest.raises(DiagnosticError, match=how.split()[-1]) as raised:
        bench.apply()
    assert raised.value.diagnostic.code.name == "bus-drive-enabled"
    assert count() == 0


@pytest.mark.parametrize(
    "frame",
    [
        CanFrame(0x080),
        CanFrame(0, b"\1\0"),
        CanFrame(0x77F, b"\5"),
        CanFrame(0x7E5, bytes(8)),
        CanFrame(0x604, bytes(8)),
        CanFrame(0x201, bytes(7)),
    ],
    ids=str,
)
def test_a_master_that_appears_in_the_middle_stops_it(frame: CanFrame) -> None:
    bench = Bench(four_drives(), SWAPPED, timing=QUICK)
    driver = bench.simulated.interface(name="driver")
    bench.wire.at_frame(bench.wire.frames + 396, lambda: driver.send(frame))
    count = writes(bench)
    assert code_of(bench.apply) == "bus-other-master"
    start_count = count()
    bench.simulated.run(1.0)
    assert count() - start_count <= (frame.id == 0), "nothing was written after it"
    assert b'"stopped"' in bench.storage.data
    bench.resume()
    assert [bench.state()[n][0] for n in NODES] == [1, 2, 3, 4]


def test_bus_off_stops_it_and_nothing_is_repeated() -> None:
    bench = Bench(four_drives(), SWAPPED, timing=QUICK)
    bench.wire.at_frame(bench.wire.frames + 450, lambda: bench.interface.controller.go_bus_off())
    assert code_of(bench.apply) == "bus-error"
    sent = bench.interface.controller.sent
    bench.simulated.run(1.0)
    assert bench.interface.controller.sent == sent


# -- resume and rollback ----------------------------------------------------------------------


def test_rollback_restores_the_start() -> None:
    bench = Bench(four_drives(), SWAPPED, timing=QUICK)
    start_state = bench.state()
    bench.apply()
    changed = bench.state()
    bench.rollback()
    after = bench.state()
    assert {n: after[n][0] for n in NODES} == {n: start_state[n][0] for n in NODES}
    assert not bench.watch.doubles
    # The values are the previous defaults; the devices now store them explicitly.
    for name in NODES:
        differing = {k for k, v in changed[name][1].items() if after[name][1][k] != v}
        assert {"1017.00", "6007.00"} <= differing
        assert after[name][1]["1017.00"] == 0, "a new drive sends no heartbeat"
    assert code_of(bench.rollback) == "journal-mismatch"


def test_rollback_of_a_flash_that_stopped() -> None:
    bench = Bench(four_drives(), SWAPPED, timing=QUICK)
    assert code_of(lambda: stop_halfway(bench)) == "flash-stopped"
    bench.simulated.power_on()
    bench.simulated.run(0.2)
    assert code_of(bench.apply) == "journal-mismatch", "it must be resumed or undone first"
    bench.rollback()
    assert {n: bench.state()[n][0] for n in NODES} == dict(
        zip(NODES, (2, 1, 255, 255), strict=True)
    )


def test_an_interrupted_rollback_is_resumed() -> None:
    bench = Bench(four_drives(), SWAPPED, timing=QUICK)
    bench.apply()
    bench.wire.at_frame(bench.wire.frames + 500, bench.simulated.power_off)
    assert code_of(bench.rollback) in ("bus-error", "flash-stopped")
    bench.simulated.power_on()
    bench.simulated.run(0.2)
    bench.resume()
    assert {n: bench.state()[n][0] for n in NODES} == dict(
        zip(NODES, (2, 1, 255, 255), strict=True)
    )
    assert not bench.watch.doubles


def test_a_resume_needs_the_same_configuration() -> None:
    bench = Bench(four_drives(), SWAPPED, timing=QUICK)
    assert code_of(lambda: stop_halfway(bench)) == "flash-stopped"
    bench.simulated.power_on()
    bench.simulated.run(0.2)
    another_configuration = Bench(without_serials(four_drives(), NODES), timing=QUICK).configuration
    count = writes(bench)
    for how in (Flash.resume, Flash.rollback):
        assert (
            code_of(lambda how=how: bench.run(how, target=another_configuration))
            == "journal-mismatch"
        )
    assert count() == 0


def test_an_interrupt_closes_the_journal() -> None:
    bench = Bench(four_drives(), SWAPPED, timing=QUICK)

    def interrupt() -> None:
        raise KeyboardInterrupt

    bench.wire.at_frame(bench.wire.frames + 400, interrupt)
    with pytest.raises(KeyboardInterrupt):
        bench.apply()
    assert bench.storage.data.splitlines()[-1].startswith(
        b'{"record":"stopped","reason":"interrupted"'
    )
    bench.simulated.timeline._running = False
    bench.resume()
    assert [bench.state()[n][0] for n in NODES] == [1, 2, 3, 4]


def test_a_node_that_cannot_store_stops_it() -> None:
    bench = Bench(four_drives(), SWAPPED, timing=QUICK)
    bench.devices()["rl_controller"].store = lambda changes, on_stored=None: None  # type: ignore[method-assign]
    with pytest.raises(DiagnosticError, match=r"step 1 of 9 .*does not answer"):
        bench.apply()


# -- steps of the operator --------------------------------------------------------------------


def test_controllers_without_lss() -> None:
    """Four controllers with the same id: powered one at a time, and each must answer alone."""
    bench = Bench(example_robot("4wd4ws_wide"), {name: {"node_id": 1} for name in NODES})
    count = 0

    class Counting(VirtualOperator):
        def attach(self, step: object, words: str) -> bool:
            nonlocal count
            count += 1
            assert "power" in words
            return super().attach(step, words)  # type: ignore[arg-type]

    bench.run(lambda f: f.apply(), operator=Counting(bench.simulated))
    assert count == 4
    assert bench.storage.data.count(b'"set_by":"the operator","says":["FBL2360","1.0","1.0"]') == 4
    assert [bench.devices()[n].node_id for n in NODES] == [3, 2, 4, 1]


def test_a_mistake_of_the_operator_is_detected() -> None:
    bench = Bench(example_robot("4wd4ws_wide"), {"fl_controller": {"node_id": 9}})

    class Careless(VirtualOperator):
        def attach(self, step: object, words: str) -> bool:
            return True

    operator = Careless(bench.simulated)
    with pytest.raises(DiagnosticError, match="more than one device answers"):
        bench.run(lambda f: f.apply(), operator=operator)
    assert code_of(lambda: bench.run(lambda f: f.resume())) == "flash-stopped", "no operator"


def test_a_resume_continues_the_steps_of_the_operator() -> None:
    """The operator stops after two of four modules; the resume requests the other two."""
    bench = Bench(example_robot("4wd4ws_wide"), {name: {"node_id": 1} for name in NODES})
    asked: list[str] = []

    class Tired(VirtualOperator):
        def attach(self, step: AttachStep, words: str) -> bool:
            asked.append(step.node)
            return len(asked) != 3 and super().attach(step, words)

    operator = Tired(bench.simulated)
    with pytest.raises(DiagnosticError, match="the operator declined"):
        bench.run(lambda f: f.apply(), operator=operator)
    bench.simulated.power_on()
    bench.simulated.run(0.3)
    bench.run(lambda f: f.resume(), operator=operator)
    assert asked == [*NODES[:3], *NODES[2:]]
    assert [bench.devices()[n].node_id for n in NODES] == [3, 2, 4, 1]


# -- journal file and verify --------------------------------------------------------


def test_a_changed_line_of_the_journal_is_refused() -> None:
    """The records are chained, so that no changed previous value is ever restored."""
    bench = Bench(four_drives(), SWAPPED, timing=QUICK)
    bench.apply()
    data = bench.storage.data
    lines = data.split(b"\n")
    for number, line in enumerate(lines[:-1], 1):
        position = min(12, len(line) // 3)
        changed = line[:position] + bytes([line[position] ^ 1]) + line[position + 1 :]
        damaged = b"\n".join([*lines[: number - 1], changed, *lines[number:]])
        bench.storage.data = damaged
        with pytest.raises(DiagnosticError, match=f"line {number} does not follow the line before"):
            bench.rollback()
    bench.storage.data = data
    bench.rollback()


def test_a_deleted_doubled_or_moved_record_is_refused() -> None:
    bench = Bench(four_drives(), SWAPPED, timing=QUICK)
    bench.apply()
    data = bench.storage.data
    lines = data.splitlines(keepends=True)
    for number in range(len(lines) - 1):
        before, line, after = lines[:number], lines[number], lines[number + 1 :]
        for changed in (
            [*before, *after],
            [*before, line, line, *after],
            [*before, after[0], line, *after[1:]],
        ):
            with pytest.raises(DiagnosticError, match="a record was changed, deleted, doubled"):
                Journal(MemoryStorage(b"".join(changed)))
    # Records that are missing at the end are those that a power cut has prevented.
    assert Journal(MemoryStorage(b"".join(lines[:-1]))).unfinished is not None
    # A later flash continues the chain.
    bench.rollback()
    assert len(Journal(bench.storage).runs) == 2
    with pytest.raises(DiagnosticError, match="does not follow"):
        Journal(MemoryStorage(bench.storage.data[len(data) :]))


def test_a_full_disk_breaks_no_chain(tmp_path: Path) -> None:
    path = tmp_path / "robot.flash.jsonl"
    file = JournalFile(path)
    journal = Journal(file)
    journal.stop("first")
    with (
        full_disk(path.stat().st_size + 10),
        pytest.raises(DiagnosticError, match=r"cannot write the journal.*File too large"),
    ):
        journal.stop("second")
    journal.stop("third")
    file.close()
    data = path.read_bytes()
    assert [json.loads(line)["reason"] for line in data.splitlines()] == ["first", "third"]
    with pytest.raises(DiagnosticError, match="it does not begin with a plan"):
        Journal(MemoryStorage(data))  # but each record follows the one before


@pytest.mark.parametrize("call", ["fsync", "write"])
@pytest.mark.parametrize("number", range(2, 6))
def test_an_interrupt_while_the_journal_is_written_breaks_no_chain(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: str, number: int
) -> None:
    """Ctrl-C comes after the system call ``number``, before Python goes on."""
    calls = itertools.count(1)
    system_call = getattr(os, call)

    def interrupted(*arguments: Any) -> Any:
        result = system_call(*arguments)
        if next(calls) == number:
            raise KeyboardInterrupt
        return result

    bench = Bench(four_drives(), SWAPPED, timing=QUICK)
    path = tmp_path / "robot.flash.jsonl"
    file = JournalFile(path)
    master = bench.master()
    with monkeypatch.context() as patch:
        patch.setattr(os, call, interrupted)
        with pytest.raises(KeyboardInterrupt):
            Flash(master, bench.configuration, Journal(file)).apply()
    file.close()
    master.interface.close()
    bench.storage = MemoryStorage(path.read_bytes())
    (bench.resume if Journal(bench.storage).runs else bench.apply)()
    assert Journal(bench.storage).unfinished is None


def test_an_interrupt_after_a_record_was_written_breaks_no_chain() -> None:
    class Storage(MemoryStorage):
        def append(self, data: bytes) -> None:
            super().append(data)
            if len(self.flushed) == 3:
                raise KeyboardInterrupt

    bench = Bench(four_drives(), SWAPPED, timing=QUICK)
    bench.storage = Storage()
    with pytest.raises(KeyboardInterrupt):
        bench.apply()
    assert b"interrupted" in bench.storage.data
    bench.resume()
    assert Journal(bench.storage).unfinished is None


def test_a_journal_is_a_regular_file(tmp_path: Path) -> None:
    fifo = tmp_path / "fifo"
    os.mkfifo(fifo)
    for path in (Path("/dev/full"), Path("/dev/zero"), fifo, tmp_path):
        with pytest.raises(OSError, match=r"regular file|directory"):
            JournalFile(path)


def test_the_journal_on_the_disk(tmp_path: Path) -> None:
    path = tmp_path / "robot.flash.jsonl"
    store = JournalFile(path)
    with pytest.raises(DiagnosticError, match="another flash writes"):
        JournalFile(path)
    bench = Bench(four_drives(), SWAPPED, timing=QUICK)
    master = bench.master()
    Flash(master, bench.configuration, Journal(store)).apply()
    store.close()
    lines = path.read_bytes().splitlines()
    assert len(lines) == 1 + 2 * 9 + 1
    again = Journal(JournalFile(path))
    assert again.unfinished is None
    assert again.chain[0].plan.hash
    assert len(again.chain[0].previous_values()) == 4


def test_verify_only_reads_and_reports_differences() -> None:
    bench = Bench(cia402_robot(), delivered=False)
    count = writes(bench)
    master = bench.master()
    verification = verify(master, bench.configuration, bench.bus)
    assert verification.passed
    assert count() == 0
    drive = bench.devices()["fl_controller"]
    drive.objects[0x6083, 0].value += 1
    drive.objects[0x1017, 0].value = 150
    verification = verify(master, bench.configuration, bench.bus)
    differing = {check.what for check in verification.checks if not check.passed}
    assert differing == {
        "6083:0 propulsion_profile_acceleration",
        "1017:0 heartbeat_period",
        "period of fl_controller_heartbeat",
    }
    plan = make_plan(bench.configuration, bench.scan())
    assert [step.description for step in plan.steps] == ["write 2 values of fl_controller (id 1)"]


def test_verify_reports_frames_that_are_not_in_the_file() -> None:
    bench = Bench(cia402_robot(), delivered=False)
    master = bench.master()
    stranger = VirtualTimeInterface(bench.wire, "stranger")
    for tick in range(50):
        bench.wire.timeline.after(tick * 100_000_000, lambda: stranger.send(CanFrame(0x7A5, b"\5")))
    checks = verify(master, bench.configuration, bench.bus).checks
    (failed,) = (check for check in checks if not check.passed)
    assert (failed.node, failed.what) == ("", "frames that are not in the file")
    assert (failed.expected, failed.actual) == ("none", "0x7a5")


@pytest.mark.parametrize(
    ("frame", "says"),
    [(330, "another device already has the id 1"), (420, "at id 1")],
)
def test_a_second_node_with_an_id_stops_the_flash(frame: int, says: str) -> None:
    """A second node is plugged in: the id is occupied, or the wrong device answers."""
    bench = Bench(four_drives(), SWAPPED, timing=QUICK)
    spare = bench.simulated.clone("fl_controller", "spare", node_id=1)
    bench.wire.at_frame(bench.wire.frames + frame, spare.power_on)
    with pytest.raises(DiagnosticError, match=says) as raised:
        bench.apply()
    assert raised.value.diagnostic.code.name == "flash-stopped"
