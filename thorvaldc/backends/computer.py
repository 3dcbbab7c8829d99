"""The build target `computer`: the files that make a Linux computer that of a robot.

systemd names the CAN interfaces and sets them up, gives serial ports and the joystick their names,
and starts the base driver, alone or with ROS 2.  ``thorvaldc install`` puts the files in their
places; the robot file and the files that it names are beside them, in ``FOLDER``.

Sources: systemd.link(5), systemd.network(5), systemd.service(5), systemd.exec(5), systemd.path(5)
of systemd 249; timesyncd.conf(5); tmpfiles.d(5); the properties of devices are those of udev's
builtins `usb_id` and `path_id`; the variables of the discovery of ROS 2 are those of
rcl/discovery_options.h.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import PurePosixPath

from thorvaldc.backends import Backend
from thorvaldc.model import Robot
from thorvaldc.model.robot_computer import POWER_OFF, Computer, UsbDevice

FOLDER = "/etc/thorvaldc/{name}/current"
"""Where the files of the robot ``name`` are on its computer."""
STATE = "/var/lib/thorvaldc/{name}"
"""Where the build of the robot ``name`` is on its computer; the service writes it."""
RUNTIME = "/run/thorvaldc/{name}"
"""Folder of the running service of the robot ``name``."""
CONTROL = f"{RUNTIME}/control"
"""Control channel of the base driver of the robot ``name``, for `thorvaldc call` and `teleop`."""
PLACES = {
    "systemd": "/etc/systemd/system",
    "network": "/etc/systemd/network",
    "udev": "/etc/udev/rules.d",
    "time": "/etc/systemd/timesyncd.conf.d",
    "tmpfiles": "/etc/tmpfiles.d",
}
"""Folders of the computer by the folders of this target."""
MODEL = "model.json"
"""Name of the model of a robot in a build."""
QUEUE_LENGTH = 128
"""Length of the send queue of a CAN interface: frames of some control cycles."""
WATCHDOG = 2.0
"""Time (s) without a control cycle after which systemd ends the base driver.

The watchdogs of the drives stop the robot long before; this one removes a program that hangs.
"""
LOG_AGE = "14d"
"""Age at which log files of ROS 2 are removed; the journal has limits of its own."""
_README = """\
# The computer of {robot}

Made by thorvaldc. `thorvaldc install ROBOT_FILE`, as root on the robot's computer, puts these files
into their places, with the robot file, and starts the service: `systemd` into /etc/systemd/system,
`network` into /etc/systemd/network, `udev` into /etc/udev/rules.d, `time` into
/etc/systemd/timesyncd.conf.d, `tmpfiles` into /etc/tmpfiles.d. `--dry-run` lists the changes,
`thorvaldc uninstall NAME` removes them. A robot without motor controllers has no service.
"""
_HEAD = "# Made by thorvaldc for {robot}; `thorvaldc install` replaces it.\n"


def name_on_computer(robot: Robot) -> str:
    """Return the name of a robot in the paths and services of its computer."""
    return re.sub("[^a-z0-9]+", "-", robot.name.lower()).strip("-") or "robot"


def service_of(robot: Robot) -> str:
    """Return the name of the service that starts the robot."""
    return f"thorvaldc-{name_on_computer(robot)}.service"


def bus_option(computer: Computer) -> str:
    """Return the value of the option ``--bus`` for the CAN interfaces of a computer."""
    several = len(computer.adapters) > 1
    return ",".join(
        f"{adapter.bus}={adapter.spec}" if several else adapter.spec
        for adapter in computer.adapters
    )


class ComputerFiles(Backend):
    name = "computer"
    summary = "services and device names of the robot's computer"

    def emit(self, robot: Robot) -> dict[str, bytes]:
        return computer_files(robot, PurePosixPath(robot.span.file).name)


def computer_files(robot: Robot, file: str) -> dict[str, bytes]:
    """Return the files of a robot's computer.

    - ``file``: name of the robot file, which the service builds, or ``MODEL``, which it drives as
      it is.
    """
    readme = {"computer/README.md": _README.format(robot=_one_line(robot.name)).encode()}
    computer = robot.computer
    if computer is None or not robot.buses:
        return readme
    name = name_on_computer(robot)
    texts = {f"systemd/{service_of(robot)}": _service(robot, computer, file)}
    if computer.power_off:
        # A unit of the computer, since the user of the service may not switch it off.
        file_of_service = f"{RUNTIME.format(name=name)}/{POWER_OFF}"
        texts[f"systemd/thorvaldc-{name}.path"] = _sections(
            ("Unit", [("Description", f"Empty battery of {_one_line(robot.name)} (thorvaldc)")]),
            ("Path", [("PathExists", file_of_service), ("Unit", "poweroff.target")]),
            ("Install", [("WantedBy", "multi-user.target")]),
        )
    bitrates = {bus.name: bus.bitrate for bus in robot.buses}
    for adapter in computer.adapters:
        path = f"network/50-{name}-{adapter.interface}"
        if adapter.device != UsbDevice() or len(computer.adapters) == 1:
            texts[f"{path}.link"] = _sections(
                ("Match", [("Type", "can"), *_properties(adapter.device)]),
                ("Link", [("Name", adapter.interface), ("TransmitQueueLength", QUEUE_LENGTH)]),
            )
        # Without RestartSec, the interface stays down after bus-off until somebody has looked
        # for the cause: the driver reports it.
        texts[f"{path}.network"] = _sections(
            ("Match", [("Name", adapter.interface)]),
            ("Link", [("RequiredForOnline", "no")]),
            ("CAN", [("BitRate", bitrates[adapter.bus])]),
        )
    if computer.time_servers:
        servers = " ".join(computer.time_servers)
        texts[f"time/50-{name}.conf"] = _sections(("Time", [("NTP", servers)]))
    if computer.ros is not None:
        texts[f"tmpfiles/50-{name}.conf"] = f"e {STATE.format(name=name)}/log - - - {LOG_AGE}\n"
    rules = list(_rules(computer))
    if rules:
        texts[f"udev/70-{name}.rules"] = "".join(f"{rule}\n" for rule in rules)
    head = _HEAD.format(robot=_one_line(robot.name))
    return readme | {f"computer/{path}": (head + text).encode() for path, text in texts.items()}


def _one_line(text: str) -> str:
    return " ".join(text.split())


def _argument(text: str) -> str:
    """Return a text as one argument of a command line of systemd.service(5)."""
    for character, escaped in (("\\", "\\\\"), ('"', '\\"'), ("%", "%%"), ("$", "$$")):
        text = text.replace(character, escaped)
    return f'"{text}"'


def robot_file_of(unit: str) -> str:
    """Return the name of the robot file that a unit builds, or an empty text."""
    match = re.search(r'^ExecStartPre=.* build "(.*)" --target ', unit, re.MULTILINE)
    text = match[1] if match else ""
    return re.sub(r'\\([\\"])|%(%)|\$(\$)', lambda m: m[1] or m[2] or m[3], text)


def starts_ros(unit: str) -> bool:
    """Return whether a unit starts ROS 2, whose base driver has no control channel."""
    return "exec ros2 launch" in unit


def _sections(*sections: tuple[str, list[tuple[str, object]]]) -> str:
    """Return the text of a configuration file of systemd."""
    return "\n".join(
        f"[{title}]\n" + "".join(f"{key}={value}\n" for key, value in entries)
        for title, entries in sections
    )


def _properties(device: UsbDevice) -> Iterator[tuple[str, object]]:
    for key, value in (("ID_SERIAL_SHORT", device.serial), ("ID_PATH", device.path)):
        if value:
            yield "Property", f"{key}={value}"


def _rules(computer: Computer) -> Iterator[str]:
    """Yield the rules of udev that name serial ports and the joystick."""
    devices = [("tty", "", name, device) for name, device in computer.ports]
    if computer.joystick is not None:
        devices.append(("input", 'KERNEL=="js[0-9]*", ', "joystick", computer.joystick))
    for subsystem, kernel, name, device in devices:
        matches = "".join(
            f'ENV{{{key}}}=="{value}", '
            for _, pair in _properties(device)
            for key, value in [str(pair).split("=", 1)]
        )
        yield (
            f'ACTION!="remove", SUBSYSTEM=="{subsystem}", {kernel}{matches}SYMLINK+="{name}", '
            f'GROUP="{computer.user}", MODE="0660"'
        )


def _service(robot: Robot, computer: Computer, file: str) -> str:
    """Return the unit that starts the base driver, alone or with ROS 2.

    The unit builds the robot file before it starts, as the user of the service.  If the file has
    errors, the last build is used, and the errors are in the journal.  A model is used as it is.
    """
    name = name_on_computer(robot)
    state, folder = STATE.format(name=name), FOLDER.format(name=name)
    model = f"{folder}/robot/{MODEL}" if file == MODEL else f"{state}/{MODEL}"
    # Devices of network interfaces, with the escapes of systemd.unit(5).
    devices = " ".join(
        f"sys-subsystem-net-devices-{adapter.interface.replace('-', chr(92) + 'x2d')}.device"
        for adapter in computer.adapters
    )
    start = (
        f"{computer.program} run {model} --bus {bus_option(computer)} "
        f"--name {CONTROL.format(name=name)}"
    )
    if computer.status_port is not None:
        start += f" --status-port {computer.status_port}"
    entries: list[tuple[str, object]] = [
        ("User", computer.user),
        ("WorkingDirectory", f"{folder}/robot"),
        ("StateDirectory", state.removeprefix("/var/lib/")),
        ("RuntimeDirectory", f"thorvaldc/{name}"),
    ]
    if computer.ros is None:
        entries += [
            ("Type", "notify"),
            ("WatchdogSec", f"{WATCHDOG:g}"),
            ("Environment", f"XDG_CACHE_HOME={folder}/cache"),
        ]
        if file != MODEL:
            # The `-` lets the service start with the last build if the file has errors.
            build = f"-{computer.program} build {_argument(file)} --target can -o {state}"
            entries.append(("ExecStartPre", build))
        entries += [
            ("ExecStart", start),
            ("CPUSchedulingPolicy", "fifo"),
            ("CPUSchedulingPriority", "20"),
            ("MemoryMax", "1G"),
        ]
    else:
        setups = [f"/opt/ros/{robot.ros.distro}", f"{computer.ros.workspace}/install"]
        sources = " && ".join(f"source {setup}/setup.bash" for setup in setups)
        launch = f"ros2 launch {robot.ros.package} robot.launch.py bus:={bus_option(computer)}"
        entries += [
            ("Type", "exec"),
            ("Environment", f"ROS_DOMAIN_ID={computer.ros.domain}"),
            ("Environment", f"ROS_LOG_DIR={state}/log"),
        ]
        if computer.ros.middleware:
            entries.append(("Environment", f"RMW_IMPLEMENTATION={computer.ros.middleware}"))
        entries.append(
            ("Environment", f"ROS_AUTOMATIC_DISCOVERY_RANGE={computer.ros.discovery.upper()}")
        )
        if computer.ros.peers:
            entries.append(("Environment", f"ROS_STATIC_PEERS={';'.join(computer.ros.peers)}"))
        entries += [("ExecStart", f"/bin/bash -c '{sources} && exec {launch}'")]
    entries += [
        # SIGINT ends the launch of ROS 2, and the runtime stops the robot on it.
        ("KillSignal", "SIGINT"),
        ("SuccessExitStatus", "130"),
        ("TimeoutStopSec", "10"),
        ("Restart", "on-failure"),
        ("RestartSec", "2"),
        ("LimitRTPRIO", "30"),
        ("LimitNOFILE", "4096"),
        ("NoNewPrivileges", "yes"),
        ("ProtectSystem", "strict"),
        ("ProtectHome", "yes"),
        # The locks of buses are in no file, and the control channel is below /run.
        ("PrivateTmp", "yes"),
        ("RestrictSUIDSGID", "yes"),
    ]
    return _sections(
        (
            "Unit",
            [
                ("Description", f"Base driver of {_one_line(robot.name)} (thorvaldc)"),
                ("Wants", devices),
                ("After", f"systemd-networkd.service time-sync.target {devices}".strip()),
                # Five starts within a minute, then a person looks for the cause.
                ("StartLimitIntervalSec", "60"),
                ("StartLimitBurst", "5"),
            ],
        ),
        ("Service", entries),
        ("Install", [("WantedBy", "multi-user.target")]),
    )
