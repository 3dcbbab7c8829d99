"""Table of all diagnostic codes, and their documentation pages.

The number of a removed diagnostic code is never used again for another code.  The page
``docs/diagnostics/<number>.md`` explains each diagnostic code; its examples are tested.  Codes of
other packages have prefixes of their own, see ``plugin_codes``.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

SUBJECTS = {
    "1": "YAML",
    "2": "Schema and units",
    "3": "References",
    "4": "Geometry and physics",
    "5": "CAN bus",
    "6": "Targets",
    "7": "Library and extras",
    "8": "Runtime, simulation and commissioning",
    "9": "Files, import, audit and comparison",
}
"""Subject of a diagnostic, by the first digit of its code."""
STRUCTURE = "1237"
"""First digits of errors in the structure of a document, in whose presence checks are left out."""


class Code(NamedTuple):
    """A diagnostic code.

    - ``number``: number of the diagnostic code.  The number of a diagnostic code, for example
      ``TV501``, never changes.
    - ``name``: name of the code, such as ``can-id-duplicate``.
    - ``severity``: severity of all diagnostics with this code.
    - ``summary``: description of the problem in one line.
    - ``outside``: whether the cause is outside the input files, for example on the CAN bus or in
      another program.  If ``outside`` is true, the exit status of the command line program is 3.
    - ``page``: documentation page in Markdown of a code of another package.
    """

    number: str
    name: str
    severity: str  # "error", "warning" or "note"
    summary: str
    outside: bool = False
    page: str = ""


class _Codes(dict[str, Code]):
    """The codes of thorvaldc by name.  A name that is missing is looked up among those of other
    packages, so that only their use reads the metadata of packages."""

    def __missing__(self, name: str) -> Code:
        return plugin_codes()[name]


def _error(number: str, name: str, summary: str, outside: bool = False) -> Code:
    return Code(number, name, "error", summary, outside)


def _warning(number: str, name: str, summary: str) -> Code:
    return Code(number, name, "warning", summary)


def _note(number: str, name: str, summary: str) -> Code:
    return Code(number, name, "note", summary)


_TABLE: tuple[Code, ...] = (
    # 1xx: YAML
    _error("TV101", "yaml-syntax", "the text is not YAML"),
    _error("TV102", "yaml-encoding", "the file is not encoded in UTF-8"),
    _error("TV103", "yaml-character", "the text contains a character that YAML does not allow"),
    _error("TV104", "yaml-empty", "the document is empty"),
    _error("TV105", "yaml-several-documents", "the file contains more than one document"),
    _error("TV106", "yaml-duplicate-key", "a mapping contains the same key twice"),
    _error("TV107", "yaml-key-not-text", "a key of a mapping is not text"),
    _error("TV108", "yaml-merge-key", "a merge key (<<) is used, which YAML 1.2 does not have"),
    _error("TV109", "yaml-tag", "a value has a YAML tag"),
    _error("TV110", "yaml-ambiguous-word", "an unquoted on, off, yes or no: YAML readers disagree"),
    _error("TV111", "yaml-leading-zero", "a number starts with 0: YAML readers disagree on octal"),
    _error("TV112", "yaml-not-finite", "a number is infinite or not a number"),
    _error("TV113", "yaml-number-range", "a number is too large for 64 bits"),
    _error("TV114", "yaml-too-deep", "the document is nested too deeply"),
    _error("TV115", "yaml-too-many-values", "the document has too many values, aliases expanded"),
    _error("TV116", "yaml-recursive-alias", "an alias refers to a value that contains the alias"),
    _error("TV117", "yaml-tab", "a tab is used for indentation; YAML allows only spaces"),
    _error("TV118", "yaml-file-too-large", "the file exceeds the size limit of a document"),
    # 2xx: schema and units
    _error("TV201", "unknown-key", "the schema does not define a key"),
    _error("TV202", "missing-key", "a required key is missing"),
    _error("TV203", "wrong-type", "a value has the wrong type, such as a list for a mapping"),
    _error("TV204", "bad-id", "a name is not a valid id (lower-case letters, digits, `_`)"),
    _error("TV205", "unknown-value", "a value is not one of the allowed values"),
    _error("TV206", "out-of-range", "a number is outside the allowed range"),
    _error("TV207", "wrong-length", "a list has the wrong number of elements"),
    _error("TV208", "conflicting-keys", "keys exclude each other, or a required choice is missing"),
    _error("TV209", "language-version", "the compiler does not support this language version"),
    _error("TV210", "bad-quantity", "a text is not a number with a unit"),
    _error("TV211", "wrong-dimension", "a quantity has the wrong dimension"),
    _error("TV212", "expression-not-allowed", "this kind of document does not allow expressions"),
    _error("TV213", "expression-syntax", "an expression has a syntax error"),
    _error("TV214", "expression-name", "an expression uses an unknown name"),
    _error("TV215", "expression-value", "an expression has no result, such as a division by zero"),
    _error("TV216", "expression-cycle", "a value depends on itself"),
    _warning("TV217", "angle-in-radians", "an angle without a unit exceeds a full turn"),
    _error("TV218", "other-document", "the file is another kind of document"),
    _warning("TV219", "number-without-unit", "a number without a unit is unusual in SI units"),
    # 3xx: references
    _error("TV301", "module-type-unknown", "no library contains the type of a module"),
    _error("TV302", "module-unknown", "a reference names an unknown module"),
    _error("TV303", "port-unknown", "a reference names an unknown port of a module"),
    _error("TV304", "motor-unknown", "a reference names an unknown motor of a module"),
    _error("TV305", "port-kind", "a module does not fit the kind of port that it is mounted on"),
    _error("TV306", "root-missing", "a robot or an assembly has no root module"),
    _error("TV307", "root-ambiguous", "more than one module has no mount"),
    _error("TV308", "mount-cycle", "modules are mounted on each other in a cycle"),
    _error("TV309", "mount-not-free", "a module without `free_mount` carries one without a port"),
    _error("TV310", "mount-without-hardware", "a module without links is mounted"),
    _error("TV311", "param-unknown", "a parameter is set that the module does not have"),
    _error("TV312", "param-missing", "a required parameter is not set"),
    _error("TV313", "param-range", "a parameter is outside its range or its choices"),
    _error("TV314", "module-category", "a selected module has the wrong category"),
    _warning("TV315", "default-unused", "defaults are set for a category that is not used"),
    _error("TV316", "can-without-device", "a module without CAN device has an address or channels"),
    _error("TV317", "name-twice", "two links or two joints have the same name"),
    _error("TV318", "assembly-recursive", "an assembly contains itself"),
    _error("TV319", "link-unknown", "a module names a link that it does not have"),
    _error("TV320", "joint-unknown", "a motor names a joint that its module does not have"),
    _error("TV321", "link-two-parents", "a link is the child of two joints"),
    _error("TV322", "link-unconnected", "a link is not connected to the root link of its module"),
    _error("TV323", "calculator-unknown", "no base calculator has this name"),
    _error("TV324", "fleet-robot-missing", "a fleet names a robot file that does not exist"),
    _error("TV325", "fleet-in-fleet", "a fleet names another fleet as a robot"),
    _error("TV326", "too-many-parts", "a module or a robot exceeds the limit of its parts"),
    _error("TV327", "parameter-set-radii", "a parameter set names radii that no wheel has"),
    _error("TV328", "fleet-name-twice", "two robots of a fleet have the same name"),
    _error("TV329", "coupling-joint-unknown", "a coupling names a joint that does not exist"),
    _error("TV330", "unit-design", "the design of a unit is missing, no robot, or in a circle"),
    _warning("TV331", "unit-unchanged", "a unit states a value that its design has"),
    _warning("TV332", "side-by-default", "modules on both sides have one side by default"),
    _error("TV340", "calibration-missing", "a robot names a calibration file that does not exist"),
    _error("TV341", "calibration-wheel", "a calibration names a wheel that does not exist"),
    _warning("TV342", "calibration-robot", "a calibration names another robot"),
    _error("TV350", "scenario-robots-missing", "a scenario has no robots"),
    _error("TV351", "scenario-robot-unknown", "a scenario refers to a robot that does not exist"),
    _error("TV352", "scenario-wheel-unknown", "an injected fault names an unknown wheel"),
    _warning("TV353", "scenario-step-late", "a step or a fault of a scenario begins after its end"),
    _warning("TV354", "scenario-without-motion", "the script of a scenario moves no robot"),
    # 4xx: geometry and physics
    _error("TV401", "link-massless", "a moving link has no mass"),
    _error("TV402", "inertia-impossible", "no rigid body can have this inertia"),
    _error("TV403", "no-wheels", "a robot has no wheels"),
    _warning("TV404", "no-drive", "no wheel has a drive motor"),
    _error("TV405", "wheel-off-ground", "a wheel does not reach the ground"),
    _error("TV406", "wheels-overlap", "two wheels overlap"),
    _error("TV407", "unstable", "the robot falls over on level ground"),
    _warning("TV408", "tip-over", "the robot tips over below the required slope angle"),
    _warning("TV409", "wheel-unloaded", "a wheel carries no load"),
    _warning("TV410", "steering-range", "a steering joint cannot reach every direction"),
    _error("TV411", "no-free-motion", "the fixed wheels block each other"),
    _error("TV412", "twist-uncontrolled", "the wheels do not determine the robot's motion"),
    _warning("TV413", "skid-steering", "the robot can turn only by skidding"),
    _error("TV414", "slope-too-steep", "motors or wheel friction are too weak for the slope"),
    _error("TV415", "frame-height", "the given frame height differs from that of the wheels"),
    _warning("TV416", "driver-limit-too-high", "a limit of the driver exceeds that of the modules"),
    _error("TV417", "mass-negative", "a mass is negative"),
    _error("TV418", "inertia-unknown", "a mass has no shape from which an inertia can be computed"),
    _error("TV419", "size-not-positive", "a size, a speed or a ratio is not positive"),
    _error("TV420", "axis-zero", "the axis of a joint has length zero"),
    _error("TV421", "joint-limit-missing", "a revolute or prismatic joint has no limit"),
    _error("TV422", "joint-limits-reversed", "the lower limit of a joint is not below the upper"),
    _error("TV423", "wheel-does-not-spin", "no joint turns a wheel about its axis"),
    _error("TV424", "wheel-lies-flat", "a wheel spins about a vertical axis"),
    _error("TV425", "steering-axis-tilted", "a steering axis is far from vertical"),
    _error("TV426", "color-unknown", "a colour is neither in the palette nor of the form #rrggbb"),
    _error("TV427", "number-out-of-range", "a number is outside the range that a robot can have"),
    _error("TV428", "motor-joint", "a motor cannot drive its joint"),
    _warning("TV429", "part-below-ground", "a part of the robot is below the ground"),
    _error("TV430", "fleet-overlap", "two robots of a fleet overlap at the start"),
    _error("TV431", "driver-cycle", "the cycle or time-out of the base driver is not possible"),
    _error("TV432", "battery-threshold", "the thresholds of the battery contradict each other"),
    _warning("TV433", "robot-size", "the robot is larger or smaller than any field robot"),
    _error("TV434", "start-in-obstacle", "a robot starts inside an obstacle"),
    _error("TV435", "mount-occupied", "two modules are mounted at the same place"),
    _warning("TV436", "slope-not-held", "the robot rolls on its slope while it has no power"),
    _error("TV437", "body-not-held", "gravity and ground do not hold a body of the robot"),
    _error("TV438", "coupling-impossible", "a joint cannot follow another joint"),
    _warning("TV439", "leans-on-limits", "the robot stands in another pose than it is drawn in"),
    _error("TV440", "calibration-value", "a calibration contains an impossible value"),
    _warning("TV441", "no-straight-line", "the robot cannot drive straight ahead"),
    _warning("TV442", "motor-without-wheel", "a drive motor turns no wheel"),
    _warning("TV443", "battery-missing", "a robot with drive motors has no battery"),
    _warning("TV444", "module-massless", "a mounted module has no mass"),
    _warning("TV445", "battery-connection", "several batteries without a stated connection"),
    _error("TV446", "battery-voltages", "batteries in parallel have different voltages"),
    _warning("TV447", "parts-overlap", "a module is inside another one or in its way"),
    _warning("TV448", "part-loose", "a mounted module touches nothing"),
    _warning(
        "TV449", "steering-axis-leans", "a steering axis is less vertical than odometry needs"
    ),
    _warning("TV450", "sensor-upside-down", "a sensor is mounted upside down"),
    # 5xx: CAN bus
    _error("TV501", "can-id-duplicate", "two devices of one id space use the same id on a bus"),
    _error("TV502", "can-id-range", "an id is outside the range of the device"),
    _error("TV503", "can-ids-exhausted", "no id is free for a device with an automatic id"),
    _error("TV504", "can-bus-unknown", "a device is on a bus that the robot does not have"),
    _warning("TV505", "can-address-unused", "a module has an address, but no device on the bus"),
    _error("TV506", "can-serial-duplicate", "two devices have the same serial number"),
    _error("TV507", "can-serial-format", "the serial number for LSS is not a 32-bit number"),
    _error("TV508", "can-lock-invalid", "a lock file is invalid"),
    _error("TV509", "can-lock-conflict", "an id in the lock file is not possible"),
    _error("TV510", "can-cob-id-conflict", "two frames on a bus have the same COB-ID"),
    _error("TV511", "can-cob-id-restricted", "a frame uses a COB-ID that CANopen reserves"),
    _error("TV512", "can-cob-id-range", "a COB-ID does not fit into 11 bits"),
    _error("TV513", "can-name-conflict", "two frames or two devices on a bus have the same name"),
    _warning("TV514", "can-lock-unused", "lock file and robot file give a device different ids"),
    _warning("TV515", "can-lock-unwritable", "the lock file cannot be written"),
    _warning("TV516", "can-buses-alike", "nothing tells two buses apart if they are exchanged"),
    _error("TV520", "can-frame-length", "a frame is longer than 8 bytes"),
    _error("TV521", "can-signal-bounds", "a signal is outside its frame"),
    _error("TV522", "can-signal-overlap", "two signals of a frame overlap"),
    _error("TV523", "can-multiplexer", "the multiplexing of a frame is inconsistent"),
    _error("TV524", "can-choice-range", "a named value does not fit into its signal"),
    _error("TV525", "can-scale", "a signal cannot represent the whole range of its joint"),
    _error("TV526", "can-period", "the period of a frame is not positive"),
    _error("TV527", "can-pdo-mapping", "the mapped objects of a PDO do not match its frame"),
    _error("TV528", "can-object-range", "a value does not fit into its object"),
    _error("TV529", "can-object-duplicate", "an object of a node is defined twice"),
    _error("TV530", "can-bitrate", "a device does not support the bitrate of its bus"),
    _error("TV531", "can-overload", "the load of the periodic frames exceeds the limit"),
    _warning("TV532", "can-load", "the periodic frames use more than half of the bus"),
    _error("TV533", "can-deadline", "a frame can arrive after its deadline"),
    _error("TV534", "can-heartbeat-consumer", "a CiA 402 drive does not monitor the heartbeat"),
    _error("TV535", "can-heartbeat-time", "a heartbeat time-out is less than twice the period"),
    _note("TV536", "can-bitrate-chosen", "the compiler selected a bitrate above the default"),
    _error("TV537", "stopping-distance", "a stop takes longer than the stated stopping distance"),
    _error("TV538", "stopping-slope", "the robot does not stop as it should on its slope"),
    _error("TV540", "channel-unknown", "a controller has no channel with this name"),
    _error("TV542", "motor-conflict", "one motor is connected to two channels"),
    _error("TV543", "channel-role", "a channel is for another kind of motor"),
    _warning("TV544", "motor-without-controller", "a motor is not connected to a controller"),
    _note("TV545", "robot-without-controller", "no motor of the robot has a motor controller"),
    _warning("TV546", "controller-without-motor", "a controller drives no motor"),
    _warning("TV547", "channel-side", "channels named left and right drive the other sides"),
    _error("TV555", "can-serial-unreadable", "a device cannot report the stated serial number"),
    _warning("TV560", "computer-adapter", "nothing says which CAN adapter belongs to a bus"),
    _error("TV561", "computer-device-twice", "two devices of the computer have the same name"),
    _error("TV580", "can-signal-floating-point", "a floating-point signal has a wrong format"),
    _error("TV581", "bus-not-canopen", "no node of a bus can be configured over CANopen"),
    _error("TV582", "can-eds-conflict", "the EDS of a device contradicts its module"),
    # 6xx: backends
    _note("TV601", "urdf-only-element", "an element of an extra is written to URDF only"),
    _error("TV602", "control-joint-unknown", "<ros2_control> names a joint that does not exist"),
    _error("TV603", "control-joint-duplicate", "<ros2_control> defines a joint twice"),
    _error("TV604", "control-joint-of-robot", "an extra controls a joint of the robot itself"),
    _error("TV605", "control-name-duplicate", "two <ros2_control> elements have the same name"),
    _warning("TV606", "control-incomplete", "<ros2_control> has no name, type or plug-in"),
    _warning("TV607", "control-joint-refused", "ros2_control refuses a joint of an extra"),
    _warning("TV608", "coupling-left-out", "a robot does not stand in a format without couplings"),
    _error("TV612", "ros-package-name", "a ROS 2 package cannot have this name"),
    _error("TV613", "ros-package-duplicate", "two robots of a fleet have the same ROS 2 package"),
    _error("TV614", "ros-frame-name", "a link has a name that no frame of ROS 2 can have"),
    _error("TV615", "ros-frame-reserved", "a link has the name of a frame of the localization"),
    _error("TV616", "ros-topic-duplicate", "a twist source or lock has a topic that is used"),
    _warning("TV617", "usd-left-out", "a part of the robot is not in its OpenUSD file"),
    _warning("TV620", "dbc-text", "a text contains characters that a DBC file cannot represent"),
    # 7xx: library and extras
    _error("TV701", "library-missing", "a library folder does not exist"),
    _error("TV702", "library-not-fetched", "a library is not in the cache, or not pinned"),
    _error("TV703", "library-changed", "a library differs from its pin in the lock file"),
    _error("TV704", "library-unusable", "a repository or archive cannot be fetched as a library"),
    _error("TV730", "mesh-missing", "a mesh file does not exist or cannot be read"),
    _error("TV731", "mesh-format", "the format of a mesh file is not supported"),
    _error("TV732", "mesh-invalid", "a mesh file is broken, empty or not finite"),
    _warning("TV733", "mesh-size", "a mesh is very large: its unit is probably wrong"),
    _error("TV734", "mesh-large", "a mesh exceeds the limit for triangles or bytes"),
    _error("TV740", "extra-missing", "a xacro file does not exist"),
    _error("TV741", "extra-xml", "a xacro file is not well-formed XML, or has no <robot> element"),
    _error("TV742", "extra-expansion", "xacro cannot expand a file"),
    _error("TV743", "extra-limit", "the expansion exceeds a limit on time, memory or size"),
    _error("TV744", "extra-package", "a ROS package that an extra uses cannot be found"),
    _warning("TV745", "extra-empty", "a xacro file adds nothing to the robot"),
    _error("TV746", "extra-argument", "a required argument of a xacro file is missing"),
    _warning("TV747", "extra-argument-unused", "an extra sets an argument that is not used"),
    _error("TV748", "extra-element", "an extra lacks a required element or attribute"),
    _error("TV749", "extra-number", "a number in an extra is invalid or out of range"),
    _error("TV750", "extra-name-duplicate", "a name in an extra is already used"),
    _error("TV751", "extra-link-unknown", "a joint of an extra refers to an unknown name"),
    _error("TV752", "extra-two-parents", "a link of an extra has two parents"),
    _error("TV753", "extra-cycle", "the links of an extra form a cycle"),
    _error("TV754", "extra-joint-type", "the model does not support the type of a joint"),
    _error("TV755", "extra-joint-limits", "a joint of an extra has impossible limits"),
    _error("TV756", "extra-inertia", "a link of an extra has an impossible mass or inertia"),
    _error("TV757", "extra-massless", "a moving link of an extra has no mass"),
    _warning("TV758", "extra-left-out", "an element or attribute of an extra is ignored"),
    _error("TV759", "extra-parent", "the parent of an extra does not exist"),
    _warning("TV760", "extra-placement-unused", "parent, xyz and rpy of an extra have no effect"),
    _warning("TV761", "extra-material", "an extra uses an undefined material"),
    _warning("TV762", "extra-warning", "xacro reports a warning about an extra"),
    _error("TV763", "extra-forbidden", "a xacro file does something that is not allowed"),
    _error("TV764", "extra-name-reserved", "a name of an extra is reserved in SDF"),
    _error("TV768", "extra-world", "a link of an extra has the name of the ground"),
    _error("TV769", "extra-environment", "an extra needs an environment variable that is not set"),
    _warning("TV770", "extra-visual-mesh", "a mesh of an extra cannot be shown"),
    _note("TV771", "extra-inertia-computed", "the inertia of a link is computed from its shapes"),
    _warning("TV772", "extra-mesh-open", "a link gets no mass, because its mesh is not closed"),
    _warning("TV773", "extra-initial-position", "a joint of an extra starts outside of its limits"),
    _error("TV774", "mesh-flat", "a mesh that is used for collisions has no volume"),
    # 8xx: runtime, simulation and commissioning
    _error("TV801", "calculator-unsuited", "the base calculator cannot drive this robot"),
    _error("TV802", "calculator-option", "an option of the base calculator is invalid"),
    _error("TV803", "simulation-scene", "the generated scene cannot be simulated"),
    _error("TV804", "simulation-tipped", "the robot fell over in the simulation"),
    _error("TV805", "simulation-diverged", "the simulation diverged"),
    _error("TV806", "twist-invalid", "a velocity command is not finite"),
    _warning("TV807", "steering-unreachable", "wheels cannot be steered to the commanded twist"),
    _warning("TV808", "twist-infeasible", "the base does not allow the commanded twist"),
    _error("TV809", "model-unreadable", "a model file cannot be read"),
    _error("TV810", "parameter-set-unknown", "no parameter set has this name"),
    _warning("TV811", "parameter-set-scene", "parameter set and scene have different radii"),
    _warning("TV815", "simulation-collision", "a robot collided in a simulation run"),
    _error("TV820", "expectation-failed", "a run does not meet an expectation of its scenario"),
    _error("TV821", "record-unreadable", "a file is not a record of a run, or is damaged"),
    _error("TV823", "record-value", "a value is not a number, or the time does not increase"),
    _warning("TV824", "record-truncated", "a record ends in the middle of a line"),
    _error("TV826", "script-log", "a log contains no velocities for a script"),
    _error("TV827", "height-map", "a file contains no heights of the ground"),
    _error(
        "TV831", "joint-log-joint", "the columns of a joint log are not those of the robot's joints"
    ),
    _warning("TV834", "joint-log-gap", "a joint log has gaps"),
    _error("TV835", "joint-log-short", "the robot hardly moves in a joint log"),
    _warning("TV836", "calibration-forced", "the wheels of a log follow their commands exactly"),
    _warning("TV837", "calibration-undetermined", "a log does not determine some wheel values"),
    _error("TV838", "calibration-distance", "a measured distance does not agree with the log"),
    _error("TV839", "calibration-fit", "no wheel errors explain a log"),
    _error("TV840", "hidden-error", "the hidden error of a simulated wheel is impossible"),
    _note("TV841", "calibration-steering", "the steering of a log only confirms the robot file"),
    _error("TV846", "variation-path", "the document has no such position"),
    _warning("TV848", "scenario-imu-missing", "gyro errors are set, but no robot has a gyro"),
    _error("TV849", "zone-under-robot", "a robot starts inside raised ground"),
    _error("TV850", "bus-missing", "a robot without a bus cannot run on a bus"),
    _error("TV851", "bus-fault-node", "an injected fault names a device that does not exist"),
    _error("TV852", "bus-fault-unsuited", "a device does not support an injected fault"),
    _note("TV853", "twist-limited", "a commanded twist is faster than a speed limit allows"),
    _warning("TV854", "twist-not-followed", "a robot drives another twist than the commanded one"),
    _warning("TV855", "scenario-sensor-missing", "sensors shall measure that are not simulated"),
    _error("TV860", "bus-error", "CAN frames are not transmitted on a bus", outside=True),
    _error("TV861", "bus-other-master", "another master is active on the bus", outside=True),
    _error("TV862", "bus-wrong-robot", "the devices on a bus differ from the robot file"),
    _error("TV863", "bus-drive-enabled", "a drive can move during the configuration of the bus"),
    _error("TV864", "plan-impossible", "no safe sequence of steps exists for the request"),
    _error("TV865", "plan-changed", "the bus changed after the plan was made"),
    _error("TV866", "journal-mismatch", "a journal belongs to another operation"),
    _error("TV867", "journal-unreadable", "a file is not a journal, or cannot be written"),
    _error("TV868", "flash-stopped", "a step of a flash failed", outside=True),
    _error("TV869", "flash-ambiguous", "another program changed the bus during a flash"),
    _error("TV870", "bus-locked", "another program is configuring the bus", outside=True),
    _error("TV875", "bus-interface", "the CAN interface cannot be used", outside=True),
    _error("TV876", "bus-driver-unknown", "no driver supports the protocol of a device"),
    _error("TV877", "bus-motor-unconnected", "a motor of the base has no motor controller"),
    _error("TV878", "bus-start", "the robot on a bus cannot start", outside=True),
    _error("TV879", "bus-mismatch", "the devices on a bus do not match the robot file"),
    _error("TV880", "bus-stopped", "a fault stopped the robot", outside=True),
    _error("TV881", "not-commissioned", "the first motion of a robot was not checked"),
    _error("TV890", "twist-priority-duplicate", "two twist sources have the same priority"),
    _error("TV891", "twist-priority-lock", "a lock does not stop a twist source as it should"),
    # 9xx: files and import
    _error("TV901", "file-not-found", "a file does not exist"),
    _error("TV902", "file-is-a-directory", "a folder is given instead of a file"),
    _error("TV903", "file-unreadable", "a file cannot be read"),
    _error("TV930", "import-not-original", "a file is not one of the original system"),
    _error("TV931", "import-value", "a value of an imported file is invalid"),
    _error("TV932", "import-missing", "an imported file lacks a required value"),
    _error("TV933", "import-node-duplicate", "an original file uses a node id twice"),
    _error("TV934", "import-reference", "an original file refers to a drive that does not exist"),
    _warning("TV935", "import-unknown-key", "an original file contains an unknown key"),
    _note("TV936", "import-left-out", "a value of an imported file cannot be converted"),
    _warning("TV937", "import-assumed", "the import assumes a value that a file does not give"),
    _warning("TV938", "import-duplicate-key", "an original file contains the same key twice"),
    _error("TV939", "import-no-base", "a description has no wheels that can be imported"),
    _note("TV940", "audit-file-skipped", "the audit does not read a file"),
    _note("TV941", "audit-limit", "a folder has more files than the audit reads"),
    _error("TV942", "audit-nothing-found", "a folder contains no robot files"),
    _warning("TV943", "audit-wheel-radius", "two files state different radii of one wheel"),
    _warning("TV944", "audit-wheel-separation", "two files state different wheel separations"),
    _error("TV945", "audit-joint-unknown", "a file names a joint that the robot does not have"),
    _error("TV946", "audit-description-broken", "a description is not a tree of known links"),
    _warning("TV947", "audit-frame-unknown", "a node uses a frame that does not exist"),
    _warning("TV948", "audit-transform-owners", "two nodes publish the transform of odometry"),
    _warning("TV950", "audit-stamped", "some nodes use TwistStamped, and others Twist"),
    _warning("TV951", "audit-speed", "a planner demands a speed beyond the limits"),
    _warning("TV953", "audit-descriptions-differ", "two descriptions of a robot differ"),
    _warning("TV954", "audit-footprints-differ", "two costmaps have different footprints"),
    _warning("TV955", "audit-footprint", "a footprint leaves out a part of the robot"),
    _error("TV956", "audit-mass", "a mass is negative, or a moving body has none"),
    _error("TV957", "audit-inertia", "no body has this inertia"),
    _warning("TV958", "inertia-too-large", "an inertia is too large for the size of the body"),
    _warning("TV959", "density-implausible", "a body is denser than metal or lighter than air"),
    _warning("TV960", "length-unit", "a length is probably in mm"),
    _warning("TV961", "angle-unit", "an angle is probably in degrees"),
    _error("TV962", "audit-mesh-missing", "a mesh file does not exist"),
    _warning("TV963", "audit-file-missing", "a launch file names a file that does not exist"),
    _warning("TV964", "audit-key-twice", "a parameter file contains a key twice"),
    _error("TV967", "price-invalid", "a price is no amount with a currency, or of an assembly"),
    _warning("TV968", "wheel-sides-exchanged", "a left wheel is on the right of the right wheel"),
    _warning("TV969", "wheel-axes-opposite", "a left and a right wheel turn about opposite axes"),
    _error("TV970", "git-unavailable", "there is no git, or no git repository"),
    _error("TV971", "git-revision-unknown", "a repository does not have a revision"),
    _error("TV972", "git-file-missing", "a revision does not have a file"),
    _error("TV973", "git-failed", "git cannot read a revision, or the revision is too large"),
    _error("TV974", "why-path-unknown", "a robot or an output has no value with a name"),
    _note("TV976", "upgrade-decision", "a file has a word that the language had"),
    _error("TV985", "build-stale", "a build folder is not the output of the present file"),
    _error("TV986", "accept-code", "an entry of `accept` names no warning"),
    _warning("TV987", "accept-unused", "an accepted warning does not occur any more"),
    _error("TV988", "accept-place", "an entry of `accept` names a place that does not exist"),
    _error("TV996", "study-value", "the values of a variable of a study are invalid"),
    _error("TV997", "study-name", "a study names an unknown fact, scenario or metric"),
)

CODES: dict[str, Code] = _Codes((code.name, code) for code in _TABLE)
PLUGINS = "thorvaldc.diagnostics"


@functools.cache
def plugin_codes() -> dict[str, Code]:
    """Returns the codes of other packages by name: their entry points ``thorvaldc.diagnostics``.

    The name of an entry point is the prefix of the numbers of its codes, two capital letters such
    as ``AC``, and its value is a sequence of codes.  Raises ``PluginError`` if the codes cannot be
    loaded, or if a code has another prefix or the number or name of another code.
    """
    from thorvaldc.tool_folders import PluginError, plugin_entries

    added: dict[str, Code] = {}
    for entry in plugin_entries(PLUGINS):
        try:
            codes: tuple[Code, ...] = tuple(entry.load())
        except Exception as error:  # code of other packages may raise any exception
            raise PluginError(f"the codes `{entry.value}` cannot be loaded: {error}") from error
        for code in codes:
            has_prefix = re.fullmatch(r"(?!TV)[A-Z]{2}\d{3}", code.number) and (
                code.number.startswith(entry.name)
            )
            taken = {word for c in added.values() for word in (c.name, c.number)} | CODES.keys()
            if not has_prefix or code.name in taken or code.number in taken:
                raise PluginError(
                    f"the code {code.number} {code.name} of `{entry.value}` needs the prefix"
                    f" `{entry.name}` of its entry point, two capital letters other than TV, and a"
                    " number and a name of its own"
                )
            added[code.name] = code
    return added


def all_codes() -> Iterator[Code]:
    """Yields the codes of thorvaldc, and then those of other packages."""
    yield from CODES.values()
    yield from plugin_codes().values()


_PACKAGE = Path(__file__).resolve().parent.parent


def page(code: Code) -> str:
    """Returns the documentation page of a diagnostic code in Markdown.

    The comments that make its examples to cases of the tests are left out.  If the documentation
    page is not installed, returns the summary of the diagnostic code.
    """
    if code.page:
        return code.page
    path = _folder() / f"{code.number}.md"
    try:
        text = path.read_text(encoding="utf-8")
    except OSError:
        return f"# {code.number} {code.name}\n\n{code.summary}\n"
    return re.sub(r"<!-- case.*?-->\n*", "", text, flags=re.S).rstrip() + "\n"


def _folder() -> Path:
    """Returns the folder with the documentation pages of the diagnostic codes.

    In the source repository, the documentation pages are in the folder ``docs/diagnostics``.  An
    installed package contains a copy of the documentation pages.
    """
    root = _PACKAGE.parent
    if (root / "pyproject.toml").is_file():
        return root / "docs" / "diagnostics"
    return _PACKAGE / "_data" / "diagnostics"


def all_codes_text() -> str:
    """Returns a line for each code, under the subjects; those of other packages come last."""
    from thorvaldc.diagnostics.text_layout import text_table

    parts = []
    for digit, subject in {**SUBJECTS, "": "Of other packages"}.items():
        rows = [
            (f"  {code.number}", code.name, code.summary)
            for code in all_codes()
            if (code.number[2:3] if code.number.startswith("TV") else "") == digit
        ]
        if rows:
            parts.append(f"{subject}:\n{text_table(rows)}")
    return "\n\n".join(parts) + "\n"
