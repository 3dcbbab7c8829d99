"""Every diagnostic code, in one table.

1xx YAML, 2xx schema and units, 3xx references, 4xx geometry and physics,
5xx bus, 6xx backends, 7xx library and extras, 8xx runtime, 9xx files and import.
A number is never reused.  ``docs/diagnostics/<number>.md`` explains each.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Code:
    """Stable number (``TV501``), name (``can-id-duplicate``), severity and meaning."""

    number: str
    name: str
    severity: str  # "error", "warning" or "note"
    meaning: str


_TABLE: tuple[Code, ...] = (
    # -- 1xx: YAML -----------------------------------------------------------
    # -- 2xx: schema and units -----------------------------------------------
    # -- 3xx: references -----------------------------------------------------
    # -- 4xx: geometry and physics -------------------------------------------
    # -- 5xx: bus ------------------------------------------------------------
    # -- 6xx: backends -------------------------------------------------------
    # -- 7xx: library and extras ---------------------------------------------
    # -- 8xx: runtime --------------------------------------------------------
    # -- 9xx: files and import -----------------------------------------------
)

CODES: dict[str, Code] = {code.name: code for code in _TABLE}
