"""The command ``thorvaldc can plan``: shows the steps that would set up the nodes of a CAN bus."""

from __future__ import annotations

from typing import TYPE_CHECKING

from thorvaldc.cli import options
from thorvaldc.cli.exits import DONE, INPUT

if TYPE_CHECKING:
    from thorvaldc.cli.bus_access import BusAccess


def plan(
    file: options.RobotFile,
    bus: options.BusInterface,
    store: options.Store = "",
    json: options.Json = False,
    library: options.Library = [],  # noqa: B006
    trust: options.Trust = False,
) -> int:
    from thorvaldc.cli.bus_access import with_bus
    from thorvaldc.cli.diagnostic_output import print_json, table_width
    from thorvaldc.commissioning.planner import plan_as_json, plan_table

    def work(access: BusAccess) -> int:
        plan = access.make_plan()
        if json:
            print_json(plan_as_json(plan))
        else:
            print(plan_table(plan, table_width()))
        return INPUT if plan.problems or plan.strangers else DONE

    return with_bus(file, bus, store, library, trust, work)
