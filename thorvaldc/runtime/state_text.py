"""The state of a running base driver as texts for people."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from thorvaldc.diagnostics import Code
from thorvaldc.diagnostics.report import find_code

FAULT = "FAULT"
"""Label of the fault, with its page."""


def page_text(code: Code) -> str:
    """Returns the number and the name of a diagnostic code, and how to read its page."""
    return f"{code.number} {code.name}, see `thorvaldc explain {code.number}`"


def state_rows(state: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Yields labels and texts of what an operator needs to know.

    ``state``: result of the service ``state``.
    """
    permission = "armed" if state["armed"] else f"not armed: {state['held'] or 'no reason'}"
    yield "driver", f"{state['mode']}, {permission}, drives: {state['source'] or 'nobody'}"
    if state["fault"]:
        yield FAULT, f"{state['fault']} ({page_text(find_code(state['fault_code']))})"
    if state["locks"]:
        yield "locked by", ", ".join(state["locks"])
    if state["stopped_by"]:
        yield "stopped by", ", ".join(state["stopped_by"])
    for warning in state["warnings"]:
        yield "warning", warning
    for bus, load in state.get("bus_load", {}).items():
        if load is not None:
            yield f"bus {bus}", f"at most {100.0 * load:.0f} % of its bit rate in use"
    for battery, values in state.get("batteries", {}).items():
        if values.get("charge") is not None:
            yield battery, f"{100.0 * values['charge']:.0f} %"
