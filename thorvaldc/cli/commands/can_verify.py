"""The command ``thorvaldc can verify``: checks the identity and values of each node, and the
periods and load of a CAN bus."""

from __future__ import annotations

from typing import TYPE_CHECKING

from thorvaldc.cli import options
from thorvaldc.cli.exits import DONE, INPUT

if TYPE_CHECKING:
    from thorvaldc.cli.bus_access import BusAccess


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
