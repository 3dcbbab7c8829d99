"""The command ``thorvaldc can plan``: shows the steps that would set up the nodes of a CAN bus."""

from __future__ import annotations

from typing import TYPE_CHECKING

from thorvaldc.cli.exits import DONE, INPUT
from thorvaldc.cli.options import BusInterface, Json, Library, RobotFile, Store, Trust

if TYPE_CHECKING:
    from thorvaldc.cli.bus_access import BusAccess


def plan(
    file: RobotFile,
    bus: BusInterface,
    store: Store = "",
    json: Json = False,
    library: Library = [],  # noqa: B006
    trust: Trust = False,
) -> int:
    from thorvaldc.cli.bus_access import with_bus
    from thorvaldc.cli.diagnostic_output import print_json, table_width
    from thorvaldc.commissioning.commissioning_text import plan_as_json, plan_table

    def work(access: BusAccess) -> int:
        plan = access.make_plan()
        if json:
            print_json(plan_as_json(plan))
        else:
            print(plan_table(plan, table_width()))
        return INPUT if plan.problems or plan.strangers else DONE

    return with_bus(file, bus, store, library, trust, work)
