"""Every diagnostic code, in one table.

1xx YAML, 2xx schema and units, 3xx references, 4xx geometry and physics,
5xx bus, 6xx backends, 7xx library and extras, 8xx runtime, 9xx files and import.
A number is never reused.  ``docs/diagnostics/<number>.md`` explains each.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Code:
    """Stable number (``TV501``), name (``can-id-duplicate``), severity and meaning.

    ``outside``: nothing in a file is wrong but something in the world; the exit status is 3.
    """

    number: str
    name: str
    severity: str  # "error", "warning" or "note"
    meaning: str
    outside: bool = False


_TABLE: tuple[Code, ...] = (
    # -- 1xx: YAML -----------------------------------------------------------
    Code("TV101", "yaml-syntax", "error", "the text is not YAML"),
    Code("TV102", "yaml-encoding", "error", "the file is not UTF-8 text"),
    Code("TV103", "yaml-character", "error", "the text has a character that YAML does not allow"),
    Code("TV104", "yaml-empty", "error", "the document says nothing"),
    Code("TV105", "yaml-several-documents", "error", "the file holds more than one document"),
    Code("TV106", "yaml-duplicate-key", "error", "a key occurs twice in one mapping"),
    Code("TV107", "yaml-key-not-text", "error", "a key of a mapping is not text"),
    Code("TV108", "yaml-merge-key", "error", "a merge key (<<) is used; YAML 1.2 has none"),
    Code("TV109", "yaml-tag", "error", "a value carries a YAML tag"),
    Code(
        "TV110",
        "yaml-ambiguous-word",
        "error",
        "an unquoted on, off, yes or no: a truth value to some readers, text to others",
    ),
    Code(
        "TV111",
        "yaml-leading-zero",
        "error",
        "a number starts with 0: octal to some readers, decimal to others",
    ),
    Code("TV112", "yaml-not-finite", "error", "a number is infinite or not a number"),
    Code("TV113", "yaml-number-range", "error", "a number is too large to be represented"),
    Code("TV114", "yaml-too-deep", "error", "the document is nested too deeply"),
    Code(
        "TV115",
        "yaml-too-many-values",
        "error",
        "the document has too many values, aliases expanded",
    ),
    Code("TV116", "yaml-recursive-alias", "error", "an alias refers to a value that contains it"),
    Code("TV117", "yaml-tab", "error", "a tab stands where only spaces may indent"),
    Code("TV118", "yaml-file-too-large", "error", "the file is larger than a document may be"),
    # -- 2xx: schema and units -----------------------------------------------
    Code("TV201", "unknown-key", "error", "a key that the document's schema does not have"),
    Code("TV202", "missing-key", "error", "a required key is missing"),
    Code(
        "TV203",
        "wrong-type",
        "error",
        "a value of the wrong kind, such as a list in place of a mapping",
    ),
    Code("TV204", "bad-id", "error", "a name that is not a lower-case id"),
    Code("TV205", "unknown-value", "error", "a value that is not one of those allowed"),
    Code("TV206", "out-of-range", "error", "a number outside the range that is allowed"),
    Code("TV207", "wrong-length", "error", "a list with the wrong number of elements"),
    Code(
        "TV208",
        "conflicting-keys",
        "error",
        "keys that exclude each other, or none where one is needed",
    ),
    Code(
        "TV209",
        "language-version",
        "error",
        "a version of the language that this compiler does not know",
    ),
    Code("TV210", "bad-quantity", "error", "text that is not a number with a unit"),
    Code("TV211", "wrong-dimension", "error", "a quantity of the wrong dimension"),
    Code(
        "TV212",
        "expression-not-allowed",
        "error",
        "an expression where the document must give a value",
    ),
    Code("TV213", "expression-syntax", "error", "an expression that cannot be read"),
    Code("TV214", "expression-name", "error", "an expression uses a name that is not known"),
    Code(
        "TV215",
        "expression-value",
        "error",
        "an expression has no usable value, such as a division by zero",
    ),
    Code("TV216", "expression-cycle", "error", "a value needs itself"),
    Code(
        "TV217",
        "angle-in-radians",
        "warning",
        "an angle without a unit is more than a full turn: degrees may be meant",
    ),
    Code("TV218", "other-document", "error", "the document is of another kind"),
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
    Code("TV326", "too-many-parts", "error", "a module or a robot has more parts than are read"),
    Code("TV327", "parameter-set-radii", "error", "a parameter set names radii no wheel has"),
    Code("TV340", "calibration-missing", "error", "a robot names a calibration that is not there"),
    Code("TV341", "calibration-wheel", "error", "a calibration is of a wheel the robot lacks"),
    Code("TV342", "calibration-robot", "warning", "a calibration is of a robot of another name"),
    Code("TV350", "scenario-robots-missing", "error", "a scenario has no robots"),
    Code("TV351", "scenario-robot-unknown", "error", "a scenario names a robot it does not have"),
    Code("TV352", "scenario-wheel-unknown", "error", "a fault is of a wheel the robot lacks"),
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
    Code("TV427", "number-out-of-range", "error", "a number is beyond what a robot can have"),
    Code("TV428", "motor-joint", "error", "a motor is on a joint that it cannot drive"),
    Code("TV429", "part-below-ground", "warning", "a part of the robot reaches below the ground"),
    Code("TV430", "fleet-overlap", "warning", "two robots of a fleet stand in one place"),
    Code("TV431", "driver-cycle", "error", "the base driver's cycle or time-out cannot be kept"),
    Code("TV440", "calibration-value", "error", "a calibration holds an impossible value"),
    # -- 5xx: bus ------------------------------------------------------------
    Code(
        "TV501",
        "can-id-duplicate",
        "error",
        "two devices of one id space have the same id on a bus",
    ),
    Code("TV502", "can-id-range", "error", "an id is not among those that the device can have"),
    Code(
        "TV503",
        "can-ids-exhausted",
        "error",
        "no id is left for a device whose id is chosen automatically",
    ),
    Code("TV504", "can-bus-unknown", "error", "a device is on a bus that the robot does not have"),
    Code(
        "TV505",
        "can-address-unused",
        "warning",
        "a module has an address, but no device on the bus",
    ),
    Code("TV506", "can-serial-duplicate", "error", "two devices have the same serial number"),
    Code(
        "TV507",
        "can-serial-format",
        "error",
        "the serial number of a device with LSS is no number of 32 bits",
    ),
    Code("TV508", "can-lock-invalid", "error", "a lock file is not one, or was damaged"),
    Code("TV509", "can-lock-conflict", "error", "an id in the lock file cannot be"),
    Code("TV510", "can-cob-id-conflict", "error", "two frames on a bus have the same COB-ID"),
    Code(
        "TV511",
        "can-cob-id-restricted",
        "error",
        "a frame has a COB-ID that CANopen keeps for itself",
    ),
    Code("TV512", "can-cob-id-range", "error", "a COB-ID does not fit into 11 bits"),
    Code(
        "TV513",
        "can-name-conflict",
        "error",
        "two frames or devices on a bus have the same name",
    ),
    Code(
        "TV514",
        "can-lock-unused",
        "warning",
        "the lock file has another id for a device than the robot's file",
    ),
    Code("TV515", "can-lock-unwritable", "warning", "the lock file cannot be written"),
    Code("TV520", "can-frame-length", "error", "a frame is longer than 8 bytes"),
    Code("TV521", "can-signal-bounds", "error", "a signal lies outside its frame"),
    Code("TV522", "can-signal-overlap", "error", "two signals of a frame share bits"),
    Code("TV523", "can-multiplexer", "error", "the multiplexing of a frame does not work out"),
    Code("TV524", "can-choice-range", "error", "a named value does not fit into its signal"),
    Code("TV525", "can-scale", "error", "a signal cannot carry the whole range of its joint"),
    Code("TV526", "can-period", "error", "the period of a frame is not positive"),
    Code(
        "TV527",
        "can-pdo-mapping",
        "error",
        "the objects in a PDO do not make up its frame",
    ),
    Code("TV528", "can-object-range", "error", "a value does not fit into its object"),
    Code("TV529", "can-object-duplicate", "error", "an object of a node is given twice"),
    Code(
        "TV530",
        "can-bitrate",
        "error",
        "a bus has a bitrate that a device on it cannot do, or none",
    ),
    Code(
        "TV531",
        "can-overload",
        "error",
        "the periodic frames take more of the bus than is safe",
    ),
    Code("TV532", "can-load", "warning", "the periodic frames take more than half of the bus"),
    Code("TV533", "can-deadline", "error", "a frame can come later than its deadline"),
    Code(
        "TV534",
        "can-heartbeat-consumer",
        "error",
        "a CiA 402 drive does not watch the master's heartbeat",
    ),
    Code(
        "TV535",
        "can-heartbeat-time",
        "error",
        "a heartbeat is waited for less than twice as long as its period",
    ),
    Code("TV536", "can-bitrate-chosen", "note", "a bus gets a higher bitrate than the default"),
    Code("TV540", "channel-unknown", "error", "a controller has no channel of that name"),
    Code("TV542", "motor-conflict", "error", "one motor is on two channels"),
    Code("TV543", "channel-role", "error", "a channel is for another kind of motor"),
    Code("TV544", "motor-without-controller", "warning", "a motor is on no controller's channel"),
    Code("TV545", "robot-without-controller", "note", "no motor of the robot has a controller"),
    Code("TV546", "controller-without-motor", "warning", "a controller drives no motor"),
    # -- 6xx: backends -------------------------------------------------------
    Code("TV601", "urdf-only-element", "note", "an element of an extra goes to URDF only"),
    Code("TV602", "mjcf-name-reserved", "warning", "MuJoCo keeps the name of a link for itself"),
    Code("TV620", "dbc-text", "warning", "a text has characters that a DBC file cannot hold"),
    # -- 7xx: library and extras ---------------------------------------------
    Code("TV701", "library-missing", "error", "a library folder is not there"),
    Code("TV730", "mesh-missing", "error", "a mesh file does not exist or cannot be read"),
    Code("TV731", "mesh-format", "error", "a mesh file has a format that is not read"),
    Code("TV732", "mesh-invalid", "error", "a mesh file is broken, empty or not finite"),
    Code("TV733", "mesh-size", "warning", "a mesh is so large that its unit must be wrong"),
    Code("TV734", "mesh-large", "error", "a mesh has more triangles or bytes than are read"),
    Code("TV740", "extra-missing", "error", "a xacro file does not exist"),
    Code("TV741", "extra-xml", "error", "a xacro file is not well-formed XML or no robot"),
    Code("TV742", "extra-expansion", "error", "xacro cannot expand a file"),
    Code("TV743", "extra-limit", "error", "a xacro file takes too much time, memory or room"),
    Code("TV744", "extra-package", "error", "a ROS package that an extra asks for is not found"),
    Code("TV745", "extra-empty", "warning", "a xacro file adds nothing"),
    Code("TV746", "extra-argument", "error", "an extra lacks an argument that its file needs"),
    Code("TV747", "extra-argument-unused", "warning", "an extra gives an argument nobody asks for"),
    Code("TV748", "extra-element", "error", "an element of an extra lacks what URDF requires"),
    Code("TV749", "extra-number", "error", "a number in an extra is not one or out of range"),
    Code("TV750", "extra-name-duplicate", "error", "a link or joint of an extra exists already"),
    Code("TV751", "extra-link-unknown", "error", "a joint of an extra names what does not exist"),
    Code("TV752", "extra-two-parents", "error", "a link of an extra has two parents"),
    Code("TV753", "extra-cycle", "error", "links of an extra hang on one another"),
    Code("TV754", "extra-joint-type", "error", "a joint of an extra has a type the model lacks"),
    Code("TV755", "extra-joint-limits", "error", "a joint of an extra has impossible limits"),
    Code("TV756", "extra-inertia", "error", "a link of an extra has an impossible mass or inertia"),
    Code("TV757", "extra-massless", "error", "a moving link of an extra has no mass"),
    Code("TV758", "extra-left-out", "warning", "an element or attribute of an extra is left out"),
    Code("TV759", "extra-parent", "error", "an extra hangs on what does not exist"),
    Code(
        "TV760", "extra-placement-unused", "warning", "an extra's parent, xyz, rpy have no effect"
    ),
    Code("TV761", "extra-material", "warning", "an extra uses a material that is not defined"),
    Code("TV762", "extra-warning", "warning", "xacro warns about an extra"),
    # -- 8xx: runtime --------------------------------------------------------
    Code("TV801", "calculator-unsuited", "error", "the base calculator cannot drive such a robot"),
    Code("TV802", "calculator-option", "error", "an option of the base calculator is wrong"),
    Code("TV803", "simulation-scene", "error", "the generated scene cannot be simulated"),
    Code("TV804", "simulation-tipped", "error", "the robot fell over in the simulation"),
    Code("TV805", "simulation-diverged", "error", "the simulation left all bounds"),
    Code("TV806", "twist-invalid", "error", "a velocity command is not a finite motion"),
    Code(
        "TV807",
        "steering-unreachable",
        "warning",
        "wheels could not be steered to the asked motion",
    ),
    Code("TV808", "twist-infeasible", "warning", "fixed wheels do not allow the asked motion"),
    Code("TV809", "model-unreadable", "error", "a model file cannot be read"),
    Code("TV810", "parameter-set-unknown", "error", "there is no parameter set of that name"),
    Code("TV811", "parameter-set-scene", "warning", "a scene's wheels have other radii"),
    Code("TV820", "expectation-failed", "error", "a run is not as its scenario expects"),
    Code("TV830", "joint-log-header", "error", "a file's first line is none of a joint log"),
    Code("TV831", "joint-log-joint", "error", "a joint log has other joints than the robot"),
    Code("TV832", "joint-log-value", "error", "a value of a joint log is not a finite number"),
    Code("TV833", "joint-log-time", "error", "the time of a joint log does not go forward"),
    Code("TV834", "joint-log-gap", "warning", "a joint log has gaps"),
    Code("TV835", "joint-log-short", "error", "the robot hardly moves in a joint log"),
    Code("TV836", "calibration-forced", "warning", "the wheels of a log only did as commanded"),
    Code("TV837", "calibration-undetermined", "warning", "a log leaves open what wheels measure"),
    Code("TV838", "calibration-distance", "error", "a measured distance does not fit the log"),
    Code("TV839", "calibration-fit", "error", "no errors of the wheels explain a log"),
    Code(
        "TV841", "calibration-steering", "note", "a log's steering only confirms the robot's file"
    ),
    Code("TV840", "hidden-error", "error", "a simulated wheel shall have an impossible error"),
    Code("TV850", "bus-missing", "error", "a robot without a bus is to be run on one"),
    Code("TV851", "bus-fault-node", "error", "a fault is that of a device that is not there"),
    Code("TV852", "bus-fault-unsuited", "error", "a device cannot have such a fault"),
    Code("TV875", "bus-interface", "error", "the interface to a bus cannot be used", outside=True),
    # -- 9xx: files and import -----------------------------------------------
    Code("TV901", "file-not-found", "error", "a file does not exist"),
    Code("TV902", "file-is-a-directory", "error", "a folder was given where a file is wanted"),
    Code("TV903", "file-unreadable", "error", "a file cannot be read"),
    Code("TV930", "import-not-original", "error", "a file is none of the original system's"),
    Code("TV931", "import-value", "error", "a value of an original file is not what it must be"),
    Code("TV932", "import-missing", "error", "an original file lacks what is needed"),
    Code("TV933", "import-node-duplicate", "error", "an original file gives a node id twice"),
    Code("TV934", "import-reference", "error", "an original file names a drive that is not there"),
    Code("TV935", "import-unknown-key", "warning", "a key of an original file is not known"),
    Code("TV936", "import-left-out", "note", "a value of an original file has no place"),
    Code("TV937", "import-assumed", "warning", "an original file left something open"),
    Code("TV938", "import-duplicate-key", "warning", "a key occurs twice in an original file"),
)

CODES: dict[str, Code] = {code.name: code for code in _TABLE}
