"""Situations in which commissioning fails, one for each diagnostic code."""

from __future__ import annotations

from collections.abc import Callable

from tests.commissioning.bench import QUICK, Bench, MemoryStorage
from thorvaldc.can.frame import CanFrame
from thorvaldc.can.open_interface import bus_lock
from thorvaldc.model import Robot


def play(robot: Robot, situation: str) -> None:
    """Flashes the robot's simulated bus in a situation.  Raises ``DiagnosticError``."""
    SITUATIONS[situation](Bench(robot, timing=QUICK))


def _undisturbed(bench: Bench) -> None:
    bench.apply()


def _no_power(bench: Bench) -> None:
    bench.simulated.power_off()
    bench.apply()


def _other_master(bench: Bench) -> None:
    driver = bench.simulated.interface(name="driver")
    timeline = bench.simulated.timeline

    def sync() -> None:
        driver.send(CanFrame(0x080))
        timeline.after(20_000_000, sync)

    sync()
    bench.apply()


def _wrong_robot(bench: Bench) -> None:
    bench.simulated.clone("fl_controller", "spare", node_id=9).power_on()
    bench.apply()


def _enabled(bench: Bench) -> None:
    bench.apply()
    bench.simulated.interface(name="driver").send(CanFrame(0, b"\1\0"))
    bench.simulated.run(0.1)
    bench.apply()


def _missing(bench: Bench) -> None:
    bench.simulated.devices["fr_controller"].power_off()
    bench.apply()


def _changed(bench: Bench) -> None:
    bench.apply("0" * 64)


def _nothing_to_resume(bench: Bench) -> None:
    bench.apply()
    bench.resume()


def _no_journal(bench: Bench) -> None:
    bench.storage = MemoryStorage(b"thorvaldc: 1\nname: robot\n")
    bench.apply()


def stop_halfway(bench: Bench) -> None:
    """Flashes, and a node loses its power while the master writes its values."""
    device = bench.devices()["fr_controller"]

    def watch(time: int, frame: CanFrame, senders: object) -> None:
        if frame.id == 0x602 and frame.data[0] >> 5 == 1:
            device.power_off()

    bench.wire.observers.append(watch)
    try:
        bench.apply()
    finally:
        bench.wire.observers.remove(watch)


def _changed_by_hand(bench: Bench) -> None:
    try:
        stop_halfway(bench)
    except Exception:
        bench.devices()["fr_controller"].change_node_id(77)
        bench.simulated.power_on()
        bench.simulated.run(0.2)
        bench.resume()


def _locked(bench: Bench) -> None:
    with bus_lock("virtual:locked"), bus_lock("virtual:locked"):
        bench.apply()


SITUATIONS: dict[str, Callable[[Bench], None]] = {
    "undisturbed": _undisturbed,
    "bus-error": _no_power,
    "bus-other-master": _other_master,
    "bus-wrong-robot": _wrong_robot,
    "bus-drive-enabled": _enabled,
    "plan-impossible": _missing,
    "plan-changed": _changed,
    "journal-mismatch": _nothing_to_resume,
    "journal-unreadable": _no_journal,
    "flash-stopped": stop_halfway,
    "flash-ambiguous": _changed_by_hand,
    "bus-locked": _locked,
}
