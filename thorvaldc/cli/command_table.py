"""The commands of the core, in the order of ``thorvaldc --help``.

Tools add their own, which ``tool_folders`` finds.
"""

from thorvaldc.tool_folders import CommandEntry

CORE: tuple[CommandEntry, ...] = (
    CommandEntry("new", "new:new", "Make a folder with a robot.yaml to start from."),
    CommandEntry("check", "check:check", "Report every error in robot and fleet files."),
    CommandEntry("build", "build:build", "Compile robots and write the target files."),
    CommandEntry("sim", "sim:sim", "Drive a robot in simulation, without a display."),
    CommandEntry("scenario", "scenario:scenario", "Run a scenario and check its expectations."),
    CommandEntry("run", "run:run", "Run the base driver on a real or simulated CAN bus."),
    CommandEntry("bus", "bus:bus", "Simulate a robot's CAN bus for other programs."),
    CommandEntry("can", "", "Set up, check and monitor a robot's CAN bus."),
    CommandEntry(
        "can scan", "can_scan:scan", "Find the nodes on a bus and compare them with the robot."
    ),
    CommandEntry(
        "can plan", "can_plan:plan", "Show the steps that would set up the bus; writes nothing."
    ),
    CommandEntry(
        "can flash", "can_flash:flash", "Write addresses and values to the nodes, verified."
    ),
    CommandEntry(
        "can verify", "can_verify:verify", "Check identities, values, periods and bus load."
    ),
    CommandEntry("modules", "", "List, show, check and make hardware modules."),
    CommandEntry("modules list", "modules_list:list_modules", "List the module types."),
    CommandEntry(
        "modules show",
        "modules_show:show_module",
        "Show a module type: parameters, ports, sources of its numbers.",
    ),
    CommandEntry("modules check", "modules_check:check_modules", "Check the modules in folders."),
    CommandEntry(
        "modules new", "modules_new:new_module", "Make a module with a mesh to start from."
    ),
    CommandEntry("targets", "targets:targets", "List the targets that a robot can be built for."),
    CommandEntry("schema", "schema:schema", "Print the JSON Schema of a kind of document."),
    CommandEntry("explain", "explain:explain", "Explain a diagnostic code."),
)
