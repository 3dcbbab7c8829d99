"""The command ``thorvaldc can flash``: writes node ids and parameters to the nodes of a CAN bus."""

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
            return _dry_run(access, json)
        path = Path(journal or _default_journal(file, access))
        return _write(access, selected[0], path, plan, yes, json)

    return with_bus(file, bus, store, library, trust, work)


def _dry_run(access: BusAccess, json: bool) -> int:
    from thorvaldc.cli.diagnostic_output import message, print_json, table_width
    from thorvaldc.commissioning.planner import plan_as_json, plan_table

    plan = access.make_plan()
    if json:
        print_json({**plan_as_json(plan), "applied": False})
    else:
        print(plan_table(plan, table_width()))
        message("dry run: nothing was written; --apply writes")
    return INPUT if plan.problems or plan.strangers else DONE


def _default_journal(file: str, access: BusAccess) -> str:
    """Returns the default path of the flash journal, the log of the steps of ``can flash`` on a
    bus.

    The default journal of a robot.yaml is in the folder of the robot.yaml. The default journal of a
    model.json is in the current folder, because the next build replaces the files in the build
    folder.
    """
    from thorvaldc.model.model_json import is_model_file

    path = Path(file)
    bus = f".{access.bus.name}" if len(access.robot.buses) > 1 else ""
    if is_model_file(path):
        return f"{access.robot.name}{bus}.flash.jsonl"
    return str(path.with_name(f"{path.stem}{bus}.flash.jsonl"))


def _write(
    access: BusAccess, mode: str, path: Path, expected_hash: str, yes: bool, json: bool
) -> int:
    from thorvaldc.cli.console_operator import agrees
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
