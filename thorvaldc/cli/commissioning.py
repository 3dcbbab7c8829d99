"""``can scan``, ``plan``, ``flash`` and ``verify``: opening the bus, tables, questions."""

from __future__ import annotations

import contextlib
import gc
import json as json_format
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from thorvaldc.cli.exits import DONE, INPUT, OutsideError
from thorvaldc.cli.faults import Faults, count, message
from thorvaldc.cli.operator import Person, VirtualOperator
from thorvaldc.cli.options import bus_of
from thorvaldc.cli.progress import Progress

if TYPE_CHECKING:
    from thorvaldc.can.interface import CanInterface
    from thorvaldc.commissioning.bus_configuration import BusConfiguration
    from thorvaldc.commissioning.bus_master import BusMaster
    from thorvaldc.commissioning.plan import Plan, PlanStep
    from thorvaldc.commissioning.scan_result import ScanResult
    from thorvaldc.commissioning.scanner import Scanner
    from thorvaldc.model import Robot
    from thorvaldc.model.bus import Bus
    from thorvaldc.simulation.bus.simulated_robot import SimulatedRobot

VIRTUAL = "virtual"
SIMULATED = (VIRTUAL, "sim", "udp")
UNTRIED = (
    "note: this was never tried on physical hardware, only on simulated buses. Lift the wheels "
    "off the ground and keep the emergency stop in reach."
)


def scan_bus(
    file: str, spec: str, active: bool, store: str, json: bool, library: Sequence[str]
) -> int:
    def work(place: Place) -> int:
        scanner = place.scanner()
        scan = scanner.active(values=False) if active else scanner.passive()
        place.clear()
        if json:
            _print_json(scan.as_json())
        else:
            print(scan_table(scan))
            _say_signs(scan)
        differs = any(entry.verdict != "ok" for entry in scan.entries)
        return INPUT if differs or scan.duplicates else DONE

    return _on_bus(file, spec, store, library, work)


def plan_bus(file: str, spec: str, store: str, json: bool, library: Sequence[str]) -> int:
    def work(place: Place) -> int:
        plan = place.plan()
        if json:
            _print_json(plan_json(plan))
        else:
            print(plan_table(plan))
        return INPUT if plan.problems or plan.strangers else DONE

    return _on_bus(file, spec, store, library, work)


def flash_bus(
    file: str,
    spec: str,
    apply: bool,
    resume: bool,
    rollback: bool,
    yes: bool,
    expected: str,
    journal: str,
    store: str,
    json: bool,
    library: Sequence[str],
) -> int:
    if apply + resume + rollback > 1:
        raise typer.BadParameter("one of them at a time", param_hint="'--apply', '--resume', ...")
    writes = apply or resume or rollback
    if writes and not yes and not sys.stdin.isatty():
        option = "--apply" if apply else "--resume" if resume else "--rollback"
        raise typer.BadParameter("needs a terminal to ask at, or --yes", param_hint=f"'{option}'")

    def work(place: Place) -> int:
        if not writes:
            plan = place.plan()
            if json:
                _print_json({**plan_json(plan), "applied": False})
            else:
                print(plan_table(plan))
                message("dry run: nothing was written; --apply writes")
            return INPUT if plan.problems or plan.strangers else DONE
        return _write(place, journal or default_journal(file, place), yes, apply, resume,
                      expected, json)  # fmt: skip

    return _on_bus(file, spec, store, library, work)


def default_journal(file: str, place: Place) -> str:
    """Beside the robot's file, of several buses one each; never in a build, which is replaced."""
    path = Path(file)
    bus = f".{place.bus.name}" if len(place.robot.buses) > 1 else ""
    if path.suffix == ".json":
        return f"{place.robot.name}{bus}.flash.jsonl"
    return str(path.with_name(f"{path.stem}{bus}.flash.jsonl"))


def verify_bus(file: str, spec: str, store: str, json: bool, library: Sequence[str]) -> int:
    def work(place: Place) -> int:
        from thorvaldc.commissioning.verify import verify

        found = verify(place.session, place.target, place.bus, place.progress)
        place.clear()
        if json:
            _print_json(found.as_json())
        else:
            rows = [("", "node", "what", "wanted", "found")]
            rows += [
                ("ok" if c.passed else "DIFFERS", c.node or "bus", c.what, c.wanted, c.found)
                for c in found.checks
            ]
            print(table(rows))
            if found.not_seen:
                message(
                    f"not seen: {', '.join(found.not_seen)}; drives send them once they are started"
                )
            failed = sum(not c.passed for c in found.checks)
            print(f"{place.target.robot}: {count(failed, 'difference')}")
        return DONE if found.passed else INPUT

    return _on_bus(file, spec, store, library, work)


def _write(
    place: Place, journal: str, yes: bool, apply: bool, resume: bool, expected: str, json: bool
) -> int:
    from thorvaldc.commissioning.flash import Flash
    from thorvaldc.commissioning.journal import Journal, JournalFile

    path = Path(journal)
    if not apply and not path.exists():
        raise typer.BadParameter(f"there is no journal {journal}", param_hint="'--journal'")
    plan = place.plan() if apply else None
    if plan is not None:
        message(plan_table(plan))
        if not plan.steps and not plan.problems and not plan.strangers:
            return _say_result(json, plan, "nothing to do")
    what = "Write this" if apply else ("Go on with the flash" if resume else "Undo the flash")
    if not yes and not _agrees(f"{what} of {journal}?" if not apply else f"{what}?"):
        message("nothing was written")
        return INPUT
    try:
        store = JournalFile(path)
    except OSError as fault:
        raise OutsideError(f"cannot write {journal}: {fault.strerror or fault}") from None
    try:
        book = Journal(store)
        flash = Flash(
            place.session,
            place.target,
            book,
            operator=place.operator(yes),
            progress=place.step,
            scanning=place.progress,
        )
        if plan is not None:
            done = flash.apply(expected or plan.hash)
        else:
            done = flash.resume() if resume else flash.rollback()
    except KeyboardInterrupt:
        place.clear()
        message(
            f"the flash was broken off; {journal} says how far it was. Go on with --resume, or "
            "undo it with --rollback"
        )
        raise
    finally:
        place.clear()
        store.close()
    return _say_result(json, done, "done" if apply or resume else "undone")


def _say_result(json: bool, plan: Plan, result: str) -> int:
    if json:
        _print_json({**plan_json(plan), "applied": True, "result": result})
    else:
        print(f"{plan.configuration.robot}: {result}, {count(len(plan.steps), 'step')}")
    return DONE


# -- a place on the bus ------------------------------------------------------------------------


@dataclass
class Place:
    """Where the work is done: the robot, its bus, and the one master on it."""

    robot: Robot
    bus: Bus
    target: BusConfiguration
    session: BusMaster
    simulated: SimulatedRobot | None
    bar: Progress

    def scanner(self) -> Scanner:
        from thorvaldc.commissioning.scanner import Scanner

        return Scanner(self.session, self.target, self.progress)

    def plan(self) -> Plan:
        from thorvaldc.commissioning.bus_master import other_master_error
        from thorvaldc.commissioning.plan import make_plan

        scan = self.scanner().active(texts=False)
        self.clear()
        if scan.masters:
            raise other_master_error(list(scan.masters))
        return make_plan(self.target, scan)

    def operator(self, yes: bool) -> Person | VirtualOperator | None:
        if self.simulated is not None:
            return VirtualOperator(self.simulated)
        return None if yes else Person()

    def progress(self, what: str, done: int, of: int) -> None:
        self.bar.what, self.bar.total = f"{what} ", float(max(of, 1))
        self.bar.show(float(done))

    def step(self, number: int, of: int, step: PlanStep, done: bool) -> None:
        self.clear()
        if done:
            message(f"{number + 1}/{of} {step.description}: verified")
        elif self.bar.active:
            self.progress(f"{number + 1}/{of} {step.description}", number, of)

    def clear(self) -> None:
        self.bar.clear()


def _on_bus(
    file: str, spec: str, store: str, library: Sequence[str], work: Callable[[Place], int]
) -> int:
    """Compile, open the bus, do it; a fault of the runtime is told as any other."""
    from thorvaldc.cli.running import load_robot
    from thorvaldc.diagnostics import Report
    from thorvaldc.diagnostics.error import DiagnosticError

    loaded = load_robot(file, library)
    if loaded is None:
        return INPUT
    robot, sources, located = loaded
    gc.enable()
    try:
        with _open(robot, spec, store) as place:
            try:
                return work(place)
            finally:
                place.clear()
    except DiagnosticError as fault:
        report = Report()
        report.put(fault.diagnostic)
        shown = Faults("text", sys.stderr)
        shown.add(located(report), sources)
        return shown.finish()


@contextlib.contextmanager
def _open(robot: Robot, spec: str, store: str) -> Iterator[Place]:
    from thorvaldc.commissioning.bus_configuration import configuration_of
    from thorvaldc.commissioning.bus_master import BusMaster
    from thorvaldc.simulation.bus.simulated_robot import SimulatedRobot

    bus, spec = bus_of(robot, spec)
    name, _, how = spec.partition(":")
    if name == VIRTUAL:
        if how not in ("", "delivered"):
            raise typer.BadParameter(
                f"{spec!r} is neither virtual nor virtual:delivered", param_hint="'--bus'"
            )
        from thorvaldc.cli.bus import read_store, write_store

        kept = read_store(store)
        simulated = SimulatedRobot(robot, delivered=how == "delivered", nonvolatile=kept)
        simulated.power_on()
        simulated.run(0.2)
        port: CanInterface = simulated.interface(bus.name, receive_limit=100_000)
        session = BusMaster(port, bus)
        try:
            yield Place(
                robot, bus, configuration_of(robot, bus), session, simulated, Progress(1.0, "")
            )
        finally:
            if store:
                write_store(store, simulated)
        return
    if store:
        raise typer.BadParameter("is for a simulated robot, --bus virtual", param_hint="'--store'")
    from thorvaldc.can.open_interface import open_interface
    from thorvaldc.commissioning.bus_lock import BusLock

    if name not in SIMULATED:
        message(UNTRIED)
    with BusLock(spec):
        port = open_interface(spec, bus)
        try:
            session = BusMaster(port, bus)
            yield Place(robot, bus, configuration_of(robot, bus), session, None, Progress(1.0, ""))
        finally:
            port.close()


def _agrees(question: str) -> bool:
    print(f"{question} [y/N] ", end="", file=sys.stderr, flush=True)
    return sys.stdin.readline().strip().lower() in ("y", "yes")


# -- what is shown -----------------------------------------------------------------------------


def table(rows: Sequence[Sequence[str]]) -> str:
    """Columns as wide as they need."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    lines = []
    for row in rows:
        cells = [cell.ljust(width) for cell, width in zip(row, widths, strict=True)]
        lines.append("  ".join(cells).rstrip())
    return "\n".join(lines)


def scan_table(scan: ScanResult) -> str:
    from thorvaldc.commissioning.scan_result import identity_text

    rows = [("verdict", "node", "id", "found", "device")]
    for entry in scan.entries:
        found = entry.found
        where = "" if found is None or found.id is None else str(found.id)
        known = found is not None and found.identity is not None
        device = identity_text(found.identity) if known and found is not None else ""
        if found is not None and any(found.texts):
            device += f" ({', '.join(text for text in found.texts if text)})"
        detail = "; ".join(part for part in (device, entry.detail) if part)
        wanted = "" if entry.wanted_id is None else str(entry.wanted_id)
        rows.append(
            (entry.verdict, entry.node or "-", wanted, "none" if where == "255" else where, detail)
        )
    return table(rows)


def _say_signs(scan: ScanResult) -> None:
    for node, why in scan.duplicates:
        message(f"two devices may have the id {node}: {why}")
    if scan.masters:
        message(f"another master is on the bus: {', '.join(scan.masters)}")
    for name, why in scan.enabled:
        message(f"{name} may move: {why}")
    if not scan.active:
        message("nobody was asked; --active asks every node")


def plan_table(plan: Plan) -> str:
    lines = []
    if plan.steps:
        rows = [("step", "how", "what")]
        rows += [
            (str(number), step.back_end, step.description)
            for number, step in enumerate(plan.steps, 1)
        ]
        lines.append(table(rows))
    lines += [f"in the way: {problem}" for problem in (*plan.strangers, *plan.problems)]
    lines += [f"note: {note}" for note in plan.notes]
    if not plan.steps and not plan.problems and not plan.strangers:
        lines.append("the bus is what the file says")
    lines.append(f"plan {plan.hash}")
    return "\n".join(lines)


def plan_json(plan: Plan) -> dict[str, Any]:
    from thorvaldc.commissioning.plan import step_to_json

    return {
        "hash": plan.hash,
        "robot": plan.configuration.robot,
        "bus": plan.configuration.bus,
        "steps": [{**step_to_json(step), "words": step.description} for step in plan.steps],
        "strangers": list(plan.strangers),
        "problems": list(plan.problems),
        "notes": list(plan.notes),
    }


def _print_json(value: Any) -> None:
    print(json_format.dumps(value, indent=1, ensure_ascii=False))
