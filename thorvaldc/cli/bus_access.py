"""Access to a CAN bus of a robot for the commands ``can scan``, ``can plan``, ``can flash`` and
``can verify``.
"""

from __future__ import annotations

import contextlib
import gc
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import typer

from thorvaldc.can.open_interface import bus_lock, open_interface
from thorvaldc.cli.diagnostic_output import message, report_of
from thorvaldc.cli.exits import INPUT, check_full_installation
from thorvaldc.cli.options import refuse_options
from thorvaldc.cli.progress import Progress
from thorvaldc.cli.robot_file import is_hardware, load_robot, select_bus
from thorvaldc.commissioning.bus_configuration import BusConfiguration, configuration_of
from thorvaldc.commissioning.bus_master import BusMaster, other_master_error
from thorvaldc.commissioning.planner import AttachStep, Plan, PlanStep, make_plan
from thorvaldc.commissioning.scan_result import ScanResult
from thorvaldc.commissioning.scanner import Scanner
from thorvaldc.commissioning.step_executor import Operator
from thorvaldc.diagnostics import DiagnosticError
from thorvaldc.model import Bus, Robot
from thorvaldc.model.bus_identity import Heard, wrong_buses

UNTESTED = (
    "note: this was never tried on physical hardware, only on simulated buses. Lift the wheels "
    "off the ground and keep the emergency stop in reach."
)


@dataclass
class BusAccess:
    """Access of a command to one CAN bus of a robot.

    - ``master``: the CANopen master for the bus. The CAN bus must have no other CANopen master.
    - ``virtual_operator``: carries out the manual steps on simulated devices, or ``None`` if a
      person carries out the manual steps.
    """

    robot: Robot
    bus: Bus
    configuration: BusConfiguration
    master: BusMaster
    bar: Progress
    virtual_operator: Operator | None = None

    def scanner(self) -> Scanner:
        return Scanner(self.master, self.configuration, self.show_progress)

    def make_plan(self) -> Plan:
        """Scans the CAN bus and returns the steps that commission the bus.

        Raises ``DiagnosticError`` if another CANopen master is on the CAN bus, or if the devices
        are those of another bus of the robot.
        """
        scan = self.scanner().active(texts=False)
        self.bar.clear()
        if scan.masters:
            raise other_master_error(list(scan.masters))
        if exchange := self.exchange(scan):
            raise DiagnosticError("bus-wrong-robot", exchange, hint="nothing was written")
        return make_plan(self.configuration, scan)

    def exchange(self, scan: ScanResult) -> str:
        """Says that the devices of another bus of the robot are on this bus, or returns ""."""
        serials = [entry.identity.serial for entry in scan.entries if entry.identity is not None]
        heard = {self.bus.name: Heard(self.master.received, serials)}
        text = wrong_buses(self.robot.buses, heard)
        return f"{text}; are the two exchanged?" if text else ""

    def operator(self, unattended: bool) -> Operator | None:
        if self.virtual_operator is not None:
            return self.virtual_operator
        return None if unattended else ConsoleOperator()

    def show_progress(self, activity: str, number: int, total: int) -> None:
        self.bar.label, self.bar.total = f"{activity} ", float(max(total, 1))
        self.bar.show(float(number))

    def show_step(self, number: int, total: int, step: PlanStep, is_verified: bool) -> None:
        self.bar.clear()
        description = f"{number + 1}/{total} {step.description}"
        if is_verified:
            message(f"{description}: verified")
        elif self.bar.active:
            self.show_progress(description, number, total)


def with_bus(
    file: str,
    spec: str,
    store: str,
    library: Sequence[str],
    trust: bool,
    work: Callable[[BusAccess], int],
    *,
    sends: bool = True,
) -> int:
    """Loads the robot, opens the CAN bus, calls ``work`` and returns the exit status of ``work``.

    ``sends``: whether ``work`` sends frames. A program that only receives needs no lock of the bus.
    If ``work`` raises a ``DiagnosticError``, the method prints the diagnostic.
    """
    loaded = load_robot(file, library, trust)
    if loaded is None:
        return INPUT
    gc.enable()
    try:
        with _open_bus(loaded.robot, spec, store, sends) as access:
            try:
                return work(access)
            finally:
                access.bar.clear()
    except DiagnosticError as error:
        return loaded.show(report_of(error))


@contextlib.contextmanager
def _open_bus(robot: Robot, spec: str, store: str, sends: bool) -> Iterator[BusAccess]:
    bus, interface_name = select_bus(robot, spec)
    if interface_name.partition(":")[0] == "virtual":
        with _open_virtual_bus(robot, bus, interface_name, store) as access:
            yield access
        return
    refuse_options({"--store": store}, "is for a simulated robot, --bus virtual")
    if is_hardware(interface_name):
        message(UNTESTED)
    with contextlib.ExitStack() as locks:
        if sends:
            locks.enter_context(bus_lock(interface_name))
        interface = open_interface(interface_name, bus)
        try:
            master = BusMaster(interface, bus)
            yield BusAccess(robot, bus, configuration_of(robot, bus), master, Progress(1.0, ""))
        finally:
            interface.close()


@contextlib.contextmanager
def _open_virtual_bus(robot: Robot, bus: Bus, name: str, store: str) -> Iterator[BusAccess]:
    variant = name.partition(":")[2]
    if variant not in ("", "delivered"):
        raise typer.BadParameter(
            f"{name!r} is neither virtual nor virtual:delivered", param_hint="'--bus'"
        )
    check_full_installation("`--bus virtual`")
    # The simulation is imported only when it is used, because the runtime package does not contain
    # the simulation.
    from thorvaldc.cli.virtual_robot import read_store
    from thorvaldc.simulation.bus import simulated_robot

    memory = read_store(store, robot)
    simulated = simulated_robot.SimulatedRobot(
        robot, delivered=variant == "delivered", nonvolatile=memory
    )
    simulated.power_on()
    simulated.run(0.2)
    interface = simulated.interface(bus.name, receive_limit=100_000)
    try:
        yield BusAccess(
            robot,
            bus,
            configuration_of(robot, bus),
            BusMaster(interface, bus),
            Progress(1.0, ""),
            simulated_robot.VirtualOperator(simulated),
        )
    finally:
        if store:
            simulated_robot.write_memory(Path(store), simulated)


class ConsoleOperator:
    """A person at the terminal who carries out manual steps, and presses Enter after each."""

    def attach(self, step: AttachStep, words: str) -> bool:
        return self._confirm(f"{words} Press Enter when it is done, or type `skip`. ")

    def power_all(self, words: str) -> bool:
        return self._confirm(f"{words} Press Enter when it is done. ")

    def _confirm(self, request: str) -> bool:
        line = _read_answer(request)
        return bool(line) and line.strip().lower() not in ("skip", "s")


def agrees(question: str) -> bool:
    """Asks a yes-or-no question and returns true for yes.

    An empty answer to the question means no.
    """
    return _read_answer(f"{question} [y/N] ").strip().lower() in ("y", "yes")


def _read_answer(question: str) -> str:
    print(question, end="", file=sys.stderr, flush=True)
    return sys.stdin.readline()
