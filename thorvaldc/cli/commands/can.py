"""The commands ``thorvaldc can``: ``scan`` compares the nodes of a CAN bus with the robot, ``plan``
shows the steps that would set them up, ``flash`` writes node ids and parameters, ``verify`` checks
identities, values, periods and load."""

from __future__ import annotations

import sys
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from thorvaldc.cli import options
from thorvaldc.cli.exits import DONE, INPUT, OutsideError

if TYPE_CHECKING:
    from thorvaldc.cli.bus_access import BusAccess
    from thorvaldc.commissioning.journal import JournalFile
    from thorvaldc.commissioning.planner import Plan


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
    from thorvaldc.cli.bus_access import with_bus
    from thorvaldc.cli.diagnostic_output import message, print_json, table_width
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
    from thorvaldc.cli.bus_access import with_bus

    def work(access: BusAccess) -> int:
        return _show_plan(access.make_plan(), json, {})

    return with_bus(file, bus, store, library, trust, work)


def _show_plan(plan: Plan, json: bool, more: dict[str, bool]) -> int:
    from thorvaldc.cli.diagnostic_output import print_json, table_width
    from thorvaldc.commissioning.planner import plan_as_json, plan_table

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
    from thorvaldc.cli.bus_access import with_bus
    from thorvaldc.cli.diagnostic_output import count, message, print_json, table_width
    from thorvaldc.commissioning.verify import verification_table
    from thorvaldc.commissioning.verify import verify as verify_bus

    def work(access: BusAccess) -> int:
        verification = verify_bus(
            access.master, access.configuration, access.bus, access.show_progress
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
    from thorvaldc.cli.bus_access import with_bus
    from thorvaldc.cli.diagnostic_output import message
    from thorvaldc.cli.robot_file import path_beside

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
    from thorvaldc.cli.bus_access import agrees
    from thorvaldc.cli.diagnostic_output import message
    from thorvaldc.commissioning.flash import Flash
    from thorvaldc.commissioning.journal import Journal
    from thorvaldc.commissioning.planner import plan_table
    from thorvaldc.diagnostics import DiagnosticError

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
            scanning=access.show_progress,
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

    try:
        return JournalFile(path)
    except OSError as error:
        raise OutsideError(f"cannot write {path}: {error.strerror or error}") from None


def _show_result(json: bool, plan: Plan, result: str) -> int:
    from thorvaldc.cli.diagnostic_output import count, print_json
    from thorvaldc.commissioning.planner import plan_as_json

    if json:
        print_json({**plan_as_json(plan), "applied": True, "result": result})
    else:
        print(f"{plan.configuration.robot}: {result}, {count(len(plan.steps), 'step')}")
    return DONE
