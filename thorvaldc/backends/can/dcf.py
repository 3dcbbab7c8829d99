"""The device configuration file (DCF, CiA 306) of a CANopen node, with the required values of its
object dictionary entries.

This project has its own DCF writer, because other DCF writers add the current date. All builds of
the same robot must have the same bytes.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import groupby

from thorvaldc.model import Bus, Node, ObjectValue
from thorvaldc.model.bus import OBJECT_TYPES

BAUDRATES = (10, 20, 50, 125, 250, 500, 800, 1000)  # kbit/s, the list of CiA 306
MANDATORY = (0x1000, 0x1001, 0x1018)
ARRAYS = (0x1003, 0x1016)  # all other objects with subindices are records
RPDOS, TPDOS = range(0x1400, 0x1600), range(0x1800, 0x1A00)
VARIABLE, ARRAY, RECORD = 0x7, 0x8, 0x9


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
        yield f"BaudRate_{rate}", "1" if rate in supported else "0"
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
    rows = [(str(i), _hexadecimal(index)) for i, index in enumerate(indices, 1)]
    return [("SupportedObjects", str(len(indices))), *rows]


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
            ("ParameterName", entries[1 if counted else 0].name),
            ("ObjectType", f"0x{ARRAY if index in ARRAYS else RECORD:X}"),
            ("SubNumber", str(len(entries) + (not counted))),
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
    return rows


def _hexadecimal(number: int) -> str:
    return f"0x{number:X}"
