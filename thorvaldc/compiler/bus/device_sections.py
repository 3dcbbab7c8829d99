"""CAN devices of a robot, and the values in their object dictionaries (CiA 301).

The section `objects` of a module document lists values of the object dictionary.  The object
dictionary entries for the identity, the heartbeats and the PDOs follow from other sections of the
module document.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

from thorvaldc.can.canopen import SYNC
from thorvaldc.compiler.modules.module_parameters import Scope
from thorvaldc.compiler.source import node as source
from thorvaldc.compiler.values.value_reader import entries
from thorvaldc.diagnostics import FIRST_USE, Label, Report, Span
from thorvaldc.model import Actuator, FrameDefinition, Node, ObjectValue
from thorvaldc.model.bus import MASTER, OBJECT_TYPES
from thorvaldc.model.number_origins import read_at

MASTER_ID = 127
MASTER_HEARTBEAT_PERIOD = 0.1  # s


class Wire(NamedTuple):
    """The connection of a motor to a channel of a motor controller.

    - ``channel``: name of the channel.
    - ``actuator``: the motor with its gear.
    - ``lower``, ``upper``: limits of the joint in rad, or ``None`` for a joint without limits.
    - ``span``: source span of the entry under ``channels`` in the robot file.
    """

    channel: str
    actuator: Actuator
    lower: float | None
    upper: float | None
    span: Span


class Device(NamedTuple):
    """A module of the robot whose module document has a section `can`.

    - ``path``: path of the module instance in the robot.
    - ``name``: name of the device on the bus.
    - ``can``: section `can` of the module type.
    - ``channels``: section `channels` of the module type.
    - ``wires``: connections of motors to the channels.
    - ``address``: entry `can` of the module instance in the robot file.  The value of the entry
      `can` is an id, the word ``auto`` or a mapping.
    - ``scope``: names and values for expressions in the module document.
    - ``span``: source span of the module instance in the robot file.
    """

    path: str
    name: str
    can: source.Node
    channels: source.Node | None
    wires: tuple[Wire, ...]
    address: source.Node | None
    scope: Scope
    span: Span


class Placed(NamedTuple):
    """A device on a CAN bus, with its node id.

    - ``path``: path of the module instance in the robot.
    - ``bus``: name of the bus.
    - ``span``: source span of the address of the device in the robot file.
    - ``serial_span``: source span of the serial number in the robot file.
    - ``node``: node of the device in the model.
    - ``frames``: CAN frames of the device.
    - ``module_span``: source span of the section `can` in the module document.
    """

    path: str
    bus: str
    span: Span
    serial_span: Span
    node: Node
    frames: tuple[FrameDefinition, ...]
    module_span: Span


class BusSpec(NamedTuple):
    """A CAN bus of the robot.

    - ``bitrate``: bitrate in bit/s.
    - ``span``: source span of the bus in the robot file.
    - ``stated``: whether the robot file contains the bitrate.
    """

    name: str
    bitrate: int
    span: Span
    stated: bool = True


def whole_number(node: source.Node | None) -> int | None:
    """Returns the value of a YAML node that is a whole number, not an expression, or ``None``."""
    if node is None or type(node.value) is not int:
        return None
    return read_at(node.value, node.span)


def integer(scope: Scope, node: source.Node | None, default: int) -> int:
    """Returns a YAML value as a whole number.

    If the YAML value is missing or is not a whole number, returns ``default``.
    """
    if node is None:
        return default
    number = whole_number(node)
    if number is not None:
        return number
    value = scope.quantity(node, "ratio", float(default))
    if not value.is_integer():
        scope.report.add("wrong-type", f"expected a whole number, found `{value:g}`", node.span)
        return default
    return round(value)


def listed(known: Iterable[str]) -> str:
    """Returns a hint for an error message that lists the known names."""
    names = ", ".join(f"`{name}`" for name in known)
    return f"there are {names}" if names else "there are none"


# -- object dictionary -------------------------------------------------------------------

DEVICE_TYPE, ERROR_REGISTER, SYNC_COB_ID, EMCY_COB_ID = 0x1000, 0x1001, 0x1005, 0x1014
HEARTBEAT_CONSUMER, HEARTBEAT_PRODUCER, IDENTITY = 0x1016, 0x1017, 0x1018
LONGEST_TIME = 0xFFFF  # longest time in ms that fits into 16 bits
# Index of the communication parameters of the first PDO.  In the object dictionary, the mapping
# parameters of a PDO are 0x200 above its communication parameters.
RPDO, TPDO = 0x1400, 0x1800
EVENT_TIMER = 5  # subindex of the communication parameters
AT_SYNC, ON_EVENT = 1, 255  # values of the PDO transmission type


def objects_of(
    device: Device, node: Node, frames: Sequence[FrameDefinition], report: Report
) -> Sequence[tuple[ObjectValue, Span]]:
    """Returns the object dictionary entries of a CANopen node in the order of their indices.

    Each entry has the source span of the document that states it.

    Returns an empty tuple if the CANopen node has no SDO service, because object dictionary entries
    are written by SDO.
    """
    if not node.is_canopen or not any(f.kind == "sdo" for f in frames):
        return ()
    objects: dict[tuple[int, int], tuple[ObjectValue, Span]] = {}
    for entry, span in (*_own(device, report), *_derived(device, node, frames, report)):
        key = (entry.index, entry.subindex)
        other = objects.setdefault(key, (entry, span))
        if other[0] is not entry:
            report.add(
                "can-object-duplicate",
                f"the object {_shown(*key)} is both `{other[0].name}` and `{entry.name}`",
                other[1],
                labels=[Label(span, f"`{entry.name}` is the same object")],
                hint="remove it from `objects` if another section already defines it",
            )
    for entry in _mapped(frames):
        objects.setdefault((entry.index, entry.subindex), (entry, device.can.where))
    return tuple(objects[key] for key in sorted(objects))


def type_range(name: str) -> tuple[int, int]:
    """Returns the smallest and the largest value of an object dictionary data type.

    - ``name``: name of the type, a key of ``OBJECT_TYPES``.
    """
    bits = OBJECT_TYPES[name][1]
    if name.startswith("integer"):
        return -(1 << (bits - 1)), (1 << (bits - 1)) - 1
    return 0, (1 << bits) - 1


def _shown(index: int, subindex: int) -> str:
    return f"{index:#06x}:{subindex}"


def _own(device: Device, report: Report) -> Iterator[tuple[ObjectValue, Span]]:
    """Yields the object dictionary entries of the section `objects`, with source spans."""
    wired = {wire.channel for wire in device.wires}
    channels = list(entries(device.channels))
    for name, node in entries(device.can.get("objects")).items():
        channel, value = node.get("channel"), node.get("value")
        if channel is not None and channel.value not in wired:
            if channel.value not in channels:
                report.add(
                    "channel-unknown",
                    f"the module has no channel `{channel.value}`",
                    channel.span,
                )
            continue
        type_name = device.scope.text(node.get("type"))
        index = integer(device.scope, node.get("index"), 0)
        subindex = integer(device.scope, node.get("subindex"), 0)
        if value is None or type_name not in OBJECT_TYPES:
            continue  # the schema check reports the missing or invalid value
        invalid = None if 0 <= subindex <= 0xFE else node.get("subindex")
        invalid = invalid if 0 <= index <= 0xFFFF else node.get("index")
        if invalid is not None:
            report.add(
                "can-object-range",
                f"`{name}` is the object {_shown(index, subindex)}; an index is 0 to 0xffff, "
                "a subindex 0 to 254",
                invalid.span,
            )
            continue
        low, high = type_range(type_name)
        number = round(device.scope.quantity(value, "ratio"))
        if not low <= number <= high:
            report.add(
                "can-object-range",
                f"`{name}` of `{device.path}` is {number}; its type `{type_name}` has the "
                f"range {low} to {high}",
                value.span,
                labels=[Label(device.span, "of this device")],
                hint="another unit of the device, a wider type, or lower limits of the motor",
            )
            continue
        yield ObjectValue(name, index, subindex, type_name, number), node.where


def _derived(
    device: Device, node: Node, frames: Sequence[FrameDefinition], report: Report
) -> Iterator[tuple[ObjectValue, Span]]:
    here = device.can.where
    for name, subindex, value in (
        ("vendor_id", 1, node.vendor_id),
        ("product_code", 2, node.product_code),
        ("revision_number", 3, node.revision_number),
        ("serial_number", 4, node.serial_number),
    ):
        yield ObjectValue(name, IDENTITY, subindex, "unsigned32", value, "ro"), here
    yield ObjectValue("device_type", DEVICE_TYPE, 0, "unsigned32", node.device_type, "ro"), here
    yield ObjectValue("error_register", ERROR_REGISTER, 0, "unsigned8", None, "ro"), here
    for frame in frames:
        if frame.kind == "heartbeat" and frame.period is not None:
            time = _milliseconds(device, "heartbeat_period", frame.period, report)
            yield ObjectValue("heartbeat_period", HEARTBEAT_PRODUCER, 0, "unsigned16", time), here
        elif frame.kind == "emcy":
            cob_id = frame.cob_id
            yield ObjectValue("emcy_cob_id", EMCY_COB_ID, 0, "unsigned32", cob_id), here
    if node.heartbeat_consumer_time is not None:
        key = "heartbeat_consumer_time"
        time = _milliseconds(device, key, node.heartbeat_consumer_time, report)
        watched = MASTER_ID << 16 | time
        yield ObjectValue(key, HEARTBEAT_CONSUMER, 1, "unsigned32", watched), here
    if any(frame.synchronous for frame in frames):
        yield ObjectValue("sync_cob_id", SYNC_COB_ID, 0, "unsigned32", SYNC), here
    numbers: dict[tuple[bool, int], FrameDefinition] = {}
    for frame in frames:
        if frame.pdo is None:
            continue
        other = numbers.setdefault((frame.producer == MASTER, frame.pdo), frame)
        if other is frame:
            for entry in _pdo(device, frame, report):
                yield entry, frame.span
        else:
            report.add(
                "can-pdo-mapping",
                f"two PDOs of one direction have the number {frame.pdo}",
                frame.span,
                labels=[Label(other.span, FIRST_USE)],
            )


def _pdo(device: Device, frame: FrameDefinition, report: Report) -> Iterator[ObjectValue]:
    """Yields the object dictionary entries that configure a PDO."""
    received = frame.producer == MASTER
    base = (RPDO if received else TPDO) + (frame.pdo or 1) - 1
    name = f"{'rpdo' if received else 'tpdo'}{frame.pdo}"
    kind = AT_SYNC if frame.synchronous else ON_EVENT
    yield ObjectValue(f"{name}_cob_id", base, 1, "unsigned32", frame.cob_id)
    yield ObjectValue(f"{name}_transmission_type", base, 2, "unsigned8", kind)
    if not received and not frame.synchronous:
        time = 0
        if frame.period is not None:
            time = _milliseconds(device, f"frames.{name}.period", frame.period, report)
        yield ObjectValue(f"{name}_event_timer", base, EVENT_TIMER, "unsigned16", time)
    base += 0x200
    yield ObjectValue(f"{name}_mapped_objects", base, 0, "unsigned8", len(frame.mapping))
    for i, (index, subindex, type_name) in enumerate(frame.mapping, 1):
        entry = index << 16 | subindex << 8 | OBJECT_TYPES[type_name][1]
        yield ObjectValue(f"{name}_mapping_{i}", base, i, "unsigned32", entry)


def _mapped(frames: Sequence[FrameDefinition]) -> Iterator[ObjectValue]:
    """Yields the object dictionary entries that are mapped into PDOs.

    The name of a mapped object is the name of the CAN signal with the same bits in the PDO.
    """
    for frame in frames:
        start = 0
        for index, subindex, type_name in frame.mapping:
            length = OBJECT_TYPES[type_name][1]
            name = next(
                (s.name for s in frame.signals if (s.start, s.length) == (start, length)),
                f"object_{index:04x}_{subindex}",
            )
            start += length
            access = "rw" if frame.producer == MASTER else "ro"
            yield ObjectValue(name, index, subindex, type_name, None, access)


def _milliseconds(device: Device, key: str, time: float, report: Report) -> int:
    """Converts a time from s to ms, which is the unit of times in the object dictionary.

    Reports an error if the time is not a whole number of milliseconds from 1 to 65535.
    """
    number = round(time * 1000)
    if not 1 <= number <= LONGEST_TIME or abs(time * 1000 - number) > 1e-6 * number:
        report.add(
            "can-object-range",
            f"`{key}` of `{device.path}` is {time * 1000:.6g} ms; CANopen has whole milliseconds "
            f"from 1 to {LONGEST_TIME}",
            device.span,
            labels=[Label(device.can.where, "stated here")],
        )
    return max(1, min(number, LONGEST_TIME))
