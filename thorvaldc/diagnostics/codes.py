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
    Code("TV730", "mesh-missing", "error", "a mesh file does not exist or cannot be read"),
    Code("TV731", "mesh-format", "error", "a mesh file has a format that is not read"),
    Code("TV732", "mesh-invalid", "error", "a mesh file is broken, empty or not finite"),
    Code("TV733", "mesh-size", "warning", "a mesh is so large that its unit must be wrong"),
    Code("TV734", "mesh-large", "error", "a mesh has more triangles or bytes than are read"),
    # -- 8xx: runtime --------------------------------------------------------
    # -- 9xx: files and import -----------------------------------------------
)

CODES: dict[str, Code] = {code.name: code for code in _TABLE}
