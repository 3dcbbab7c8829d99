"""Reads how the batteries of a robot are connected: the key ``batteries`` of a robot document."""

from __future__ import annotations

import math
from collections.abc import Sequence

from thorvaldc.compiler.source.node import Node, insertion
from thorvaldc.diagnostics import Label, Proposal, Report
from thorvaldc.model import Battery
from thorvaldc.model.facts.energy import battery_voltage
from thorvaldc.model.robot import PARALLEL, SEPARATE


def read_battery_connection(
    document: Node, batteries: Sequence[Battery], report: Report
) -> str | None:
    """Returns the connection of the batteries, or ``None`` if the document does not state it.

    Reports several batteries without a statement, and batteries in parallel with different nominal
    voltages: the one with the higher voltage charges the other without a limit of the current.
    """
    node = document.get("batteries")
    present = [battery for battery in batteries if battery.node is not None]
    if node is None:
        if len(present) > 1:
            names = ", ".join(f"`{battery.module}`" for battery in present[:4])
            report.add(
                "battery-connection",
                f"the robot has {len(present)} batteries ({names}{', ..' * (len(present) > 4)}) "
                "and does not state how they are connected",
                present[1].span,
                labels=[Label(present[0].span, "the first battery")],
                hint=insertion(
                    "add `batteries: parallel`, or `separate` if each supplies its own modules",
                    document,
                    "batteries",
                    PARALLEL,
                    is_example=True,
                ),
            )
        return None
    if node.value == PARALLEL:
        _check_voltages(present, node, report)
    return str(node.value)


def _check_voltages(batteries: Sequence[Battery], connection: Node, report: Report) -> None:
    stated = [(b, v) for b in batteries if (v := battery_voltage(b)) is not None]
    for battery, voltage in stated[1:]:
        first, expected = stated[0]
        if not math.isclose(voltage, expected, rel_tol=1e-6):
            report.add(
                "battery-voltages",
                f"`{battery.module}` with {voltage:g} V is in parallel with `{first.module}` with "
                f"{expected:g} V",
                battery.span,
                labels=[Label(first.span, f"{expected:g} V here")],
                hint=Proposal(
                    "use batteries of one voltage, or write `batteries: separate`",
                    SEPARATE,
                    span=connection.span,
                ),
            )
