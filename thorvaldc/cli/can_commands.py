"""The commands ``thorvaldc can``: ``scan`` compares the nodes of a CAN bus with the robot, ``plan``
shows the steps that would set them up, ``flash`` writes node ids and parameters, ``verify`` checks
identities, values, periods and load."""

from __future__ import annotations

import contextlib
import gc
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from thorvaldc.cli import options
from thorvaldc.cli.diagnostic_output import (
    Progress,
    count,
    message,
    print_json,
    report_of,
    table_width,
)
from thorvaldc.cli.exits import DONE, INPUT, check_full_installation, write_errors
from thorvaldc.cli.robot_file import (
    is_hardware,
    load_robot,
    path_beside,
    select_bus,
    simulated_devices,
)
from thorvaldc.diagnostics import DiagnosticError

if TYPE_CHECKING:
    from thorvaldc.commissioning.bus_configuration import BusConfiguration
    from thorvaldc.commissioning.bus_master import BusMaster
    from thorvaldc.commissioning.journal import JournalFile
    from thorvaldc.commissioning.plan import AttachStep, Plan, PlanStep
    from thorvaldc.commissioning.scan_result import ScanResult
    from thorvaldc.commissioning.scanner import Scanner
    from thorvaldc.commissioning.step_executor import Operator
    from thorvaldc.model import Bus, Robot


def scan(
    file: options.RobotFile,
    bus: options.BusInterface,
    active: Annotated[
        bool, typer.Option("--active", help="Listen, then send a request to every node.")
    ] = False,
    store: options.Store = "",
    json: options.Json = False,
    library: options.Library = [],  # noqa: B006
    trust: options.Trust = False,
) -> int:
    from thorvaldc.commissioning.scan_result import scan_notes, scan_table

    def work(access: BusAccess) -> int:
        scanner = access.scanner()
        scan = scanner.active(values=False) if active else scanner.passive()
        access.bar.clear()
        if json:
            print_json(scan.as_json())
        else:
            print(scan_table(scan, table_width()))
            for note in scan_notes(scan):
                message(note)
        if exchange := access.exchange(scan):
            message(exchange)
        differs = any(entry.verdict != "ok" for entry in scan.entries)
        return INPUT if differs or scan.duplicates else DONE

    return with_bus(file, bus, store, library, trust, work, sends=active)


def plan(
    file: options.RobotFile,
    bus: options.BusInterface,
    store: options.Store = "",
    json: options.Json = False,
    library: options.Library = [],  # noqa: B006
    trust: options.Trust = False,
) -> int:

    def work(access: BusAccess) -> int:
        return _show_plan(access.make_plan(), json, {})

    return with_bus(file, bus, store, library, trust, work)


def _show_plan(plan: Plan, json: bool, more: dict[str, bool]) -> int:
    from thorvaldc.commissioning.plan import plan_as_json, plan_table

    if json:
        print_json({**plan_as_json(plan), **more})
    else:
        print(plan_table(plan, table_width()))
    return INPUT if plan.problems or plan.strangers else DONE


def verify(
    file: options.RobotFile,
    bus: options.BusInterface,
    store: options.Store = "",
    json: options.Json = False,
    library: options.Library = [],  # noqa: B006
    trust: options.Trust = False,
) -> int:
    from thorvaldc.commissioning.verify import verification_table
    from thorvaldc.commissioning.verify import verify as verify_bus

    def work(access: BusAccess) -> int:
        verification = verify_bus(
            access.master, access.configuration, access.bus, access.bar.show_activity
        )
        access.bar.clear()
        if exchange := access.exchange(verification.scan):
            message(exchange)
        if json:
            print_json(verification.as_json())
        else:
            print(verification_table(verification, table_width()))
            if verification.not_seen:
                names = ", ".join(verification.not_seen)
                message(f"not seen: {names}; drives send them only after their start")
            differences = sum(1 for check in verification.checks if not check.passed)
            print(f"{access.configuration.robot}: {count(differences, 'difference')}")
        return DONE if verification.passed else INPUT

    return with_bus(file, bus, store, library, trust, work)


def flash(
    file: options.RobotFile,
    bus: options.BusInterface,
    apply: Annotated[
        bool, typer.Option("--apply", help="Write; the default is a dry run.")
    ] = False,
    resume: Annotated[
        bool, typer.Option("--resume", help="Continue a flash that was interrupted.")
    ] = False,
    rollback: Annotated[
        bool, typer.Option("--rollback", help="Undo the last flash of the journal.")
    ] = False,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask; for scripts.")] = False,
    plan: Annotated[
        str,
        typer.Option("--plan", metavar="HASH", help="Write only if the plan still has this hash."),
    ] = "",
    journal: Annotated[
        str,
        typer.Option(
            "--journal",
            metavar="FILE",
            help="Record of the steps.",
            show_default="<robot>.flash.jsonl",
        ),
    ] = "",
    store: options.Store = "",
    json: options.Json = False,
    library: options.Library = [],  # noqa: B006
    trust: options.Trust = False,
) -> int:
    modes = {"--apply": apply, "--resume": resume, "--rollback": rollback}
    selected = [option for option, is_set in modes.items() if is_set]
    if len(selected) > 1:
        raise typer.BadParameter("one of them at a time", param_hint="'--apply', '--resume', ...")
    if selected and not yes and not sys.stdin.isatty():
        raise typer.BadParameter(
            "needs a terminal to ask at, or --yes", param_hint=f"'{selected[0]}'"
        )

    if not apply:
        options.refuse_options({"--plan": plan}, "needs --apply")

    def work(access: BusAccess) -> int:
        if not selected:
            status = _show_plan(access.make_plan(), json, {"applied": False})
            if not json:
                message("dry run: nothing was written; --apply writes")
            return status
        bus_name = f".{access.bus.name}" if len(access.robot.buses) > 1 else ""
        default = path_beside(file, access.robot, f"{bus_name}.flash.jsonl")
        path = Path(journal) if journal else default
        return _write(access, selected[0], path, plan, yes, json)

    return with_bus(file, bus, store, library, trust, work)


def _write(
    access: BusAccess, mode: str, path: Path, expected_hash: str, yes: bool, json: bool
) -> int:
    from thorvaldc.commissioning.flash import Flash
    from thorvaldc.commissioning.journal import Journal
    from thorvaldc.commissioning.plan import plan_table

    if mode != "--apply" and not path.exists():
        raise typer.BadParameter(f"there is no journal {path}", param_hint="'--journal'")
    if mode == "--apply" and path.exists():
        with closing(_opened(path)) as previous:  # before the scan, which takes some seconds
            Journal(previous).refuse_unfinished()
    plan = access.make_plan() if mode == "--apply" else None
    if plan is not None:
        message(plan_table(plan))
        if expected_hash not in ("", plan.hash):
            raise DiagnosticError(
                "plan-changed",
                f"the hash of the plan is now {plan.hash}, not {expected_hash}",
                hint="nothing was written; look at `thorvaldc can plan` again, and flash that",
            )
        if not plan.steps and not plan.problems and not plan.strangers:
            return _show_result(json, plan, "nothing to do")
    question = {
        "--apply": "Write this?",
        "--resume": f"Continue the flash of {path}?",
        "--rollback": f"Undo the flash of {path}?",
    }[mode]
    if not yes and not agrees(question):
        message("nothing was written")
        return INPUT
    journal_file = _opened(path)
    try:
        flash = Flash(
            access.master,
            access.configuration,
            Journal(journal_file),
            operator=access.operator(yes),
            progress=access.show_step,
            scanning=access.bar.show_activity,
        )
        if plan is not None:
            result = flash.apply(expected_hash or plan.hash)
        else:
            result = flash.resume() if mode == "--resume" else flash.rollback()
    except KeyboardInterrupt:
        access.bar.clear()
        message(
            f"the flash was interrupted; {path} records its progress. Continue with --resume, or "
            "undo it with --rollback"
        )
        raise
    finally:
        access.bar.clear()
        journal_file.close()
    return _show_result(json, result, "undone" if mode == "--rollback" else "done")


def _opened(path: Path) -> JournalFile:
    from thorvaldc.commissioning.journal import JournalFile

    with write_errors(path):
        return JournalFile(path)


def _show_result(json: bool, plan: Plan, result: str) -> int:
    from thorvaldc.commissioning.plan import plan_as_json

    if json:
        print_json({**plan_as_json(plan), "applied": True, "result": result})
    else:
        print(f"{plan.configuration.robot}: {result}, {count(len(plan.steps), 'step')}")
    return DONE


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
        from thorvaldc.commissioning.scanner import Scanner

        return Scanner(self.master, self.configuration, self.bar.show_activity)

    def make_plan(self) -> Plan:
        """Scans the CAN bus and returns the steps that commission the bus.

        Raises ``DiagnosticError`` if another CANopen master is on the CAN bus, or if the devices
        are those of another bus of the robot.
        """
        from thorvaldc.commissioning.bus_master import other_master_error
        from thorvaldc.commissioning.planner import make_plan

        scan = self.scanner().active(texts=False)
        self.bar.clear()
        if scan.masters:
            raise other_master_error(list(scan.masters))
        if exchange := self.exchange(scan):
            raise DiagnosticError("bus-wrong-robot", exchange, hint="nothing was written")
        return make_plan(self.configuration, scan)

    def exchange(self, scan: ScanResult) -> str:
        """Says that the devices of another bus of the robot are on this bus, or returns ""."""
        from thorvaldc.model.bus_identity import Heard, wrong_buses

        serials = [entry.identity.serial for entry in scan.entries if entry.identity is not None]
        heard = {self.bus.name: Heard(self.master.received, serials)}
        text = wrong_buses(self.robot.buses, heard)
        return f"{text}; are the two exchanged?" if text else ""

    def operator(self, unattended: bool) -> Operator | None:
        if self.virtual_operator is not None:
            return self.virtual_operator
        return None if unattended else ConsoleOperator()

    def show_step(self, number: int, total: int, step: PlanStep, is_verified: bool) -> None:
        self.bar.clear()
        description = f"{number + 1}/{total} {step.description}"
        if is_verified:
            message(f"{description}: verified")
        elif self.bar.active:
            self.bar.show_activity(description, number, total)


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
    from thorvaldc.can.open_interface import bus_lock, open_interface
    from thorvaldc.commissioning.bus_configuration import configuration_of
    from thorvaldc.commissioning.bus_master import BusMaster

    bus, interface_name = select_bus(robot, spec)
    if interface_name.partition(":")[0] == "virtual":
        with _open_virtual_bus(robot, bus, interface_name, store) as access:
            yield access
        return
    options.refuse_options({"--store": store}, "is for a simulated robot, --bus virtual")
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
    # The runtime package does not contain the simulation.
    from thorvaldc.commissioning.bus_configuration import configuration_of
    from thorvaldc.commissioning.bus_master import BusMaster
    from thorvaldc.simulation.bus.simulated_robot import VirtualOperator

    with simulated_devices(robot, store, delivered=variant == "delivered") as simulated:
        interface = simulated.interface(bus.name, receive_limit=100_000)
        yield BusAccess(
            robot,
            bus,
            configuration_of(robot, bus),
            BusMaster(interface, bus),
            Progress(1.0, ""),
            VirtualOperator(simulated),
        )


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
