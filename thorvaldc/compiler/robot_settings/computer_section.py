"""Reads the section `computer` of a robot document: its adapters, serial ports and services."""

from __future__ import annotations

from collections.abc import Sequence

from thorvaldc.compiler.source.node import Node, insertion, removal
from thorvaldc.compiler.values.document_section import Section
from thorvaldc.diagnostics import FIRST_USE, Label, Report, Span, did_you_mean
from thorvaldc.model import Bus, Sensor
from thorvaldc.model.robot_computer import (
    CanAdapter,
    Computer,
    RosStart,
    UsbDevice,
    interface_name,
)

_ZENOH = "rmw_zenoh"


def read_computer(
    section: Section, buses: Sequence[Bus], report: Report, *, is_stated: bool
) -> Computer:
    """Returns the computer of a robot, as the section ``computer`` and its defaults describe it.

    Each bus gets an adapter.  Reports adapters of unknown buses, devices and names that occur
    twice, and, if the document states the section, buses whose adapter it does not distinguish.
    """
    adapters = _adapters(section, buses, report, warns=is_stated)
    ports = tuple((name, _device(entry)) for name, entry in section["ports"].items())
    joystick = _device(section["joystick"]) if "joystick" in section else None
    _check_devices(section, report)
    if "status_port" in section and "ros" in section:
        _report_ineffective("status_port", section, "ros", "whose base driver has topics", report)
    return Computer(
        section["user"],
        section["program"],
        adapters,
        ports,
        joystick,
        _ros_start(section["ros"], report) if "ros" in section else None,
        tuple(section["time_servers"]),
        section["status_port"],
        section["power_off"],
    )


def _ros_start(ros: Section, report: Report) -> RosStart:
    """Returns how ROS 2 is started.

    Reports settings of the discovery for rmw_zenoh, which ignores them: a robot would be reachable
    from where its file says that it is not.
    """
    middleware = ros["middleware"]
    for key in ("discovery", "peers"):
        if middleware.startswith(_ZENOH) and key in ros:
            why = "which has a configuration file of its own for it"
            _report_ineffective(key, ros, middleware, why, report)
    return RosStart(
        ros["workspace"], ros["domain"], middleware, ros["discovery"], tuple(ros["peers"])
    )


def _report_ineffective(key: str, section: Section, other: str, why: str, report: Report) -> None:
    report.add(
        "conflicting-keys",
        f"`{key}` has no effect with `{other}`, {why}",
        section.entry(key).span,
        hint=removal(f"remove `{key}`", section.node, key),
    )


def _device(entry: Section) -> UsbDevice:
    return UsbDevice(entry["serial"], entry["path"])


def _adapters(
    section: Section, buses: Sequence[Bus], report: Report, *, warns: bool
) -> tuple[CanAdapter, ...]:
    stated = dict(section["can"].items())
    names = [bus.name for bus in buses]
    for name, entry in stated.items():
        if name not in names:
            report.add(
                "can-bus-unknown",
                f"the robot has no bus `{name}`",
                entry.node.where,
                hint=did_you_mean(name, names, f"its buses: {', '.join(names)}"),
            )
    adapters = []
    interfaces: dict[str, Span] = {}
    for bus in buses:
        entry = stated.get(bus.name)
        interface = (entry["interface"] if entry else "") or interface_name(bus.name)
        device = _device(entry) if entry else UsbDevice()
        node = entry.node if entry else section.entry("can")
        first = interfaces.setdefault(interface, node.where)
        if first is not node.where:
            _report_twice(f"the interface name `{interface}`", first, node.where, report)
        adapters.append(CanAdapter(bus.name, interface, device))
        if warns and len(buses) > 1 and device == UsbDevice():
            _report_unknown(bus.name, section, entry, report)
    return tuple(adapters)


def _report_unknown(bus: str, section: Section, entry: Section | None, report: Report) -> None:
    """Warns of one of several buses whose adapter the file does not distinguish."""
    hint = f"state the `serial` or the `path` of the adapter: `can: {{{bus}: {{serial: ...}}}}`"
    if entry is not None:
        hint = insertion(
            "add its serial number, as `udevadm info -q property /sys/class/net/can0` prints it",
            entry.node,
            "serial",
            '"004A00345551501720303658"',
            is_example=True,
        )
    report.add(
        "computer-adapter",
        f"nothing says which CAN adapter is that of the bus `{bus}`: Linux numbers them in the"
        " order in which it finds them",
        (entry or section).node.where,
        hint=hint,
    )


def check_sensor_ports(sensors: Sequence[Sensor], computer: Computer, report: Report) -> None:
    """Reports sensors whose driver uses a serial port that the computer of the robot lacks."""
    known = [name for name, _ in computer.ports]
    for sensor in sensors:
        for _, port in sensor.ros2_driver.ports if sensor.ros2_driver is not None else ():
            if port.startswith("/") or port in known:
                continue
            have = f"it has {', '.join(known)}" if known else "it has none"
            report.add(
                "unknown-value",
                f"the robot's computer has no serial port `{port}` for `{sensor.name}`; {have}",
                sensor.span,
                hint=f"add `computer: {{ports: {{{port}: {{serial: ...}}}}}}` to the robot file, or"
                " write the path of a device, such as `/dev/ttyUSB0`",
            )


def _check_devices(section: Section, report: Report) -> None:
    """Reports a serial number or a connector that two devices have."""
    entries = [*section["can"].items(), *section["ports"].items()]
    if "joystick" in section:
        entries.append(("joystick", section["joystick"]))
    places: dict[tuple[str, str], Node] = {}
    for _, entry in entries:
        for key in ("serial", "path"):
            value = entry.node.get(key)
            if value is None:
                continue
            first = places.setdefault((key, str(value.value)), value)
            if first is not value:
                _report_twice(f"the {key} `{value.value}`", first.span, value.span, report)


def _report_twice(what: str, first: Span, second: Span, report: Report) -> None:
    report.add(
        "computer-device-twice",
        f"two devices of the computer have {what}",
        second,
        hint="correct one of them",
        labels=[Label(first, FIRST_USE)],
    )
