"""The device configuration file (DCF, CiA 306) of each CANopen node, and the file `bus.yml` for
ros2_canopen.

A DCF has the required values of the object dictionary. This project has its own DCF writer, because
other DCF writers add the current date. All builds of the same robot must have the same bytes.

`bus.yml` has the nodes, their DCFs, heartbeats and object values. It turns on heartbeats, because
they are off by default in ros2_canopen. Without heartbeats, the drives continue to run when the
CANopen master stops working.

The tool `dcfgen` of ros2_canopen writes the SDO downloads that configure a node at each start into
a binary file. `dcfgen` takes the parameter values of a DCF as values that the node already has, and
writes only the values of `bus.yml`. In the sections `rpdo:` and `tpdo:` it leaves out the values
that are equal to those of the DCF. The section `sdo:` therefore contains all values, those of the
PDOs too, in the order in which CiA 301 permits to write them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import groupby
from operator import itemgetter

from thorvaldc.model import Bus, Node, ObjectValue
from thorvaldc.model.bus import FIRST_INDEX, MASTER, OBJECT_TYPES, STRIDE, motor_numbers
from thorvaldc.model.number_origins import derived

BAUDRATES = (10, 20, 50, 125, 250, 500, 800, 1000)  # kbit/s, the list of CiA 306
MANDATORY = (0x1000, 0x1001, 0x1018)
ARRAYS = (0x1003, 0x1016)  # all other objects with subindices are records
RPDOS, TPDOS = range(0x1400, 0x1600), range(0x1800, 0x1A00)
VARIABLE, ARRAY, RECORD = 0x7, 0x8, 0x9
# Maps the unit of a CAN signal to the name of the physical quantity in ros2_canopen.
SCALES = {"rad": "pos", "rad/s": "vel"}
MODES = {1: "position_mode", 8: "position_mode", 3: "velocity_mode", 9: "velocity_mode"}
NO_TEXT = ("true", "false", "null", "yes", "no", "on", "off", "y", "n")
MODE_OF_OPERATION = 0x6060
MAPPING = 0x200
"""Distance of the index of a PDO mapping from the index of the communication parameters."""
SWITCHED_OFF = 1 << 31
"""Bit in the COB-ID of a PDO that is switched off."""
AXES_SINCE = "0.3.3"
"""First version of ros2_canopen with several axes of a drive (`num_channels`, `channels`)."""


def dcf_text(bus: Bus, node: Node) -> str:
    """Return the DCF of a CANopen node as text.

    In the DCF, numbers are decimal, and CAN identifiers are hexadecimal.
    """
    in_pdo = {
        (index, subindex): frame.producer != node.name
        for frame in bus.frames
        if node.name in (frame.producer, *frame.consumers)
        for index, subindex, _ in frame.mapping
    }
    groups = [(i, list(entries)) for i, entries in groupby(node.objects, key=lambda e: e.index)]
    indices = [index for index, _ in groups]
    sections = [
        (
            "FileInfo",
            [
                ("FileName", f"{node.name}.dcf"),
                ("FileVersion", "1"),
                ("FileRevision", "0"),
                ("EDSVersion", "4.0"),
                ("Description", f"{node.module}, {node.protocol}"),
                ("CreatedBy", "thorvaldc"),
            ],
        ),
        ("DeviceInfo", list(_device_info(bus, node, indices))),
        ("DeviceComissioning", list(_commissioning(bus, node))),  # the spelling of CiA 306
        ("DummyUsage", [(f"Dummy{number:04X}", "0") for number in range(1, 8)]),
        ("Comments", [("Lines", "0")]),
        ("MandatoryObjects", _listed([i for i in indices if i in MANDATORY])),
        (
            "OptionalObjects",
            _listed([i for i in indices if i not in MANDATORY and not 0x2000 <= i < 0x6000]),
        ),
        ("ManufacturerObjects", _listed([i for i in indices if 0x2000 <= i < 0x6000])),
    ]
    for index, entries in groups:
        sections.extend(_object(index, entries, in_pdo))
    return "\n".join(
        "".join((f"[{name}]\n", *(f"{key}={value}\n" for key, value in entries)))
        for name, entries in sections
    )


def _device_info(bus: Bus, node: Node, indices: Sequence[int]) -> Iterator[tuple[str, str]]:
    yield "VendorName", ""
    yield "VendorNumber", _hexadecimal(node.vendor_id or 0)
    yield "ProductName", node.protocol
    yield "ProductNumber", _hexadecimal(node.product_code or 0)
    yield "RevisionNumber", _hexadecimal(node.revision_number or 0)
    yield "OrderCode", ""
    supported = [rate // 1000 for rate in node.bitrates or (bus.bitrate,)]
    for rate in BAUDRATES:
        yield f"BaudRate_{rate}", str(derived(int(rate in supported), supported))
    yield "SimpleBootUpMaster", "0"
    yield "SimpleBootUpSlave", "1"
    yield "Granularity", "8"
    yield "DynamicChannelsSupported", "0"
    yield "GroupMessaging", "0"
    yield "NrOfRXPDO", str(sum(1 for index in indices if index in RPDOS))
    yield "NrOfTXPDO", str(sum(1 for index in indices if index in TPDOS))
    yield "LSS_Supported", "1" if node.lss else "0"


def _commissioning(bus: Bus, node: Node) -> Iterator[tuple[str, str]]:
    yield "NodeID", str(node.id)
    yield "NodeName", node.name
    yield "Baudrate", f"{bus.bitrate / 1000:g}"
    yield "NetNumber", "1"
    yield "NetworkName", bus.name
    yield "CANopenManager", "0"
    serial = next((e.value for e in node.objects if (e.index, e.subindex) == (0x1018, 4)), None)
    if serial is not None:
        yield "LSS_SerialNumber", str(serial)


def _listed(indices: Sequence[int]) -> list[tuple[str, str]]:
    rows = [(str(derived(i, indices)), _hexadecimal(index)) for i, index in enumerate(indices, 1)]
    return [("SupportedObjects", str(derived(len(indices), indices))), *rows]


def _object(
    index: int, entries: Sequence[ObjectValue], in_pdo: dict[tuple[int, int], bool]
) -> Iterator[tuple[str, list[tuple[str, str]]]]:
    section = f"{index:04X}"
    if entries[-1].subindex == 0:
        yield section, _variable(entries[0], in_pdo)
        return
    highest = entries[-1].subindex
    counted = entries[0].subindex == 0
    yield (
        section,
        [
            ("ParameterName", derived(entries[1 if counted else 0].name, index)),
            ("ObjectType", f"0x{ARRAY if index in ARRAYS else RECORD:X}"),
            (
                "SubNumber",
                str(derived(len(entries) + (not counted), *(e.subindex for e in entries))),
            ),
        ],
    )
    if not counted:
        count = ObjectValue("highest_subindex", index, 0, "unsigned8", highest, "ro")
        yield f"{section}sub0", _variable(count, in_pdo)
    for entry in entries:
        yield f"{section}sub{entry.subindex:X}", _variable(entry, in_pdo)


def _variable(entry: ObjectValue, in_pdo: dict[tuple[int, int], bool]) -> list[tuple[str, str]]:
    received = in_pdo.get((entry.index, entry.subindex))
    rows = [
        ("ParameterName", entry.name),
        ("ObjectType", f"0x{VARIABLE:X}"),
        ("DataType", f"0x{OBJECT_TYPES[entry.type][0]:04X}"),
        ("AccessType", "rww" if received and entry.access == "rw" else entry.access),
        ("PDOMapping", "0" if received is None else "1"),
    ]
    if entry.value is not None:
        number = _hexadecimal(entry.value) if entry.type == "unsigned32" else str(entry.value)
        # For a read-only object dictionary entry, which identifies the node, the DCF contains the
        # required value as the default value. All writable object dictionary entries are written to
        # the node with their required values.
        rows.append(("DefaultValue" if entry.access == "ro" else "ParameterValue", number))
    return [(key, derived(text, entry.index, entry.subindex)) for key, text in rows]


def _hexadecimal(number: int) -> str:
    return f"0x{number:X}"


# -- bus.yml ---------------------------------------------------------------------------


def bus_yml(bus: Bus) -> str:
    """Return the text of the file `bus.yml` for a CAN bus.

    The tools of ros2_canopen read the data types of the objects from the DCF of a CANopen node.
    """
    lines = [
        "# Made by thorvaldc; changes are lost. Never tried on physical hardware.",
        *_least_version(bus),
        "options:",
        '  dcf_path: "@BUS_CONFIG_PATH@"',
        "",
        "master:",
        f"  node_id: {bus.master_id}",
        '  driver: "ros2_canopen::MasterDriver"',
        '  package: "canopen_master_driver"',
        f"  baudrate: {bus.bitrate / 1000:g}",
        f"  sync_period: {round(bus.sync_period * 1e6)}",
        *_master_heartbeat(bus),
        "",
        "nodes:",
    ]
    for node in bus.described_nodes:
        lines += [f"  {_key(node.name)}:", *(f"    {line}" for line in _node(bus, node))]
    return "\n".join(lines) + "\n"


def _least_version(bus: Bus) -> Iterator[str]:
    if any(node.is_cia402 and len(node.channels) > 1 for node in bus.described_nodes):
        yield f"# Drives with several axes need ros2_canopen {AXES_SINCE} or newer."


def _master_heartbeat(bus: Bus) -> Iterator[str]:
    period = _heartbeat(bus, MASTER)
    yield "  heartbeat_consumer: true"
    if period is None:
        return
    yield f"  heartbeat_producer: {_milliseconds(period)}"
    timeouts = [n.heartbeat_consumer_time for n in bus.nodes if n.heartbeat_consumer_time]
    if timeouts:
        yield f"  heartbeat_multiplier: {min(timeouts) / period:.6g}"


def _node(bus: Bus, node: Node) -> Iterator[str]:
    yield f"node_id: {node.id}"
    yield f'dcf: "dcf/{node.name}.dcf"'
    if node.is_cia402:
        yield 'driver: "ros2_canopen::Cia402Driver"'
        yield 'package: "canopen_402_driver"'
    else:
        yield 'driver: "ros2_canopen::ProxyDriver"'
        yield 'package: "canopen_proxy_driver"'
    yield f"period: {_milliseconds(bus.sync_period)}"
    if node.revision_number is not None:
        yield f"revision_number: {node.revision_number}"
    serial = next((e.value for e in node.objects if (e.index, e.subindex) == (0x1018, 4)), None)
    if serial is not None:
        yield f"serial_number: {serial}"
    period = _heartbeat(bus, node.name)
    if period is not None:
        yield f"heartbeat_producer: {_milliseconds(period)}"
        if node.heartbeat_timeout is not None:
            yield f"heartbeat_multiplier: {node.heartbeat_timeout / period:.6g}"
    watches = node.heartbeat_consumer_time is not None
    yield f"heartbeat_consumer: {'true' if watches else 'false'}"
    yield "mandatory: true"
    if node.is_cia402:
        yield from _axes(bus, node)
    yield from _downloads(node)


def _downloads(node: Node) -> Iterator[str]:
    """Yield the lines of `bus.yml` with the values that ros2_canopen writes to a node."""
    values = [entry for entry in node.objects if entry.access == "rw" and entry.value is not None]
    communication = [entry for entry in values if entry.index in RPDOS or entry.index in TPDOS]
    pdos = dict.fromkeys(entry.index for entry in communication)
    mappings = range(RPDOS.start, TPDOS.stop + MAPPING)
    downloads = [entry for entry in values if entry.index not in mappings]
    of_object: dict[int, list[ObjectValue]] = {}
    for entry in values:
        of_object.setdefault(entry.index, []).append(entry)
    for index in pdos:
        downloads += _pdo_downloads(of_object[index], of_object.get(index + MAPPING, []))
    if downloads:
        yield "sdo:"
    for entry in downloads:
        value = f"0x{entry.value:X}" if entry.index in mappings else f"{entry.value}"
        key = f"index: 0x{entry.index:04X}, sub_index: {entry.subindex}"
        yield f"  - {{{key}, value: {value}}}  # {entry.name}"


def _pdo_downloads(
    parameters: Sequence[ObjectValue], mapping: Sequence[ObjectValue]
) -> Iterator[ObjectValue]:
    """Yield the communication parameters and the mapping of a PDO in writing order.

    The PDO is switched off, and its mapping is empty, while its other values are written.
    """
    cob_ids = [entry for entry in parameters if entry.subindex == 1]
    counts = [entry for entry in mapping if entry.subindex == 0]
    for entry in cob_ids:
        yield replace(entry, value=(entry.value or 0) | SWITCHED_OFF, name=f"{entry.name}: off")
    yield from (entry for entry in parameters if entry not in cob_ids)
    for entry in counts:
        yield replace(entry, value=0, name=f"{entry.name}: none")
    yield from (entry for entry in mapping if entry not in counts)
    yield from counts
    yield from cob_ids


def _axes(bus: Bus, node: Node) -> Iterator[str]:
    """Yield the lines of `bus.yml` with the operating modes and scales of a CiA 402 drive.

    For a CiA 402 drive with several axes, `bus.yml` has a group of lines for each axis.
    """
    order = sorted(zip(motor_numbers(bus, node), node.channels, strict=True), key=itemgetter(0))
    axes = [list(_axis(bus, node, number)) for number, _ in order]
    if len(axes) == 1:
        yield from axes[0]
        return
    yield f"num_channels: {len(axes)}"
    yield f"channel_names: [{', '.join(f'{node.name}_{c.name}' for _, c in order)}]"
    yield "channels:"
    for lines in axes:
        if not lines:
            yield "  - {}"
        for i, line in enumerate(lines):
            yield f"  {'- ' if i == 0 else '  '}{line}"


def _axis(bus: Bus, node: Node, number: int) -> Iterator[str]:
    objects = range(FIRST_INDEX + STRIDE * number, FIRST_INDEX + STRIDE * (number + 1))
    for entry in node.objects:
        if entry.index == MODE_OF_OPERATION + STRIDE * number and entry.value in MODES:
            yield f"{MODES[entry.value]}: {entry.value}"
    for frame in bus.frames:
        if not frame.mapping or node.name not in (frame.producer, *frame.consumers):
            continue
        if not any(index in objects for index, _, _ in frame.mapping):
            continue
        for signal in frame.signals:
            quantity = SCALES.get(signal.unit)
            if signal.joint is None or quantity is None:
                continue
            if frame.producer == node.name:
                yield f"scale_{quantity}_from_dev: {signal.scale!r}"
                if signal.offset:
                    yield f"offset_{quantity}_from_dev: {signal.offset!r}"
            else:
                yield f"scale_{quantity}_to_dev: {1 / signal.scale!r}"
                if signal.offset:
                    yield f"offset_{quantity}_to_dev: {-signal.offset / signal.scale!r}"


def _key(name: str) -> str:
    """Return the name as a YAML key, in quotes if YAML 1.1 would read the name as true or false.

    The program ros2_canopen reads YAML 1.1.
    """
    return f'"{name}"' if name in NO_TEXT else name


def _heartbeat(bus: Bus, producer: str) -> float | None:
    """Return the heartbeat period of a node or of the CANopen master in s.

    Returns ``None`` if the node or the CANopen master sends no heartbeat.
    """
    return next(
        (f.period for f in bus.frames if f.kind == "heartbeat" and f.producer == producer), None
    )


def _milliseconds(time: float) -> str:
    return f"{round(time * 1000, 3):g}"
