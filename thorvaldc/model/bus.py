"""The CAN bus in the model: nodes, frame definitions, signals and CANopen objects."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field

from thorvaldc.diagnostics import Span
from thorvaldc.model import quantities as si

Scalar = bool | int | float | str

# CANopen data types (CiA 301) that the model uses.
# Maps the name of each CANopen data type to the index of the data type and its length in bits.
OBJECT_TYPES = {
    "boolean": (0x0001, 1),
    "integer8": (0x0002, 8),
    "integer16": (0x0003, 16),
    "integer32": (0x0004, 32),
    "unsigned8": (0x0005, 8),
    "unsigned16": (0x0006, 16),
    "unsigned32": (0x0007, 32),
}
CIA_402 = 402
MASTER = "master"
"""Name of the base driver as a producer or consumer of frames."""
CANOPEN = "canopen"
"""Id space of the CANopen node ids.  A node in another id space is no CANopen device."""
FLOAT32_MAX = (2.0 - 2.0**-23) * 2.0**127
"""Largest finite number of IEEE 754 with 32 bits."""
EXTENDED = 1 << 31
"""Bit of the key of an extended frame, the same as in DBC files and in SocketCAN.

Frames are known by their keys. The key of a standard frame is its identifier. The key of an
extended frame is its identifier plus this bit, so that the frames 0x123 with 11 and with 29 bits
differ.
"""


def key_text(key: int) -> str:
    """Return the identifier of a frame as text: 3 digits if it is standard, 8 if it is extended."""
    return f"0x{key ^ EXTENDED:08x}" if key & EXTENDED else f"{key:#05x}"


@dataclass(frozen=True, slots=True)
class Signal:
    """A field of a CAN frame: physical value = raw value * scale + offset.

    - ``start``: number of the least significant bit, of a big-endian signal the most significant
      one, as in a DBC file: bit n is bit n % 8 of byte n // 8.
    - ``length``: number of bits.
    - ``signed``: true if the raw value is an integer in two's complement.
    - ``unit``: unit of the physical value, rad or rad/s for a signal that belongs to a joint.
    - ``joint``: name of the joint that the signal belongs to, or ``None``.
    - ``multiplexer``: true if the signal selects which other signals the frame contains.
    - ``selected_by``: values of the multiplexer with which the frame contains the signal.
    - ``choices``: pairs of a raw value and its name.
    - ``floating_point``: true if the raw value is a number after IEEE 754 with 32 or 64 bits.
    - ``minimum``, ``maximum``: limits of the physical value, or ``None``.
    - ``description``: purpose of the signal.
    - ``big_endian``: true if the byte with the most significant bits comes first (Motorola).
    """

    name: str
    start: int
    length: int
    signed: bool = False
    scale: float = 1.0
    offset: float = 0.0
    unit: str = ""
    minimum: float | None = None
    maximum: float | None = None
    joint: str | None = None
    multiplexer: bool = False
    selected_by: tuple[int, ...] = ()
    choices: tuple[tuple[int, str], ...] = ()
    description: str = ""
    floating_point: bool = False
    big_endian: bool = False

    @property
    def first_bit(self) -> int:
        """Place of the first bit of the signal in the frame.

        Places count through all bytes from the end of a byte at which the signal begins: from the
        least significant bit of a little-endian signal, else from the most significant bit. The
        signal has the places ``first_bit`` to ``first_bit + length - 1``.
        """
        return self.start ^ 7 if self.big_endian else self.start

    @property
    def bits(self) -> list[int]:
        """The numbers of the bits of the signal, which count as ``start`` does."""
        places = range(self.first_bit, self.first_bit + self.length)
        return [place ^ 7 for place in places] if self.big_endian else list(places)

    @property
    def raw_range(self) -> tuple[int | float, int | float]:
        """The lowest and the highest finite raw value, integers unless ``floating_point``."""
        if self.floating_point:
            greatest = FLOAT32_MAX if self.length == 32 else sys.float_info.max
            return -greatest, greatest
        if self.signed:
            return -(1 << self.length - 1), (1 << self.length - 1) - 1
        return 0, (1 << self.length) - 1


@dataclass(frozen=True, slots=True)
class FrameDefinition:
    """The definition of a CAN frame: signals, nodes and timing.

    - ``name``, ``description``: name of the frame, unique on its bus, and its purpose.
    - ``cob_id``, ``length``: the identifier, and the number of bytes.
    - ``producer``, ``consumers``: names of nodes, or ``master``.
    - ``kind``: ``pdo``, ``sdo``, ``heartbeat``, ``emcy``, ``sync``, ``nmt``, ``broadcast`` or
      ``relay``. A ``relay`` frame is a CAN frame that the base driver forwards between another
      program and a device that the driver does not control.
    - ``period``, ``deadline``: times in s, or ``None`` for a frame that is sent on demand.
    - ``minimum_interval``: shortest time in s between two frames that are sent on demand, or
      ``None`` if the frame has no such limit.
    - ``response_time``: longest time in s from the instant at which the frame is due until the
      frame is received, or ``None`` if the time has no upper bound.
    - ``pdo``: number of the CANopen PDO, 1 to 512.
    - ``mapping``: objects in the PDO, each as (index, subindex, type).
    - ``synchronous``: true if the PDO is sent, or takes effect, when the SYNC frame is received.
    - ``extended``: true if the identifier has 29 bits, false if it has 11.

    The module ``bus_timing`` states how often a CAN frame without a period and without a minimum
    interval is assumed to be sent.
    """

    name: str
    cob_id: int
    kind: str
    producer: str
    consumers: tuple[str, ...]
    length: int
    period: si.Seconds | None
    deadline: si.Seconds | None
    signals: tuple[Signal, ...]
    span: Span
    description: str = ""
    minimum_interval: si.Seconds | None = None
    response_time: si.Seconds | None = None
    pdo: int | None = None
    mapping: tuple[tuple[int, int, str], ...] = ()
    synchronous: bool = False
    extended: bool = False

    @property
    def key(self) -> int:
        """The identifier, with the bit ``EXTENDED`` if it has 29 bits."""
        return self.cob_id | EXTENDED if self.extended else self.cob_id

    @property
    def arbitration(self) -> int:
        """The lowest of these numbers wins the arbitration; a standard frame wins over an extended
        one whose identifier begins with the same 11 bits."""
        return self.cob_id << 1 | 1 if self.extended else self.cob_id << 19


@dataclass(frozen=True, slots=True)
class Channel:
    """A channel of a motor controller.

    - ``role``: ``propulsion`` or ``steering``.
    - ``actuator``: name of the actuator on the channel, or ``None`` if no actuator is connected.
    """

    name: str
    role: str
    actuator: str | None


@dataclass(frozen=True, slots=True)
class ObjectValue:
    """An object dictionary entry of a CANopen node, with the required value of the entry.

    - ``index``, ``subindex``: address of the entry.
    - ``type``: name of the data type, one of ``OBJECT_TYPES``.
    - ``access``: ``ro`` (read only) or ``rw`` (read and write). A read-only object dictionary entry
      identifies the node, so the node must report the required value.
    - ``value``: the required value. The required value is ``None`` if the object dictionary entry
      changes while the node runs, or if the robot requires no value.
    """

    name: str
    index: int
    subindex: int
    type: str
    value: int | None
    access: str = "rw"


@dataclass(frozen=True, slots=True)
class DescribedObject:
    """An entry of the object dictionary of a device, as the EDS of the device describes it.

    - ``index``, ``subindex``: address of the entry.
    - ``type``: name of the data type, one of ``OBJECT_TYPES``, or empty for another type.
    - ``access``: access as in the EDS, such as ``ro`` or ``rww``, or empty.
    - ``value``: value of a new device, or ``None``. The node id is added if ``adds_node_id``.
    - ``lower``, ``upper``: limits of the value, or ``None``.
    """

    index: int
    subindex: int
    type: str
    access: str
    value: int | None
    adds_node_id: bool
    lower: int | None
    upper: int | None


@dataclass(frozen=True, slots=True)
class Node:
    """A device on a CAN bus.

    - ``module``: path of the module that the device belongs to.
    - ``protocol``: name of the driver of the device, such as ``cia402`` or ``roboteq``.
    - ``id``: the number of the node, unique within the ``id_space``. The id is 0 if the device has
      no id, such as a device that the base driver does not control.
    - ``id_space``: name of a group of ids. The ids of batteries and the node ids of CANopen nodes
      (``CANOPEN``) are separate groups. The name of the group is empty if the device has no id.
    - ``automatic``: true if the compiler chose the id. The lock file of the robot stores the node
      ids that the compiler chose.
    - ``vendor_id``, ``product_code``, ``revision_number``: values of the CANopen object 0x1018.
    - ``device_type``: value of the CANopen object 0x1000.
    - ``lss``: true if the node id can be written by LSS (CiA 305).
    - ``heartbeat_timeout``: time in s without a heartbeat of the node after which the master
      considers the node lost, or ``None`` if the master does not supervise the node.
    - ``heartbeat_consumer_time``: time in s without a heartbeat of the master after which the node
      considers the master lost (object 0x1016), or ``None`` if the node does not supervise the
      master.
    - ``command_watchdog``: time in s without commands after which the program of the node stops the
      motors, or ``None``. The time cannot be changed over the bus.
    - ``watchdog_coasts``: true if this program does not brake, so that the motors coast.
    - ``bitrates``: the supported bit rates in bit/s. An empty list of bit rates means that the node
      supports any bit rate.
    - ``objects``: required values of the object dictionary, sorted by index and subindex.
    - ``serial``: serial number as the robot file states it, or ``None``.
    - ``channels``: the channels of a motor controller.
    - ``properties``: values of the device in SI units, by name.
    - ``described``: object dictionary of the device after its EDS, or empty if its module names
      none. Only the simulated device needs it; the JSON text of the model omits it.
    """

    name: str
    module: str
    protocol: str
    id: int
    id_space: str
    vendor_id: int | None
    serial: str | None
    channels: tuple[Channel, ...]
    properties: tuple[tuple[str, Scalar], ...]
    span: Span
    automatic: bool = False
    product_code: int | None = None
    revision_number: int | None = None
    device_type: int | None = None
    lss: bool = False
    heartbeat_timeout: si.Seconds | None = None
    heartbeat_consumer_time: si.Seconds | None = None
    bitrates: tuple[si.BitsPerSecond, ...] = ()
    objects: tuple[ObjectValue, ...] = ()
    command_watchdog: si.Seconds | None = None
    watchdog_coasts: bool = False
    described: tuple[DescribedObject, ...] = field(default=(), compare=False, repr=False)

    @property
    def is_canopen(self) -> bool:
        """True if the id of the node is a CANopen node id."""
        return self.id_space == CANOPEN

    @property
    def serial_number(self) -> int | None:
        """Serial number as in the CANopen object 0x1018:4, or ``None`` if ``serial`` is no 32-bit
        integer."""
        try:
            number = int(self.serial or "", 0)
        except ValueError:
            return None
        return number if 0 <= number <= 0xFFFFFFFF else None

    @property
    def is_cia402(self) -> bool:
        """True if the node is a CiA 402 drive, according to its CANopen device type."""
        return self.device_type is not None and self.device_type & 0xFFFF == CIA_402


@dataclass(frozen=True, slots=True)
class Bus:
    """A CAN bus with its nodes and its CAN frames.

    - ``name``: name of the bus, such as ``main``.
    - ``nodes``, ``frames``: devices on the bus, and the frames that they and the master send.
    - ``bitrate``: bit rate in bit/s.
    - ``sync_period``: period of the control cycle in s.
    - ``master_id``: CANopen node id of the master.
    - ``load``: worst-case bus load, 0 to 1.
    """

    name: str
    bitrate: si.BitsPerSecond
    sync_period: si.Seconds
    nodes: tuple[Node, ...]
    frames: tuple[FrameDefinition, ...]
    span: Span
    master_id: int = 127
    load: si.Share = 0.0

    @property
    def described_nodes(self) -> list[Node]:
        """The nodes whose object dictionary is known."""
        return [node for node in self.nodes if node.objects]


# -- motors of CiA 402 drives --------------------------------------------------------------

FIRST_INDEX, STRIDE, MOTORS = 0x6000, 0x800, 8
"""First object index of motor 0, difference between the object indices of two successive motors,
and the largest number of motors (CiA 402)."""


def motor_numbers(bus: Bus, node: Node) -> tuple[int, ...]:
    """Return the number of the motor of each channel of a CiA 402 drive, from 0.

    The objects in the PDOs with the signals of a channel decide, and not the order in which the
    module lists its channels, because the driver finds a value by the name of its signal.  Without
    such PDOs the motors are numbered in the order of the channels.
    """
    channels = [channel.name for channel in node.channels]
    numbers: dict[str, int] = {}
    for frame in bus.frames:
        if not frame.mapping or node.name not in (frame.producer, *frame.consumers):
            continue
        signals, bit = {signal.start: signal.name for signal in frame.signals}, 0
        for index, _, kind in frame.mapping:
            name, number = signals.get(bit, ""), (index - FIRST_INDEX) // STRIDE
            bit += OBJECT_TYPES[kind][1]
            for channel in channels:
                if name.startswith(f"{channel}_") and 0 <= number < MOTORS:
                    numbers.setdefault(channel, number)
    in_order = tuple(numbers[channel] for channel in channels if channel in numbers)
    if len(set(in_order)) < len(channels):
        return tuple(range(len(channels)))
    return in_order
