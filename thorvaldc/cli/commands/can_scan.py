"""The command ``thorvaldc can scan``: finds the nodes on a CAN bus and compares them with the
robot."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from thorvaldc.cli import options
from thorvaldc.cli.exits import DONE, INPUT

if TYPE_CHECKING:
    from thorvaldc.cli.bus_access import BusAccess


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
        differs = any(entry.verdict != "ok" for entry in scan.entries)
        return INPUT if differs or scan.duplicates else DONE

    return with_bus(file, bus, store, library, trust, work, sends=active)
