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
    Code("TV216", "expression-cycle", "error", "a value needs itself"),
    # -- 3xx: references -----------------------------------------------------
    Code("TV301", "module-type-unknown", "error", "a module has a type that no library has"),
    Code("TV302", "module-unknown", "error", "a reference names a module that is not there"),
    Code("TV303", "port-unknown", "error", "a reference names a port that a module does not have"),
    Code(
        "TV304", "motor-unknown", "error", "a reference names a motor that a module does not have"
    ),
    Code(
        "TV305",
        "port-kind",
        "error",
        "a module is mounted on a port of a kind that it does not fit",
    ),
    Code("TV306", "root-missing", "error", "no module of a robot or an assembly is its root"),
    Code("TV307", "root-ambiguous", "error", "more than one module has no mount"),
    Code(
        "TV308", "mount-cycle", "error", "modules are mounted on one another and not on the frame"
    ),
    Code(
        "TV309", "mount-not-free", "error", "a module is placed freely on one that has only ports"
    ),
    Code("TV310", "mount-without-hardware", "error", "something that has no body is mounted"),
    Code("TV311", "param-unknown", "error", "a parameter is set that the module does not have"),
    Code("TV312", "param-missing", "error", "a parameter without a default is not set"),
    Code("TV313", "param-range", "error", "a parameter is outside of its range or choices"),
    Code(
        "TV314", "module-category", "error", "a chosen module is of another category than is wanted"
    ),
    Code(
        "TV315",
        "default-unused",
        "warning",
        "defaults are given for a category that the robot does not have",
    ),
    Code(
        "TV316",
        "can-without-device",
        "error",
        "an address or channels are given to what is no device",
    ),
    Code("TV317", "name-twice", "error", "two links or joints come out with one name"),
    Code("TV318", "assembly-recursive", "error", "an assembly contains itself"),
    Code("TV319", "link-unknown", "error", "a module names a link that it does not have"),
    Code("TV320", "joint-unknown", "error", "a motor names a joint that its module does not have"),
    Code("TV321", "link-two-parents", "error", "a link is the child of two joints"),
    Code("TV322", "link-unconnected", "error", "a link hangs on nothing"),
    Code("TV323", "calculator-unknown", "error", "there is no base calculator of that name"),
    Code("TV324", "fleet-robot-missing", "error", "a fleet names a robot file that is not there"),
    Code("TV325", "fleet-in-fleet", "error", "a fleet names another fleet as a robot"),
    # -- 4xx: geometry and physics -------------------------------------------
    Code("TV401", "link-massless", "error", "a link that moves has no mass"),
    Code("TV402", "inertia-impossible", "error", "an inertia is that of no body"),
    Code("TV403", "no-wheels", "error", "a robot has no wheels"),
    Code("TV404", "no-drive", "warning", "no wheel is driven"),
    Code("TV405", "wheel-off-ground", "error", "a wheel does not reach the ground"),
    Code("TV406", "wheels-overlap", "error", "two wheels are in one place"),
    Code("TV407", "unstable", "error", "the robot falls over by itself"),
    Code(
        "TV408", "tip-over", "warning", "the robot tips over at a smaller angle than is asked for"
    ),
    Code("TV409", "wheel-unloaded", "warning", "a wheel carries no load"),
    Code("TV410", "steering-range", "warning", "a steering cannot reach every direction"),
    Code("TV411", "no-free-motion", "error", "fixed wheels block one another"),
    Code("TV412", "twist-uncontrolled", "error", "the wheels do not determine the robot's motion"),
    Code("TV413", "skid-steering", "warning", "the robot can turn only by skidding"),
    Code(
        "TV414",
        "slope-too-steep",
        "error",
        "the motors or the grip are too weak for the stated slope",
    ),
    Code(
        "TV415",
        "frame-height",
        "error",
        "the stated height of the frame is not what the wheels give",
    ),
    Code(
        "TV416",
        "driver-limit-too-high",
        "warning",
        "a limit of the driver is above what the modules allow",
    ),
    Code("TV417", "mass-negative", "error", "a mass is negative"),
    Code("TV418", "inertia-unknown", "error", "a mass has no shape to have an inertia from"),
    Code("TV419", "size-not-positive", "error", "a size, a speed or a ratio is not positive"),
    Code("TV420", "axis-zero", "error", "the axis of a joint has no direction"),
    Code("TV421", "joint-limit-missing", "error", "a revolute or prismatic joint lacks a limit"),
    Code(
        "TV422",
        "joint-limits-reversed",
        "error",
        "the lower limit of a joint is not below the upper",
    ),
    Code("TV423", "wheel-does-not-spin", "error", "a wheel hangs on no joint that turns it"),
    Code("TV424", "wheel-lies-flat", "error", "a wheel spins about a vertical axis"),
    Code("TV425", "steering-axis-tilted", "error", "a steering axis is far off the vertical"),
    Code(
        "TV426",
        "color-unknown",
        "error",
        "a colour is neither in the palette nor of the form #rrggbb",
    ),
    # -- 5xx: bus ------------------------------------------------------------
    # -- 6xx: backends -------------------------------------------------------
    # -- 7xx: library and extras ---------------------------------------------
    Code("TV701", "library-missing", "error", "a library folder is not there"),
    Code("TV730", "mesh-missing", "error", "a mesh file does not exist or cannot be read"),
    Code("TV731", "mesh-format", "error", "a mesh file has a format that is not read"),
    Code("TV732", "mesh-invalid", "error", "a mesh file is broken, empty or not finite"),
    Code("TV733", "mesh-size", "warning", "a mesh is so large that its unit must be wrong"),
    Code("TV734", "mesh-large", "error", "a mesh has more triangles or bytes than are read"),
    # -- 8xx: runtime --------------------------------------------------------
    # -- 9xx: files and import -----------------------------------------------
)

CODES: dict[str, Code] = {code.name: code for code in _TABLE}
